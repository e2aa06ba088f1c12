"""The probabilistic single-target executor of ViTL V-C, and the loop of planner and executor.

From the paper: the robot reaches a target that was observed before directly. For any other target
it explores. With probability p_obs it finds and reaches the target. Else it encounters a different
object, and the planner is asked again.

The paper leaves some points open. Here:

- The world has the six categories of HM3D and the task's own objects, one place each. The different
  object is drawn uniformly from those not yet seen, without the target. If there is none, the
  attempt shows nothing new.
- An object that was seen or reached stays known. To go there (again) needs no exploration.
- To encounter an object is not to reach it: only a reached target advances the automaton.
- No object is unreachable, so the failed set B stays empty.
- The planner is asked before every attempt, not only after a change.
- A run ends at the first accepting state (as algorithm 1), when success has become impossible, when
  the planner stops, or after `MAX_DECISIONS`.
- An object that the formula does not name counts as "nothing reached" in the automaton.

Note: with five other objects unknown, each is encountered with probability (1 - p_obs) / 5. So at
p_obs < 1/6 the robot finds a given object sooner when it looks for another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from edge.mission.logic.automaton import Automaton

NOTHING, DONE = -1, -2
"""A planner's answers other than an object: let a step pass, and stop.

`NOTHING` is also an index: -1 is the last column of `PlanningProblem.moves`.
"""

MAX_DECISIONS = 500

OUTCOMES = ("complete", "violated", "gave up", "out of attempts")
COMPLETE, VIOLATED, GAVE_UP, OUT_OF_ATTEMPTS = range(len(OUTCOMES))


@dataclass(frozen=True, eq=False, slots=True)
class PlanningProblem:
    """A task's automaton, extended to all objects of its world.

    The automaton is delexicalised: its propositions are a, b, … in place of the objects' names.

    Attributes:
        automaton: over the objects that the formula names.
        n_propositions: number of objects that the formula names; they come first.
        moves: (n_states, n_objects + 1) int32 next states; the last column is "nothing reached".
        accepting: (n_states,) bool.
        steps_left: (n_states,) int32, fewest reached objects to acceptance, -1 if impossible.
    """

    automaton: Automaton
    n_propositions: int
    n_objects: int
    moves: np.ndarray
    accepting: np.ndarray
    steps_left: np.ndarray

    @classmethod
    def of(cls, automaton: Automaton, others: int) -> PlanningProblem:
        """Build the problem of an automaton in a world with `others` unnamed objects."""
        n_named = len(automaton.propositions)
        by_object, nothing = automaton.delta[:, :n_named], automaton.delta[:, n_named:]
        moves = np.hstack([by_object, np.repeat(nothing, others, axis=1), nothing])
        return cls(
            automaton, n_named, n_named + others, moves,
            automaton.accepting, automaton.steps_left,
        )  # fmt: skip


class PlannerInput(NamedTuple):
    """The input of a planner.

    Attributes:
        seen: bit i is set if object i's place is known; reached objects are included.
        reached: bit i is set if object i was reached.
        order: the reached objects, in order.
        current: the target of the attempt that has just failed, else `NOTHING`.
        draw: uniform in [0, 1), for planners that choose at random.
    """

    state: int
    seen: int = 0
    reached: int = 0
    order: tuple[int, ...] = ()
    current: int = NOTHING
    draw: float = 0.0


ChooseTarget = Callable[[PlannerInput], int]
"""A planner: returns an object's index, `NOTHING` or `DONE`."""


class EpisodeResult(NamedTuple):
    """The result of one run of a planner on a task.

    Attributes:
        outcome: index into `OUTCOMES`.
        explorations: attempts on targets whose place was not known (the paper's attempts).
        steps: explorations and direct reaches.
    """

    outcome: int
    explorations: int
    steps: int


def draws_of(seed: int, task: int, p_obs: float, episode: int) -> np.ndarray:
    """Return random numbers for an episode: luck, encountered object, the planner's own draw.

    They depend only on the arguments, so all planners have the same luck in the same attempt
    (common random numbers), and differences between planners are paired.

    Returns:
        (MAX_DECISIONS, 3) float64, uniform in [0, 1).
    """
    counter = np.array([0, 0, episode, round(p_obs * 1e6)], dtype=np.uint64)
    key = np.array([seed, task], dtype=np.uint64)
    bits = np.random.Philox(counter=counter, key=key)
    return np.random.Generator(bits).random((MAX_DECISIONS, 3))


def run_episode(
    problem: PlanningProblem, p_obs: float, choose: ChooseTarget, draws: np.ndarray, seen: int = 0
) -> EpisodeResult:
    """Ask the planner and attempt its target, until the run ends.

    An exploration finds its target with probability `p_obs`. Row i of `draws` (see `draws_of`)
    serves the i-th decision. `seen` is a bit mask of objects whose places are known from the start.
    """
    state, reached, order, current = 0, 0, (), NOTHING
    explorations = steps = 0
    for luck, meeting, chance in draws.tolist():
        if problem.accepting[state]:
            return EpisodeResult(COMPLETE, explorations, steps)
        if problem.steps_left[state] < 0:
            return EpisodeResult(VIOLATED, explorations, steps)
        target = choose(PlannerInput(state, seen, reached, order, current, chance))
        if target == DONE:
            return EpisodeResult(GAVE_UP, explorations, steps)
        if target != NOTHING:
            steps += 1
            if not seen >> target & 1:  # its place is not known
                explorations += 1
                if luck >= p_obs:
                    seen |= _encountered(seen | 1 << target, problem.n_objects, meeting)
                    current = target
                    continue  # the attempt has failed: ask again in the same state
            seen |= 1 << target
            reached |= 1 << target
            order = (*order, target)
        current = NOTHING
        state = int(problem.moves[state, target])
    outcome = COMPLETE if problem.accepting[state] else OUT_OF_ATTEMPTS
    return EpisodeResult(outcome, explorations, steps)


def _encountered(excluded: int, n_objects: int, draw: float) -> int:
    """Return the bit of one of the objects not in `excluded`; 0 if there are none."""
    bits = _bits_outside(excluded, n_objects)
    return bits[int(draw * len(bits))] if bits else 0


@cache
def _bits_outside(excluded: int, n_objects: int) -> tuple[int, ...]:
    return tuple(1 << i for i in range(n_objects) if not excluded >> i & 1)

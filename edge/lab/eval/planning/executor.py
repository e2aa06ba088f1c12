"""The probabilistic single-target executor of ViTL V-C, and the loop of planner and executor.

What the paper says: a target that was observed before is reached directly. For any other the
robot explores: with probability p_obs it finds (and reaches) the intended target, else it
encounters a different object, and the planner is asked again.

What the paper leaves open, and how it is here:

- The world has the six categories of HM3D and the task's own objects, one place each. The
  different object is drawn uniformly from those not yet seen, the intended one left out. When
  there is none, the attempt shows nothing new.
- An object once seen or reached stays known: going there (again) needs no exploration.
- Encountering is not reaching: only a reached target advances the automaton.
- Nothing ever fails for good, so the failed set B stays empty.
- The planner is asked before every attempt, not only when something changed.
- A run ends at the first accepting state (as algorithm 1), when success has become impossible,
  when the planner gives up, or after `MAX_DECISIONS`.
- An object that the formula does not name counts as "nothing reached" in the automaton.

Mind that with five others unknown each of them turns up with probability (1 - p_obs) / 5: at
p_obs < 1/6 a given object is found sooner by looking for something else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from edge.mission.logic.automaton import Automaton

NOTHING, DONE, INVALID = -1, -2, -3
"""A planner's answers other than an object: let a step pass, stop, no usable answer."""

MAX_DECISIONS = 500

OUTCOMES = ("complete", "violated", "gave up", "invalid answer", "out of attempts")
COMPLETE, VIOLATED, GAVE_UP, NO_ANSWER, OUT_OF_ATTEMPTS = range(len(OUTCOMES))


@dataclass(frozen=True, eq=False, slots=True)
class Problem:
    """A lifted task's automaton over all objects of its world.

    Attributes:
        automaton: over the objects that the formula names.
        n_letters: objects that the formula names; they are the first of the `n_objects`.
        moves: (n_states, n_objects + 1) int32 next states; the last column is "nothing reached".
        accepting: (n_states,) bool.
        steps_left: (n_states,) int32, fewest reached objects to acceptance, -1 if impossible.
    """

    automaton: Automaton
    n_letters: int
    n_objects: int
    moves: np.ndarray
    accepting: np.ndarray
    steps_left: np.ndarray

    @classmethod
    def of(cls, automaton: Automaton, others: int) -> Problem:
        """
        Args:
            others: objects in the world that the formula does not name.
        """
        n_letters = len(automaton.letters)
        by_letter, nothing = automaton.delta[:, :n_letters], automaton.delta[:, n_letters:]
        moves = np.hstack([by_letter, np.repeat(nothing, others, axis=1), nothing])
        return cls(
            automaton, n_letters, n_letters + others, moves,
            automaton.accepting, automaton.steps_left,
        )  # fmt: skip


class Situation(NamedTuple):
    """What a planner is asked about.

    Attributes:
        state: of the automaton.
        seen: bit i is set when object i's place is known; reached ones are among them.
        reached: bit i is set when object i was reached.
        order: the objects in the order of being reached.
        current: the target of the attempt just made in vain, else `NOTHING`.
        draw: uniform in [0, 1), for planners that decide by chance.
    """

    state: int
    seen: int = 0
    reached: int = 0
    order: tuple[int, ...] = ()
    current: int = NOTHING
    draw: float = 0.0


Choose = Callable[[Situation], int]
"""A planner: an object's index, `NOTHING`, `DONE` or `INVALID`."""


class Episode(NamedTuple):
    """How a run ended.

    Attributes:
        outcome: index into `OUTCOMES`.
        explorations: attempts on targets whose place was not known (the paper's attempts).
        steps: explorations and direct reaches.
    """

    outcome: int
    explorations: int
    steps: int


def draws_of(seed: int, task: int, p_obs: float, episode: int) -> np.ndarray:
    """(MAX_DECISIONS, 3) float64 uniform in [0, 1): luck, what is met, the planner's own chance.

    They depend on nothing but the arguments, so all planners meet the same luck in the same
    attempt (common random numbers) and differences between them are paired.
    """
    counter = np.array([0, 0, episode, round(p_obs * 1e6)], dtype=np.uint64)
    key = np.array([seed, task], dtype=np.uint64)
    bits = np.random.Philox(counter=counter, key=key)
    return np.random.Generator(bits).random((MAX_DECISIONS, 3))


def run_episode(
    problem: Problem, p_obs: float, choose: Choose, draws: np.ndarray, seen: int = 0
) -> Episode:
    """Ask the planner and attempt what it says, until the run ends.

    Args:
        draws: see `draws_of`; row i serves the i-th decision.
        seen: objects whose places are known from the start (bit mask).
    """
    state, reached, order, current = 0, 0, (), NOTHING
    explorations = steps = 0
    for luck, meeting, chance in draws.tolist():
        if problem.accepting[state]:
            return Episode(COMPLETE, explorations, steps)
        if problem.steps_left[state] < 0:
            return Episode(VIOLATED, explorations, steps)
        target = choose(Situation(state, seen, reached, order, current, chance))
        if target < NOTHING:
            return Episode(GAVE_UP if target == DONE else NO_ANSWER, explorations, steps)
        if target != NOTHING:
            steps += 1
            if not seen >> target & 1:
                explorations += 1
                if luck >= p_obs:
                    seen |= _encountered(seen | 1 << target, problem.n_objects, meeting)
                    current = target
                    continue
            seen |= 1 << target
            reached |= 1 << target
            order = (*order, target)
        current = NOTHING
        state = int(problem.moves[state, target])
    outcome = COMPLETE if problem.accepting[state] else OUT_OF_ATTEMPTS
    return Episode(outcome, explorations, steps)


def _encountered(excluded: int, n_objects: int, draw: float) -> int:
    """The bit of one of the objects not in `excluded`; 0 when there are none."""
    bits = _bits_outside(excluded, n_objects)
    return bits[int(draw * len(bits))] if bits else 0


@cache
def _bits_outside(excluded: int, n_objects: int) -> tuple[int, ...]:
    return tuple(1 << i for i in range(n_objects) if not excluded >> i & 1)

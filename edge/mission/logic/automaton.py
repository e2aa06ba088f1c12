"""The automaton of a mission: the objects and orders of reaching them that fulfil the formula.

In each step of a trace, the robot reaches one object or nothing, as in ViTL IV-A1.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from edge.mission.logic import compiler as own_compiler
from edge.mission.logic import spot_compiler
from edge.mission.logic.limits import MAX_STATES, MAX_STEPS, CompileBudget, CompileError
from edge.mission.logic.ltl import Formula, propositions

__all__ = [
    "NOTHING", "Automaton", "CompileError", "compile_formula", "implies", "shortest_trace",
]  # fmt: skip

# Name → function that returns the arrays `delta` and `accepting` of a formula.
COMPILERS = {"own": own_compiler.minimal_automaton, "spot": spot_compiler.minimal_automaton_by_spot}
NOTHING = ""
"""The entry of a trace for a step in which no object of the formula is reached."""


@dataclass(frozen=True, eq=False)
class Automaton:
    """The minimal complete deterministic automaton of a formula over finite traces.

    In each step one proposition is true, or none (`NOTHING`). States are numbered breadth-first
    from the initial state 0, propositions in their order. So two formulas with the same
    propositions are equivalent exactly if their arrays are equal.

    Attributes:
        propositions: its propositions, in order of first appearance.
        delta: (n_states, len(propositions) + 1) int32, the next state for each proposition; the
            last column is NOTHING.
        accepting: (n_states,) bool.
        steps_left: (n_states,) int32, the fewest objects to reach until acceptance; steps without
            an object are free. -1 if success is impossible.
    """

    formula: Formula
    propositions: tuple[str, ...]
    delta: np.ndarray
    accepting: np.ndarray
    steps_left: np.ndarray

    @property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.delta)

    @cached_property
    def _column(self) -> dict[str | None, int]:
        return {name: k for k, name in enumerate(self.propositions)}

    def step(self, state: int, proposition: str | None) -> int:
        """Return the state after one step; a proposition outside the formula counts as NOTHING."""
        return int(self.delta[state, self._column.get(proposition, len(self.propositions))])

    def run(self, trace: Sequence[str | None]) -> int:
        """Return the state after a trace."""
        state = 0
        for proposition in trace:
            state = self.step(state, proposition)
        return state

    def accepts(self, trace: Sequence[str | None]) -> bool:
        """Return True if a trace fulfils the formula."""
        return bool(self.accepting[self.run(trace)])

    def is_dead(self, state: int) -> bool:
        """Return True if success is impossible from this state."""
        return bool(self.steps_left[state] < 0)

    @property
    def possible(self) -> tuple[str, ...]:
        """The propositions that can be true in some step of a trace that fulfils the formula.

        The others are only forbidden.
        """
        alive = [q for q in range(self.n_states) if not self.is_dead(q)]
        return tuple(
            name
            for name in self.propositions
            if any(not self.is_dead(self.step(q, name)) for q in alive)
        )

    def edges(self, state: int) -> Iterator[tuple[str, int]]:
        """Return pairs of a proposition and the next state, NOTHING last."""
        return zip((*self.propositions, NOTHING), self.delta[state].tolist(), strict=True)


def compile_formula(
    formula: Formula,
    max_states: int = MAX_STATES,
    max_steps: int = MAX_STEPS,
    compiler: Literal["own", "spot"] = "own",
) -> Automaton:
    """Return the automaton of a formula; both compilers return the same one.

    Args:
        formula: the formula.
        max_states: limit of the states of the result and of each intermediate automaton.
        max_steps: limit of the work, see `edge.mission.logic.limits`.
        compiler: "own", or "spot" for the library Spot.

    Raises:
        CompileError: a limit was exceeded.
        UserError: "spot" was chosen, and its Python bindings are not installed.

    Example:
        >>> from edge.mission.logic.ltl import parse
        >>> automaton = compile_formula(parse("F (bed & F sofa)"))
        >>> automaton.accepts(["bed", "sofa"]), automaton.accepts(["sofa", "bed"])
        (True, False)
    """
    budget = CompileBudget(max_states, max_steps)
    names = propositions(formula)
    delta, accepting = COMPILERS[compiler](formula, names, budget)
    return Automaton(formula, names, delta, accepting, steps_left(delta, accepting, budget))


def shortest_trace(
    first: Automaton, second: Automaton, wanted: Callable[[int, int], bool]
) -> tuple[str, ...] | None:
    """Return a shortest trace to a pair of states that `wanted` accepts; None if there is none."""
    names = (*dict.fromkeys((*first.propositions, *second.propositions)), NOTHING)
    seen = {(0, 0)}
    queue: deque[tuple[int, int, tuple[str, ...]]] = deque([(0, 0, ())])
    while queue:
        s, t, trace = queue.popleft()
        if wanted(s, t):
            return trace
        for name in names:
            pair = first.step(s, name), second.step(t, name)
            if pair not in seen:
                seen.add(pair)
                queue.append((*pair, (*trace, name)))
    return None


def implies(first: Automaton, second: Automaton) -> bool:
    """Return True if every trace that fulfils the first formula fulfils the second."""
    # `a > b` of two bools: a, and not b.
    example = shortest_trace(first, second, lambda s, t: first.accepting[s] > second.accepting[t])
    return example is None


def steps_left(delta: np.ndarray, accepting: np.ndarray, budget: CompileBudget) -> np.ndarray:
    """Return `Automaton.steps_left`: shortest paths to acceptance, by relaxation of all states."""
    far = len(delta)  # more than any path
    left = np.where(accepting, 0, far).astype(np.int32)
    while True:
        budget.spend_cells(delta.size)
        left_after = left[delta]
        by_object = left_after[:, :-1].min(axis=1, initial=far) + 1
        new = np.minimum(left, np.minimum(by_object, left_after[:, -1]))
        if np.array_equal(new, left):
            return np.where(left >= far, -1, left).astype(np.int32)
        left = new

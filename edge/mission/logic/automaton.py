"""The automaton of a mission: which objects, reached in which order, fulfil the formula.

Words have "one reached object or nothing" per step, as in ViTL IV-A1, where a transition is
taken when the robot reaches an object.
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
from edge.mission.logic.limits import MAX_STATES, MAX_STEPS, CompileError, Effort
from edge.mission.logic.ltl import Formula, propositions

__all__ = [
    "NOTHING", "Automaton", "CompileError", "compile_formula", "implies", "shortest_word",
]  # fmt: skip

COMPILERS = {"own": own_compiler.language, "spot": spot_compiler.language}
NOTHING = ""  # the letter of a step in which nothing of the formula is reached


@dataclass(frozen=True, eq=False)
class Automaton:
    """The minimal complete deterministic automaton of a formula over finite words.

    States are numbered breadth-first from the initial state 0, letters in their order; so two
    formulas with the same letters mean the same exactly when their arrays are equal.

    Attributes:
        formula: what was compiled.
        letters: its propositions, in order of first appearance.
        delta: (n_states, len(letters) + 1) int32, the next state per letter; the last column is
            NOTHING.
        accepting: (n_states,) bool.
        steps_left: (n_states,) int32, the fewest objects to reach until acceptance (steps in
            which nothing is reached are free); -1 where success is impossible.
    """

    formula: Formula
    letters: tuple[str, ...]
    delta: np.ndarray
    accepting: np.ndarray
    steps_left: np.ndarray

    @property
    def n_states(self) -> int:
        return len(self.delta)

    @cached_property
    def _column(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.letters)}

    def step(self, state: int, letter: str | None) -> int:
        """The state after one step; a letter that the formula lacks is NOTHING."""
        return int(self.delta[state, self._column.get(letter or NOTHING, len(self.letters))])

    def run(self, word: Sequence[str | None]) -> int:
        """The state after a word."""
        state = 0
        for letter in word:
            state = self.step(state, letter)
        return state

    def accepts(self, word: Sequence[str | None]) -> bool:
        """Whether a word fulfils the formula."""
        return bool(self.accepting[self.run(word)])

    def dead(self, state: int) -> bool:
        """Whether no continuation leads to acceptance."""
        return bool(self.steps_left[state] < 0)

    def edges(self, state: int) -> Iterator[tuple[str, int]]:
        """Letters and the states they lead to, NOTHING last."""
        return zip((*self.letters, NOTHING), self.delta[state].tolist(), strict=True)


def compile_formula(
    formula: Formula,
    max_states: int = MAX_STATES,
    max_steps: int = MAX_STEPS,
    compiler: Literal["own", "spot"] = "own",
) -> Automaton:
    """The automaton of a formula; it is the same from either compiler.

    Args:
        max_states: the most states that it, or any automaton on the way to it, may have.
        max_steps: the most steps of work that may be taken, see `edge.mission.logic.limits`.

    Raises:
        CompileError: a limit was passed.
        UserError: Spot was chosen, and its real bindings are not there.
    """
    effort = Effort(max_states, max_steps)
    letters = propositions(formula)
    delta, accepting = COMPILERS[compiler](formula, letters, effort)
    return Automaton(formula, letters, delta, accepting, steps_left(delta, accepting, effort))


def shortest_word(
    first: Automaton, second: Automaton, wanted: Callable[[int, int], bool]
) -> tuple[str, ...] | None:
    """A shortest word after which the states of two automata are a wanted pair; None if none is."""
    letters = (*dict.fromkeys((*first.letters, *second.letters)), NOTHING)
    seen = {(0, 0)}
    queue: deque[tuple[int, int, tuple[str, ...]]] = deque([(0, 0, ())])
    while queue:
        s, t, word = queue.popleft()
        if wanted(s, t):
            return word
        for letter in letters:
            pair = first.step(s, letter), second.step(t, letter)
            if pair not in seen:
                seen.add(pair)
                queue.append((*pair, (*word, letter)))
    return None


def implies(first: Automaton, second: Automaton) -> bool:
    """Whether every word that fulfils the first formula fulfils the second."""
    told_apart = shortest_word(first, second, lambda s, t: first.accepting[s] > second.accepting[t])
    return told_apart is None


def steps_left(delta: np.ndarray, accepting: np.ndarray, effort: Effort) -> np.ndarray:
    """See `Automaton.steps_left`."""
    far = len(delta)
    left = np.where(accepting, 0, far).astype(np.int32)
    while True:
        effort.spend_cells(delta.size)
        reach = left[delta]
        new = np.minimum(left, np.minimum(reach[:, :-1].min(axis=1, initial=far) + 1, reach[:, -1]))
        if np.array_equal(new, left):
            return np.where(left >= far, -1, left).astype(np.int32)
        left = new

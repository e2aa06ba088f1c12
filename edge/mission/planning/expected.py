"""The expected-cost planner: a stochastic shortest path over automaton and knowledge.

ViTL's planner takes every unknown object for one attempt away. Here a search may show another
object first, and the plan with the least expected cost under that model is found exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge.config import PlannerExpected, PlannerVitl
from edge.errors import UserError
from edge.mission.automaton import NOTHING, Automaton
from edge.mission.planning import plan_kernels as kernels
from edge.mission.planning.plan import ACCEPTED, DEAD, Knowledge, Plan, explain
from edge.mission.planning.vitl import W_NOTHING, VitlPlanner, working_order
from edge.perception.prior import table

MAX_LETTERS = 12
MAX_VALUES = 1 << 18
"""Entries of a table of values: 2 MiB. The largest, nine objects in any order, takes about 10 ms
to solve, which a tick can bear: it comes when a mission begins and when an object fails."""
_TABLES = 2
_LEAST_SHARE = 0.1
"""A prior never takes p_obs down to less than this share of it."""


class PlannerError(UserError):
    """A planner cannot take on this formula."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Values of one set of failed objects.

    Attributes:
        usable: (m,) int64, letters that have not failed; bit i of a set stands for usable[i].
        p_find: (2**m, m) float64, see `find_probabilities`.
        value: (2**m, e + 1, n) float64, least expected cost by set, by objects outside the
            formula that were not met, and by state.
    """

    usable: np.ndarray
    p_find: np.ndarray
    value: np.ndarray


class ExpectedPlanner:
    """Least expected cost to acceptance.

    Going to a known object costs `w_det` and succeeds. To search costs by time, and every look
    searches for all objects at once: while the robot searches for one, each unknown object is
    seen at a rate of `p_obs` an attempt (a search of length 1), independent of the others and of
    which one is the target. So one object takes 1 / p_obs attempts and two take 1.5 / p_obs. The
    target is reached when it is seen; another one is then known. No target makes others come
    sooner, so nothing is pursued merely for what may be met on the way: the target is what to go
    to if it is seen. An object whose reaching would make success impossible is never the target.

    With `prior: cooccurrence` the rate is times the lift of `Table.lift`, at most 1.
    Known are D and R, failed objects are neither available nor met.

    With `universe_extra` the model is ViTL V-C's executor instead (`edge.eval.planning.executor`):
    an attempt costs 1 and with probability p_obs finds and reaches its target; else one other
    object that is not known yet, each as likely, is seen but not reached, and where none is left
    nothing is learned. There the chance to meet an object does depend on the target: where p_obs
    is so low that an object is met sooner by chance, the best plan looks for another one.

    Values are solved at the first plan with a set of failed objects and kept for the last two.
    One thread at a time.
    """

    def __init__(
        self, config: PlannerExpected, automaton: Automaton, universe_extra: int | None = None
    ) -> None:
        """
        Args:
            universe_extra: plan for the paper's executor with so many objects outside the formula
                that may be met too; names in D and R that the formula lacks are taken off it.

        Raises:
            PlannerError: the table of values would be too large.
        """
        k, n = len(automaton.letters), automaton.n_states
        extra = universe_extra or 0
        values = n * (extra + 1) << k
        if k > MAX_LETTERS or values > MAX_VALUES:
            raise PlannerError(
                f"mission.planner: 'expected' cannot take on a formula with {k} objects and {n} "
                f"states: {values} values by state and known objects (at most {MAX_VALUES} and "
                f"{MAX_LETTERS} objects); choose kind: vitl"
            )
        self.config = config
        self.automaton = automaton
        self._extra = extra
        self._executor = universe_extra is not None
        self._w_known = max(config.w_det, 1.0 / kernels.SCALE)
        self._order = working_order(automaton)
        self._solved: dict[frozenset[str], Solution] = {}
        self._first = np.empty(k + 1)
        self._scratch = np.empty(k + 1)
        # Within a set of known objects no state comes twice, and there are at most k + 1 sets.
        self._path = np.empty(n * (k + 1) + 1, np.int32)

    def plan(self, state: int, knowledge: Knowledge, current: str | None = None) -> Plan:
        """See `Planner.plan`. `steps` is the way if every search finds its target first."""
        a = self.automaton
        if a.accepting[state]:
            return ACCEPTED
        if a.steps_left[state] < 0:
            return DEAD
        solution = self._solution(knowledge.failed.intersection(a.letters))
        known, extra = self._place(solution, knowledge)
        if not solution.value[known, extra, state] < np.inf:
            return VitlPlanner(PlannerVitl(), a).plan(state, knowledge, current)
        kernels.expected_first(
            a.delta, *self._model(solution), state, known, extra, self._first
        )  # fmt: skip
        names = (*a.letters, NOTHING)
        cost = self._first.tolist()
        ranked = sorted((c for c in range(len(names)) if cost[c] < np.inf), key=cost.__getitem__)
        tied = [c for c in ranked if cost[c] <= cost[ranked[0]] + kernels.TOLERANCE]
        ways = {c: self._follow(solution, state, known, extra, c) for c in tied}
        tied.sort(key=lambda c: (len(ways[c]), names[c] != current, c))
        first = tied[0]
        options = tuple((names[c], cost[c]) for c in (*tied, *ranked[len(tied) :]))
        reason = explain(names[first], options, knowledge, "about {:.2f} attempts".format)
        return Plan(names[first] or None, ways[first], cost[first], True, (), reason, options)

    def _follow(
        self, solution: Solution, state: int, known: int, extra: int, first: int
    ) -> tuple[str, ...]:
        a = self.automaton
        length = kernels.expected_follow(
            a.delta, a.accepting, *self._model(solution), state, known, extra, first,
            self._scratch, self._path,
        )  # fmt: skip
        names = (*a.letters, NOTHING)
        return tuple(names[c] for c in self._path[:length].tolist())

    def _model(self, solution: Solution) -> tuple[np.ndarray | float | bool, ...]:
        costs = (self._w_known, W_NOTHING)
        return solution.usable, solution.p_find, *costs, self._executor, solution.value

    def _place(self, solution: Solution, knowledge: Knowledge) -> tuple[int, int]:
        """What is known as a set of bits, and how many objects outside the formula are left."""
        letters = self.automaton.letters
        seen = knowledge.detected | knowledge.reached
        known = sum(1 << i for i, c in enumerate(solution.usable.tolist()) if letters[c] in seen)
        return known, max(self._extra - len(seen.difference(letters)), 0)

    def _solution(self, failed: frozenset[str]) -> Solution:
        if failed not in self._solved:
            if len(self._solved) == _TABLES:
                del self._solved[next(iter(self._solved))]
            self._solved[failed] = self._solve(failed)
        return self._solved[failed]

    def _solve(self, failed: frozenset[str]) -> Solution:
        a, c = self.automaton, self.config
        usable = np.array([i for i, x in enumerate(a.letters) if x not in failed], np.int64)
        p_find = find_probabilities(c, tuple(a.letters[i] for i in usable))
        value = np.empty((1 << usable.size, self._extra + 1, a.n_states))
        kernels.expected_costs(
            a.delta, a.accepting, self._order, usable, p_find, self._w_known, W_NOTHING,
            self._executor, value,
        )  # fmt: skip
        return Solution(usable, p_find, value)


def find_probabilities(config: PlannerExpected, names: tuple[str, ...]) -> np.ndarray:
    """Rate at which an object is seen (in the executor: probability that an attempt finds it), by
    what is known.

    Returns:
        (2**m, m) float64; bit i of the first index: names[i] is known.
    """
    m = len(names)
    p = np.full((1 << m, m), config.p_obs)
    if config.prior == "cooccurrence" and m:
        sets = (np.arange(1 << m)[:, None] >> np.arange(m)) & 1
        lift = table.load().lift(names)
        n_known = sets.sum(axis=1, keepdims=True)
        # A room drawn from those of the known objects; with none known, any room: lift 1.
        mean = np.where(n_known > 0, sets @ lift.T / np.maximum(n_known, 1), 1.0)
        p = np.clip(p * mean, _LEAST_SHARE * config.p_obs, 1.0)
    return p

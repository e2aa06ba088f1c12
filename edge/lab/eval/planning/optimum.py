"""The exact optimum of the paper's executor: the fewest explorations that can be expected.

A stochastic shortest path over automaton and knowledge, solved for all situations of a problem.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from edge.lab.eval.planning.executor import DONE, NOTHING, Problem, Situation
from edge.mission.planning.vitl import working_order

MAX_VALUES = 1 << 18
"""Entries of a table of values: 2 MiB."""
_DIRECT_COST, _WAIT_COST = 1e-5, 1e-6
"""Going to a known object and waiting only break ties between explorations."""


class Optimum:
    """A planner that is told p_obs and how many other objects there are.

    Targets are the formula's own objects, as for every planner. At p_obs < 1/6 one that explored
    on behalf of objects that the task does not name would gain
    (see `edge.lab.eval.planning.executor`).

    Attributes:
        value: (2**k, e + 1, n) float64, least expected cost by the set of known letters (bit i:
            letter i), by other objects that were not met, and by state; inf if there is no way.
        best: the letter to go to, likewise; int8, `DONE` if there is none.
    """

    def __init__(self, problem: Problem, p_obs: float) -> None:
        """
        Args:
            problem: one that is `solvable`.
        """
        self._others = problem.n_objects - problem.n_letters
        self._own = (1 << problem.n_letters) - 1
        automaton = problem.automaton
        shape = (self._own + 1, self._others + 1, automaton.n_states)
        self.value, self.best = np.empty(shape), np.full(shape, DONE, np.int8)
        order = working_order(automaton)
        least_costs(automaton.delta, problem.accepting, order, p_obs, self.value, self.best)

    def choose(self, situation: Situation) -> int:
        """See `edge.lab.eval.planning.executor.Choose`."""
        left = self._others - (situation.seen & ~self._own).bit_count()
        return int(self.best[situation.seen & self._own, left, situation.state])


def solvable(problem: Problem) -> bool:
    """Whether a problem is small enough for its optimum to be found."""
    others = problem.n_objects - problem.n_letters
    return (problem.automaton.n_states * (others + 1)) << problem.n_letters <= MAX_VALUES


@njit(nogil=True, cache=True)
def least_costs(delta, accepting, order, p_obs, value, best):
    """Least expected cost to acceptance, and what to go to, by what is known and by state.

    Knowledge only grows, so sets are solved from the full one down: what exploring leads to is
    then settled, and within a set only certain steps are left, a shortest path.

    An attempt on an object that is not known finds and reaches it with probability p; else another
    one that is not known is met, each as likely. Without another one it goes on until it is found.

    Args:
        delta: (n, k + 1) int32, the last column is the step that reaches nothing.
        accepting: (n,) bool.
        order: (m,) int32, states that are neither accepting nor dead.
        value, best: see `Optimum`, written.
    """
    k = delta.shape[1] - 1
    total = np.empty(delta.shape[0])
    for known in range(value.shape[0] - 1, -1, -1):
        for extra in range(value.shape[1]):
            here, go = value[known, extra], best[known, extra]
            here[:] = np.where(accepting, 0.0, np.inf)
            others = extra - 1
            total[:] = 0.0
            if extra > 0:
                total[:] = extra * value[known, extra - 1]
            for i in range(k):
                if known & (1 << i) == 0:
                    others += 1
                    total += value[known | (1 << i), extra]
            for i in range(k):
                if known & (1 << i):
                    continue
                after = value[known | (1 << i), extra]
                for s in order:
                    if others == 0:
                        cost = 1.0 / p_obs + after[delta[s, i]]
                    else:
                        met = (total[s] - after[s]) / others
                        cost = 1.0 + p_obs * after[delta[s, i]] + (1.0 - p_obs) * met
                    if cost < here[s]:  # not so if there is no way: inf, or inf - inf
                        here[s], go[s] = cost, i
            changed = True
            while changed:
                changed = False
                for s in order:
                    for i in range(k + 1):
                        if i == k:
                            cost = _WAIT_COST + here[delta[s, k]]
                        elif known & (1 << i):
                            cost = _DIRECT_COST + here[delta[s, i]]
                        else:
                            continue
                        if cost < here[s]:
                            here[s], go[s] = cost, NOTHING if i == k else i
                            changed = True

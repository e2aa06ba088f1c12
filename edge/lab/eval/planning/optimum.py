"""The exact optimum of the paper's executor: the lowest expected number of explorations.

It solves a stochastic shortest path over automaton states and knowledge (the objects whose places
are known).
"""

from __future__ import annotations

import numpy as np

from edge.jit import jit
from edge.lab.eval.planning.executor import DONE, NOTHING, PlannerInput, PlanningProblem
from edge.mission.planning.vitl import order_of_relaxation

_DIRECT_COST, _WAIT_COST = 1e-5, 1e-6
"""Costs of a known object and of waiting: small, so that they only break ties."""


class Optimum:
    """A planner that knows p_obs, the chance of an exploration, and the number of other objects.

    Targets are the formula's own objects, as for every planner. At p_obs < 1/6 it could gain by
    exploring for objects that the task does not name (see `edge.lab.eval.planning.executor`).

    Attributes:
        value: (2**k, e + 1, n) float64, least expected cost by the set of known propositions (bit
            i: proposition i), by the number of other objects not yet encountered, and by state; inf
            if there is no path.
        best: the next proposition, of the same shape; int8, `DONE` if there is none.
    """

    def __init__(self, problem: PlanningProblem, p_obs: float) -> None:
        self._others = problem.n_objects - problem.n_propositions
        self._named_bits = (1 << problem.n_propositions) - 1  # of the formula's own objects
        automaton = problem.automaton
        shape = (self._named_bits + 1, self._others + 1, automaton.n_states)
        self.value, self.best = np.empty(shape), np.full(shape, DONE, np.int8)
        order = order_of_relaxation(automaton)
        least_costs(automaton.delta, problem.accepting, order, p_obs, self.value, self.best)

    def choose(self, known: PlannerInput) -> int:
        """Return the next target. See `edge.lab.eval.planning.executor.ChooseTarget`."""
        left = self._others - (known.seen & ~self._named_bits).bit_count()
        return int(self.best[known.seen & self._named_bits, left, known.state])


@jit
def least_costs(delta, accepting, order, p_obs, value, best):
    """Compute the least expected cost to acceptance and the next target, by knowledge and state.

    Knowledge only grows, so the sets are solved from the full one down. The results of an
    exploration are then already known. Within a set only certain steps remain: a shortest path.

    An exploration finds and reaches its object with probability p. Else it encounters another
    unknown object, each with the same probability. If there is no other, it goes on until it finds
    its object.

    Args:
        delta: (n, k + 1) int32; the last column is the step that reaches nothing.
        accepting: (n,) bool.
        order: (m,) int32, states that are neither accepting nor dead.
        p_obs: the probability p.
        value: see `Optimum`; written.
        best: see `Optimum`; written.
    """
    k = delta.shape[1] - 1
    # `known`: set of known propositions; `extra`: number of other objects not yet encountered.
    # `total`, by state: sum of the costs after an encounter of each unknown object.
    total = np.empty(delta.shape[0])
    for known in range(value.shape[0] - 1, -1, -1):
        for extra in range(value.shape[1]):
            cost_here, choice_here = value[known, extra], best[known, extra]
            cost_here[:] = np.where(accepting, 0.0, np.inf)
            others = extra - 1  # number of unknown objects other than the target
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
                        met_cost = (total[s] - after[s]) / others
                        cost = 1.0 + p_obs * after[delta[s, i]] + (1.0 - p_obs) * met_cost
                    if cost < cost_here[s]:  # False without a path: inf, or inf - inf
                        cost_here[s], choice_here[s] = cost, i
            # Relax the steps that cost almost nothing, until no cost becomes lower.
            changed = True
            while changed:
                changed = False
                for s in order:
                    for i in range(k + 1):
                        if i == k:
                            cost = _WAIT_COST + cost_here[delta[s, k]]
                        elif known & (1 << i):
                            cost = _DIRECT_COST + cost_here[delta[s, i]]
                        else:
                            continue
                        if cost < cost_here[s]:
                            cost_here[s], choice_here[s] = cost, NOTHING if i == k else i
                            changed = True

"""The optimal policy under the planner's information, solved exactly.

States are (automaton state, set of objects whose place is known). Exploring either reaches the
target or makes one more object known, so the known set never shrinks: going from the full set
down to the empty one, every exploration's outcomes are already solved, and what is left within
one set is a shortest path over direct reaches. When the target is the only unknown object the
failed attempt changes nothing and the expected number of attempts is 1 / p_obs.

Targets are the formula's own objects, as for every planner. At p_obs < 1/6 one that explored on
behalf of objects that the task does not name would gain (see `edge.eval.executor`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from edge.eval.executor import DONE, NOTHING, Problem

DIRECT_COST, WAIT_COST = 1e-6, 1e-9
"""Explorations are what is minimised; direct reaches and waiting only break ties."""

MAX_CELLS = 1 << 20
"""Largest n_states * 2 ** n_objects that is solved; 12 objects and 256 states fit."""


def solvable(problem: Problem) -> bool:
    """Whether the policy's table stays within `MAX_CELLS`."""
    return len(problem.moves) << problem.n_objects <= MAX_CELLS


def solve(problem: Problem, p_obs: float) -> tuple[np.ndarray, np.ndarray]:
    """Least expected number of explorations from everywhere, and what to do there.

    Args:
        p_obs: in (0, 1].

    Returns:
        value: (n_states, 2 ** n_objects) float64; inf where success is impossible.
        action: the same shape, int8: an object, `NOTHING` or `DONE`.
    """
    return _solve(
        problem.moves, problem.accepting, problem.steps_left, problem.n_letters, p_obs,
        DIRECT_COST, WAIT_COST,
    )  # fmt: skip


@njit(nogil=True, cache=True)
def _solve(moves, accepting, steps_left, n_letters, p_obs, direct_cost, wait_cost):
    """See `solve`; moves as in `Problem`."""
    n_states, n_objects = moves.shape[0], moves.shape[1] - 1
    value = np.full((n_states, 1 << n_objects), np.inf)
    action = np.full((n_states, 1 << n_objects), DONE, np.int8)
    for known in range((1 << n_objects) - 1, -1, -1):
        for s in range(n_states):
            if accepting[s]:
                value[s, known] = 0.0
                continue
            if steps_left[s] < 0:
                continue
            # What comes to light when an attempt fails, summed over all unknown objects.
            revealed, unknown = 0.0, 0
            for i in range(n_objects):
                if not known >> i & 1:
                    revealed += value[s, known | 1 << i]
                    unknown += 1
            for i in range(n_letters):
                found = value[moves[s, i], known | 1 << i]
                if known >> i & 1 or found == np.inf:
                    continue
                if unknown == 1:
                    cost = 1.0 / p_obs + found
                else:
                    others = (revealed - value[s, known | 1 << i]) / (unknown - 1)
                    cost = 1.0 + p_obs * found + (1.0 - p_obs) * others
                if cost < value[s, known] - 1e-12:
                    value[s, known] = cost
                    action[s, known] = i
        # Direct reaches stay within the known set: relax until nothing improves.
        improved = True
        while improved:
            improved = False
            for s in range(n_states):
                if accepting[s] or steps_left[s] < 0:
                    continue
                wait = wait_cost + value[moves[s, n_objects], known]
                if wait < value[s, known] - 1e-12:
                    value[s, known] = wait
                    action[s, known] = NOTHING
                    improved = True
                for i in range(n_letters):
                    if not known >> i & 1:
                        continue
                    cost = direct_cost + value[moves[s, i], known]
                    if cost < value[s, known] - 1e-12:
                        value[s, known] = cost
                        action[s, known] = i
                        improved = True
    return value, action

"""Numba kernels for shortest paths over the transition table of an automaton.

A node is a pair of automaton state and place. With constant weights there is one place. With
distances there are k + 1: one for each object (the robot is there), and the last one for the
robot's current position. Costs are integers, so ties are exact and sums do not depend on order.

Names in the kernels: s and t are states, p and q are places, and c is a column of `delta` (an
object of the formula, or nothing); t and q come after c.
"""

from __future__ import annotations

import numpy as np

from edge.jit import jit

SCALE = 1_000_000
"""Integer cost of a weight of 1."""
FAILED = np.int64(1 << 48)
"""Cost of an edge to a failed object: more than any path without one."""
UNREACHABLE = np.int64(2**63 - 1)
"""Cost of a node without a path to acceptance."""


@jit
def _place_after(c, place, n_places, nothing):
    """Return the robot's place after a step; a step that reaches nothing does not move it."""
    return place if c == nothing else min(c, n_places - 1)


@jit
def cost_to_go(delta, accepting, order, weight, cost, steps):
    """Write the least cost to acceptance from every node (ViTL eq. 2), then the fewest steps.

    Bellman-Ford. It settles in a few sweeps if `order` has the states nearest to acceptance first.

    Args:
        delta: (n, k + 1) int32; the last column is the step that reaches nothing.
        accepting: (n,) bool.
        order: (m,) int32, states that are neither accepting nor dead.
        weight: (k + 1, places) int64, at least 0, of each column from each place.
        cost: (n, places) int64 output; UNREACHABLE if there is no path.
        steps: (n, places) int32 output, steps of the best path.
    """
    n_columns, n_places = weight.shape
    for s in range(delta.shape[0]):
        for p in range(n_places):
            cost[s, p] = 0 if accepting[s] else UNREACHABLE
            steps[s, p] = 0
    changed = True
    while changed:
        changed = False
        for s in order:
            for c in range(n_columns):
                t = delta[s, c]
                if t == s:
                    continue
                for p in range(n_places):
                    q = _place_after(c, p, n_places, n_columns - 1)
                    ahead, n_steps = cost[t, q], steps[t, q] + 1
                    if ahead == UNREACHABLE:
                        continue
                    total = weight[c, p] + ahead
                    if total < cost[s, p] or (total == cost[s, p] and n_steps < steps[s, p]):
                        cost[s, p], steps[s, p] = total, n_steps
                        changed = True


@jit
def first_step_costs(delta, weight, cost, steps, state, place, out_cost, out_steps):
    """Write cost and steps of the best path from a node that begins with each column.

    See `cost_to_go` for the other arguments, of which it has filled `cost` and `steps`.

    - `out_cost`: (k + 1,) int64 output; UNREACHABLE if a step leads nowhere or keeps the state.
    - `out_steps`: (k + 1,) int32 output.
    """
    n_columns, n_places = weight.shape
    for c in range(n_columns):
        t = delta[state, c]
        q = _place_after(c, place, n_places, n_columns - 1)
        out_cost[c], out_steps[c] = UNREACHABLE, 0
        if t != state and cost[t, q] != UNREACHABLE:
            out_cost[c], out_steps[c] = weight[c, place] + cost[t, q], steps[t, q] + 1


@jit
def follow(delta, accepting, weight, cost, steps, state, place, first, path):
    """Write the columns of the best path from a node that begins with `first`; return its length.

    Ties go to the first column. See `cost_to_go` for the other arguments, of which it has filled
    `cost` and `steps`; `path` is an int32 output.
    """
    n_columns, n_places = weight.shape
    column, length = first, 0
    while True:
        path[length] = column
        length += 1
        place = _place_after(column, place, n_places, n_columns - 1)
        state = delta[state, column]
        if accepting[state]:
            return length
        for c in range(n_columns):
            t = delta[state, c]
            q = _place_after(c, place, n_places, n_columns - 1)
            if (
                t != state
                and cost[t, q] != UNREACHABLE
                and weight[c, place] + cost[t, q] == cost[state, place]
                and steps[t, q] + 1 == steps[state, place]
            ):
                column = c
                break

"""Shortest paths over an automaton's transition table. Knows arrays only.

A node is a state and a place. With constant weights there is one place; with distances there are
k + 1: one for each letter (the robot stands at that object) and the last for where it is now.
Costs are integers, so that ties are exact and sums do not depend on their order.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SCALE = 1_000_000
"""Integer cost of a weight of 1."""
FAILED = np.int64(1 << 48)
"""Cost of an edge to a failed object: over that of any path without one."""
UNREACHABLE = np.int64(2**63 - 1)
TOLERANCE = 1e-9
"""Expected costs that are nearer than this are equal."""


@njit(nogil=True, cache=True)
def _place_after(letter, place, n_places, nothing):
    """Where the robot is after a step: a step that reaches nothing leaves it where it was."""
    return place if letter == nothing else min(letter, n_places - 1)


@njit(nogil=True, cache=True)
def cost_to_go(delta, accepting, order, weight, cost, steps):
    """Least cost to acceptance from every node (ViTL eq. 2), then fewest steps.

    Bellman-Ford; sweeps over `order` settle in a few rounds where it leads away from acceptance.

    Args:
        delta: (n, k + 1) int32, the last column is the step that reaches nothing.
        accepting: (n,) bool.
        order: (m,) int32, states that are neither accepting nor dead.
        weight: (k + 1, places) int64, at least 0, of each letter from each place.
        cost, steps: (n, places) int64 and int32, written; UNREACHABLE where there is no way.
    """
    n_letters, n_places = weight.shape
    for s in range(delta.shape[0]):
        for p in range(n_places):
            cost[s, p] = 0 if accepting[s] else UNREACHABLE
            steps[s, p] = 0
    changed = True
    while changed:
        changed = False
        for s in order:
            for c in range(n_letters):
                t = delta[s, c]
                if t == s:
                    continue
                for p in range(n_places):
                    q = _place_after(c, p, n_places, n_letters - 1)
                    ahead, n_steps = cost[t, q], steps[t, q] + 1
                    if ahead == UNREACHABLE:
                        continue
                    total = weight[c, p] + ahead
                    if total < cost[s, p] or (total == cost[s, p] and n_steps < steps[s, p]):
                        cost[s, p], steps[s, p] = total, n_steps
                        changed = True


@njit(nogil=True, cache=True)
def first_letters(delta, weight, cost, steps, state, place, out_cost, out_steps):
    """Cost and steps of the best path that begins with each letter.

    Args:
        out_cost, out_steps: (k + 1,) int64 and int32, written; UNREACHABLE where a letter
            leads nowhere or leaves the state as it is.
    """
    n_letters, n_places = weight.shape
    for c in range(n_letters):
        t = delta[state, c]
        q = _place_after(c, place, n_places, n_letters - 1)
        out_cost[c], out_steps[c] = UNREACHABLE, 0
        if t != state and cost[t, q] != UNREACHABLE:
            out_cost[c], out_steps[c] = weight[c, place] + cost[t, q], steps[t, q] + 1


@njit(nogil=True, cache=True)
def follow(delta, accepting, weight, cost, steps, state, place, first, path):
    """Write the best path that begins with the letter `first`; ties go to the first letter.

    Returns:
        Its length.
    """
    n_letters, n_places = weight.shape
    letter, length = first, 0
    while True:
        path[length] = letter
        length += 1
        place = _place_after(letter, place, n_places, n_letters - 1)
        state = delta[state, letter]
        if accepting[state]:
            return length
        for c in range(n_letters):
            t = delta[state, c]
            q = _place_after(c, place, n_places, n_letters - 1)
            if (
                t != state
                and cost[t, q] != UNREACHABLE
                and weight[c, place] + cost[t, q] == cost[state, place]
                and steps[t, q] + 1 == steps[state, place]
            ):
                letter = c
                break


@njit(nogil=True, cache=True)
def _search(delta, usable, p_find, value, state, known, i):
    """Expected cost of searching with `usable[i]`, which is not known, as the target, until the
    next object is seen, and going on from there: the robot's model.

    Each unknown object is seen at its own rate, whatever the target is, so the next one comes
    after 1 / (sum of rates) and is j with j's share of the sum. If it is the target, the robot is
    there (or turns to what the sight makes better).
    """
    rate, total = 0.0, 1.0
    for j in range(usable.size):
        if known & (1 << j) == 0:
            after = value[known | (1 << j), 0, state]
            if j == i:
                after = min(after, value[known | (1 << j), 0, delta[state, usable[j]]])
            rate += p_find[known, j]
            total += p_find[known, j] * after
    return total / rate


@njit(nogil=True, cache=True)
def _search_all(delta, order, usable, p_find, value, known, total):
    """The least of `_search` over all objects that may be reached into value[known, 0], for every
    state.

    Args:
        total: (n,) float64 scratch, one and what follows from seeing each object, by rates.
    """
    rate = 0.0
    total[:] = 1.0
    for i in range(usable.size):
        if known & (1 << i) == 0:
            rate += p_find[known, i]
            total += p_find[known, i] * value[known | (1 << i), 0]
    here = value[known, 0]
    for i in range(usable.size):
        if known & (1 << i):
            continue
        after, letter = value[known | (1 << i), 0], usable[i]
        for s in order:
            there = after[delta[s, letter]]
            if there < np.inf:
                q = (total[s] - p_find[known, i] * max(after[s] - there, 0.0)) / rate
                here[s] = min(here[s], q)


@njit(nogil=True, cache=True)
def _explore(delta, usable, p_find, value, state, known, extra, i):
    """Expected cost of an attempt on `usable[i]`, which is not known, and going on from there: the
    paper's executor.

    With probability p it is found and reached; else one other object that is not known yet is
    met, each as likely. Where there is no other, exploring goes on until it is found.
    """
    p = p_find[known, i]
    bit = 1 << i
    found = value[known | bit, extra, delta[state, usable[i]]]
    others, total = extra, 0.0
    if extra > 0:
        total = extra * value[known, extra - 1, state]
    for j in range(usable.size):
        if j != i and known & (1 << j) == 0:
            others += 1
            total += value[known | (1 << j), extra, state]
    if others == 0:
        return 1.0 / p + found
    return 1.0 + p * found + (1.0 - p) * total / others


@njit(nogil=True, cache=True)
def _explore_all(delta, order, usable, p_find, value, known, extra, total):
    """The least of `_explore` over all objects into value[known, extra], for every state.

    Args:
        total: (n,) float64 scratch, the sum of what follows from meeting each object.
    """
    others = extra - 1
    total[:] = 0.0
    if extra > 0:
        total[:] = extra * value[known, extra - 1]
    for i in range(usable.size):
        if known & (1 << i) == 0:
            others += 1
            total += value[known | (1 << i), extra]
    here = value[known, extra]
    for i in range(usable.size):
        if known & (1 << i):
            continue
        p, after, letter = p_find[known, i], value[known | (1 << i), extra], usable[i]
        for s in order:
            if others == 0:
                q = 1.0 / p + after[delta[s, letter]]
            else:
                q = 1.0 + p * after[delta[s, letter]] + (1.0 - p) * (total[s] - after[s]) / others
            if q < here[s]:  # not so where there is no way: inf, or inf - inf
                here[s] = q


@njit(nogil=True, cache=True)
def expected_costs(
    delta, accepting, order, usable, p_find, w_known, w_nothing, executor, value
):  # fmt: skip
    """Least expected cost to acceptance, by what is known and by state.

    Knowledge only grows, so sets are solved from the full one down: what exploring leads to is
    then settled, and within a set only certain steps are left, a shortest path.

    Args:
        delta, accepting, order: see `cost_to_go`.
        usable: (m,) int64, letters that have not failed; bit i of a set is usable[i].
        p_find: (2**m, m) float64 in (0, 1], by set: probability that an attempt on it finds it,
            or, on the robot, its rate of being seen.
        w_known, w_nothing: cost of going to a known object, and of reaching nothing.
        executor: whether exploring is `_explore`'s; else it is `_search`'s.
        value: (2**m, e + 1, n) float64, written; the second index counts objects outside the
            formula that have not been met (e = 0 on the robot). inf where there is no way.
    """
    nothing = delta.shape[1] - 1
    total = np.empty(delta.shape[0])
    for known in range(value.shape[0] - 1, -1, -1):
        for extra in range(value.shape[1]):
            here = value[known, extra]
            for s in range(here.size):
                here[s] = 0.0 if accepting[s] else np.inf
            if executor:
                _explore_all(delta, order, usable, p_find, value, known, extra, total)
            elif known + 1 < value.shape[0]:
                _search_all(delta, order, usable, p_find, value, known, total)
            changed = True
            while changed:
                changed = False
                for s in order:
                    best = w_nothing + here[delta[s, nothing]]
                    for i in range(usable.size):
                        if known & (1 << i):
                            best = min(best, w_known + here[delta[s, usable[i]]])
                    if best < here[s]:
                        here[s] = best
                        changed = True


@njit(nogil=True, cache=True)
def expected_first(
    delta, usable, p_find, w_known, w_nothing, executor, value, state, known, extra, out
):  # fmt: skip
    """Expected cost of each first letter.

    Args:
        out: (k + 1,) float64, written; inf where it leads nowhere, failed, or changes nothing.
    """
    out[:] = np.inf
    nothing = delta.shape[1] - 1
    t = delta[state, nothing]
    if t != state:
        out[nothing] = w_nothing + value[known, extra, t]
    for i in range(usable.size):
        c = usable[i]
        t = delta[state, c]
        if known & (1 << i) == 0:
            if value[known | (1 << i), extra, t] == np.inf:
                continue
            if executor:
                out[c] = _explore(delta, usable, p_find, value, state, known, extra, i)
            else:
                out[c] = _search(delta, usable, p_find, value, state, known, i)
        elif t != state:
            out[c] = w_known + value[known, extra, t]


@njit(nogil=True, cache=True)
def expected_follow(
    delta, accepting, usable, p_find, w_known, w_nothing, executor, value, state, known, extra,
    first, out, path,
):  # fmt: skip
    """Write the way that begins with `first` if every exploration finds what it looks for.

    Args:
        out: (k + 1,) float64 scratch.

    Returns:
        Its length.
    """
    letter, length = first, 0
    while True:
        path[length] = letter
        length += 1
        state = delta[state, letter]
        for i in range(usable.size):
            if usable[i] == letter:
                known |= 1 << i
        if accepting[state]:
            return length
        expected_first(
            delta, usable, p_find, w_known, w_nothing, executor, value, state, known, extra, out
        )  # fmt: skip
        least = out.min() + TOLERANCE
        for c in range(out.size):
            if out[c] <= least:
                letter = c
                break


@njit(nogil=True, cache=True)
def metre_costs(delta, accepting, order, sought, known, way_m, search_m, w_nothing, value, total):
    """Least expected metres to acceptance, by what is found, place and state.

    As in `expected_costs` sets are solved from the full one down, and within a set only certain
    steps are left.

    Args:
        delta, accepting, order: see `cost_to_go`.
        sought: (u,) int64, letters to be found that have not failed; bit i of a set: sought[i]
            is found.
        known: (m,) int64, letters that are known from the start and have not failed.
        way_m: (k + 1, k) float64 over 0, metres from letter i (row k: from the robot) to letter j;
            the diagonal is what is left where j was just found, or reached.
        search_m: (k + 1, k, k) float64 over 0, see `Knowledge.search_m`.
        w_nothing: cost of reaching nothing.
        value: (2**u, k + 1, n) float64, written; inf where there is no way, and at places
            that are not found.
        total: (n,) float64 scratch.
    """
    nothing = delta.shape[1] - 1
    for found in range(value.shape[0] - 1, -1, -1):
        for p in range(value.shape[1]):
            here = value[found, p]
            for s in range(here.size):
                here[s] = 0.0 if accepting[s] else np.inf
            for i in range(sought.size):
                if found & (1 << i) == 0:
                    rate = _seen_next(sought, search_m, value, found, p, i, total)
                    after = value[found | (1 << i), sought[i]]
                    for s in order:
                        t = delta[s, sought[i]]
                        if t != s and after[t] < np.inf:
                            here[s] = min(here[s], total[s] / rate)
        changed = True
        while changed:
            changed = False
            for s in order:
                for p in range(value.shape[1]):
                    best = w_nothing + value[found, p, delta[s, nothing]]
                    for c in known:
                        best = min(best, way_m[p, c] + value[found, c, delta[s, c]])
                    for i in range(sought.size):
                        if found & (1 << i):
                            c = sought[i]
                            best = min(best, way_m[p, c] + value[found, c, delta[s, c]])
                    if best < value[found, p, s]:
                        value[found, p, s] = best
                        changed = True


@njit(nogil=True, cache=True)
def _seen_next(sought, search_m, value, found, p, i, total):
    """What a search from place `p` for sought[i] leads to, times its rate, into total, (n,).

    Each object that is not found is seen at its own rate, so the next one comes after
    1 / (sum of rates) metres and is j with j's share of the sum; the robot is then near it.

    Returns:
        The sum of rates.
    """
    rate = 0.0
    total[:] = 1.0
    for j in range(sought.size):
        if found & (1 << j) == 0:
            each = 1.0 / search_m[p, sought[i], sought[j]]
            rate += each
            total += each * value[found | (1 << j), sought[j]]
    return rate


@njit(nogil=True, cache=True)
def metre_first(
    delta, sought, known, way_m, search_m, w_nothing, value, total, state, place, found, out
):  # fmt: skip
    """Expected metres of each first letter.

    Args:
        out: (k + 1,) float64, written; inf where it leads nowhere, failed, or changes nothing.
    """
    out[:] = np.inf
    nothing = delta.shape[1] - 1
    if delta[state, nothing] != state:
        out[nothing] = w_nothing + value[found, place, delta[state, nothing]]
    for c in known:
        if delta[state, c] != state:
            out[c] = way_m[place, c] + value[found, c, delta[state, c]]
    for i in range(sought.size):
        c = sought[i]
        t = delta[state, c]
        if t == state:
            continue
        if found & (1 << i):
            out[c] = way_m[place, c] + value[found, c, t]
        elif value[found | (1 << i), c, t] < np.inf:
            rate = _seen_next(sought, search_m, value, found, place, i, total)
            out[c] = total[state] / rate

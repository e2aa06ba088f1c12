"""The grid hash finds the same rows as a search of all rows."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from edge.perception.tracking import place_index
from edge.perception.tracking.place_index import insert, make_index, move, remove, rows_near

CAPACITY = 12
PLACE_M = st.tuples(*(st.floats(-30, 30),) * 2)


def near(index, n, at_m, within_m):
    out = np.zeros(CAPACITY, np.int32)
    return out[: rows_near(index, n, *at_m, within_m, out)].tolist()


def test_an_empty_index_holds_nothing():
    assert near(make_index(CAPACITY), 0, (0.0, 0.0), 1e9) == []


@given(
    steps=st.lists(st.tuples(st.sampled_from("amrr"), st.integers(0, CAPACITY - 1), PLACE_M)),
    at_m=PLACE_M,
    within_m=st.floats(0, 80),
)
def test_all_rows_within_the_distance_are_found_once(steps, at_m, within_m):
    index, centers = make_index(CAPACITY), np.zeros((CAPACITY, 2))
    n = 0
    for what, row, place_m in steps:
        if what == "a" and n < CAPACITY:
            centers[n] = place_m
            insert(index, n, *place_m)
            n += 1
        elif n == 0:
            continue
        elif what == "m":
            centers[row % n] = place_m
            move(index, row % n, *place_m)
        else:  # the last row takes the place of the removed one, as in `ObjectTracker`
            row, n = row % n, n - 1
            remove(index, row)
            if row != n:
                remove(index, n)
                insert(index, row, *centers[n])
            centers[row] = centers[n]
    found = near(index, n, at_m, within_m)
    apart_m = np.abs(centers[:n] - at_m).max(axis=1, initial=0)
    wanted = set(np.flatnonzero(apart_m <= within_m).tolist())
    assert wanted <= set(found) <= set(range(n))
    assert found == sorted(set(found))
    assert all(apart_m[row] <= within_m + place_index.CELL_M + 1e-6 for row in found)
    again = make_index(CAPACITY)
    place_index.rebuild(again, centers, n)
    assert near(again, n, at_m, within_m) == found

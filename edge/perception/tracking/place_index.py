"""Grid hash over the centres of objects: it finds the rows near a place without visiting all rows.

`ObjectTracker` uses it to match detections; a row is one object.

The rows whose cells have the same hash form a bucket, which is a linked list. The index is three
arrays, so that kernels can use it: the first row of each bucket, the row that follows each row in
its bucket, and the cell of each row.
"""

from __future__ import annotations

import math

import numpy as np

from edge.jit import jit

CELL_M = 2.0
"""Side of a cell."""
_BUCKETS = 4096  # a power of two
_END = -1  # end of a linked list
_FARTHEST = 1e6  # largest cell number; a centre beyond has this cell

PlaceIndex = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(first, following, cell): the first row of each bucket (buckets,), the next row in the bucket of
each row (capacity,), and the cell (ix, iy) of each row (capacity, 2); all int32, -1: none."""


def make_index(capacity: int) -> PlaceIndex:
    """Return an empty index for this number of rows."""
    return (
        np.full(_BUCKETS, _END, np.int32),
        np.full(capacity, _END, np.int32),
        np.zeros((capacity, 2), np.int32),
    )


@jit
def _cell(x):
    """Return the cell number of a coordinate in metres."""
    return math.floor(max(-_FARTHEST, min(_FARTHEST, x / CELL_M)))


@jit
def _bucket(ix, iy):
    """Return the bucket of a cell: its hash by two large primes."""
    return ((ix * 73856093) ^ (iy * 19349663)) & (_BUCKETS - 1)


@jit
def insert(index, row, x, y):
    """Add a row, which is not yet in the index, with its centre (x, y) in metres."""
    first, following, cell = index
    cell[row, 0], cell[row, 1] = _cell(x), _cell(y)
    bucket = _bucket(cell[row, 0], cell[row, 1])
    following[row] = first[bucket]
    first[bucket] = row


@jit
def remove(index, row):
    """Remove a row that is in the index."""
    first, following, cell = index
    bucket = _bucket(cell[row, 0], cell[row, 1])
    at = first[bucket]
    if at == row:
        first[bucket] = following[row]
        return
    while following[at] != row:
        at = following[at]
    following[at] = following[row]


@jit
def move(index, row, x, y):
    """Set the centre of a row."""
    cell = index[2]
    if cell[row, 0] != _cell(x) or cell[row, 1] != _cell(y):
        remove(index, row)
        insert(index, row, x, y)


@jit
def rebuild(index, centers, n):
    """Index the first `n` rows of (capacity, 2 or 3) centres, and no others."""
    index[0][:] = _END
    for row in range(n):
        insert(index, row, centers[row, 0], centers[row, 1])


@jit
def rows_near(index, n, x, y, within_m, out):
    """Write the rows whose cells lie within a distance of a place; return their number.

    These are all rows with a centre within `within_m`, and some others, in ascending order.

    Args:
        index: see `PlaceIndex`.
        n: number of rows in the index.
        x: x of the place in metres.
        y: y of the place in metres.
        within_m: distance along each axis.
        out: (n or more,) int32.
    """
    first, following, cell = index
    x0, x1, y0, y1 = (
        _cell(x - within_m),
        _cell(x + within_m),
        _cell(y - within_m),
        _cell(y + within_m),
    )
    k = 0
    if (x1 - x0 + 1) * (y1 - y0 + 1) > n:  # fewer rows than cells
        for row in range(n):
            if x0 <= cell[row, 0] <= x1 and y0 <= cell[row, 1] <= y1:
                out[k] = row
                k += 1
        return k
    for ix in range(x0, x1 + 1):
        for iy in range(y0, y1 + 1):
            row = first[_bucket(ix, iy)]
            while row != _END:
                if cell[row, 0] == ix and cell[row, 1] == iy:
                    out[k] = row
                    k += 1
                row = following[row]
    out[:k].sort()
    return k

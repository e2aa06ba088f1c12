"""Reads the torus of layers out as one grid. Knows arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit

from edge.mapping.layers import OCCUPIED as RAW_OCCUPIED
from edge.mapping.layers import ZONE, Layers, bit_get, on_trail

UNKNOWN, FREE, OCCUPIED = -1, 0, 100


@njit(nogil=True, cache=True)
def compose(
    layers: Layers, body: np.ndarray, x0: int, y0: int, inflated: int, zones: bool, out: np.ndarray
) -> None:
    """Write what is published of the layers into `out`.

    Args:
        body: disc that has to be free for the robot to go back where it was; see `on_trail`.
        x0, y0: world cell of `out[0, 0]`; world cell c lies at c mod N.
        inflated: value of cells that are only too near to something occupied, or in a zone.
        zones: False leaves zones open.
        out: (h, w) int8: -1 unknown, 0 free, 100 occupied, or `inflated`.
    """
    raw, near, trail = layers.raw, layers.near, layers.trail
    n = raw.shape[0]
    counted = np.uint16(0xFFFF) if zones else ~ZONE
    for i in range(out.shape[0]):
        sy = (y0 + i) % n
        sx = x0 % n
        for j in range(out.shape[1]):
            if raw[sy, sx] >= RAW_OCCUPIED:
                out[i, j] = OCCUPIED
            # Most are not on the trail; to call with all layers costs more than to look.
            elif near[sy, sx] & counted and not (
                bit_get(trail, sy, sx) and on_trail(layers, sy, sx, body)
            ):
                out[i, j] = inflated
            elif raw[sy, sx] > 0:
                out[i, j] = FREE
            else:
                out[i, j] = UNKNOWN
            sx += 1
            if sx == n:
                sx = 0

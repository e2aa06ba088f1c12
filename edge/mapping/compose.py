"""Kernel that reads a rectangle of the map's layers as one occupancy grid.

The layers are stored as a torus: a ring buffer in x and in y (see `edge.mapping.layers`).
"""

from __future__ import annotations

import numpy as np

from edge.jit import jit
from edge.mapping.layers import OCCUPIED as RAW_OCCUPIED
from edge.mapping.layers import ZONE, Layers, bit_get, on_trail

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of an occupancy grid of ROS. `RAW_OCCUPIED` is on the scale of `Layers.raw`."""


@jit
def compose(
    layers: Layers, body: np.ndarray, x0: int, y0: int, inflated: int, zones: bool, out: np.ndarray
) -> None:
    """Write the published state of the layers into `out`.

    Args:
        layers: layers of the map.
        body: half widths of a disc of the robot's size. A cell where the robot has driven (its
            trail) is not inflated while this disc around it is free, so that the robot can drive
            back (`on_trail`).
        x0: world cell of `out[0, 0]`; world cell c is at c mod N.
        y0: as `x0`.
        inflated: value of cells that are only too near to an occupied cell, or in a zone.
        zones: False leaves zones open.
        out: (h, w) int8: -1 unknown, 0 free, 100 occupied, or `inflated`.
    """
    raw, near, trail = layers.raw, layers.near, layers.trail
    n = raw.shape[0]
    # `near` is a count of obstacles, and the bit `ZONE`: this mask leaves the bit out.
    inflating_bits = np.uint16(0xFFFF) if zones else ~ZONE
    for i in range(out.shape[0]):
        sy = (y0 + i) % n
        sx = x0 % n
        for j in range(out.shape[1]):
            if raw[sy, sx] >= RAW_OCCUPIED:
                out[i, j] = OCCUPIED
            # Most cells are not on the trail: test the bit first, the call is expensive.
            elif near[sy, sx] & inflating_bits and not (
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

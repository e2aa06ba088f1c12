"""Kernels that find the objects near a place and in sight of it, for the prior. Arrays only."""

from __future__ import annotations

import math

from edge.jit import jit

_UNCHECKED_M = 0.25
"""Length at the end of a line of sight that is not checked: that part may be in the object."""


@jit
def nearby(wall, x0_m, y0_m, cell_m, xy_m, n, object_m, row, weight, n_objects, radius_m, out):
    """Write the confidence that each class is near each place and in sight of it.

    A class is a kind of object, such as chair. Of several objects, the most confident counts.

    Args:
        wall: (h, w) bool, cells that block the view.
        x0_m: x of the lower-left corner of `wall`, in `map`.
        y0_m: y of the lower-left corner of `wall`, in `map`.
        cell_m: side of a cell.
        xy_m: (n or more, 2) float32, places in `map`.
        n: number of places.
        object_m: (n_objects or more, 2 or more) float32, x and y of the objects in `map`.
        row: (n_objects or more,) int32, class of each object; -1: the object is ignored.
        weight: (n_objects or more,) float32 in [0, 1], confidence of each object.
        n_objects: number of objects.
        radius_m: largest distance.
        out: (n or more, classes) float32, written for the first n.
    """
    out[:n] = 0.0
    for i in range(n):
        for j in range(n_objects):
            k = row[j]
            if k < 0 or weight[j] <= out[i, k]:
                continue
            dx, dy = object_m[j, 0] - xy_m[i, 0], object_m[j, 1] - xy_m[i, 1]
            if dx * dx + dy * dy <= radius_m * radius_m and in_sight(
                wall, x0_m, y0_m, cell_m, xy_m[i, 0], xy_m[i, 1], dx, dy
            ):
                out[i, k] = weight[j]


@jit
def in_sight(wall, x0_m, y0_m, cell_m, x_m, y_m, dx_m, dy_m):
    """Return True if no wall is on the line (dx_m, dy_m) from a place, without its end.

    The other arguments are those of `nearby`.
    """
    h, w = wall.shape
    length = math.sqrt(dx_m * dx_m + dy_m * dy_m)
    y, x = (y_m - y0_m) / cell_m, (x_m - x0_m) / cell_m
    step_y, step_x = dy_m / length if length > 0.0 else 0.0, dx_m / length if length > 0.0 else 0.0
    for k in range(1, int((length - _UNCHECKED_M) / cell_m) + 1):
        r, c = y + k * step_y, x + k * step_x
        if 0.0 <= r < h and 0.0 <= c < w and wall[int(r), int(c)]:
            return False
    return True

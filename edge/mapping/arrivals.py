"""Cells that a person may have left: where something arrived, and small obstacles."""

from __future__ import annotations

import cv2
import numpy as np

from edge.mapping import layers as ly
from edge.mapping.window import Window

# Obstacles that are this near to the robot are never forgotten unseen.
_KEEP_M = 0.5
# Largest side of an obstacle that may be a person.
_PERSON_M = 0.8


def cells_to_forget(
    raw: np.ndarray, window: Window, robot: tuple[int, int] | None, small_too: bool
) -> list[tuple[int, int, bool]]:
    """Return the cells of obstacles that may be gone, except those next to the robot.

    Args:
        raw: see `Layers.raw`.
        window: window of the map.
        robot: the robot's world cell.
        small_too: True: also cells of obstacles that are no larger than a person.

    Returns:
        World cells, with True if something arrived there, and False for a small obstacle.
    """
    n, (ox, oy) = window.n, window.origin
    arrived = (raw >= ly.ARRIVED) & (raw < ly.BUMPED)
    gone = arrived.copy()
    if small_too:
        label, side_cells = _components((raw >= ly.OCCUPIED) & (raw < ly.BUMPED), window)
        is_small = side_cells * window.resolution_m <= _PERSON_M
        is_small[0] = False  # the background
        gone |= is_small[label]
    label, _ = _components(gone, window)
    row, column = np.nonzero(label)
    x, y = ox + (column - ox) % n, oy + (row - oy) % n
    far = np.ones(len(x), bool)
    if robot is not None:
        away_m = window.resolution_m * np.hypot(x - robot[0], y - robot[1])
        of = label[row, column]
        far = ~np.isin(of, of[away_m <= _KEEP_M])
    cells = x[far], y[far], arrived[row[far], column[far]]
    return list(zip(*(values.tolist() for values in cells), strict=True))


def _components(cells: np.ndarray, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Label the 8-connected parts of a layer's cells, (n, n) bool, from 1; 0 is the rest.

    Returns:
        The label of each cell, (n, n) int32, and the longest side of each part in cells.
    """
    shift_x, shift_y = window.shift
    in_window = np.roll(cells.view(np.uint8), (-shift_y, -shift_x), (0, 1))
    _, label, stats, _ = cv2.connectedComponentsWithStats(in_window, connectivity=8)
    side = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    return np.roll(label, (shift_y, shift_x), (0, 1)), side

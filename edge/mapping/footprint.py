"""The cells under the robot: known to be free, and on its trail."""

from __future__ import annotations

import math

from edge.mapping import layers as ly
from edge.mapping import update
from edge.mapping.cells import MapCells

_FOOTPRINT_M = 0.3  # unknown cells this near to the robot's centre are free
# The robot's centre may be off its cell's centre: a wall that it touches must stay occupied.
_OFF_CENTRE_CELLS = 0.7
# Poses farther apart do not join the trail: the robot was carried, or frames were lost.
_TRAIL_STEP_CELLS = 10


class Footprint:
    """The cells under the robot: it frees them, and marks its trail.

    Attributes:
        cell: world cell of the robot at the last update; None: unknown.
    """

    def __init__(self, cells: MapCells, robot_radius_m: float) -> None:
        self.cell: tuple[int, int] | None = None
        self._cells, cell_m = cells, cells.window.resolution_m
        self._unknown_disc = ly.disc_half_widths(max(_FOOTPRINT_M, robot_radius_m) / cell_m)
        self._body = ly.disc_half_widths(max(robot_radius_m / cell_m - _OFF_CENTRE_CELLS, 0.0))

    def move_to(self, cell: tuple[int, int]) -> None:
        """Update the cells around the robot, which is at a world cell now."""
        cells, window, (ox, oy) = self._cells, self._cells.window, self._cells.window.origin
        x, y = cell
        update.free_footprint(
            cells.layers, *window.shift, x - ox, y - oy, self._unknown_disc, self._body, cells.disc,
            cells.changed, cells.explored,
        )  # fmt: skip
        before = self.cell
        if before is None or math.dist(before, cell) > _TRAIL_STEP_CELLS:
            before = cell
        ly.mark_trail(cells.layers, *window.shift, before[0] - ox, before[1] - oy, x - ox, y - oy)
        self.cell = cell
        reach = max(len(self._unknown_disc) // 2, _TRAIL_STEP_CELLS) + 1
        window.mark_written(x - reach, y - reach, x + reach + 1, y + reach + 1)

"""Travel-cost field: the driving distance from the robot to each free cell that it can reach.

A wavefront computes it, spread over many ticks. Kernels: `edge.mapping.reach_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from edge.geometry import SE2
from edge.mapping.layers import Layers
from edge.mapping.reach_kernels import (
    BUCKETS,
    STRAIGHT,
    UNREACHED,
    Wave,
    first_in_sight,
    grow_wave,
    nearest_reached,
    path_lengths,
    start_wave,
    trace,
)
from edge.mapping.window import Window

_CLEARED_PER_CELL = 16  # cells that are cleared in the time in which one cell is added
MAX_PATH_CELLS = 4096
"""Largest number of cells that `path_xy_m` returns; of a longer path it returns the end."""


class TravelCostField:
    """Driving distance: length of the shortest path from the robot over free cells, 8-connected.

    There are two fields. The last complete one answers queries while the next one grows by at most
    `per_tick` cells a step. So the cost of a step does not depend on the size of the map.

    Attributes:
        generation: number of complete fields; 0 = none yet.
    """

    def __init__(
        self,
        layers: Layers,
        window: Window,
        inflation_cells: float,
        body: np.ndarray,
        per_tick: int,
    ) -> None:
        """Allocate both fields.

        Args:
            layers: layers of the map.
            window: window of the map.
            inflation_cells: inflation radius in cells.
            body: half widths of a disc of the robot's size. Cells where the robot has driven (its
                trail) are free while this disc around them is; see `on_trail`.
            per_tick: largest number of cells that a step adds.
        """
        n = window.n
        self.generation = 0
        self._layers, self._window = layers, window
        # A robot inside the inflation may leave it: this near to it, inflated cells are crossed.
        self._escape_cells = inflation_cells + 1.0
        self._body = body
        self._per_tick = per_tick
        # Longest contour of equal cost in a window, except in artificial mazes.
        contour = 8192 + 16 * n
        self._waves = [
            Wave(
                distance=np.zeros((n, n), np.int32),
                bucket=np.zeros((BUCKETS, contour), np.int32),
                filled=np.zeros(BUCKETS, np.int64),
                bounds=np.zeros(4, np.int64),
                state=np.zeros(5, np.int64),
            )
            for _ in range(2)
        ]
        self._origins = [(0, 0), (0, 0)]  # of the window at the start of each field
        self._complete = 0  # index of the field that answers queries
        self._is_growing = False
        self._clear_row = -1

    def step(self, pose: SE2) -> None:
        """Grow the next field; use it for queries when it is complete.

        A new field starts at `pose`, the robot's current pose.
        """
        growing = 1 - self._complete
        wave = self._waves[growing]
        if not self._is_growing:
            if not self._clear_older(wave):
                return
            window = self._window
            self._origins[growing] = window.origin
            x, y = window.cell_of(pose.x_m, pose.y_m)
            if not window.contains(x, y):
                return
            start_wave(self._layers, wave, x % window.n, y % window.n, self._escape_cells)
            self._is_growing = True
        x0, y0, x1, y1 = self._valid_rect(growing)
        ox, oy = self._window.origin
        if grow_wave(self._layers, wave, self._body, ox, oy, x0, y0, x1, y1, self._per_tick):
            self._is_growing = False
            self._complete = growing
            self.generation += 1
            self._clear_row = -1

    @property
    def field(self) -> tuple[np.ndarray, tuple[int, int, int, int]]:
        """The distances (see `Wave.distance`), and where they are valid.

        That is the half-open rectangle (x0, y0, x1, y1) of world cells.
        """
        return self._waves[self._complete].distance, self._valid_rect(self._complete)

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Return the driving distance to a point's cell in metres; inf if it was not reached."""
        if self.generation == 0:
            return math.inf
        window = self._window
        x, y = window.cell_of(x_m, y_m)
        x0, y0, x1, y1 = self._valid_rect(self._complete)
        if not (x0 <= x < x1 and y0 <= y < y1):
            return math.inf
        entry = int(self._waves[self._complete].distance[y % window.n, x % window.n])
        if entry == UNREACHED:
            return math.inf
        return (entry - 1) / STRAIGHT * window.resolution_m  # `Wave.distance` is 1 + cost

    def nearest(self, x_m: float, y_m: float, radius_m: float) -> tuple[float, float, float] | None:
        """Return the nearest free cell that the robot can reach, within `radius_m` of a point.

        Returns:
            (x_m, y_m, distance_m) of the cell's centre; None if there is none.
        """
        res = self._window.resolution_m
        return self._search(nearest_reached, float(x_m / res), float(y_m / res), radius_m / res)

    def stopping_point(
        self,
        surface_m: np.ndarray,
        within_m: float,
        points: int = 1,
        except_disc: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> tuple[float, float, float] | None:
        """Return the stopping point for an object: the nearest free cell in sight of its surface.

        The cell has the shortest driving distance of all cells that have enough points of the
        surface near, with no wall in between.

        Args:
            surface_m: (k, 2 or more) float32 in `map`.
            within_m: largest distance from the cell's centre to a point.
            points: least number of such points; > 0.
            except_disc: (x_m, y_m, radius_m) of a disc without stopping points.

        Returns:
            (x_m, y_m, distance_m) of the cell's centre; None if there is none.
        """
        res = self._window.resolution_m
        return self._search(first_in_sight, res, surface_m, within_m, points, except_disc)

    def _search(
        self, search: Callable[..., tuple[int, int, int]], *args: object
    ) -> tuple[float, float, float] | None:
        """Return the cell that a kernel finds in the current field; see `nearest`."""
        if self.generation == 0:
            return None
        distance, rect = self.field
        x, y, entry = search(self._layers, distance, *rect, *args)
        return _centre_m(x, y, entry, self._window.resolution_m)

    def path_xy_m(self, x_m: float, y_m: float) -> np.ndarray:
        """Return the shortest path to a point's cell, from the start of the field, for display.

        Returns:
            (k, 2) float32 centres of cells in `map`, at most `MAX_PATH_CELLS`, the point's own cell
            last; (0, 2) if the robot cannot get there.
        """
        if self.generation == 0:
            return np.zeros((0, 2), np.float32)
        distance, rect = self.field
        cells = np.empty((MAX_PATH_CELLS, 2), np.int64)
        n = trace(distance, *rect, *self._window.cell_of(x_m, y_m), cells)
        return ((cells[:n][::-1] + 0.5) * self._window.resolution_m).astype(np.float32)

    def path_lengths_m(
        self, xy_m: np.ndarray, kind: np.ndarray, radius_m: np.ndarray, n: int, out_m: np.ndarray
    ) -> None:
        """Write the driving distance to each point, or to the nearest free cell as in `nearest`.

        Args:
            xy_m: (n or more, 2) float32 in `map`.
            kind: (n or more,) int8, index into `radius_m`.
            radius_m: search radius for each kind.
            n: number of points.
            out_m: (n or more,) float32 output; inf if the robot cannot get there.
        """
        if self.generation == 0:
            out_m[:n] = math.inf
            return
        distance, rect = self.field
        res = self._window.resolution_m
        path_lengths(self._layers, distance, *rect, res, xy_m, kind, radius_m, n, out_m)

    def _valid_rect(self, field_index: int) -> tuple[int, int, int, int]:
        """Return the half-open rectangle of world cells in both a field's window and the map's."""
        (ax, ay), (bx, by), n = self._origins[field_index], self._window.origin, self._window.n
        return max(ax, bx), max(ay, by), min(ax, bx) + n, min(ay, by) + n

    def _clear_older(self, wave: Wave) -> bool:
        """Clear some rows of the older field, so that the next one can start in it.

        Returns:
            True when it is empty.
        """
        x0, y0, x1, y1 = (int(v) for v in wave.bounds)
        if x1 <= x0:
            return True
        row = y0 if self._clear_row < 0 else self._clear_row
        rows = max(1, self._per_tick * _CLEARED_PER_CELL // (x1 - x0))
        end = min(row + rows, y1)
        wave.distance[row:end, x0:x1] = UNREACHED
        self._clear_row = end
        if end < y1:
            return False
        wave.bounds[:] = 0
        return True


def _centre_m(x: int, y: int, entry: int, res_m: float) -> tuple[float, float, float] | None:
    """Return (x_m, y_m, distance_m) of a cell's centre; None if it was not reached.

    `entry` is a value of `Wave.distance`.
    """
    if entry == UNREACHED:
        return None
    return (x + 0.5) * res_m, (y + 0.5) * res_m, (entry - 1) / STRAIGHT * res_m

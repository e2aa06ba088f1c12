"""Which free cells the robot can get to, and how far they are: an amortised wavefront."""

from __future__ import annotations

import math

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

_CLEAR_PER_CELL = 16
WAY_CELLS = 4096
"""Of a longer way the end is shown."""


class ReachField:
    """Geodesic distance from the robot over free cells, 8-connected.

    Two fields take turns: the last complete one answers while the next grows by at most
    `cells_per_tick` cells a step, so that a step's cost does not depend on the map's size.

    Attributes:
        generation: counts complete fields; 0 = none yet.
    """

    def __init__(
        self,
        layers: Layers,
        window: Window,
        inflation_cells: float,
        body: np.ndarray,
        per_tick: int,
    ) -> None:
        """
        Args:
            body: disc that has to be free for the robot to go back where it was; see `on_trail`.
        """
        n = window.n
        self.generation = 0
        self._layers, self._window = layers, window
        self._escape_cells = inflation_cells + 1.0
        self._body = body
        self._per_tick = per_tick
        # No contour of equal cost in a window is longer, save in mazes made to be.
        contour = 8192 + 16 * n
        self._waves = [
            Wave(
                np.zeros((n, n), np.int32),
                np.zeros((BUCKETS, contour), np.int32),
                np.zeros(BUCKETS, np.int64),
                np.zeros(4, np.int64),
                np.zeros(6, np.int64),
            )
            for _ in range(2)
        ]
        self._origins = [(0, 0), (0, 0)]  # of the window, when the fields began
        self._current = 0
        self._growing = False
        self._clear_row = -1

    def step(self, pose: SE2) -> None:
        """Grow the next field; take it into use when it is complete.

        Args:
            pose: where the robot is now; a new field starts there.
        """
        nxt = 1 - self._current
        wave = self._waves[nxt]
        if not self._growing:
            if not self._clear(wave):
                return
            window = self._window
            self._origins[nxt] = window.origin
            x, y = window.cell_of(pose.x_m, pose.y_m)
            if not window.holds(x, y):
                return
            start_wave(self._layers, wave, x % window.n, y % window.n, self._escape_cells)
            self._growing = True
        x0, y0, x1, y1 = self._common(nxt)
        ox, oy = self._window.origin
        if grow_wave(self._layers, wave, self._body, ox, oy, x0, y0, x1, y1, self._per_tick):
            self._growing = False
            self._current = nxt
            self.generation += 1
            self._clear_row = -1

    @property
    def field(self) -> tuple[np.ndarray, tuple[int, int, int, int]]:
        """The distances in use (see `Wave.distance`), and the world cells where they hold."""
        return self._waves[self._current].distance, self._common(self._current)

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Geodesic distance to a point's cell in metres; inf where it was not reached."""
        if self.generation == 0:
            return math.inf
        window = self._window
        x, y = window.cell_of(x_m, y_m)
        x0, y0, x1, y1 = self._common(self._current)
        if not (x0 <= x < x1 and y0 <= y < y1):
            return math.inf
        steps = int(self._waves[self._current].distance[y % window.n, x % window.n])
        if steps == UNREACHED:
            return math.inf
        return (steps - 1) / STRAIGHT * window.resolution_m

    def nearest(self, x_m: float, y_m: float, radius_m: float) -> tuple[float, float, float] | None:
        """The free cell nearest to a point, within `radius_m`, that the robot can get to.

        Returns:
            (x_m, y_m, geodesic_m) of the cell's centre; None when there is none.
        """
        if self.generation == 0:
            return None
        res = self._window.resolution_m
        distance, common = self.field
        x, y, steps = nearest_reached(
            self._layers, distance, *common, float(x_m / res), float(y_m / res), radius_m / res
        )
        return _place_m(x, y, steps, res)

    def approach(
        self, surface_m: np.ndarray, within_m: float, points: int = 1
    ) -> tuple[float, float, float] | None:
        """Where to stop on the way to a thing: the free cell with the shortest way there from
        which points of its surface are near, with no wall in between.

        Args:
            surface_m: (k, 2 or more) float32 in `map`.
            within_m: how near; the centre of the cell to the point.
            points: how many at least are to be near; > 0.

        Returns:
            (x_m, y_m, geodesic_m) of the cell's centre; None when there is none.
        """
        if self.generation == 0:
            return None
        res = self._window.resolution_m
        distance, common = self.field
        x, y, steps = first_in_sight(
            self._layers, distance, *common, res, surface_m, within_m, points
        )
        return _place_m(x, y, steps, res)

    def way_m(self, x_m: float, y_m: float) -> np.ndarray:
        """The shortest way to a point's cell, from where the field began, for people to look at.

        Returns:
            (k, 2) float32 centres of cells in `map`, at most `WAY_CELLS`, the point's own last;
            (0, 2) where the robot does not get to.
        """
        if self.generation == 0:
            return np.zeros((0, 2), np.float32)
        distance, common = self.field
        cells = np.empty((WAY_CELLS, 2), np.int64)
        n = trace(distance, *common, *self._window.cell_of(x_m, y_m), cells)
        return ((cells[:n][::-1] + 0.5) * self._window.resolution_m).astype(np.float32)

    def paths_m(
        self, xy_m: np.ndarray, kind: np.ndarray, radius_m: np.ndarray, n: int, out_m: np.ndarray
    ) -> None:
        """Driving distance to each of some points: to the free cell nearest to it, as `nearest`.

        Args:
            xy_m: (n or more, 2) float32.
            kind: (n or more,) int8, index into `radius_m`, how far that cell may lie.
            out_m: (n or more,) float32; inf where the robot does not get to.
        """
        if self.generation == 0:
            out_m[:n] = math.inf
            return
        distance, common = self.field
        res = self._window.resolution_m
        path_lengths(self._layers, distance, *common, res, xy_m, kind, radius_m, n, out_m)

    def _common(self, which: int) -> tuple[int, int, int, int]:
        """World cells that lie in a field's window and in the map's: half-open rectangle."""
        (ax, ay), (bx, by), n = self._origins[which], self._window.origin, self._window.n
        return max(ax, bx), max(ay, by), min(ax, bx) + n, min(ay, by) + n

    def _clear(self, wave: Wave) -> bool:
        """Empty the older field, a share each step; True when it is empty."""
        x0, y0, x1, y1 = (int(v) for v in wave.bounds)
        if x1 <= x0:
            return True
        row = y0 if self._clear_row < 0 else self._clear_row
        rows = max(1, self._per_tick * _CLEAR_PER_CELL // (x1 - x0))
        end = min(row + rows, y1)
        wave.distance[row:end, x0:x1] = UNREACHED
        self._clear_row = end
        if end < y1:
            return False
        wave.bounds[:] = 0
        return True


def _place_m(x: int, y: int, steps: int, res_m: float) -> tuple[float, float, float] | None:
    """(x_m, y_m, geodesic_m) of a cell's centre; None where it was not reached."""
    if steps == UNREACHED:
        return None
    return (x + 0.5) * res_m, (y + 0.5) * res_m, (steps - 1) / STRAIGHT * res_m

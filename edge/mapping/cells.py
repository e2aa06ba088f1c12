"""Cells of the map: the layers with the window that they hold, and what of them changed."""

from __future__ import annotations

import math

import numpy as np

from edge import config
from edge.geometry import Grid
from edge.mapping import layers as ly
from edge.mapping.bumps import ROUNDING_CELLS
from edge.mapping.compose import compose
from edge.mapping.window import Window

Rect = tuple[int, int, int, int]
_EMPTY_RECT = (1 << 40, 1 << 40, -(1 << 40), -(1 << 40))  # `layers.grow` extends it


class MapCells:
    """The layers of the map: write cells, move their window, copy them.

    Args:
        config: settings of the map.
        scan_cells: cells on each side of the sensor that an update may write.

    Attributes:
        window: part of the world that the layers hold.
        layers: writable arrays by storage cell.
        inflation_cells: distance that the robot's centre keeps from an obstacle's.
        body: half widths of a disc of the robot's size, see `layers.on_trail`.
        reach_cells: cells that must be in the window on each side of the sensor.
        disc: half widths of the inflation disc, see `layers.disc_half_widths`.
        changed: (4,) int64, half-open window rectangle of the cells that changed since the last
            `take_changed`; writers of layers extend it.
        explored: as `changed`, all cells ever written.
    """

    def __init__(self, config: config.MappingConfig, scan_cells: int) -> None:
        cell_m = config.resolution_m
        # An obstacle may be at the rim of its cell, half a cell nearer than the centre.
        self.inflation_cells = config.inflation_m / cell_m + 0.5
        self.disc = ly.disc_half_widths(self.inflation_cells)
        self.body = ly.disc_half_widths(max(self.inflation_cells - ROUNDING_CELLS, 0.0))
        self.reach_cells = scan_cells + len(self.disc) // 2 + 1
        cells = max(math.ceil(config.extent_m / cell_m), 2 * self.reach_cells + 1 + ly.WORD)
        self.window = Window(ly.WORD * math.ceil(cells / ly.WORD), cell_m)
        self.layers = ly.make_layers(self.window.n)
        self.changed = np.array(_EMPTY_RECT, np.int64)
        self.explored = np.array(_EMPTY_RECT, np.int64)

    def write(self, x: int, y: int, state: int, top: int = 0) -> None:
        """Set the state of one world cell, and update the inflation around it."""
        layers, n, (ox, oy) = self.layers, self.window.n, self.window.origin
        sx, sy, x, y = x % n, y % n, x - ox, y - oy
        before, after = layers.raw[sy, sx] >= ly.OCCUPIED, state >= ly.OCCUPIED
        layers.raw[sy, sx], layers.top[sy, sx] = state, top
        ly.bit_set(layers.known, sy, sx, state != ly.UNSEEN)
        if after != before:
            by = 1 if after else -1
            clip = (0, 0, n, n)
            ly.add_disc(layers, *self.window.shift, x, y, by, self.disc, clip, self.changed)
        ly.grow(self.changed, x, y)
        ly.grow(self.explored, x, y)
        self.window.mark_written(x + ox, y + oy, x + ox + 1, y + oy + 1)

    def take_changed(self) -> Rect | None:
        """Return `changed` and empty it; None if no cell changed."""
        x0, y0, x1, y1 = (int(v) for v in self.changed)
        if x1 <= x0:
            return None
        self.changed[:] = _EMPTY_RECT
        return x0, y0, x1, y1

    def roll(self, axis: int, by: int, dirty: np.ndarray) -> None:
        """Move the window along one axis by a multiple of 64 cells; clear the strip that leaves.

        Clusters with cells in that strip are marked in `dirty`.
        """
        window, n, layers, shift = self.window, self.window.n, self.layers, self.window.shift
        margin = len(self.disc) // 2
        leaving = band(axis, strip(-by, n), n)
        ly.remove_obstacles(layers, *shift, *leaving, self.disc, self.changed)
        ly.wipe(layers, *shift, *leaving, dirty)
        (x0, y0, x1, y1), (ox, oy) = leaving, window.origin
        window.mark_written(x0 + ox, y0 + oy, x1 + ox, y1 + oy)
        window.origin = (ox + by, oy) if axis == 0 else (ox, oy + by)
        for rect in (self.changed, self.explored):
            rect[axis] = max(rect[axis] - by, 0)
            rect[axis + 2] = min(rect[axis + 2] - by, n)
            if rect[axis] >= rect[axis + 2]:
                rect[:] = _EMPTY_RECT
        start, end = entering = strip(by, n)
        edge = (start - margin, start) if by > 0 else (end, end + margin)
        ly.inflate_into(
            layers, *window.shift, band(axis, edge, n), band(axis, entering, n), self.disc,
            self.changed,
        )  # fmt: skip

    def inflate_all(self) -> None:
        """Compute all that follows from the layer `raw`, in layers that have nothing else."""
        layers, n = self.layers, self.window.n
        seen = layers.raw != ly.UNSEEN
        layers.known[:] = ly.bits_of(seen)
        if seen.any():
            rect, changed = (0, 0, n, n), np.array(_EMPTY_RECT, np.int64)
            ly.inflate_into(layers, *self.window.shift, rect, rect, self.disc, changed)
            for axis in (0, 1):
                at = (np.flatnonzero(seen.any(axis=axis)) - self.window.origin[axis]) % n
                self.explored[axis], self.explored[axis + 2] = at.min(), at.max() + 1

    def snapshot(self, inflated: int, zones: bool) -> Grid:
        """Copy the explored part; see `compose`. If the window moves meanwhile, copy it again."""
        window, n = self.window, self.window.n
        while True:
            origin, cell_m = window.origin, window.resolution_m
            if not window.placed:
                return Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), cell_m)
            margin = len(self.disc) // 2
            x0, y0 = (max(int(v) - margin, 0) for v in self.explored[:2])
            x1, y1 = (min(int(v) + margin, n) for v in self.explored[2:])
            cells = np.empty((max(y1 - y0, 0), max(x1 - x0, 0)), np.int8)
            corner = origin[0] + x0, origin[1] + y0
            compose(self.layers, self.body, *corner, inflated, zones, cells)
            if window.origin == origin:
                return Grid(cells, (corner[0] * cell_m, corner[1] * cell_m), cell_m)


def strip(by: int, n: int) -> tuple[int, int]:
    """Return the window cells along an axis that enter when the window moves `by` cells.

    Those that leave are `strip(-by, n)`, before the move.
    """
    cells = min(abs(by), n)
    return (n - cells, n) if by > 0 else (0, cells)


def band(axis: int, along: tuple[int, int], n: int) -> Rect:
    """Return the window rectangle that spans `along` on one axis and everything on the other."""
    return (along[0], 0, along[1], n) if axis == 0 else (0, along[0], n, along[1])

"""Segmentation of the known map into rooms at its narrow places, on a coarse grid.

Only tall obstacles are walls; furniture does not separate rooms. Rooms are the basins of the
distance to the nearest wall. Two basins are one room unless a passage separates them: as narrow as
a door, and clearly narrower than the smaller basin. Unknown space is not a wall, so an opening to
it separates nothing. This module only knows arrays; `edge.memory.rooms` makes rooms of the regions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from edge.geometry import Grid
from edge.jit import jit
from edge.mapping.layers import OCCUPIED, Layers
from edge.mapping.window import Window

UNKNOWN, OPEN, WALL = 0, 1, 2
"""Values of the cells of `coarse_grid`."""
DOOR_M = 2.2
"""Largest width of a door, double doors included."""
_PASSAGE_RATIO = 0.8
"""A passage is narrower than the smaller basin's widest place by at least this factor."""
_MIN_BASIN_M2 = 1.0
"""A smaller basin is a corner of a larger one."""
CELL_M = 0.1
"""Approximate side of a cell of `survey_regions`."""
NEAR_M = 0.7
"""Largest distance of an object from the cells of its region: it may be at a wall."""


class RegionMap(NamedTuple):
    """The map cut into regions.

    Attributes:
        grid: see `coarse_grid`.
        wall: (h, w) bool, True for walls.
        label: (h, w) int16, region of each cell: 1 … n, 0 for none.
        border: see `border_lengths`.
    """

    grid: Grid
    wall: np.ndarray
    label: np.ndarray
    n: int
    border: np.ndarray

    def at(self, xy_m: np.ndarray) -> np.ndarray:
        """Return the region of each place, (n,) int16; see `regions_at`.

        Args:
            xy_m: (n, 2 or more) float32 in `map`.
        """
        grid, out = self.grid, np.empty(len(xy_m), np.int16)
        regions_at(self.label, *grid.origin_xy_m, grid.resolution_m, xy_m, len(xy_m), NEAR_M, out)
        return out


NO_REGIONS = RegionMap(
    Grid(np.zeros((0, 0), np.uint8), (0.0, 0.0), CELL_M),
    np.zeros((0, 0), np.bool_),
    np.zeros((0, 0), np.int16),
    0,
    np.zeros((1, 1), np.int64),
)


def survey_regions(layers: Layers, window: Window, tall_code: int) -> RegionMap:
    """Cut the explored part of the map into regions; see `coarse_grid` for the arguments."""
    grid = coarse_grid(layers, window, tall_code, CELL_M)
    label, n = segment_rooms(grid.cells, grid.resolution_m)
    return RegionMap(grid, grid.cells == WALL, label, n, border_lengths(label, n))


def coarse_grid(layers: Layers, window: Window, tall_code: int, cell_m: float) -> Grid:
    """Return the explored part of the map on coarse cells.

    Another thread may call it during an update; some cells are then from before the update. If the
    window moves during the copy, the map is read again.

    Args:
        layers: layers of the map.
        window: window of the map.
        tall_code: value of `Layers.top` from which an obstacle is a wall.
        cell_m: approximate side of a cell; never smaller than the map's.

    Returns:
        `Grid` of uint8 `UNKNOWN`, `OPEN` (also furniture) or `WALL`, in `map`.
    """
    factor = max(1, round(cell_m / window.resolution_m))
    side_m = factor * window.resolution_m
    while True:
        origin = window.origin
        # Storage rows, and words of 64 cells of a row, with a known cell.
        known_rows = np.flatnonzero(layers.known.any(1))
        known_words = np.flatnonzero(layers.known.any(0))
        if not window.placed or not len(known_rows):
            return Grid(np.zeros((0, 0), np.uint8), (0.0, 0.0), side_m)
        y0, y1 = _span(known_rows, origin[1], window.n, 1)
        x0, x1 = _span(known_words, origin[0], window.n, 64)
        x0, y0 = x0 // factor, y0 // factor
        rows, columns = math.ceil(y1 / factor) - y0, math.ceil(x1 / factor) - x0
        cells = np.empty((rows, columns), np.uint8)
        _coarsen(layers, tall_code, x0 * factor, y0 * factor, factor, cells)
        if window.origin == origin:
            return Grid(cells, (x0 * side_m, y0 * side_m), side_m)


def _span(stored: np.ndarray, origin: int, n: int, unit: int) -> tuple[int, int]:
    """Return the half-open span of world cells of some storage rows, or of words of a row."""
    world = (stored * unit - origin) % n + origin
    return int(world.min()), int(world.max()) + unit


def segment_rooms(cells: np.ndarray, cell_m: float) -> tuple[np.ndarray, int]:
    """Return the region of each cell, and the number of regions.

    Args:
        cells: (h, w) uint8, see `coarse_grid`.
        cell_m: side of a cell.

    Returns:
        (h, w) int16: 1 … n, 0 at walls and unknown cells; and n.
    """
    label = np.zeros(cells.shape, np.int16)
    if not cells.size:
        return label, 0
    wall_distance_m = _wall_distance_cells(cells) * cell_m
    order = np.argsort(-wall_distance_m, axis=None, kind="stable")
    n = _basins(
        cells,
        wall_distance_m,
        order,
        0.5 * DOOR_M,
        _PASSAGE_RATIO,
        _MIN_BASIN_M2 / cell_m**2,
        label,
    )
    return label, n


def border_lengths(label: np.ndarray, n: int) -> np.ndarray:
    """Return the length of the border between each two regions, in cells.

    The result is (n + 1, n + 1) int64, symmetric, 0 for region 0 and on the diagonal. `label` is
    the result of `segment_rooms`.
    """
    out = np.zeros((n + 1, n + 1), np.int64)
    for a, b in ((label[1:], label[:-1]), (label[:, 1:], label[:, :-1])):
        on_border = (a > 0) & (b > 0) & (a != b)
        np.add.at(out, (a[on_border], b[on_border]), 1)
    return out + out.T


def _wall_distance_cells(cells: np.ndarray) -> np.ndarray:
    """Return the distance to the nearest wall in cells, (h, w) float32."""
    wall = cells == WALL
    if not wall.any():
        return np.full(cells.shape, float(max(cells.shape)), np.float32)
    return cv2.distanceTransform((~wall).astype(np.uint8), cv2.DIST_L2, 5)


@jit
def _coarsen(layers, tall_code, x0, y0, factor, cells):
    """Make a coarse cell a wall if one of its cells is, else open if one is known."""
    raw, top = layers.raw, layers.top
    n = raw.shape[0]
    for row in range(cells.shape[0]):
        for col in range(cells.shape[1]):
            state = UNKNOWN
            for y in range(y0 + row * factor, y0 + (row + 1) * factor):
                for x in range(x0 + col * factor, x0 + (col + 1) * factor):
                    sy, sx = y % n, x % n
                    if raw[sy, sx] >= OCCUPIED and top[sy, sx] >= tall_code:
                        state = WALL
                    elif raw[sy, sx] and state == UNKNOWN:
                        state = OPEN
            cells[row, col] = state


@jit
def _root(parent, i):
    """Return the representative of a set in a union-find forest, and shorten the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def _basins(cells, wall_distance_m, order, half_door_m, passage_ratio, min_cells, label):
    """Flood from the places farthest from walls; return the number of regions.

    A cell joins the basin of its neighbour that is farthest from walls. If it connects two basins,
    they are merged unless the cell is a passage.

    - `wall_distance_m`: (h, w) float32, metres to the nearest wall.
    - `order`: flat indices, the farthest from walls first.
    - `half_door_m`, `passage_ratio`: a passage is at most this far from walls, and at most this
      share of the lower peak. The peak of a basin is the largest distance from walls in it.
    - `min_cells`: a smaller basin is always merged.
    - `label`: (h, w) int16 output.
    """
    h, w = cells.shape
    # By basin, from 1: union-find parent, peak and number of cells.
    parent = np.zeros(order.size + 1, np.int32)
    peak_m = np.zeros(order.size + 1, np.float32)
    area = np.zeros(order.size + 1, np.int32)
    basin = np.zeros((h, w), np.int32)
    n_basins = 0
    for flat in order:
        y, x = flat // w, flat % w
        if cells[y, x] != OPEN:
            continue
        distance_m, own, farthest_m = wall_distance_m[y, x], 0, np.float32(-1.0)
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                r, c = y + dy, x + dx
                if 0 <= r < h and 0 <= c < w and basin[r, c] and wall_distance_m[r, c] > farthest_m:
                    own, farthest_m = basin[r, c], wall_distance_m[r, c]
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                r, c = y + dy, x + dx
                if not (0 <= r < h and 0 <= c < w) or basin[r, c] == 0:
                    continue
                first, second = _root(parent, own), _root(parent, basin[r, c])
                if first == second:
                    continue
                lower_peak_m = min(peak_m[first], peak_m[second])
                is_passage = distance_m <= half_door_m and distance_m < passage_ratio * lower_peak_m
                if not is_passage or min(area[first], area[second]) < min_cells:
                    if peak_m[second] > peak_m[first]:
                        first, second = second, first
                    parent[second] = first
                    area[first] += area[second]
        if own == 0:
            n_basins += 1
            own = n_basins
            parent[own], peak_m[own] = own, distance_m
        own = _root(parent, own)
        area[own] += 1
        basin[y, x] = own
    # Number the regions in the order of their first cells.
    region_of = np.zeros(n_basins + 1, np.int16)
    n = 0
    for y in range(h):
        for x in range(w):
            if basin[y, x]:
                root = _root(parent, basin[y, x])
                if region_of[root] == 0:
                    n += 1
                    region_of[root] = n
                label[y, x] = region_of[root]
    return n


@jit
def regions_at(label, x0_m, y0_m, cell_m, xy_m, n, radius_m, out):
    """Write the region of the labelled cell nearest to each place into out[:n]; 0 if none is near.

    Args:
        label: (h, w) int16, see `segment_rooms`.
        x0_m: x of the lower-left corner of `label`.
        y0_m: y of that corner.
        cell_m: side of a cell.
        xy_m: (n or more, 2 or more) float32 in `map`.
        n: number of places.
        radius_m: radius of the search.
        out: (n or more,) int16.
    """
    h, w = label.shape
    reach = int(radius_m / cell_m + 1e-6)
    for i in range(n):
        row = math.floor((xy_m[i, 1] - y0_m) / cell_m)
        col = math.floor((xy_m[i, 0] - x0_m) / cell_m)
        best = reach * reach + 1
        out[i] = 0
        if 0 <= row < h and 0 <= col < w and label[row, col]:
            out[i] = label[row, col]
            continue
        for r in range(max(row - reach, 0), min(row + reach + 1, h)):
            for c in range(max(col - reach, 0), min(col + reach + 1, w)):
                d = (r - row) ** 2 + (c - col) ** 2
                if label[r, c] and d < best:
                    best = d
                    out[i] = label[r, c]

"""Zones: polygons that the robot must stay out of, or inside of, as closed cells of the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from edge.geometry import Grid
from edge.mapping.layers import WORD, ZONE, Layers, bits_of, grow
from edge.mapping.window import Window

MARGIN_CELLS = 2
"""Cells added to the inflation, because a controller may cut a corner by this much."""
_FIXED_BITS = 4  # fractional bits of the coordinates that OpenCV takes
_BORDER_M = 1.0  # closed border around a stay-inside zone, which no planner can cross
_MAX_CELLS = 1 << 22  # largest number of cells of a mask
_CLOSED, _UNKNOWN = 100, -1


class ZonePolygons(NamedTuple):
    """Zones as polygons, each (n, 2) float64 in `map`.

    Attributes:
        keep_out_m: areas that the robot must stay out of.
        stay_inside_m: areas that it must stay inside of; without any, it may be anywhere.
    """

    keep_out_m: tuple[np.ndarray, ...] = ()
    stay_inside_m: tuple[np.ndarray, ...] = ()


class Zones:
    """Keep-out and stay-inside zones: cells closed to every planner, whether seen free or not.

    A cell is closed if the robot, with its centre there, would touch a keep-out polygon or leave
    all stay-inside polygons. A closed cell has the bit `ZONE` in `Layers.near`, and is `blocked`.

    Args:
        layers: layers of the map; the zones are written there.
        inflation_cells: distance that the robot keeps from obstacles.

    Attributes:
        polygons: the zones; another object after each change.
    """

    def __init__(self, layers: Layers, window: Window, inflation_cells: float) -> None:
        self._layers, self._window = layers, window
        self._margin = _margin_cells(inflation_cells)
        self.polygons = ZonePolygons()

    def set(
        self,
        keep_out_m: Sequence[np.ndarray],
        stay_inside_m: Sequence[np.ndarray],
        changed: np.ndarray,
    ) -> None:
        """Replace the zones.

        Args:
            keep_out_m: polygons, each (n, 2) float64 in `map`.
            stay_inside_m: polygons; without any, the robot may be anywhere.
            changed: (4,) int64, window rectangle, extended by the cells that open or close.
        """
        old, old_inside = self.polygons
        self.polygons = new = ZonePolygons(tuple(keep_out_m), tuple(stay_inside_m))
        if not self._window.placed:
            return
        if _same_polygons(old_inside, new.stay_inside_m):
            # Keep-out polygons that are gone or new.
            changed_polygons = [p for p in old if not _contains_polygon(p, new.keep_out_m)]
            changed_polygons += [p for p in new.keep_out_m if not _contains_polygon(p, old)]
            if changed_polygons:
                self._paint_around(np.concatenate(changed_polygons), changed)
        else:
            n = self._window.n
            self.paint((0, 0, n, n), changed)

    def _paint_around(self, points_m: np.ndarray, changed: np.ndarray) -> None:
        """Paint the rectangle around some points; the entire window would take too long."""
        n, origin = self._window.n, self._window.origin
        cells = points_m / self._window.resolution_m - origin
        low = np.floor(cells.min(axis=0)).astype(int) - self._margin - 1
        high = np.ceil(cells.max(axis=0)).astype(int) + self._margin + 1
        (x0, y0), (x1, y1) = np.clip(low, 0, n).tolist(), np.clip(high, 0, n).tolist()
        x0, x1 = x0 // WORD * WORD, math.ceil(x1 / WORD) * WORD
        if x0 < x1 and y0 < y1:
            self.paint((x0, y0, x1, y1), changed)

    def paint(self, rect: tuple[int, int, int, int], changed: np.ndarray) -> None:
        """Close the cells that the zones close, and open the others.

        The trail is cleared in a zone: a robot that was there before may still not go back.

        Args:
            rect: half-open window rectangle (x0, y0, x1, y1), x in full words of the bit planes.
            changed: see `set`.
        """
        layers, (x0, y0, x1, y1), n = self._layers, rect, self._window.n
        shift_x, shift_y = self._window.shift
        mask = self._closed(x0, y0, x1 - x0, y1 - y0).astype(bool)
        rows = (np.arange(y0, y1) + shift_y) % n
        cells = np.ix_(rows, (np.arange(x0, x1) + shift_x) % n)
        words = np.ix_(rows, (np.arange(x0, x1, WORD) + shift_x) % n // WORD)
        before = layers.near[cells]
        layers.near[cells] = after = np.where(mask, before | ZONE, before & ~ZONE)
        layers.blocked[words] = bits_of(after != 0)
        layers.trail[words] &= ~bits_of(mask)
        y, x = np.nonzero((before == 0) != (after == 0))
        if len(x):
            grow(changed, x0 + int(x.min()), y0 + int(y.min()))
            grow(changed, x0 + int(x.max()), y0 + int(y.max()))

    @property
    def any(self) -> bool:
        """True if there is a zone."""
        return any(self.polygons)  # a tuple of two tuples: empty ones are False

    def contains(self, x_m: float, y_m: float) -> bool:
        """Return True if the zones close the cell of a point."""
        return self.contains_cell(*self._window.cell_of(x_m, y_m))

    def contains_cell(self, x: int, y: int) -> bool:
        """Return True if the zones close a world cell."""
        n = self._window.n
        return self._window.contains(x, y) and bool(self._layers.near[y % n, x % n] & ZONE)

    def _closed(self, x0: int, y0: int, width: int, height: int) -> np.ndarray:
        """Return (height, width) uint8, 1 where a cell is closed; (x0, y0) is a window cell."""
        (ox, oy), resolution_m = self._window.origin, self._window.resolution_m
        corner = np.array([x0 + ox, y0 + oy])
        return _closed_cells(self.polygons, resolution_m, self._margin, corner, (height, width))


def keepout_mask(zones: ZonePolygons, resolution_m: float, inflation_m: float) -> Grid:
    """Return the cells that the zones close for the robot's centre.

    Closed cells are 100, all others -1, "unknown", so that a costmap keeps what it knows there.
    Around stay-inside zones there is a closed border. A large mask has larger cells.

    Returns:
        Grid of int8; a single cell without zones.
    """
    if not any(zones):
        return Grid(np.full((1, 1), _UNKNOWN, np.int8), (0.0, 0.0), resolution_m)
    corners_m = np.concatenate([polygon for polygons in zones for polygon in polygons])
    while True:
        margin = _margin_cells(inflation_m / resolution_m + 0.5)
        border = margin + math.ceil(_BORDER_M / resolution_m)
        low = np.floor(corners_m.min(axis=0) / resolution_m).astype(np.int64) - border
        high = np.ceil(corners_m.max(axis=0) / resolution_m).astype(np.int64) + border
        width, height = (high - low).tolist()
        if width * height <= _MAX_CELLS:
            break
        resolution_m *= 2
    closed = _closed_cells(zones, resolution_m, margin, low, (height, width))
    cells = np.where(closed, np.int8(_CLOSED), np.int8(_UNKNOWN))
    return Grid(cells, (float(low[0] * resolution_m), float(low[1] * resolution_m)), resolution_m)


def _margin_cells(inflation_cells: float) -> int:
    """Return the distance in cells that the robot's centre keeps from the polygons' edges."""
    return math.ceil(inflation_cells) + MARGIN_CELLS


def _closed_cells(
    zones: ZonePolygons,
    resolution_m: float,
    margin: int,
    corner: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Return uint8 of a (height, width) `shape`, 1 where a cell is closed.

    Args:
        zones: the zones.
        resolution_m: side of a cell.
        margin: cells that the robot's centre keeps from the polygons' edges.
        corner: (2,) int64, world cell (x, y) of the first cell.
        shape: of the result.
    """
    height, width = shape
    if not any(zones):
        return np.zeros(shape, np.uint8)
    mask = np.zeros((height + 2 * margin, width + 2 * margin), np.uint8)
    side = 2 * margin + 1
    if zones.stay_inside_m:
        _fill(mask, zones.stay_inside_m, resolution_m, corner - margin)
        mask ^= 1
    _fill(mask, zones.keep_out_m, resolution_m, corner - margin)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return cv2.dilate(mask, disc)[margin : margin + height, margin : margin + width]


def _fill(
    mask: np.ndarray, polygons_m: Sequence[np.ndarray], resolution_m: float, corner: np.ndarray
) -> None:
    """Set the cells in any of the polygons to 1; `corner` is the world cell of `mask[0, 0]`."""
    for polygon_m in polygons_m:
        # OpenCV has pixel centres at integers, the map has cell centres at halves.
        cells = polygon_m / resolution_m - 0.5 - corner
        fixed = np.round(cells * (1 << _FIXED_BITS)).astype(np.int32)
        cv2.fillPoly(mask, [fixed], 1, shift=_FIXED_BITS)


def _contains_polygon(polygon_m: np.ndarray, polygons_m: Sequence[np.ndarray]) -> bool:
    return any(np.array_equal(polygon_m, other) for other in polygons_m)


def _same_polygons(polygons_m: Sequence[np.ndarray], others_m: Sequence[np.ndarray]) -> bool:
    return len(polygons_m) == len(others_m) and all(
        _contains_polygon(p, others_m) for p in polygons_m
    )

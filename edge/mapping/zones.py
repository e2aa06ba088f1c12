"""Zones: polygons that the robot must stay out of, or inside of."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from edge.mapping.layers import WORD, ZONE, Layers, bits_of, grow
from edge.mapping.window import Window

MARGIN_CELLS = 2
"""Cells added to the inflation, because a controller may cut a corner by this much."""
_FIXED_BITS = 4  # fractional bits of the coordinates that OpenCV takes


class Zones:
    """Keep-out and stay-inside zones: cells closed to every planner, whether seen free or not.

    A cell is closed if the robot, with its centre there, would touch a keep-out polygon or leave
    all stay-inside polygons. A closed cell has the bit `ZONE` in `Layers.near`, and is `blocked`.

    Args:
        layers: layers of the map; the zones are written there.
        window: window of the map.
        inflation_cells: distance that the robot keeps from obstacles.
    """

    def __init__(self, layers: Layers, window: Window, inflation_cells: float) -> None:
        self._layers, self._window = layers, window
        self._margin = math.ceil(inflation_cells) + MARGIN_CELLS
        side = 2 * self._margin + 1
        self._disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        self._keep_out_m: tuple[np.ndarray, ...] = ()
        self._stay_inside_m: tuple[np.ndarray, ...] = ()

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
        old, old_inside = self._keep_out_m, self._stay_inside_m
        self._keep_out_m, self._stay_inside_m = tuple(keep_out_m), tuple(stay_inside_m)
        if not self._window.placed:
            return
        if _same(old_inside, self._stay_inside_m):
            moved = [p for p in old if not _among(p, self._keep_out_m)]
            moved += [p for p in self._keep_out_m if not _among(p, old)]
            if moved:
                self._paint_around(np.concatenate(moved), changed)
        else:
            n = self._window.n
            self.paint((0, 0, n, n), changed)

    def _paint_around(self, points_m: np.ndarray, changed: np.ndarray) -> None:
        """Paint the rectangle around some points; the whole window would take too long."""
        n, origin = self._window.n, self._window.origin
        cells = points_m / self._window.resolution_m - origin
        low = np.floor(cells.min(axis=0)).astype(int) - self._margin - 1
        high = np.ceil(cells.max(axis=0)).astype(int) + self._margin + 1
        (x0, y0), (x1, y1) = np.clip(low, 0, n).tolist(), np.clip(high, 0, n).tolist()
        x0, x1 = x0 // WORD * WORD, -(-x1 // WORD) * WORD
        if x0 < x1 and y0 < y1:
            self.paint((x0, y0, x1, y1), changed)

    def paint(self, rect: tuple[int, int, int, int], changed: np.ndarray) -> None:
        """Close the cells that the zones close, and open the others.

        The trail is cleared in a zone: a robot that was there before may still not go back.

        Args:
            rect: half-open window rectangle (x0, y0, x1, y1), x in whole words of the bit planes.
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
        return bool(self._keep_out_m or self._stay_inside_m)

    def holds(self, x_m: float, y_m: float) -> bool:
        """Return True if the zones close the cell of a point."""
        return self.holds_cell(*self._window.cell_of(x_m, y_m))

    def holds_cell(self, x: int, y: int) -> bool:
        """Return True if the zones close a world cell."""
        n = self._window.n
        return self._window.holds(x, y) and bool(self._layers.near[y % n, x % n] & ZONE)

    def _closed(self, x0: int, y0: int, width: int, height: int) -> np.ndarray:
        """Return (height, width) uint8, 1 where a cell is closed; (x0, y0) is a window cell."""
        if not self.any:
            return np.zeros((height, width), np.uint8)
        pad, (ox, oy) = self._margin, self._window.origin
        corner = np.array([x0 + ox - pad, y0 + oy - pad])
        mask = np.zeros((height + 2 * pad, width + 2 * pad), np.uint8)
        if self._stay_inside_m:
            self._fill(mask, self._stay_inside_m, corner)
            mask ^= 1
        self._fill(mask, self._keep_out_m, corner)
        return cv2.dilate(mask, self._disc)[pad : pad + height, pad : pad + width]

    def _fill(self, mask: np.ndarray, polygons_m: Sequence[np.ndarray], corner: np.ndarray) -> None:
        """Set the cells in any of the polygons to 1; `corner` is the world cell of `mask[0, 0]`."""
        for polygon_m in polygons_m:
            # OpenCV has pixel centres at integers, the map has cell centres at halves.
            cells = polygon_m / self._window.resolution_m - 0.5 - corner
            fixed = np.round(cells * (1 << _FIXED_BITS)).astype(np.int32)
            cv2.fillPoly(mask, [fixed], 1, shift=_FIXED_BITS)


def _among(polygon_m: np.ndarray, polygons_m: Sequence[np.ndarray]) -> bool:
    return any(np.array_equal(polygon_m, other) for other in polygons_m)


def _same(polygons_m: Sequence[np.ndarray], others_m: Sequence[np.ndarray]) -> bool:
    return len(polygons_m) == len(others_m) and all(_among(p, others_m) for p in polygons_m)

"""Unknown cells around points (VL-Nav eq. 6), counted in the map's bit planes.

A bit plane holds 64 cells of a row in one word, so one operation handles 64 cells.
"""

from __future__ import annotations

import math

import numpy as np

from edge.config import MAX_RADIUS_CELLS
from edge.jit import jit
from edge.mapping.layers import Layers, disc_half_widths
from edge.mapping.window import Window


class UnknownArea:
    """Share of unknown cells around points."""

    def __init__(self, layers: Layers, window: Window) -> None:
        self._layers, self._window = layers, window
        self._flood = (np.zeros(64, np.uint64), np.zeros(64, np.uint64))  # of `unknown_ratios`
        self._radius_m, self._disc = 0.0, disc_half_widths(0.0)  # the newest radius, and its disc

    def ratio(self, xy_m: np.ndarray, n: int, radius_m: float, out: np.ndarray) -> None:
        """Write the share of unknown cells around points (VL-Nav eq. 6) into out[:n].

        Args:
            xy_m: (n or more, 2) float32 in `map`.
            n: number of points.
            radius_m: radius of the search from each point; at most 31 cells.
            out: (n or more,) float32.

        Raises:
            ValueError: the radius is over 31 cells.
        """
        window, cell_m = self._window, self._window.resolution_m
        if self._radius_m != radius_m:
            if radius_m > MAX_RADIUS_CELLS * cell_m:
                finest_m = math.ceil(1000 * radius_m / MAX_RADIUS_CELLS) / 1000
                raise ValueError(
                    f"unknown-area radius {radius_m} m: with cells of {cell_m} m at most "
                    f"{MAX_RADIUS_CELLS * cell_m:g} m are possible; set mapping.resolution_m to "
                    f"at least {finest_m:.3g}"
                )
            self._radius_m, self._disc = radius_m, disc_half_widths(radius_m / cell_m)
        if not window.placed:
            out[:n] = 1.0
            return
        unknown_ratios(
            self._layers.known, self._layers.blocked, *window.shift, *window.origin, 1.0 / cell_m,
            xy_m, n, self._disc, *self._flood, out,
        )  # fmt: skip


@jit(inline="always")
def _popcount(x):
    """Return the number of set bits of a word, by adding neighbouring groups of bits."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@jit(inline="always")
def _spread_in_row(x, p):
    """Return the bits of p that are connected to a bit of x within one row of 64 cells."""
    while x != p:
        # Two cells further in each direction.
        wider = (x | (x << np.uint64(1)) | (x >> np.uint64(1))) & p
        wider |= ((wider << np.uint64(1)) | (wider >> np.uint64(1))) & p
        if wider == x:
            break
        x = wider
    return x


@jit
def unknown_ratios(
    known, blocked, shift_x, shift_y, origin_x, origin_y, inv_res, xy, n_points, disc,
    passable, flooded, out,
):  # fmt: skip
    """Write the share of unknown cells in the cells that a 4-connected search reaches.

    The search starts at the point's cell, crosses unknown and free cells, and stays within the disc
    and the window. A point on a blocked cell or outside the window has ratio 0.

    - `known`, `blocked`: see `edge.mapping.layers.Layers`.
    - `shift_x`, `shift_y`: storage cell of the window's corner; `origin_x`, `origin_y`: its world
      cell.
    - `inv_res`: cells per metre.
    - `xy`: (n_points or more, 2) float32, points in `map`.
    - `disc`: half widths of the disc's rows, at most `edge.config.MAX_RADIUS_CELLS`.
    - `passable`, `flooded`: (64,) uint64 scratch, one word for each row of the disc.
    - `out`: (n_points or more,) float32 output.
    """
    n = known.shape[0]
    words = n >> 6
    radius, rows = len(disc) // 2, len(disc)
    full = ~np.uint64(0)
    seed = np.uint64(1) << np.uint64(radius)
    for i in range(n_points):
        out[i] = 0.0
        x = math.floor(xy[i, 0] * inv_res) - origin_x
        y = math.floor(xy[i, 1] * inv_res) - origin_y
        if x < 0 or y < 0 or x >= n or y >= n:
            continue
        left = x - radius
        word, offset = left >> 6, np.uint64(left & 63)
        # A row's 64 columns from `left` on are in two words of the bit plane.
        first_word = (word + (shift_x >> 6)) % words
        second_word = (first_word + 1) % words
        back = np.uint64(63) - offset
        # Columns of the 64 that are in the window.
        in_window = full
        if left < 0:
            in_window &= full << np.uint64(-left)
        if left + 64 > n:
            in_window &= full >> np.uint64(left + 64 - n)
        first, last = max(0, radius - y), min(rows, n - y + radius)
        for k in range(first, last):
            sy = y + k - radius + shift_y
            if sy >= n:
                sy -= n
            width = np.uint64(2 * disc[k] + 1)
            in_disc = ((np.uint64(1) << width) - np.uint64(1)) << np.uint64(radius - disc[k])
            # Two shifts, because a shift by 64 (for offset 0) is not defined.
            bits = (blocked[sy, first_word] >> offset) | (
                (blocked[sy, second_word] << back) << np.uint64(1)
            )
            passable[k] = ~bits & in_disc & in_window
            flooded[k] = 0
        if passable[radius] & seed == np.uint64(0):
            continue
        flooded[radius] = _spread_in_row(seed, passable[radius])
        _flood(flooded, passable, radius, first, last)
        visited, unknown = np.uint64(0), np.uint64(0)
        for k in range(first, last):
            sy = y + k - radius + shift_y
            if sy >= n:
                sy -= n
            visited += _popcount(flooded[k])
            bits = (known[sy, first_word] >> offset) | (
                (known[sy, second_word] << back) << np.uint64(1)
            )
            unknown += _popcount(flooded[k] & ~bits)
        out[i] = float(unknown) / float(visited)


@jit
def _flood(flooded, passable, start, first, last):
    """Spread the bits of `flooded` within `passable`, over the rows from `first` to before `last`.

    Each round goes up from row `start` to the last row, and then down to `first`. It ends when a
    round changes nothing, or when all passable bits are set.
    """
    while True:
        is_changing = False
        row = flooded[start]
        for k in range(start + 1, last):
            more = flooded[k] | (row & passable[k])
            if more != flooded[k]:
                more = _spread_in_row(more, passable[k])
                flooded[k] = more
                is_changing = True
            row = more
        full = row == passable[last - 1]
        for k in range(last - 2, first - 1, -1):
            more = flooded[k] | (row & passable[k])
            if more != flooded[k]:
                more = _spread_in_row(more, passable[k])
                flooded[k] = more
                is_changing = True
            full &= more == passable[k]
            row = more
        if full or not is_changing:
            return
        start = first  # the next round begins at the bottom

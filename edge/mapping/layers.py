"""Storage of the map: one torus (ring buffer in x and y) for all layers, and kernels for cells.

The map holds a square *window* of N x N cells that follows the robot. Cells have three kinds of
coordinates:

- *world*: floor(x_m / resolution) and floor(y_m / resolution) in `map`.
- *window*: 0 .. N-1 from the lower-left corner of the window, whose world cell is its origin.
- *storage*: index into the arrays: world mod N = (window + shift) mod N, with shift = origin mod N.

N and the origin are multiples of 64. So a move of the window clears full strips of 64 cells, and
the place where the storage wraps around is never inside a word of the bit planes. Every layer is
zero where nothing was seen, so memory that was never visited stays untouched.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edge.jit import jit

WORD = 64
"""Cells in a word of a bit plane."""
UNSEEN, FREE, OCCUPIED, ARRIVED = 0, 1, 2, 128
"""Values of `Layers.raw`; all values from `OCCUPIED` on are occupied. From `ARRIVED` on, the cell
was surely free before: something came there, and may go again."""
ZONE = np.uint16(0x8000)
"""Bit of `Layers.near`: a zone closes the cell (see `edge.mapping.zones`). The rest is a count."""
BUMPED = 255
"""Value of `Layers.raw` where the robot was blocked: occupied, and no ray clears it."""


class Layers(NamedTuple):
    """All layers in storage coordinates: row = y, column = x.

    Attributes:
        raw: (N, N) uint8, observed state: 0 unseen, 1 free, 2 + k occupied and seen through in the
            last k updates, 128 + k the same if it was surely free before, 255 the robot was blocked
            there.
        near: (N, N) uint16, number of occupied cells within the inflation disc, and the bit `ZONE`.
        top: (N, N) uint8, height of the obstacle over the local ground, as a code (see
            `edge.mapping.points.HEIGHT_CODES`). In a free cell, the number of updates that saw its
            floor (see `edge.mapping.update.SURELY_FREE`).
        label: (N, N) int16, frontier cluster; 0 none, -1 not in a cluster yet.
        known: (N, N / 64) uint64 bits, raw != 0.
        blocked: (N, N / 64) uint64 bits, near != 0.
        frontier: (N, N / 64) uint64 bits, frontier cells.
        trail: (N, N / 64) uint64 bits, cells where the robot's centre was, and their four
            neighbours.
    """

    raw: np.ndarray
    near: np.ndarray
    top: np.ndarray
    label: np.ndarray
    known: np.ndarray
    blocked: np.ndarray
    frontier: np.ndarray
    trail: np.ndarray


def make_layers(n: int) -> Layers:
    """Make empty layers of n x n cells (n a multiple of 64); pages are touched on first use."""
    bits = (n, n // WORD)
    return Layers(
        raw=np.zeros((n, n), np.uint8),
        near=np.zeros((n, n), np.uint16),
        top=np.zeros((n, n), np.uint8),
        label=np.zeros((n, n), np.int16),
        known=np.zeros(bits, np.uint64),
        blocked=np.zeros(bits, np.uint64),
        frontier=np.zeros(bits, np.uint64),
        trail=np.zeros(bits, np.uint64),
    )


def disc_half_widths(radius_cells: float) -> np.ndarray:
    """Return half the width of each row of a disc, in cells, from its lowest row to its highest.

    >>> disc_half_widths(2.0).tolist()
    [0, 1, 2, 1, 0]
    """
    r = int(radius_cells + 1e-6)
    dy = np.arange(-r, r + 1)
    return np.floor(np.sqrt(np.maximum((radius_cells + 1e-6) ** 2 - dy**2, 0))).astype(np.int64)


def plain(array: np.ndarray) -> np.ndarray:
    """Return a writeable C-ordered float32 array; other kinds would compile the kernels again."""
    if array.dtype == np.float32 and array.flags.c_contiguous and array.flags.writeable:
        return array
    return np.array(array, np.float32, order="C")


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view


def bits_of(cells: np.ndarray) -> np.ndarray:
    """Pack (N, N) bool into a bit plane."""
    return np.packbits(cells, axis=1, bitorder="little").view(np.uint64)


@jit
def grow(rect, x, y):
    """Extend a half-open rectangle (x0, y0, x1, y1) to contain a cell."""
    rect[0] = min(rect[0], x)
    rect[1] = min(rect[1], y)
    rect[2] = max(rect[2], x + 1)
    rect[3] = max(rect[3], y + 1)


@jit
def bit_set(plane, sy, sx, on):
    """Set or clear one bit of a bit plane."""
    word = sx >> 6
    bit = np.uint64(1) << np.uint64(sx & 63)
    if on:
        plane[sy, word] |= bit
    else:
        plane[sy, word] &= ~bit


@jit
def bit_get(plane, sy, sx):
    """Return one bit of a bit plane."""
    return (plane[sy, sx >> 6] >> np.uint64(sx & 63)) & np.uint64(1) != np.uint64(0)


@jit
def add_disc(layers, shift_x, shift_y, x, y, delta, disc, clip, changed):
    """Add an occupied cell (delta 1) to the inflation around it, or remove it (delta -1).

    - `disc`: the inflation, see `disc_half_widths`.
    - `x`, `y`: window coordinates of the occupied cell.
    - `clip`: (x0, y0, x1, y1) half-open window rectangle outside which nothing is written.
    - `changed`: rectangle that is extended by the cells whose state changed.
    """
    n = layers.raw.shape[0]
    radius = len(disc) // 2
    for k in range(len(disc)):
        wy = y + k - radius
        if wy < clip[1] or wy >= clip[3]:
            continue
        sy = wy + shift_y
        if sy >= n:
            sy -= n
        for wx in range(max(x - disc[k], clip[0]), min(x + disc[k] + 1, clip[2])):
            sx = wx + shift_x
            if sx >= n:
                sx -= n
            before = layers.near[sy, sx]
            after = before + delta
            layers.near[sy, sx] = after
            if (before == 0) != (after == 0):
                bit_set(layers.blocked, sy, sx, after != 0)
                grow(changed, wx, wy)


@jit
def set_free(layers, shift_x, shift_y, x, y, changed):
    """Mark an unseen cell as free."""
    n = layers.raw.shape[0]
    sy, sx = y + shift_y, x + shift_x
    if sy >= n:
        sy -= n
    if sx >= n:
        sx -= n
    layers.raw[sy, sx] = FREE
    bit_set(layers.known, sy, sx, True)
    if layers.near[sy, sx] == 0:
        grow(changed, x, y)


@jit
def mark_trail(layers, shift_x, shift_y, x0, y0, x1, y1):
    """Mark the straight line between two window cells, thick enough to be 4-connected."""
    n = layers.raw.shape[0]
    steps = max(abs(x1 - x0), abs(y1 - y0), 1)
    for k in range(steps + 1):
        x, y = x0 + (x1 - x0) * k // steps, y0 + (y1 - y0) * k // steps
        for dx, dy in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
            if 0 <= x + dx < n and 0 <= y + dy < n:
                bit_set(layers.trail, (y + dy + shift_y) % n, (x + dx + shift_x) % n, True)


@jit
def on_trail(layers, sy, sx, body):
    """Return True if the robot was at a storage cell, and no obstacle is known there.

    Rounding to cells may make a gap that the robot came through look too narrow afterwards. Without
    this exception the robot would be shut in. `body` is the disc that must be free of obstacles; it
    is smaller than the inflation.
    """
    if not bit_get(layers.trail, sy, sx) or layers.near[sy, sx] & ZONE:
        return False
    n = layers.raw.shape[0]
    radius = len(body) // 2
    for k in range(len(body)):
        for dx in range(-body[k], body[k] + 1):
            if layers.raw[(sy + k - radius) % n, (sx + dx) % n] >= OCCUPIED:
                return False
    return True


@jit
def near_trail(layers, sy, sx, radius):
    """Return True if the trail comes within `radius` cells of a storage cell."""
    n = layers.raw.shape[0]
    r = int(radius)
    for dy in range(-r, r + 1):
        for dx in range(-r, r + 1):
            near = dx * dx + dy * dy <= radius * radius
            if near and bit_get(layers.trail, (sy + dy) % n, (sx + dx) % n):
                return True
    return False


@jit
def remove_obstacles(layers, shift_x, shift_y, x0, y0, x1, y1, disc, changed):
    """Remove the obstacles of a window rectangle, and their inflation."""
    n = layers.raw.shape[0]
    clip = (0, 0, n, n)
    for y in range(y0, y1):
        sy = (y + shift_y) % n
        for x in range(x0, x1):
            sx = (x + shift_x) % n
            if layers.raw[sy, sx] >= OCCUPIED:
                layers.raw[sy, sx] = UNSEEN
                add_disc(layers, shift_x, shift_y, x, y, -1, disc, clip, changed)


@jit
def wipe(layers, shift_x, shift_y, x0, y0, x1, y1, dirty):
    """Clear a window rectangle; mark clusters with cells in it in `dirty`."""
    n = layers.raw.shape[0]
    for y in range(y0, y1):
        sy = (y + shift_y) % n
        for x in range(x0, x1):
            sx = (x + shift_x) % n
            label = layers.label[sy, sx]
            if label > 0:
                dirty[label] = True
            layers.raw[sy, sx] = UNSEEN
            layers.near[sy, sx] = 0
            layers.top[sy, sx] = 0
            layers.label[sy, sx] = 0
            if sx & 63 == 0:
                layers.known[sy, sx >> 6] = np.uint64(0)
                layers.blocked[sy, sx >> 6] = np.uint64(0)
                layers.frontier[sy, sx >> 6] = np.uint64(0)
                layers.trail[sy, sx >> 6] = np.uint64(0)


@jit
def inflate_into(layers, shift_x, shift_y, source, target, disc, changed):
    """Inflate the obstacles of the window rectangle `source`, writing only into `target`."""
    n = layers.raw.shape[0]
    for y in range(max(source[1], 0), min(source[3], n)):
        sy = (y + shift_y) % n
        for x in range(max(source[0], 0), min(source[2], n)):
            sx = (x + shift_x) % n
            if layers.raw[sy, sx] >= OCCUPIED:
                add_disc(layers, shift_x, shift_y, x, y, 1, disc, target, changed)

"""Saves the map's layers for the checkpoint in tiles of 64 x 64 cells: copy, pack, unpack, restore.

The map is copied while the loop continues, without a stall, but as of one moment. In each tick
`TileCopier` copies some of the tiles written since the last time, and again those that were
written in between. When none is left, its copy is the map of that tick.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from edge.host.checkpoint import Arrays, check_arrays
from edge.mapping.window import TILE, Window

MOST_PER_STEP = 128
"""Tiles copied per step in addition to those of one update; takes 0.1 to 0.2 ms."""
_ZLIB_LEVEL = 1  # compression level

TileIndex = tuple[int, int]
"""(row, column) of a storage tile, or (x, y) of a world tile."""


VALUE_PLANES = 2
"""Number of `RollingMap.planes` that belong to the value maps: the last ones."""


def tiled(array: np.ndarray, m: int) -> np.ndarray:
    """Return a view of (rows, columns, …) as (m, rows / m, m, columns / m, …)."""
    rows, columns, *rest = array.shape
    return array.reshape(m, rows // m, m, columns // m, *rest)


class TileBatch(NamedTuple):
    """Copies of k storage tiles.

    Attributes:
        row: (k,) row of each tile.
        column: (k,) column of each tile.
        planes: the layers, (k, rows, columns, …) each.
    """

    row: np.ndarray
    column: np.ndarray
    planes: tuple[np.ndarray, ...]


class TileCopier:
    """Copies the written tiles of a map until it has all of one moment; for the loop's thread."""

    def __init__(self) -> None:
        self._window: Window | None = None
        self._restarted = True
        self._batches: list[TileBatch] = []

    def step(self, window: Window, planes: Iterable[np.ndarray], most: int) -> bool:
        """Copy up to `most` tiles; return True if `collect` now gives the complete current map."""
        if window is not self._window:  # another map: drop the tiles of the last one
            self._window, self._restarted, self._batches = window, True, []
        row, column = np.nonzero(window.written)
        row, column = row[:most], column[:most]
        if len(row):
            copies = tuple(plane[row, :, column] for plane in planes)
            self._batches.append(TileBatch(row, column, copies))
            window.written[row, column] = False
        return not window.written.any()

    def collect(self) -> tuple[bool, list[TileBatch]]:
        """Return True if the map is a new one, and the copies since the last call, oldest first."""
        taken = self._restarted, self._batches
        self._restarted, self._batches = False, []
        return taken


class PackedTiles:
    """A map's compressed tiles; for the writer's thread.

    Each tile is packed by itself, so that only changed tiles are packed again. Empty tiles are left
    out.
    """

    def __init__(self) -> None:
        self._packed: dict[TileIndex, bytes] = {}

    def update(self, batches: Iterable[TileBatch]) -> None:
        """Pack copied tiles, oldest first."""
        for row, column, planes in batches:
            empty = ~np.any([plane.reshape(len(row), -1).any(axis=1) for plane in planes], axis=0)
            for i, tile_index in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
                if empty[i]:
                    self._packed.pop(tile_index, None)
                else:
                    tile = b"".join(plane[i].tobytes() for plane in planes)
                    self._packed[tile_index] = zlib.compress(tile, _ZLIB_LEVEL)

    def state_dict(self, origin: np.ndarray, n: int) -> Arrays:
        """Return the packed tiles, one after the other.

        Returns:
            `xy` (k, 2) int32, world tiles: tile x has the world cells 64 x to 64 x + 63. `n_bytes`
            (k,) int32, packed size of each tile. `packed` (n_bytes.sum(),) uint8.
        """
        (x0, y0), m = (int(at) // TILE for at in origin), n // TILE
        # World tile of each storage tile (row r, column c).
        xy = [(x0 + (c - x0) % m, y0 + (r - y0) % m) for r, c in self._packed]
        return {
            "xy": np.array(xy, np.int32).reshape(-1, 2),
            "n_bytes": np.array(list(map(len, self._packed.values())), np.int32),
            "packed": np.frombuffer(b"".join(self._packed.values()), np.uint8),
        }


def unpack_tiles(state: Arrays, size: int) -> Iterator[tuple[TileIndex, bytes]]:
    """Yield world tiles (x, y) of a `state_dict`, each with its bytes.

    Raises:
        ValueError: the arrays are inconsistent, or a tile has another size than `size` bytes.
    """
    template = PackedTiles().state_dict(np.zeros(2), TILE)
    rows = {("xy", "n_bytes"): 1 << 12, ("packed",): 1 << 27}
    check_arrays(state, template, rows, {"n_bytes": 1 << 24})
    packed, ends = state["packed"].data, np.cumsum(state["n_bytes"], dtype=np.int64).tolist()
    if (ends[-1] if ends else 0) != len(packed):
        raise ValueError("tiles: the sum of n_bytes is not the size of packed")
    for (x, y), start, end in zip(state["xy"].tolist(), [0, *ends], ends, strict=False):
        yield (x, y), _unpack(packed[start:end], size)


def _unpack(packed: memoryview, size: int) -> bytes:
    """Unpack one tile. A bad file cannot make it larger than one byte more than `size`."""
    unpacker = zlib.decompressobj()
    try:
        tile = unpacker.decompress(packed, size + 1)
    except zlib.error:
        raise ValueError("tiles: a tile cannot be decompressed") from None
    if len(tile) != size or not unpacker.eof or unpacker.unused_data:
        raise ValueError(f"tiles: a tile does not have {size} bytes")
    return tile


def tile_bytes(planes: Iterable[np.ndarray]) -> int:
    """Return the unpacked size of one tile in bytes."""
    return sum(plane[0, :, 0].nbytes for plane in planes)


def write_tiles(
    planes: Iterable[np.ndarray], window: Window, tiles: Iterable[tuple[TileIndex, bytes]]
) -> None:
    """Write unpacked world tiles into the layers; tiles outside the window are ignored.

    Args:
        planes: all of `RollingMap.planes`, or the first ones; the tiles hold the same.
        window: window of the map.
        tiles: world tiles (x, y), each with its bytes.
    """
    m = len(window.written)
    first = window.origin[0] // TILE, window.origin[1] // TILE
    for (x, y), tile in tiles:
        if not all(0 <= at - low < m for at, low in zip((x, y), first, strict=True)):
            continue
        window.written[y % m, x % m] = True
        start = 0
        for plane in planes:
            target = plane[y % m, :, x % m]
            end = start + target.nbytes
            target[...] = np.frombuffer(tile[start:end], plane.dtype).reshape(target.shape)
            start = end

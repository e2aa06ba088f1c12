"""What is kept of places as bytes, and back: trusted with nothing.

One line `{"format", "version", "sha256", "table", "arrays", "tiles"}`, the last three being the
lengths of what follows: a JSON table of the arrays, all arrays in one zlib stream, and the map's
tiles, each a zlib stream. The checksum is over all that follows the line.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from edge.loop.places import WORD, Kept, check
from edge.mapping.tiles import Place, unpack
from edge.mission.sealed import Sealed

VERSION = 1
MAX_BYTES = 96 << 20
MAX_ARRAYS_BYTES = 64 << 20
_MAX_TABLE_BYTES = 256 << 10
_MOST_WORDS, _LONGEST_WORD = 1 << 15, 1000
_LEVEL = 1  # of zlib
_BETWEEN = "\0"  # words
_TYPES = ("b1", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")

_LENGTHS = rb'"table":([0-9]{1,9}),"arrays":([0-9]{1,9}),"tiles":([0-9]{1,9})\}\n'
FILE = Sealed("edge-map", "map", VERSION, _LENGTHS + rb"(?P<body>.*)", MAX_BYTES)
_Sizes = Annotated[tuple[Annotated[int, Field(ge=0, le=1 << 26)], ...], Field(max_length=8)]
_Count = Annotated[int, Field(ge=0)]
_Name = Annotated[str, Field(max_length=100)]
_ROWS = TypeAdapter(
    Annotated[
        list[tuple[_Name, _Name, _Sizes, Annotated[int, Field(ge=0)]]], Field(max_length=500)
    ],
    config=ConfigDict(strict=False),
)


@dataclass(frozen=True, eq=False)
class Places:
    """What a file holds: the arrays, and the map's tiles, still packed."""

    kept: Kept
    tiles: tuple[bytes, ...]

    def unpacked(self, size: int) -> Iterator[tuple[Place, bytes]]:
        """World tiles (x, y), each with its bytes.

        Raises:
            ValueError: one is not of this size.
        """
        for (x, y), tile in zip(self.kept["tile/xy"].tolist(), self.tiles, strict=True):
            yield (x, y), unpack(tile, size)


def encode(places: Places) -> bytes:
    """The file's content.

    Raises:
        ValueError: with one line, where `decode` would not take it.
    """
    sizes = np.array([len(tile) for tile in places.tiles], np.int32)
    kept = {**places.kept, "tile/bytes": sizes}
    check(kept)
    rows, raw = [], []
    for name, array in kept.items():
        words = array.dtype.kind == WORD
        raw.append(_BETWEEN.join(array.tolist()).encode() if words else array.tobytes())
        dtype = WORD if words else array.dtype.newbyteorder("<").str[1:]
        rows.append((name, dtype, array.shape, len(raw[-1])))
    table = json.dumps(rows, separators=(",", ":")).encode()
    arrays, tiles = zlib.compress(b"".join(raw), _LEVEL), b"".join(places.tiles)
    lengths = f'"table":{len(table)},"arrays":{len(arrays)},"tiles":{len(tiles)}}}\n'
    return FILE.seal(lengths, table + arrays + tiles)


def decode(content: bytes) -> Places:
    """What `encode` made a file of; memory is allocated for what the limits allow, no more.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    whole, body = FILE.open(content)
    n_table, n_arrays, n_tiles = (int(whole[i]) for i in (3, 4, 5))
    if n_table + n_arrays + n_tiles != len(body):
        raise ValueError("its lengths are not those of its parts")
    kept = _arrays(bytes(body[:n_table]), body[n_table : n_table + n_arrays])
    check(kept)
    return Places(kept, _tiles(kept, body[n_table + n_arrays :]))


def _arrays(table: bytes, packed: memoryview) -> Kept:
    if len(table) > _MAX_TABLE_BYTES:
        raise ValueError(f"a table of more than {_MAX_TABLE_BYTES} bytes")
    try:
        rows = _ROWS.validate_json(table)
    except ValidationError:
        raise ValueError("its table is none") from None
    total = sum(size for *_, size in rows)
    if total > MAX_ARRAYS_BYTES or len({name for name, *_ in rows}) < len(rows):
        raise ValueError("its table is none")
    raw = unpack(packed, total)
    kept: Kept = {}
    start = 0
    for name, dtype, shape, size in rows:
        kept[name] = _array(name, dtype, shape, raw[start : start + size])
        start += size
    return kept


def _array(name: str, dtype: str, shape: tuple[int, ...], raw: bytes) -> np.ndarray:
    """Raises ValueError where these bytes are no such array."""
    if dtype == WORD:
        # Counted first: a long word among many short ones would take its length for each.
        n = raw.count(_BETWEEN.encode()) + 1 if raw or shape != (0,) else 0
        if shape == (n,) and n <= _MOST_WORDS:
            words = raw.decode().split(_BETWEEN) if n else []
            if max(map(len, words), default=0) <= _LONGEST_WORD:
                return np.array(words, np.str_)
    elif dtype in _TYPES and math.prod(shape) * int(dtype[1]) == len(raw):
        return np.frombuffer(raw, f"<{dtype}").astype(dtype).reshape(shape)
    raise ValueError(f"{name!r:.60} is not what the table says")


def _tiles(kept: Kept, body: memoryview) -> tuple[bytes, ...]:
    ends = np.cumsum(kept["tile/bytes"], dtype=np.int64)
    if (ends[-1] if len(ends) else 0) != len(body):
        raise ValueError("its tiles are not what the table says")
    starts = [0, *ends.tolist()][:-1]
    return tuple(bytes(body[a:b]) for a, b in zip(starts, ends.tolist(), strict=True))

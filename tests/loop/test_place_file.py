"""The file of places: whole or refused, whatever is in it; memory never beyond its limits."""

from __future__ import annotations

import hashlib
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_places import Run, config

from edge.loop import place_file
from edge.loop.place_file import Places, decode, encode
from edge.loop.places import TABLE, WORD


@pytest.fixture(scope="module")
def content(tmp_path_factory) -> bytes:
    """Of a file that a run has written."""
    path = tmp_path_factory.mktemp("kept") / "m.json"
    run = Run(path, config("hvl")).ticks(40)
    pose = run.drive.motion.odometry
    run.service.map.grid.bumps.close(pose, pose.ahead(0.5), 0.2, run.drive.motion.stamp_ns)
    run.service.keeper.close()
    return path.with_name("m.json.map").read_bytes()


def wrong(content: bytes) -> str:
    """Why it is no file; "" where it is one."""
    try:
        decode(content)
    except ValueError as error:
        return str(error)
    return ""


def in_file(table: bytes, arrays: bytes, tiles: bytes = b"", version: int = 1) -> bytes:
    """A file whose checksum is right, whatever is in it."""
    body = table + arrays + tiles
    return (
        b'{"format":"edge-map","version":%d,"sha256":"%s","table":%d,"arrays":%d,"tiles":%d}\n'
        % (version, hashlib.sha256(body).hexdigest().encode(), len(table), len(arrays), len(tiles))
        + body
    )


def forged(monkeypatch: pytest.MonkeyPatch, places: Places, name: str, array: np.ndarray) -> bytes:
    """A file in which one array is another."""
    with monkeypatch.context() as unchecked:
        unchecked.setattr(place_file, "check", lambda kept: None)
        return encode(Places({**places.kept, name: array}, places.tiles))


def test_what_is_decoded_is_what_was_encoded(content):
    places = decode(content)
    again = decode(encode(places))
    assert places.kept.keys() == again.kept.keys() > TABLE.keys()
    for name, array in places.kept.items():
        np.testing.assert_array_equal(array, again.kept[name], name)
    assert places.tiles == again.tiles


@pytest.mark.parametrize(
    ("whole", "text"),
    [
        (b"", "not a whole map"),
        (b"{}", "not a whole map"),
        (b"\0" * 5000, "not a whole map"),
        (in_file(b"[]", zlib.compress(b"")), "about/boot is missing"),
        (in_file(b"[]", zlib.compress(b""), version=2), "version 2, this program reads 1"),
        (in_file(b"{}", zlib.compress(b"")), "its table is none"),
        (in_file(b"[" * 100_000, zlib.compress(b"")), "its table is none"),
        (in_file(b" " * 300_000, zlib.compress(b"")), "a table of more than"),
        (in_file(b'[["a","f8",[67000000],536000000]]', b""), "its table is none"),
        (in_file(b'[["a","f8",[1],8],["a","f8",[1],8]]', b""), "its table is none"),
        (in_file(b'[["a","f8",[2],8]]', zlib.compress(bytes(8))), "'a' is not what"),
        (in_file(b'[["a","O",[1],8]]', zlib.compress(bytes(8))), "'a' is not what"),
        (in_file(b'[["a","f8",[1],8]]', zlib.compress(bytes(9))), "not of 8 bytes"),
        (in_file(b'[["a","f8",[1],8]]', b"garbage"), "cannot be unpacked"),
        (in_file(b'[["a","U",[2],1]]', zlib.compress(b"x")), "'a' is not what"),
        (in_file(b'[["a","U",[1],2000]]', zlib.compress(b"x" * 2000)), "'a' is not what"),
        (in_file(b'[["a","U",[1],1]]', zlib.compress(b"\xff")), "can't decode"),
        (in_file(b'[["a\\u000a","f8",[],8]]', zlib.compress(bytes(8))), "about/boot is missing"),
    ],
    ids=range(18),
)  # fmt: skip
def test_what_is_no_map_is_refused_in_one_line(whole, text):
    said = wrong(whole)
    assert text in said
    assert "\n" not in said


@given(st.data())
def test_damage_anywhere_is_told(content, data):
    at = data.draw(st.integers(0, len(content) - 1))
    flipped = bytes([content[at] ^ 1 << data.draw(st.integers(0, 7))])
    damaged = [content[:at], content[:at] + flipped + content[at + 1 :], content + b"\0"]
    assert all(map(wrong, damaged))


@given(st.binary(max_size=300))
def test_any_bytes_are_no_map(garbage):
    assert wrong(garbage) == "not a whole map"


@pytest.mark.parametrize("name", sorted(TABLE.keys() - {"tile/bytes"}))
def test_every_array_is_held_to_the_table(content, monkeypatch, name):
    places, column = decode(content), TABLE[name]
    assert wrong(forged(monkeypatch, places, name, places.kept[name])) == ""
    array = places.kept[name]
    others = [array[..., None] if column.dtype != WORD else np.zeros(1)]
    if column.low is not None and column.dtype != WORD:
        shape = [len(array) if size == 0 else size for size in array.shape]
        least = np.nan if array.dtype.kind == "f" else np.iinfo(array.dtype).min
        others += [np.full(shape, least, array.dtype)] if array.size else []
    for other in others:
        said = wrong(forged(monkeypatch, places, name, other))
        limited = column.low is None or array.dtype.kind != "i" or column.low > np.iinfo("i4").min
        assert name in said or not limited, (name, other.dtype, other.shape)


@given(st.lists(st.sampled_from(sorted(TABLE)), min_size=1, max_size=3), st.integers(0, 1000))
def test_whatever_numbers_a_file_holds_the_service_goes_on(tmp_path_factory, content, names, seed):
    """The checksum is right, and some arrays hold anything of their type, within the limits."""
    places, random = decode(content), np.random.default_rng(seed)
    changes = {}
    for name in names:
        column, array = TABLE[name], places.kept[name]
        if column.dtype == WORD or name == "tile/bytes":
            continue
        low, high = (0, 1) if column.low is None else (column.low, column.high)
        far = 10.0 ** random.integers(1, 9 if array.itemsize < 8 else 18)
        low = max(low, -far)
        high = max(low, min(high, far, 2.0 ** (8 * array.itemsize - 2)))
        drawn = random.uniform(low, high, array.shape)
        changes[name] = drawn.astype(array.dtype)
    path = tmp_path_factory.mktemp("forged") / "m.json"
    try:
        made = encode(Places({**places.kept, **changes}, places.tiles))
    except ValueError:
        return
    path.with_name("m.json.map").write_bytes(made)
    run = Run(path, config("hvl", source={"localised": True})).ticks(2)
    assert run.service.map.grid.window.placed
    run.service.keeper.close()


def test_a_bomb_in_what_is_packed_takes_no_memory(content):
    places, bomb = decode(content), zlib.compress(bytes(1 << 27), 9)
    tracemalloc.start()
    made = encode(Places(places.kept, (bomb, *places.tiles[1:])))
    with pytest.raises(ValueError, match="not of 8960 bytes"):
        list(decode(made).unpacked(8960))
    assert "not of 8 bytes" in wrong(in_file(b'[["a","f8",[1],8]]', bomb))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 16 << 20

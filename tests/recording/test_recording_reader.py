"""MCAP files of anybody's: nothing is larger in memory than the file says and the reader allows."""

from __future__ import annotations

import argparse
import struct
import tracemalloc
import zlib
from collections.abc import Callable

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord, Metadata, Schema
from recordings import Recording

from edge.recording import commands, reader, replay_source
from edge.recording.channels import JOURNAL
from edge.recording.file import McapReader, recover
from edge.recording.journal import MAX_VALUES
from edge.recording.reader import MAGIC
from edge.recording.session import RecordedRun, RecordingError
from edge.sources.recording import read
from edge.text import read_json

MANY = 1 << 27
"""Bytes that a small file stands for."""
FEW = 1 << 24


def packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def message(payload: bytes) -> bytes:
    head = struct.pack("<BQHIQQ", Opcode.MESSAGE, len(payload) + 22, 1, 0, 0, 0)
    return head + payload


def zstd(data: bytes, known: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=known).compress(data)


def chunk(data: bytes, size: int, compression: str = "", crc: int = 0) -> bytes:
    return packed(Chunk(compression, data, 0, 0, crc, size))


CHANNEL = packed(Schema(1, b"", "", "status")) + packed(Channel(1, "/status", "json", {}, 1))
SMALL = CHANNEL + message(b"{}")


def write(path, *parts: bytes) -> None:
    end = packed(DataEnd(0)) + packed(Footer(0, 0, 0)) + MAGIC
    path.write_bytes(b"".join([MAGIC, packed(Header("", "")), *parts, end]))


NOTHING = bytes(MANY)
NOT_THE_SIZE = "a chunk does not have its declared size"
BOMBS: dict[str, tuple[Callable[[], bytes], str]] = {
    "zstd": (lambda: chunk(zstd(NOTHING), 1000, "zstd"), NOT_THE_SIZE),
    "zstd, of no size": (
        lambda: chunk(zstd(NOTHING, False), 1000, "zstd"),
        "cannot be decompressed",
    ),
    "zstd, of too small a size": (lambda: chunk(zstd(SMALL), len(SMALL) + 1, "zstd"), NOT_THE_SIZE),
    "lz4": (lambda: chunk(lz4.frame.compress(NOTHING), 1000, "lz4"), NOT_THE_SIZE),
    "lz4, of no length": (lambda: chunk(lz4.frame.compress(NOTHING), 0, "lz4"), NOT_THE_SIZE),
    "lz4, cut off": (
        lambda: chunk(lz4.frame.compress(SMALL)[:-8], len(SMALL), "lz4"),
        NOT_THE_SIZE,
    ),
    "none": (lambda: chunk(SMALL, 1000), NOT_THE_SIZE),
    "another codec": (lambda: chunk(SMALL, len(SMALL), "xz"), "unknown compression xz"),
    "a size of all": (
        lambda: chunk(zstd(SMALL), 1 << 62, "zstd"),
        f"chunk has {1 << 62} bytes, at most",
    ),
    "checksum": (
        lambda: chunk(SMALL, len(SMALL), crc=zlib.crc32(SMALL) ^ 1),
        "checksum of a chunk",
    ),
    "a long record": (
        lambda: chunk(struct.pack("<BQ", Opcode.MESSAGE, 1 << 62) + b"x", 10),
        "a record is longer than its chunk",
    ),
    "a chunk within a chunk": (lambda: chunk(chunk(zstd(NOTHING), MANY, "zstd"), 9), NOT_THE_SIZE),
    "a short message": (
        lambda: chunk(struct.pack("<BQ", Opcode.MESSAGE, 0), 9),
        "too short to have its",
    ),
    "a length in a chunk": (
        lambda: struct.pack("<BQ", Opcode.CHUNK, 40) + bytes(28) + struct.pack("<IQ", 0, 1 << 62),
        "a record is shorter than its content",
    ),
    "channels": (
        lambda: b"".join(
            chunk(zstd(c), len(c), "zstd")
            for c in (packed(Channel(i, "x" * (1 << 20), "", {}, 0)) for i in range(2, 66))
        ),
        "or more than 8388608 bytes",
    ),
    "many channels": (
        lambda: b"".join(packed(Channel(i, "", "", {}, 0)) for i in range(2, 10_010)),
        "more than 10000 schemas, channels and metadata",
    ),
    "one channel": (
        lambda: chunk(zstd(c := packed(Channel(2, "x" * FEW, "", {}, 0))), len(c), "zstd"),
        "bytes, at most",
    ),
    "metadata": (
        lambda: b"".join(packed(Metadata(f"{i}", {"a": "x" * (1 << 20)})) for i in range(64)),
        "or more than 8388608 bytes",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BOMBS)
def test_a_small_file_stays_small(tmp_path, case):
    """All readers of recordings read the part before the limit."""
    bomb, why = BOMBS[case]
    path = tmp_path / "edge-a.mcap"
    write(path, chunk(SMALL, len(SMALL)), bomb())
    tracemalloc.start()
    try:
        reading = McapReader(path)
        assert [m.payload for m in reading] == [b"{}"]
        assert reading.truncation.startswith("damaged: ")
        assert why in reading.truncation
        with pytest.raises(RecordingError, match="not a complete MCAP file: damaged"):
            list(read(path))
        assert recover(path, tmp_path / "out.mcap") == (1, reading.truncation)
        with pytest.raises(RecordingError, match="no journal to replay"):
            RecordedRun(path)
        assert tracemalloc.get_traced_memory()[1] < MANY / 4
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("known", [True, False])
def test_a_chunk_of_its_declared_size_is_read(tmp_path, known):
    path = tmp_path / "a.mcap"
    whole, data = message(b"x" * 10_000), CHANNEL + message(b"y")
    write(
        path,
        chunk(zstd(data, known), len(data), "zstd", zlib.crc32(data)),
        chunk(b"", 0),
        chunk(lz4.frame.compress(whole), len(whole), "lz4", zlib.crc32(whole)),
        chunk(CHANNEL * 3, 3 * len(CHANNEL)),  # repeated values take no more memory
        struct.pack("<BQ", Opcode.ATTACHMENT, 3) + b"any",  # passed over, whatever it says
        struct.pack("<BQ", 0x80, 2) + b"??",
        message(b"z"),
    )
    reading = McapReader(path)
    assert [m.payload[:1] for m in reading] == [b"y", b"x", b"z"]
    assert (reading.is_complete, reading.truncation) == (True, "")


def test_attachments_are_skipped_in_blocks(tmp_path, monkeypatch):
    """An attachment as large as a disk passes through a block at a time."""
    monkeypatch.setattr(reader, "MAX_RECORD_BYTES", 1 << 10)
    path = tmp_path / "a.mcap"
    write(path, SMALL, struct.pack("<BQ", Opcode.ATTACHMENT, FEW) + bytes(FEW), message(b"z"))
    assert [m.payload for m in McapReader(path)] == [b"{}", b"z"]


def test_json_of_a_million_values_is_not_read():
    ok, many = b"[" + b"0," * 1000 + b"0]", b"[" + b"[]," * MAX_VALUES + b"0]"
    assert len(read_json(ok, MAX_VALUES)) == 1001
    with pytest.raises(ValueError, match="more than 1048576 values"):
        read_json(many, MAX_VALUES)


def test_a_page_of_a_million_values_is_damaged(tmp_path):
    recorded = Recording(tmp_path / "run").steps(1).close()
    reading = McapReader(recorded)
    list(reading)
    path, bomb = tmp_path / "edge-a.mcap", b'{"entries":[' + b"[]," * MAX_VALUES + b"[]]}"
    said = packed(Metadata("edge-recording", reading.metadata["edge-recording"]))
    channel = packed(Channel(1, JOURNAL.topic, "json", {}, 0))
    write(path, said, channel, *[chunk(zstd(m := message(bomb)), len(m), "zstd")])
    with pytest.raises(RecordingError, match="damaged journal: ValueError: more than"):
        list(RecordedRun(path).steps())


def test_frames_that_wait_for_detections_are_of_limited_size(tmp_path, monkeypatch):
    session = RecordedRun(Recording(tmp_path).steps(4).close())
    seen = [m.observation for m in session.steps() if m.observation is not None]
    now = replay_source.ReplayTick()
    for observation in seen:
        now.add_frame(observation, True)
    assert len(now.frames) == len(seen) == 4
    size = replay_source._bytes_of(seen[0])
    monkeypatch.setattr(replay_source, "_MAX_FRAMES_BYTES", 2 * size)
    now.add_frame(seen[-1], True)
    assert list(now.frames) == [observation.seq for observation in seen[-2:]]


def test_a_trace_is_of_the_first_spans(tmp_path, monkeypatch, capsys):
    path = Recording(tmp_path).steps(3).close()
    every = commands.spans_of(path)
    monkeypatch.setattr(commands, "MAX_SPANS", len(every) - 1)
    args = argparse.Namespace(file=str(path), out=tmp_path / "trace.json")
    assert commands.trace(args) == 0
    assert f"only its first {len(every) - 1} spans" in capsys.readouterr().out

"""How an MCAP file is laid out: messages in compressed chunks, and what finds them at the end.

Rare records are written by the library `mcap`. Its writer for all of them takes a dozen small steps
for each message, copies each chunk four times, and knows one level of each codec.
https://mcap.dev/spec is the format.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 1 << 20
"""A chunk that holds as much is complete."""
COMPRESSIONS: dict[str, tuple[str, Callable[[memoryview], Any]]] = {
    "none": ("", lambda data: data),
    "lz4": ("lz4", partial(lz4.frame.compress, compression_level=-16)),
    "zstd": ("zstd", partial(zstandard.compress, level=1)),
}
"""By what the user calls it: what the format calls it, and what does it. Depth at lz4's own level
is half as large and takes 1.7 times as long; zstd's first level is nearly as small as its third."""

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_BYTES = _MESSAGE.size - 9  # without its opcode and its length
_CHUNK = struct.Struct("<BQQQQII")
_INDEX = struct.Struct("<BQHI")
_LENGTH = struct.Struct("<Q")


class Writer:
    """Lays out one file.

    Args:
        write: takes what comes next in the file, in parts, and raises OSError where it cannot.
        compression: of `COMPRESSIONS`.

    Attributes:
        at: bytes that were written so far; what is in the chunk at hand is not yet counted.
    """

    def __init__(self, write: Callable[[Sequence[Any]], None], compression: str) -> None:
        self.at = 0
        self._write, (self._codec, self._compress) = write, COMPRESSIONS[compression]
        self._crc = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: Counter[int] = Counter()  # messages by channel
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        # The chunk at hand, in a buffer that is used again and again.
        self._chunk = memoryview(bytearray(CHUNK_BYTES + CHUNK_BYTES // 4))
        self._end = 0
        self._index: dict[int, list[int]] = {}  # by channel: time, place, time, place, …

    def start(self, metadata: Mapping[str, dict[str, str]]) -> None:
        """Begin the file, with what it says of itself, by name."""
        self._put(MAGIC, _bytes(Header("ros2", "edge")))
        for name, said in metadata.items():
            record = _bytes(Metadata(name, said))
            self._metadata.append(MetadataIndex(self.at, len(record), name))
            self._put(record)

    def register(
        self, topic: str, encoding: str, schema: str, schema_encoding: str, schema_data: bytes
    ) -> int:
        """A channel; its number for `add`."""
        number = len(self._channels) + 1
        self._schemas.append(Schema(number, schema_data, schema_encoding, schema))
        self._channels.append(Channel(number, topic, encoding, {}, number))
        self._into_chunk(_bytes(self._schemas[-1]), _bytes(self._channels[-1]))
        return number

    def add(
        self, channel: int, log_ns: int, stamp_ns: int, payload: Sequence[Any], sequence: int = 0
    ) -> None:
        """A message, whose payload may come in parts: bytes, or a memoryview of bytes."""
        size = sum(map(len, payload)) + _MESSAGE_BYTES
        self._index.setdefault(channel, []).extend((log_ns, self._end))
        head = _MESSAGE.pack(Opcode.MESSAGE, size, channel, sequence, log_ns, stamp_ns)
        self._into_chunk(head, *payload)
        if self._end >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Complete the chunk at hand, unless no message is in it, and write it."""
        if not self._index:
            return
        times_ns = [ns for entries in self._index.values() for ns in entries[::2]]
        span_ns = min(times_ns), max(times_ns)
        with self._chunk[: self._end] as data:
            packed, crc = self._compress(data), zlib.crc32(data)
            codec, packed_size = self._codec.encode(), len(packed)
            size = _CHUNK.size - 9 + len(codec) + _LENGTH.size + packed_size
            head = _CHUNK.pack(Opcode.CHUNK, size, *span_ns, self._end, crc, len(codec))
            begin = self.at
            self._put(head + codec + _LENGTH.pack(packed_size), packed)
        index_begin, places, records = self.at, {}, []
        for channel, entries in self._index.items():
            places[channel] = index_begin + sum(map(len, records))
            size = 8 * len(entries)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size)
            records.append(head + struct.pack(f"<{len(entries)}Q", *entries))
            self._counts[channel] += len(entries) // 2
        self._put(b"".join(records))
        self._chunks.append(ChunkIndex(
            index_begin - begin, begin, self._codec, packed_size, span_ns[1], self.at - index_begin,
            places, span_ns[0], self._end,
        ))  # fmt: skip
        self._end, self._index = 0, {}

    def finish(self) -> None:
        """Write the last chunk, and the summary that finds what is in the file."""
        self.flush()
        self._put(_bytes(DataEnd(self._crc)))
        begin, summary, offsets = self.at, RecordBuilder(), []
        for group in (self._schemas, self._channels, [self._statistics()], self._chunks,
                      self._metadata):  # fmt: skip
            first = summary.count
            for record in group:
                record.write(summary)
            if group:
                opcode = _bytes(group[0])[0]
                offsets.append(SummaryOffset(opcode, begin + first, summary.count - first))
        offsets_begin = begin + summary.count
        for record in offsets:
            record.write(summary)
        # The checksum goes as far as the footer's own field for it.
        data = summary.end()
        crc = zlib.crc32(_bytes(Footer(begin, offsets_begin, 0))[:-4], zlib.crc32(data))
        self._put(data, _bytes(Footer(begin, offsets_begin, crc)), MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0, channel_count=len(self._channels),
            channel_message_counts=dict(self._counts), chunk_count=len(self._chunks),
            message_count=self._counts.total(), metadata_count=len(self._metadata),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            schema_count=len(self._schemas),
        )  # fmt: skip

    def _into_chunk(self, *parts: Any) -> None:
        size = sum(map(len, parts))
        if self._end + size > len(self._chunk):
            larger = memoryview(bytearray(self._end + size))
            larger[: self._end] = self._chunk[: self._end]
            self._chunk = larger
        for part in parts:
            end = self._end + len(part)
            self._chunk[self._end : end] = part
            self._end = end

    def _put(self, *parts: Any) -> None:
        for part in parts:
            self._crc = zlib.crc32(part, self._crc)
            self.at += len(part)
        self._write(parts)


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()

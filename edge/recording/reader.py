"""Reader of the records of untrusted MCAP files.

The library `mcap` trusts lengths inside a record and decompresses chunks without a limit, so a file
of 200 kB can take gigabytes. This reader limits everything to `MAX_RECORD_BYTES`, and rejects data
that differ from their declared size. https://mcap.dev/spec defines the format.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Header, McapRecord, Metadata, Schema

from edge.text import one_line

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 1 << 27
"""Limit of a record, and of a decompressed chunk.

Twice the largest message that a robot sends (`source.max_message_mb`).
"""
MAX_KEPT, MAX_KEPT_BYTES = 10_000, 1 << 23
"""Largest number, and size in bytes, of all schemas, channels and metadata of a file together.

They stay in memory.
"""
_BLOCK_BYTES = 1 << 20  # read at a time from a record that is skipped

# A record's opcode and size; a message's channel, sequence number, log time and publish time.
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
# Records that are yielded apart from messages.
_KEPT = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}


class DamagedError(ValueError):
    """A file that violates the format or is too large; the message is one line."""


class Message(NamedTuple):
    """A message of a channel.

    Attributes:
        log_time: time at which it was recorded, in ns.
        publish_time: time of its data, in ns.
    """

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


Record = Header | Schema | Channel | Metadata | DataEnd | Message


def read_records(file: BinaryIO) -> Iterator[Record]:
    """Yield the records of a file in their order; `Header` is first, `DataEnd` last.

    Attachments, indices and unknown records are skipped.

    Raises:
        EOFError: the file ends before its data do.
        DamagedError: the file violates the format. Records yielded before are valid.
    """
    if _read_exactly(file, len(MAGIC)) != MAGIC:
        raise DamagedError("the first bytes are not those of MCAP")
    # `crc`: checksum of all bytes before `DataEnd`, which has the correct one, or 0.
    crc, kept, begun = zlib.crc32(MAGIC), _KeptRecords(), False
    while True:
        head = _read_exactly(file, _HEAD.size)
        opcode, size = _HEAD.unpack(head)
        if not begun and opcode != Opcode.HEADER:
            raise DamagedError("the file does not begin with a header")
        begun = True
        if opcode == Opcode.DATA_END:
            end = _parse(DataEnd, _read_exactly(file, _check_size(size)))
            if end.data_section_crc not in (0, crc):
                raise DamagedError("the checksum of the file's data does not match")
            yield end
            return
        crc = zlib.crc32(head, crc)
        if opcode not in _USED:
            while size > 0:
                block = _read_exactly(file, min(size, _BLOCK_BYTES))
                crc, size = zlib.crc32(block, crc), size - len(block)
            continue
        body = _read_exactly(file, _check_size(size, _max_size(opcode)))
        crc = zlib.crc32(body, crc)
        if opcode == Opcode.CHUNK:
            yield from _chunk_records(_parse(Chunk, body), kept)
        else:
            yield _parse_record(opcode, body, kept)


_USED = (Opcode.CHUNK, Opcode.MESSAGE, *_KEPT)


class _KeptRecords:
    """Counts the records that stay in memory; a repeated record counts once."""

    def __init__(self) -> None:
        self._sizes: dict[tuple[int, int | str], int] = {}
        self._left = MAX_KEPT_BYTES  # bytes that may still be added

    def add(self, opcode: int, record: McapRecord, size: int) -> None:
        """Count a record; raise DamagedError above the limits."""
        key = opcode, getattr(record, "id", getattr(record, "name", ""))
        known = self._sizes.get(key, 0)
        if size > known:
            self._sizes[key] = size
            self._left -= size - known
        if self._left < 0 or len(self._sizes) > MAX_KEPT:
            raise DamagedError(
                f"more than {MAX_KEPT} schemas, channels and metadata records, or more than "
                f"{MAX_KEPT_BYTES} bytes of them"
            )


def _chunk_records(chunk: Chunk, kept: _KeptRecords) -> Iterator[Record]:
    data = _decompress(chunk)
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise DamagedError("the checksum of a chunk does not match")
    at = 0
    while at < len(data):
        if at + _HEAD.size > len(data):
            raise DamagedError("a chunk ends within a record")
        opcode, size = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if size > len(data) - at:
            raise DamagedError("a record is longer than its chunk")
        if opcode == Opcode.MESSAGE or opcode in _KEPT:
            yield _parse_record(opcode, data[at : at + _check_size(size, _max_size(opcode))], kept)
        at += size


def _decompress(chunk: Chunk) -> bytes:
    """Return the records of a chunk; allocates no more than its declared size."""
    size = _check_size(chunk.uncompressed_size)
    try:
        if chunk.compression == "":
            data = chunk.data
        elif chunk.compression == "zstd":
            # zstandard ignores the limit if the frame declares a size.
            if zstandard.frame_content_size(chunk.data) not in (-1, size):
                raise DamagedError("a chunk does not have its declared size")
            data = zstandard.decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "lz4":
            frame = lz4.frame.LZ4FrameDecompressor()
            data = frame.decompress(chunk.data, max_length=size + 1)
            if not frame.eof:
                raise DamagedError("a chunk does not have its declared size")
        else:
            raise DamagedError(f"unknown compression {one_line(chunk.compression, 40)}")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise DamagedError(f"a chunk cannot be decompressed: {one_line(error, 80)}") from None
    if len(data) != size:
        raise DamagedError("a chunk does not have its declared size")
    return data


def _parse_record(opcode: int, body: bytes, kept: _KeptRecords) -> Record:
    """Parse a message, or a record that is kept."""
    if opcode != Opcode.MESSAGE:
        record = _parse(_KEPT[Opcode(opcode)], body)
        kept.add(opcode, record, len(body))
        return record
    if len(body) < _MESSAGE.size:
        raise DamagedError("a message is too short to have its times")
    return Message(*_MESSAGE.unpack_from(body), body[_MESSAGE.size :])


class _Body(ReadDataStream):
    """The bytes of one record; a read beyond its end raises EndOfFile."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def _parse(kind: type[McapRecord], body: bytes) -> McapRecord:
    try:
        return kind.read(_Body(BytesIO(body)))
    except EndOfFile:
        raise DamagedError("a record is shorter than its content") from None
    except Exception as error:  # damaged data can raise anything in the library
        why = one_line(error, 80) or type(error).__name__
        raise DamagedError(f"a {kind.__name__} cannot be read: {why}") from None


def _read_exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise EOFError
    return data


def _max_size(opcode: int) -> int:
    return MAX_KEPT_BYTES if opcode in _KEPT else MAX_RECORD_BYTES


def _check_size(size: int, most: int = MAX_RECORD_BYTES) -> int:
    if size > most:
        raise DamagedError(f"a record or chunk has {size} bytes, at most {most} are allowed")
    return size

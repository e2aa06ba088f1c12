"""MCAP files: a power cut costs the last seconds at most, and what is there can be read.

A file appears under its name only when it is complete; until then it is called `NAME.partial`, and
what it holds can be read all the same.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel as ChannelRecord
from mcap.records import DataEnd, Metadata, Schema
from mcap.writer import CompressionType, Writer

from edge.errors import FileError
from edge.host.files import open_regular, sync
from edge.recording.channels import Channel
from edge.recording.reader import MAGIC, DamagedError, Message, records

PARTIAL = ".partial"
COMPRESSIONS = {kind.name.lower(): kind for kind in CompressionType}
"""`none`, `lz4` and `zstd`, as the user names them."""
_LONGER = "damaged: a record is longer than what is left of the file"
_RECOVERING = ".recovering"
"""Another, since what is recovered may be the partial file of the very name."""


class RecordingError(FileError):
    """A recording that cannot be written or read; one line."""


class _Whole:
    """A stream for the library: `write` writes all or raises, and nothing is kept in a buffer."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._fd, fcntl.LOCK_SH)  # see `is_written`
        self._at = 0

    def write(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            n = os.write(self._fd, left)
            self._at, left = self._at + n, left[n:]

    def tell(self) -> int:
        return self._at

    def flush(self) -> None:
        """Nothing is kept back."""

    def sync(self) -> None:
        os.fdatasync(self._fd)

    def close(self) -> None:
        os.close(self._fd)


class McapFile:
    """Writes one recording: a context manager, complete and in place when it ends without error.

    Args:
        metadata: of the file, by name.
        suffix: that its name has until it is complete.

    Raises:
        OSError: `add`, `sync` and the end of the block: the disk is full, or gone.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        compression: str = "lz4",
        metadata: Mapping[str, dict[str, str]] | None = None,
        suffix: str = PARTIAL,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        self._compression = compression
        self._metadata = metadata or {}
        self._partial = self.path.with_name(self.path.name + suffix)
        self._channels: dict[Channel, int] = {}

    def __enter__(self) -> McapFile:
        try:
            self.open()
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be written: {error.strerror}") from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.finish()
        else:
            self.abandon()
            self._partial.unlink()

    def open(self) -> None:
        """Begin the file; raises OSError, and there is none then."""
        self._file = _Whole(self._partial)
        try:
            self._writer = Writer(
                self._file, compression=COMPRESSIONS[self._compression], enable_data_crcs=True
            )
            self._writer.start("ros2", "edge")
            for name, said in self._metadata.items():
                self._writer.add_metadata(name, said)
        except OSError:
            self.abandon()
            self._partial.unlink()
            raise

    def add(
        self, channel: Channel, log_ns: int, stamp_ns: int, *payload: Any, sequence: int = 0
    ) -> None:
        """One message: when it was heard (or made), its stamp, and its bytes, which may come in
        parts."""
        at = self._channels.get(channel)
        if at is None:
            at = self._channels[channel] = self._register(channel)
        data = b"".join(payload)
        self._writer.add_message(at, max(0, log_ns), data, max(0, stamp_ns), sequence)
        self.messages += 1

    @property
    def bytes(self) -> int:
        """That were written so far; what is in the chunk at hand is not yet counted."""
        return self._file.tell()

    def sync(self) -> None:
        """Have all that was added on the disk."""
        self._writer.flush()
        self._file.sync()

    def finish(self) -> None:
        """Complete the file, and give it its name."""
        self._writer.finish()
        self._file.sync()
        self._file.close()
        os.replace(self._partial, self.path)
        sync(self.path.parent)

    def abandon(self) -> None:
        """Leave the file as far as it was written, under the name that it has so far."""
        self._file.close()

    def _register(self, channel: Channel) -> int:
        data = channel.schema_text.encode()
        schema = self._writer.register_schema(channel.schema, channel.schema_encoding, data)
        return self._writer.register_channel(channel.topic, channel.encoding, schema)


class Recorded(NamedTuple):
    """One message of a file; `schema` is its name."""

    topic: str
    schema: str
    encoding: str
    log_ns: int
    stamp_ns: int
    sequence: int
    payload: bytes


class McapReading:
    """The messages of a file in the order in which they were written.

    Attributes:
        metadata: by name, of what was read so far.
        whole: whether the file's end was read: one that was cut off has none.
        cut: why reading ended before that; empty while it has not.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.metadata: dict[str, dict[str, str]] = {}
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, ChannelRecord] = {}
        self.whole, self.cut = False, ""

    def __iter__(self) -> Iterator[Recorded]:
        """
        Raises:
            RecordingError: there is no such file, or it is no MCAP file.
        """
        with _opened(self.path) as file:
            found = records(file)
            begun = False
            while not self.whole:
                try:
                    record = next(found)
                except EOFError:
                    self._end(begun, _LONGER if _has_end(file) else "cut off")
                    return
                except DamagedError as error:
                    over = not file.read(1) and not _has_end(file)
                    self._end(begun, "cut off" if over else f"damaged: {error}")
                    return
                begun = True
                if isinstance(record, Schema):
                    self.schemas.setdefault(record.id, record)  # it may come again, as it was
                elif isinstance(record, ChannelRecord):
                    self.channels.setdefault(record.id, record)
                elif isinstance(record, Metadata):
                    self.metadata[record.name] = record.metadata
                elif isinstance(record, DataEnd):
                    self.whole = True  # what follows only helps to find messages
                elif isinstance(record, Message) and record.channel_id in self.channels:
                    yield self._message(record)

    def _end(self, begun: bool, why: str) -> None:
        if not begun:
            raise RecordingError(f"{self.path}: not an MCAP file")
        self.cut = why

    def _message(self, m: Message) -> Recorded:
        channel = self.channels[m.channel_id]
        schema = self.schemas.get(channel.schema_id)
        return Recorded(
            channel.topic, "" if schema is None else schema.name, channel.message_encoding,
            m.log_time, m.publish_time, m.sequence, m.data,
        )  # fmt: skip


def _has_end(file: BinaryIO) -> bool:
    """Whether a file is there to its last byte."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - len(MAGIC)))
    return file.read() == MAGIC


def is_complete(path: str | os.PathLike[str]) -> bool:
    """Return whether a file ends as a complete one does; raises RecordingError for no file."""
    with _opened(Path(path)) as file:
        return _has_end(file)


def is_written(path: Path) -> bool:
    """Whether somebody writes this file now."""
    with _opened(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@contextmanager
def _opened(path: Path):  # type: ignore[no-untyped-def]
    try:
        file = open_regular(path)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None
    with file:
        yield file


def recover(path: Path, out: Path) -> tuple[int, str]:
    """Write what can be read of a file as a complete one.

    Returns:
        How many messages that were, and why no more; empty where it was complete.

    Raises:
        RecordingError: it cannot be read, `out` cannot be written or is there already.
    """
    for there in (out, out.with_name(out.name + _RECOVERING)):
        if there.exists():
            raise RecordingError(f"{there}: is there already; name another file with --out")
    reading = McapReading(path)
    messages = iter(reading)
    first = next(messages, None)  # before anything is made: it may be no recording
    copy = McapFile(out, "zstd", reading.metadata, _RECOVERING)
    try:
        with copy:
            known: dict[str, Channel] = {}
            while first is not None:
                m, first = first, next(messages, None)
                if m.topic not in known:
                    known[m.topic] = _channel_of(reading, m)
                copy.add(known[m.topic], m.log_ns, m.stamp_ns, m.payload, sequence=m.sequence)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written: {error.strerror}") from None
    return copy.messages, reading.cut


def _channel_of(reading: McapReading, message: Recorded) -> Channel:
    of_name = (s for s in reading.schemas.values() if s.name == message.schema)
    schema = next(of_name, Schema(0, b"", "", message.schema))  # there may be none
    text = schema.data.decode(errors="replace")
    return Channel(message.topic, message.encoding, schema.name, schema.encoding, text)

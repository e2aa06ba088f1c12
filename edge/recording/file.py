"""MCAP files that survive a power cut: at most the last seconds are lost.

A file has the name `NAME.partial` until it is complete. A partial file can be read, too.
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
from edge.recording.reader import MAGIC, DamagedError, Message, read_records

PARTIAL = ".partial"
COMPRESSIONS = {kind.name.lower(): kind for kind in CompressionType}
"""`none`, `lz4` and `zstd`, as in the configuration."""
_RECORD_TOO_LONG = "damaged: a record is longer than what is left of the file"
_RECOVERING = ".recovering"
"""Not `PARTIAL`: NAME.partial may be the damaged file that is recovered to NAME."""


class RecordingError(FileError):
    """A recording cannot be written or read; the message is one line."""


class _UnbufferedFile:
    """Output stream for the library `mcap`: `write` writes everything or raises; no buffer."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._fd, fcntl.LOCK_SH)  # see `is_being_written`
        self._at = 0

    def write(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            n = os.write(self._fd, left)
            self._at, left = self._at + n, left[n:]

    def tell(self) -> int:
        return self._at

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        os.fdatasync(self._fd)

    def close(self) -> None:
        """Close the file; again: do nothing."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


class McapWriter:
    """Writes one recording; a context manager. The file is complete if the block has no error.

    Args:
        compression: `none`, `lz4` or `zstd`.
        suffix: suffix of the file's name until the file is complete.

    Raises:
        OSError: raised by `add`, `sync` and the end of the block: the disk is full or gone.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        compression: str = "lz4",
        metadata: Mapping[str, dict[str, str]] | None = None,
        suffix: str = PARTIAL,
    ) -> None:
        self.path = Path(path)
        self.messages = 0  # number of messages added
        self._compression = compression
        self._metadata = metadata or {}
        self._partial = self.path.with_name(self.path.name + suffix)
        self._channels: dict[Channel, int] = {}

    def __enter__(self) -> McapWriter:
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
        """Create the file; if that raises OSError, there is no file."""
        self._file = _UnbufferedFile(self._partial)
        try:
            self._writer = Writer(
                self._file, compression=COMPRESSIONS[self._compression], enable_data_crcs=True
            )
            self._writer.start("ros2", "edge")
            for name, fields in self._metadata.items():
                self._writer.add_metadata(name, fields)
        except OSError:
            self.abandon()
            self._partial.unlink()
            raise

    def add(
        self, channel: Channel, log_ns: int, stamp_ns: int, *payload: Any, sequence: int = 0
    ) -> None:
        """Add one message with its log time, stamp and payload, which may have several parts."""
        number = self._channels.get(channel)
        if number is None:
            number = self._channels[channel] = self._register(channel)
        data = b"".join(payload)
        self._writer.add_message(number, max(0, log_ns), data, max(0, stamp_ns), sequence)
        self.messages += 1

    @property
    def bytes(self) -> int:
        """Bytes written so far, without the current chunk."""
        return self._file.tell()

    def sync(self) -> None:
        """Write all messages to the disk."""
        self._writer.flush()
        self._file.sync()

    def finish(self) -> None:
        """Complete the file and rename it."""
        self._writer.finish()
        self._file.sync()
        self._file.close()
        os.replace(self._partial, self.path)
        sync(self.path.parent)

    def abandon(self) -> None:
        """Close the incomplete file and keep its partial name."""
        self._file.close()

    def _register(self, channel: Channel) -> int:
        data = channel.schema_text.encode()
        schema = self._writer.register_schema(channel.schema, channel.schema_encoding, data)
        return self._writer.register_channel(channel.topic, channel.encoding, schema)


class RecordedMessage(NamedTuple):
    """One message of a file.

    Attributes:
        topic: name of its channel.
        schema: name of its schema, which is the message type; "" if it has none.
        encoding: `cdr`, `json`, or another.
        sequence: number of the message in its channel.
    """

    topic: str
    schema: str
    encoding: str
    log_ns: int
    stamp_ns: int
    sequence: int
    payload: bytes


class McapReader:
    """The messages of a file in the order in which they were written.

    Attributes:
        metadata: metadata that were read so far, by name.
        schemas: schemas that were read so far, by id.
        channels: channels that were read so far, by id.
        is_complete: True if the end of the data was read; a file that is cut off has no end.
        truncation: why reading stopped before the end; empty if it did not.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.metadata: dict[str, dict[str, str]] = {}
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, ChannelRecord] = {}
        self.is_complete, self.truncation = False, ""

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Yield the messages.

        Raises:
            RecordingError: no such file, or no MCAP file.
        """
        with _open_to_read(self.path) as file:
            records = read_records(file)
            begun = False
            while not self.is_complete:
                try:
                    record = next(records)
                except EOFError:  # the last record is longer than the rest of the file
                    self._stop_reading(begun, _RECORD_TOO_LONG if _has_end(file) else "cut off")
                    return
                except DamagedError as error:
                    # Cut off: the reader is at the end of the file, and this is no proper end.
                    is_cut = not file.read(1) and not _has_end(file)
                    self._stop_reading(begun, "cut off" if is_cut else f"damaged: {error}")
                    return
                begun = True
                if isinstance(record, Schema):
                    self.schemas.setdefault(record.id, record)  # it may be repeated
                elif isinstance(record, ChannelRecord):
                    self.channels.setdefault(record.id, record)
                elif isinstance(record, Metadata):
                    self.metadata[record.name] = record.metadata
                elif isinstance(record, DataEnd):
                    self.is_complete = True  # the rest is only an index
                elif isinstance(record, Message) and record.channel_id in self.channels:
                    yield self._message(record)

    def _stop_reading(self, begun: bool, why: str) -> None:
        if not begun:
            raise RecordingError(f"{self.path}: not an MCAP file")
        self.truncation = why

    def _message(self, m: Message) -> RecordedMessage:
        channel = self.channels[m.channel_id]
        schema = self.schemas.get(channel.schema_id)
        return RecordedMessage(
            channel.topic, "" if schema is None else schema.name, channel.message_encoding,
            m.log_time, m.publish_time, m.sequence, m.data,
        )  # fmt: skip


def _has_end(file: BinaryIO) -> bool:
    """Return True if the file has its last bytes."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - len(MAGIC)))
    return file.read() == MAGIC


def has_end(path: str | os.PathLike[str]) -> bool:
    """Return True if a file ends as a complete file does; raise RecordingError for no file."""
    with _open_to_read(Path(path)) as file:
        return _has_end(file)


def is_being_written(path: Path) -> bool:
    """Return True if a process is writing this file now."""
    with _open_to_read(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@contextmanager
def _open_to_read(path: Path):  # type: ignore[no-untyped-def]
    try:
        file = open_regular(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    with file:
        yield file


def recover(path: Path, out: Path) -> tuple[int, str]:
    """Copy the readable part of a file into a complete one.

    Returns:
        The number of messages, and why there are no more; "" if the file was complete.

    Raises:
        RecordingError: `path` cannot be read, or `out` exists or cannot be written.
    """
    for new in (out, out.with_name(out.name + _RECOVERING)):
        if new.exists():
            raise RecordingError(f"{new}: exists already; name another file with --out")
    reader = McapReader(path)
    messages = iter(reader)
    following = next(messages, None)  # before a file is created: `path` may be no recording
    copy = McapWriter(out, "zstd", reader.metadata, _RECOVERING)
    try:
        with copy:
            known: dict[str, Channel] = {}
            while following is not None:
                m, following = following, next(messages, None)
                if m.topic not in known:
                    known[m.topic] = _copy_channel(reader, m)
                copy.add(known[m.topic], m.log_ns, m.stamp_ns, m.payload, sequence=m.sequence)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written: {error.strerror}") from None
    return copy.messages, reader.truncation


def _copy_channel(reader: McapReader, message: RecordedMessage) -> Channel:
    """Return the channel of a message, with the schema that the reader has found."""
    of_name = (s for s in reader.schemas.values() if s.name == message.schema)
    schema = next(of_name, Schema(0, b"", "", message.schema))  # a channel may have no schema
    text = schema.data.decode(errors="replace")
    return Channel(message.topic, message.encoding, schema.name, schema.encoding, text)

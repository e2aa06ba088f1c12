"""Reader of recordings of any robot: MCAP files, and rosbag2 folders and SQLite files (`.db3`).

Files are untrusted. Decompressed data are limited to `MAX_RECORD_BYTES`. The tables of a `.db3`
must be plain tables, since a view could compute forever. https://github.com/ros2/rosbag2 defines
both layouts.
"""

from __future__ import annotations

import heapq
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import zstandard

from edge.config.yaml_text import read_yaml
from edge.errors import ConfigError
from edge.host.files import open_regular
from edge.recording.file import McapReader, RecordedMessage, RecordingError
from edge.recording.reader import MAGIC, MAX_KEPT, MAX_RECORD_BYTES
from edge.text import one_line

METADATA = "metadata.yaml"
WINDOW_NS = 1_000_000_000
"""In a file that is nearly sorted, log times differ by at most this from those in sorted order."""
_MAX_WAITING_BYTES = 1 << 28  # of messages that wait to be sorted
_MESSAGE_BYTES = 1000  # memory of a message in addition to its payload
# First bytes of files, and of compressed data.
_SQLITE = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"
_ZSTD = b"\x28\xb5\x2f\xfd"
_BLOCK_BYTES = 1 << 20  # decompressed at a time
_MAX_NAME_CHARS = 2000  # characters of a topic and its type together
_HIDDEN = 6  # field of `PRAGMA table_xinfo`: not 0 for a computed column
_SUFFIXES = (".mcap", ".mcap.zstd", ".db3", ".db3.zstd")


def by_log_time(
    messages: Iterable[RecordedMessage], most_bytes: int = _MAX_WAITING_BYTES
) -> Iterator[RecordedMessage]:
    """Yield nearly sorted messages in the order of their log times.

    Args:
        messages: messages that are nearly sorted.
        most_bytes: limit of the messages in the sorting buffer, in bytes.
    """
    # A heap of (log time, number, message); the number decides between equal times.
    waiting: list[tuple[int, int, RecordedMessage]] = []
    size = 0
    for n, message in enumerate(messages):
        heapq.heappush(waiting, (message.log_ns, n, message))
        size += len(message.payload) + _MESSAGE_BYTES
        while size > most_bytes or message.log_ns - waiting[0][0] > WINDOW_NS:
            first = heapq.heappop(waiting)[2]
            size -= len(first.payload) + _MESSAGE_BYTES
            yield first
    while waiting:
        yield heapq.heappop(waiting)[2]


class Db3Reader:
    """The messages of a rosbag2 SQLite file in the order in which they were written.

    Attributes:
        truncation: why reading stopped before the end; empty if it did not.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.truncation = path, ""

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Yield the messages.

        Raises:
            RecordingError: it is no rosbag2 file.
        """
        begun = False
        try:
            uri = f"file:{quote(str(self.path.resolve()))}?mode=ro"
            with closing(sqlite3.connect(uri, uri=True)) as db:
                db.execute("PRAGMA trusted_schema = OFF")
                db.text_factory = lambda text: text.decode(errors="replace")
                _check_tables(db)
                topics = {
                    number: (str(name), str(kind), str(encoding))
                    for number, name, kind, encoding in db.execute(
                        "SELECT id, name, type, serialization_format FROM topics "
                        "WHERE length(name) + length(type) <= ? LIMIT ?",
                        (_MAX_NAME_CHARS, MAX_KEPT),  # MAX_KEPT: largest number of topics
                    )
                }
                begun = True
                yield from self._messages(db, topics)
        except (sqlite3.Error, ValueError, OverflowError) as error:  # damaged or forged data
            why = one_line(error, 80)
            if not begun:
                raise RecordingError(f"{self.path}: not a rosbag2 file: {why}") from None
            self.truncation = f"damaged: {why}"

    def _messages(
        self, db: sqlite3.Connection, topics: dict[Any, tuple[str, str, str]]
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of all rows; stop at the first damaged row."""
        rows = db.execute(
            "SELECT topic_id, timestamp, CASE WHEN length(data) <= ? THEN data END "
            "FROM messages ORDER BY rowid",
            (MAX_RECORD_BYTES,),
        )
        for n, (number, time_ns, data) in enumerate(rows):
            if number not in topics or type(time_ns) is not int or not isinstance(data, bytes):
                self.truncation = f"damaged: row {n} of its messages is no message of a topic"
                return
            topic, kind, encoding = topics[number]
            yield RecordedMessage(topic, kind, encoding, time_ns, time_ns, n, data)


def _check_tables(db: sqlite3.Connection) -> None:
    """Raise sqlite3.DatabaseError unless both tables are plain, without computed columns."""
    for table in ("topics", "messages"):
        plain = "SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = ?"
        root = db.execute(plain, (table,)).fetchone()
        columns = db.execute(f"PRAGMA table_xinfo({table})")
        computed = [column for column in columns if column[_HIDDEN]]
        if root is None or not root[0] or computed:
            raise sqlite3.DatabaseError(f"no usable table {table}")


class Bag:
    """A recording of one or several files; a context manager.

    Args:
        path: an MCAP file, a `.db3`, or a rosbag2 folder of either.

    Attributes:
        notes: problems that the user should know, such as missing or damaged files, one per line.

    Raises:
        RecordingError: there is no recording, or a recording of another kind; one line.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.parent if path.name == METADATA else path
        self.notes: list[str] = []
        self._stack = ExitStack()
        self._files: list[Path] = []

    def __enter__(self) -> Bag:
        if not self.path.exists():
            raise RecordingError(f"{self.path}: no such file")
        with ExitStack() as stack:
            files = _files_in(self.path, self.notes) if self.path.is_dir() else [self.path]
            for path in files:
                with self._note_errors(alone=len(files) == 1):
                    self._files.append(_unpack(path, stack))
            if not self._files:
                raise RecordingError(f"{self.path}: nothing to read: {'; '.join(self.notes)}")
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Yield every message, file by file. A damaged file ends early, with a note."""
        for path in self._files:
            with self._note_errors(alone=len(self._files) == 1):
                yield from self._messages(path)

    def _messages(self, path: Path) -> Iterator[RecordedMessage]:
        """Yield the messages of a file, decompressed; note if the file is damaged."""
        reader = (
            Db3Reader(path) if _first_bytes(path, len(_SQLITE)) == _SQLITE else McapReader(path)
        )
        for message in reader:
            payload = _decompressed(message.payload)
            if payload is None:
                reader.truncation = f"damaged: a message of {one_line(message.topic, 80)}"
                break
            yield message._replace(payload=payload)
        if reader.truncation:
            self._note(f"{path.name}: {reader.truncation}")

    @contextmanager
    def _note_errors(self, alone: bool) -> Iterator[None]:
        """Skip a file that cannot be read, unless it is the only one (`alone`)."""
        try:
            yield
        except RecordingError as error:
            if alone:
                raise
            self._note(str(error))

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def by_time(self, topics: Collection[str], nearly_sorted: bool) -> Iterator[RecordedMessage]:
        """Yield the messages of some topics in the order of their log times.

        Args:
            topics: their names.
            nearly_sorted: True if all messages are within `WINDOW_NS` of their place. If not, the
                file is read once per topic, because it may hold one topic after the other.
        """
        if nearly_sorted:
            return by_log_time(m for m in self if m.topic in topics)
        most_bytes = _MAX_WAITING_BYTES // max(1, len(topics))
        by_topic = (by_log_time(self._of_topic(topic), most_bytes) for topic in sorted(topics))
        return heapq.merge(*by_topic, key=lambda m: m.log_ns)

    def _of_topic(self, topic: str) -> Iterator[RecordedMessage]:
        return (m for m in self if m.topic == topic)


def _files_in(folder: Path, notes: list[str]) -> list[Path]:
    """Return the files of a rosbag2 folder in the order in which they were written."""
    files = sorted((p for p in folder.iterdir() if p.name.endswith(_SUFFIXES)), key=_natural_order)
    listed = _listed_files(folder, notes)
    if listed is not None:
        present, files = files, []
        for name in listed:
            # The names of compressed files may lack the suffix.
            found = next((p for p in present if p.name in (name, f"{name}.zstd")), None)
            if found is None:
                notes.append(f"{METADATA} names {one_line(name, 80)}, but there is no such file")
            else:
                files.append(found)
    elif files:
        notes.append(f"no {METADATA}: files are read in the order of their names")
    if not files:
        kinds = ", ".join(_SUFFIXES)
        raise RecordingError(f"{folder}: no recording in this folder (looked for {kinds})")
    return files


def _listed_files(folder: Path, notes: list[str]) -> list[str] | None:
    """Return the names in `metadata.yaml`, without folders, which old or forged files have.

    None if there is no such list.
    """
    path = folder / METADATA
    if not path.exists():
        return None
    try:
        files = read_yaml(path)["rosbag2_bagfile_information"]["relative_file_paths"]
        return [Path(str(name)).name for name in list(files)]
    except (ConfigError, KeyError, TypeError) as error:
        notes.append(f"{METADATA} cannot be read: {one_line(error, 120)}")
        return None


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that puts `bag_10` behind `bag_9`."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _first_bytes(path: Path, n: int) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read(n)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None


def _unpack(path: Path, stack: ExitStack) -> Path:
    """Return the file, or a decompressed copy."""
    out, first = path, _first_bytes(path, len(_SQLITE))
    if first.startswith(_ZSTD):
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="edge-bag-")))
        out = _decompress(path, folder / path.name.removesuffix(".zstd"))
        first = _first_bytes(out, len(_SQLITE))
    if not first:
        raise RecordingError(f"{path}: empty: name another file")
    if first.startswith(_ROS1):
        raise RecordingError(
            f"{path}: a ROS 1 bag: convert it first, for example with "
            "`rosbags-convert --src FILE.bag --dst FOLDER` (pip install rosbags)"
        )
    if not (MAGIC.startswith(first[: len(MAGIC)]) or first.startswith(_SQLITE)):
        raise RecordingError(f"{path}: neither an MCAP file nor a rosbag2 file (.db3)")
    return out


def _decompress(path: Path, out: Path) -> Path:
    """Write a decompressed copy, which may use half the free disk space."""
    left = shutil.disk_usage(out.parent).free // 2
    try:
        with (
            open_regular(path) as packed,
            out.open("wb") as file,
            zstandard.ZstdDecompressor().stream_reader(packed) as blocks,
        ):
            while block := blocks.read(_BLOCK_BYTES):
                left -= len(block)
                if left < 0:
                    raise RecordingError(
                        f"{path}: it does not fit into {out.parent.parent} when decompressed: "
                        "set TMPDIR to a larger disk"
                    )
                file.write(block)
    except zstandard.ZstdError as error:
        raise RecordingError(f"{path}: damaged: {one_line(error, 80)}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be decompressed: {error.strerror}") from None
    return out


def _decompressed(payload: bytes) -> bytes | None:
    """Decompress a message if rosbag2 compressed it; return None if it is damaged or too large.

    No other message begins like zstd: CDR begins with 0, JSON with a bracket.
    """
    if not payload.startswith(_ZSTD):
        return payload
    try:
        size = zstandard.frame_content_size(payload)
        if size > MAX_RECORD_BYTES:
            return None
        return zstandard.decompress(payload, max_output_size=MAX_RECORD_BYTES)
    except zstandard.ZstdError:
        return None

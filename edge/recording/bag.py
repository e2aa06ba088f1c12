"""Recordings of any robot: MCAP files, and rosbag2's folders and SQLite files (`.db3`).

A file is untrusted. Nothing in it is larger than `MAX_RECORD_BYTES` once decompressed, and the
tables of a `.db3` must be plain ones: a view could compute for ever.
https://github.com/ros2/rosbag2 has both layouts.
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
from edge.recording.file import McapReading, Recorded, RecordingError
from edge.recording.reader import MAGIC, MAX_KEPT, MAX_RECORD_BYTES
from edge.text import one_line

METADATA = "metadata.yaml"
WINDOW_NS = 1_000_000_000
"""Messages that are written nearly in order lie no farther from their place in time."""
_MOST_WAITING_BYTES = 1 << 28
_MESSAGE_BYTES = 1000  # what a message takes besides its payload
_SQLITE = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"
_ZSTD = b"\x28\xb5\x2f\xfd"
_BLOCK_BYTES = 1 << 20
_LONGEST_NAMES = 2000  # of a topic and its type together
_STORED = (".mcap", ".mcap.zstd", ".db3", ".db3.zstd")


def in_order(
    messages: Iterable[Recorded], most_bytes: int = _MOST_WAITING_BYTES
) -> Iterator[Recorded]:
    """Yield messages by the time at which they were heard; they are written nearly so.

    Args:
        most_bytes: that wait to be put in order.
    """
    waiting: list[tuple[int, int, Recorded]] = []
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


class Db3Reading:
    """The messages of a rosbag2 SQLite file in the order in which they were written.

    Attributes:
        cut: why reading ended before the file did; empty while it has not.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.cut = path, ""

    def __iter__(self) -> Iterator[Recorded]:
        """
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
                        (_LONGEST_NAMES, MAX_KEPT),
                    )
                }
                begun = True
                yield from self._messages(db, topics)
        except (sqlite3.Error, ValueError, OverflowError) as error:  # of bytes that nobody wrote
            why = one_line(error, 80)
            if not begun:
                raise RecordingError(f"{self.path}: not a rosbag2 file: {why}") from None
            self.cut = f"damaged: {why}"

    def _messages(
        self, db: sqlite3.Connection, topics: dict[Any, tuple[str, str, str]]
    ) -> Iterator[Recorded]:
        rows = db.execute(
            "SELECT topic_id, timestamp, CASE WHEN length(data) <= ? THEN data END "
            "FROM messages ORDER BY rowid",
            (MAX_RECORD_BYTES,),
        )
        for n, (number, time_ns, data) in enumerate(rows):
            if number not in topics or type(time_ns) is not int or not isinstance(data, bytes):
                self.cut = f"damaged: row {n} of its messages is no message of a topic"
                return
            topic, kind, encoding = topics[number]
            yield Recorded(topic, kind, encoding, time_ns, time_ns, n, data)


def _check_tables(db: sqlite3.Connection) -> None:
    """Raises sqlite3.DatabaseError unless both tables hold what was written to them."""
    for table in ("topics", "messages"):
        plain = "SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = ?"
        root = db.execute(plain, (table,)).fetchone()
        computed = [row for row in db.execute(f"PRAGMA table_xinfo({table})") if row[6]]
        if root is None or not root[0] or computed:
            raise sqlite3.DatabaseError(f"no table of {table}")


class Bag:
    """A recording of one or several files: a context manager.

    Args:
        path: an MCAP file, a `.db3`, or rosbag2's folder of either.

    Attributes:
        notes: what a user should know of it, one line each: a file that is missing, damage.

    Raises:
        RecordingError: there is nothing to read, or it is of another kind; one line.
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
            files = _files_of(self.path, self.notes) if self.path.is_dir() else [self.path]
            for path in files:
                with self._noted(alone=len(files) == 1):
                    self._files.append(_unpacked(path, stack))
            if not self._files:
                raise RecordingError(f"{self.path}: nothing to read: {'; '.join(self.notes)}")
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[Recorded]:
        """Yield every message, in the order of the files. Damage ends a file, and is noted."""
        for path in self._files:
            with self._noted(alone=len(self._files) == 1):
                yield from self._messages(path)

    def _messages(self, path: Path) -> Iterator[Recorded]:
        reading = Db3Reading(path) if _begins(path, _SQLITE) else McapReading(path)
        for message in reading:
            payload = _payload(message.payload)
            if payload is None:
                reading.cut = f"damaged: a message of {one_line(message.topic, 80)}"
                break
            yield message._replace(payload=payload)
        if reading.cut:
            self._note(f"{path.name}: {reading.cut}")

    @contextmanager
    def _noted(self, alone: bool) -> Iterator[None]:
        """Go on without a file that cannot be read, unless it is `alone`."""
        try:
            yield
        except RecordingError as error:
            if alone:
                raise
            self._note(str(error))

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def by_time(self, topics: Collection[str], sorted_nearly: bool) -> Iterator[Recorded]:
        """Yield the messages of some topics by the time at which they were heard.

        Args:
            sorted_nearly: whether all lie within `WINDOW_NS` of their place. If not, each topic is
                read by itself: a file may hold one topic after the other.
        """
        if sorted_nearly:
            return in_order(m for m in self if m.topic in topics)
        most_bytes = _MOST_WAITING_BYTES // max(1, len(topics))
        each = (in_order(self._of(topic), most_bytes) for topic in sorted(topics))
        return heapq.merge(*each, key=lambda m: m.log_ns)

    def _of(self, topic: str) -> Iterator[Recorded]:
        return (m for m in self if m.topic == topic)


def _files_of(folder: Path, notes: list[str]) -> list[Path]:
    """The files of a rosbag2 folder, in the order in which they were written."""
    there = sorted((p for p in folder.iterdir() if p.name.endswith(_STORED)), key=_natural)
    named = _named(folder, notes)
    if named is not None:
        files = []
        for name in named:
            # Compressed files are named as they were before, or as they are.
            found = next((p for p in there if p.name in (name, f"{name}.zstd")), None)
            if found is None:
                notes.append(f"{METADATA} names {one_line(name, 80)}, which is not there")
            else:
                files.append(found)
        there = files
    elif there:
        notes.append(f"no {METADATA}: its files are taken by name")
    if not there:
        kinds = ", ".join(_STORED)
        raise RecordingError(f"{folder}: no recording in this folder (looked for {kinds})")
    return there


def _named(folder: Path, notes: list[str]) -> list[str] | None:
    """The names in `metadata.yaml`, without folders: old ones have one, a forged one might."""
    path = folder / METADATA
    if not path.exists():
        return None
    try:
        files = read_yaml(path)["rosbag2_bagfile_information"]["relative_file_paths"]
        return [Path(str(name)).name for name in list(files)]
    except (ConfigError, KeyError, TypeError) as error:
        notes.append(f"{METADATA} cannot be read: {one_line(error, 120)}")
        return None


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort `bag_10` behind `bag_9`."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _begins(path: Path, magic: bytes) -> bool:
    return _first_bytes(path, len(magic)) == magic


def _first_bytes(path: Path, n: int) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read(n)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None


def _unpacked(path: Path, stack: ExitStack) -> Path:
    """The file, decompressed if need be.

    Raises:
        RecordingError: no such file, of another kind, or larger than there is room for.
    """
    out, first = path, _first_bytes(path, len(_SQLITE))
    if first.startswith(_ZSTD):
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="edge-bag-")))
        out = _decompressed(path, folder / path.name.removesuffix(".zstd"))
        first = _first_bytes(out, len(_SQLITE))
    if not first:
        raise RecordingError(f"{path}: empty")
    if first.startswith(_ROS1):
        raise RecordingError(
            f"{path}: a bag of ROS 1: convert it first, as with "
            "`rosbags-convert --src FILE.bag --dst FOLDER` (pip install rosbags)"
        )
    if not (MAGIC.startswith(first[: len(MAGIC)]) or first.startswith(_SQLITE)):
        raise RecordingError(f"{path}: neither an MCAP file nor rosbag2's (.db3)")
    return out


def _decompressed(path: Path, out: Path) -> Path:
    """Write a decompressed copy, of half the free disk at most."""
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
                        f"{path}: too large for {out.parent.parent} once decompressed: "
                        "set TMPDIR to a larger disk"
                    )
                file.write(block)
    except zstandard.ZstdError as error:
        raise RecordingError(f"{path}: damaged: {one_line(error, 80)}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be decompressed: {error.strerror}") from None
    return out


def _payload(payload: bytes) -> bytes | None:
    """A message, decompressed if rosbag2 compressed it; None: it is damaged or too large.

    No message begins like a compressed one: CDR's first byte is 0, JSON's a bracket.
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

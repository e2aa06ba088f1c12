"""Checkpoint files: written atomically on a separate thread, and read as untrusted input.

A file is one line of JSON, `{"format", "version", "sha256", "config", "written_ns", "state"}`,
followed by an archive of `np.savez` without pickles. The hash covers all bytes after itself. A
damaged file is renamed, never deleted. A file that does not begin like a checkpoint belongs to
another program and stays as it is.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import logging
import math
import os
import re
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from edge import names
from edge.errors import FileError, UserError
from edge.geometry import FARTHEST_M
from edge.host.files import replace_atomically, sync
from edge.host.worker import Worker
from edge.text import one_line

log = logging.getLogger("edge.host.checkpoint")

VERSION = 6  # of the format
MAX_STATE_BYTES = 8 << 20  # of the line of JSON
_MAX_DIRECTORY_BYTES = 64 << 10  # of the zip archive
_ZIP_END_BYTES = 22  # size of the last record of a zip archive without a comment
_ZIP64 = b"PK\x06\x07"  # begins a record of 20 bytes that only archives over 4 GB need
_TAIL_BYTES = 20 + _ZIP_END_BYTES
# The line of JSON behind `CheckpointFormat.begins`, in two parts. The head ends with the hash:
# `"version":5,"sha256":"<64 digits>",`. The rest is hashed:
# `"config":"<fingerprint>","written_ns":1700000000000000000,"state":{…}}` and a line break.
_HEAD_PATTERN = rb'"version":([0-9]{1,9}),"sha256":"([0-9a-f]{64})",'
_REST_PATTERN = rb'"config":"([0-9a-f]{0,64})","written_ns":([0-9]{1,19}),"state":([^\n]*)\}\n'
# Largest values of integers that have no limit of their own.
_FAR = 1 << 32  # cell indices and others
_FAR_NS = 1 << 61  # stamps in ns, and ids of objects
_RETRY_NS = 5_000_000_000
"""Longest time from a checkpoint that could not be written to the next."""

Arrays = dict[str, np.ndarray]
"""Name → array."""
Rows = dict[tuple[str, ...], int]
"""See `check_arrays`."""
State = TypeVar("State")


class CheckpointError(FileError):
    """A path that cannot hold a checkpoint; the message has the path, the reason and what to do."""


@dataclass(frozen=True, eq=False)
class Checkpoint(Generic[State]):
    """Content of a checkpoint file.

    Attributes:
        state: dataclass of JSON-ready values.
        config: fingerprint of the configuration that made it.
        written_ns: wall-clock time of writing.
    """

    state: State
    arrays: Arrays = field(default_factory=dict)
    config: str = ""
    written_ns: int = field(default_factory=time.time_ns)

    def part(self, name: str) -> Arrays:
        """Return the arrays with names `name/…`, without that prefix."""
        prefix = f"{name}/"
        found = self.arrays.items()
        return {key.removeprefix(prefix): a for key, a in found if key.startswith(prefix)}


class CheckpointFormat(Generic[State]):
    """Format of one kind of checkpoint.

    Args:
        name: value of `format` in the file.
        title: name of the format for people.
        state: dataclass of the state, which pydantic validates.
        max_bytes: largest file.
        check: raises ValueError if a state with valid types is inconsistent.

    Attributes:
        begins: first bytes of every file of this format.
    """

    def __init__(
        self,
        name: str,
        title: str,
        state: type[State],
        max_bytes: int,
        check: Callable[[State], None] = lambda state: None,
    ) -> None:
        self.title, self.max_bytes = title, max_bytes
        self.begins = b'{"format":"%s",' % name.encode()
        self._adapter, self._check = TypeAdapter(state), check

    def encode(self, checkpoint: Checkpoint[State]) -> bytes:
        """Return the file's content.

        Raises:
            ValueError: `decode` would refuse the content; one line.
        """
        state = self._adapter.dump_json(checkpoint.state)
        self._read_state(state)  # raises ValueError for a state that `decode` would refuse
        if any(array.dtype.hasobject for array in checkpoint.arrays.values()):
            raise ValueError("an array holds Python objects; only numbers and text can be saved")
        archive = io.BytesIO()
        np.savez(archive, **checkpoint.arrays)  # type: ignore[arg-type]
        rest = b'"config":"%s","written_ns":%d,"state":%s}\n' % (
            checkpoint.config.encode(), checkpoint.written_ns, state
        )  # fmt: skip
        body = rest + archive.getvalue()
        content = self.begins + b'"version":%d,"sha256":"%s",' % (VERSION, _sha256(body)) + body
        if len(content) > self.max_bytes:
            raise ValueError(
                f"the {self.title} has {len(content)} bytes, at most {self.max_bytes} are allowed"
            )
        return content

    def decode(self, content: bytes) -> Checkpoint[State]:
        """Return the checkpoint of a file's content; memory is limited by `max_bytes`.

        Raises:
            ValueError: the content is not valid; one line.
        """
        if len(content) > self.max_bytes:
            raise ValueError(f"a {self.title} of more than {self.max_bytes} bytes")
        head = re.match(re.escape(self.begins) + _HEAD_PATTERN, content)
        if head is None:
            raise ValueError(f"not a complete {self.title}")
        if (version := int(head[1])) != VERSION:
            raise ValueError(
                f"written in version {version} of the format; this edge reads version {VERSION}"
            )
        if _sha256(memoryview(content)[head.end() :]) != head[2]:
            raise ValueError("damaged: the checksum does not match")
        rest = re.compile(_REST_PATTERN).match(content, head.end(), head.end() + MAX_STATE_BYTES)
        if rest is None:
            raise ValueError(f"not a complete {self.title}")
        arrays = _read_archive(content[rest.end() :])
        return Checkpoint(self._read_state(rest[3]), arrays, rest[1].decode(), int(rest[2]))

    def _read_state(self, text: bytes) -> State:
        """Parse and check a state; raise ValueError with one line."""
        try:
            state = self._adapter.validate_json(text)
        except ValidationError as error:
            first = error.errors(include_input=False, include_url=False)[0]
            where = ".".join(map(str, first["loc"])) or "state"
            raise ValueError(f"{where}: {one_line(first['msg'])}") from None
        self._check(state)
        return state


def _sha256(content: bytes | memoryview) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _read_archive(content: bytes) -> Arrays:
    """Read an uncompressed archive, so that the arrays are not larger than the file."""
    # zipfile reads the entire directory when it opens the archive, so check its size before. A
    # plain archive ends with a record PK 5 6; its bytes 12 to 15 are the directory's size, its last
    # two the length of a comment (0).
    end = content[-_ZIP_END_BYTES:]
    is_plain = (
        end[:4] == b"PK\x05\x06" and end[-2:] == b"\0\0" and _ZIP64 not in content[-_TAIL_BYTES:]
    )
    if not is_plain or int.from_bytes(end[12:16], "little") > _MAX_DIRECTORY_BYTES:
        raise ValueError("damaged: the list of arrays is missing or too long")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            stored = all(m.compress_type == zipfile.ZIP_STORED for m in members)
            if not stored or sum(m.file_size for m in members) > len(content):
                raise ValueError("the arrays are compressed, or have more bytes than the file")
            return {m.filename.removesuffix(".npy"): _read_array(archive.read(m)) for m in members}
    except Exception as error:  # the parsers may raise anything on hostile input
        raise ValueError(f"damaged: the arrays cannot be read: {one_line(error)}") from None


def _read_array(content: bytes) -> np.ndarray:
    """Read one array. Its header must match the size, since NumPy allocates by the header."""
    file = io.BytesIO(content)
    np.lib.format.read_magic(file)
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    n_bytes = math.prod(shape) * dtype.itemsize
    if dtype.kind not in "biufU" or not dtype.itemsize or n_bytes != len(content) - file.tell():
        raise ValueError(
            f"an array of type {dtype} and shape {shape} does not fit its {len(content)} bytes"
        )
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def check_arrays(
    state: Arrays, like: Arrays, rows: Rows, most: Mapping[str, float], unique: tuple[str, ...] = ()
) -> None:
    """Check the arrays of a file against the `state_dict` of the object that shall load them.

    Text in the arrays must be valid names (`edge.names.normalise`).

    Args:
        state: arrays of the file.
        like: `state_dict` of the object; names, dtypes and shapes must be the same, apart from the
            numbers of rows in `rows`.
        rows: groups of arrays with a variable number of rows → largest number of rows. All arrays
            of a group must have the same number.
        most: name of an array → largest value; the smallest is 0. In other arrays, floats must be
            within `FARTHEST_M`, integers within `_FAR` or `_FAR_NS`.
        unique: names of arrays in which no value may occur twice.

    Raises:
        ValueError: an array is wrong; one line that names it.
    """
    if state.keys() != like.keys():
        name = min(state.keys() ^ like.keys())
        raise ValueError(f"the array {name!r:.60} is {'missing' if name in like else 'unknown'}")
    group_of = {name: group for group in rows for name in group}
    for name, array in state.items():
        group, expected = group_of.get(name), like[name]
        shape = expected.shape
        if group is not None:  # as many rows as the first array of its group, within the limit
            n_rows = state[group[0]].shape[:1]  # (n,), or () for a forged array without axes
            shape = (min((*n_rows, rows[group])), *shape[1:])
        is_text = array.dtype.kind == expected.dtype.kind == "U"
        if array.shape != shape or not (is_text or array.dtype == expected.dtype):
            raise ValueError(
                f"{name} is {array.dtype} {array.shape}, expected {expected.dtype} {shape}"
            )
        if is_text:
            _check_names(name, array)
        elif array.size and array.dtype.kind in "if":
            far = FARTHEST_M if array.dtype.kind == "f" else _FAR
            far = _FAR_NS if name.endswith(("_ns", "id")) else far
            low, high = (0, most[name]) if name in most else (-far, far)  # allowed values
            if not (array.min() >= low and array.max() <= high):  # also False for NaN
                raise ValueError(f"{name} has a value that is not from {low:g} to {high:g}")
    for name in unique:
        if len(np.unique(state[name])) < len(state[name]):
            raise ValueError(f"{name} has the same value twice")


def _check_names(name: str, words: np.ndarray) -> None:
    """Raise ValueError if a text in the array is no valid name."""
    try:
        for word in set(words.tolist()):
            names.normalise(word)
    except (UserError, SystemError) as error:  # NumPy raises SystemError for invalid characters
        raise ValueError(f"{name}: {error}") from None


def save(path: Path, checkpoint: Checkpoint[State], form: CheckpointFormat[State]) -> None:
    """Replace a checkpoint file, and return when it is on the disk.

    Raises:
        OSError: the file cannot be written; the previous one is unchanged.
        ValueError: `load` would refuse the checkpoint.
    """
    path, content = _resolve_links(path), form.encode(checkpoint)
    with replace_atomically(path, path.with_name(f".{path.name}.tmp")) as temporary:
        temporary.write_bytes(content)
    sync(path.parent)  # else a power cut may restore the old file


def load(path: Path, form: CheckpointFormat[State]) -> tuple[Checkpoint[State] | None, str]:
    """Read a checkpoint; rename a damaged file, or one of another version.

    Returns:
        The checkpoint or None, and the logged line if a file was renamed, else "".

    Raises:
        CheckpointError: the file cannot be read or renamed, or is no checkpoint.
    """
    path = _resolve_links(path)
    content = _read(path, form, form.max_bytes + 1)
    if content is None:
        return None, ""
    try:
        return form.decode(content), ""
    except ValueError as error:
        return None, quarantine(path, one_line(error))


def quarantine(path: Path, problem: str) -> str:
    """Rename an unusable file to the first free `<name>.damaged-N`; log and return a message.

    Raises:
        CheckpointError: the file cannot be renamed.
    """
    path = _resolve_links(path)
    for n in itertools.count(1):
        kept = path.with_name(f"{path.name}.damaged-{n}")
        try:
            # Reserve the name: a rename would overwrite an existing file.
            os.close(os.open(kept, os.O_CREAT | os.O_EXCL))
            os.replace(path, kept)
            break
        except FileExistsError:
            continue
        except OSError as error:
            raise _unusable(path, error) from None
    problem = f"mission.checkpoint: {path}: {problem}; kept as {kept.name}, starting without it"
    log.warning("%s", problem)
    return problem


class CheckpointWriter(Generic[State]):
    """Writer of the newest checkpoint, on a thread of its own, so that the loop never waits.

    Args:
        period_s: shortest time between periodic checkpoints (`is_due`).

    Attributes:
        written: number of checkpoints on the disk.
        failed: number of checkpoints that could not be written.
        problem: reason of the last failure, "" after a success.

    Raises:
        CheckpointError: the path cannot be written, or holds a file that is no checkpoint.
    """

    def __init__(self, path: Path, form: CheckpointFormat[State], period_s: float = 1.0) -> None:
        self.path = _resolve_links(path)
        self.written = self.failed = 0
        self.problem = ""
        self._form = form
        self._period_ns = int(period_s * 1e9)
        self._posted_ns: int | None = None  # time of the last post
        _check_writable(self.path, form)
        self._worker = Worker("checkpoint", self._write, finish_on_close=True)

    @property
    def idle(self) -> bool:
        """True if no posted checkpoint is left to write."""
        return self._worker.idle

    def is_due(self, now_ns: int) -> bool:
        """Return True if the last post is at least one period old; a failure is retried sooner."""
        period_ns = min(self._period_ns, _RETRY_NS) if self.problem else self._period_ns
        return self._posted_ns is None or abs(now_ns - self._posted_ns) >= period_ns

    def post(self, make: Callable[[], Checkpoint[State]], now_ns: int) -> None:
        """Write a checkpoint next, in place of one that still waits; never blocks.

        Args:
            make: returns the checkpoint; called on the writer's thread.
            now_ns: time on the clock of `is_due`.
        """
        self._posted_ns = now_ns
        self._worker.submit(make)

    def close(self, timeout_s: float = 5.0) -> bool:
        """Write the last checkpoint; return True if that ended within `timeout_s`."""
        return self._worker.close(timeout_s)

    def _write(self, make: Callable[[], Checkpoint[State]]) -> None:
        """Save a checkpoint; log the first failure of a series, and its end."""
        try:
            save(self.path, make(), self._form)
        except (OSError, ValueError) as error:
            if not self.problem:
                log.warning("mission.checkpoint: %s: not written: %s", self.path, _why(error))
            self.problem = _why(error)
            self.failed += 1
        else:
            if self.problem:
                log.info("mission.checkpoint: %s: can be written again", self.path)
            self.problem = ""
            self.written += 1


def _resolve_links(path: Path) -> Path:
    """Resolve links, so that the target is replaced and a link stays a link."""
    return Path(os.path.realpath(path))


def _read(path: Path, form: CheckpointFormat[State], most: int) -> bytes | None:
    """Return the first `most` bytes of a checkpoint, or None if there is no file."""
    # A folder, a device, a loop of links, or a pipe, whose read might block forever.
    if os.path.lexists(path) and not os.path.isfile(path):
        raise CheckpointError(
            f"mission.checkpoint: {path}: not a file; name a file in a folder that can be written"
        )
    try:
        with path.open("rb") as file:
            content = file.read(most)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unusable(path, error) from None
    if not content.startswith(form.begins):
        raise CheckpointError(
            f"mission.checkpoint: {path}: not a {form.title}, left unchanged; name another "
            "file, or move this one away"
        )
    return content


def _check_writable(path: Path, form: CheckpointFormat[State]) -> None:
    """Raise CheckpointError unless a checkpoint can be written at `path`."""
    _read(path, form, len(form.begins))
    try:
        # Not the temporary name of `save`, which a running service may be using.
        with tempfile.NamedTemporaryFile(prefix=f".{path.name}.", dir=path.parent):
            pass
    except OSError as error:
        raise _unusable(path, error) from None


def _unusable(path: Path, error: OSError) -> CheckpointError:
    return CheckpointError(
        f"mission.checkpoint: {path}: {_why(error)}; name a file in a folder that can be written"
    )


def _why(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)

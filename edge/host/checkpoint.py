"""Checkpoint files: written off the caller's thread, atomically; read as untrusted input.

A file is one line of JSON and what `np.savez` writes, without pickles:
`{"format", "version", "sha256", "config", "written_ns", "state"}`. The hash covers every byte after
itself. A damaged file is set aside, never deleted: it may be all that is left. A file that does not
begin like a checkpoint belongs to another program. It stays as it is.
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

VERSION = 3
MAX_STATE_BYTES = 8 << 20
_MAX_DIRECTORY_BYTES = 64 << 10
_END_BYTES = 22  # of a zip archive's last record, without a comment
_ZIP64 = b"PK\x06\x07"
_HEAD = rb'"version":([0-9]{1,9}),"sha256":"([0-9a-f]{64})",'
_ABOUT = rb'"config":"([0-9a-f]{0,64})","written_ns":([0-9]{1,19}),"state":([^\n]*)\}\n'
_FAR, _FAR_NS = 1 << 32, 1 << 61  # limits of integers: cells, and stamps or ids

Arrays = dict[str, np.ndarray]
Rows = dict[tuple[str, ...], int]
State = TypeVar("State")


class CheckpointError(FileError):
    """A path that can hold no checkpoint: which one, why, what to do."""


@dataclass(frozen=True, eq=False)
class Checkpoint(Generic[State]):
    """Content of a file.

    Attributes:
        state: JSON-ready dataclass.
        config: fingerprint of the configuration it was made with.
        written_ns: wall-clock time.
    """

    state: State
    arrays: Arrays = field(default_factory=dict)
    config: str = ""
    written_ns: int = field(default_factory=time.time_ns)

    def part(self, name: str) -> Arrays:
        """Return the arrays `name/…`, without that prefix."""
        prefix = f"{name}/"
        found = self.arrays.items()
        return {key.removeprefix(prefix): a for key, a in found if key.startswith(prefix)}


class CheckpointFormat(Generic[State]):
    """One kind of checkpoint.

    Args:
        name: first value in the file; `title`: the same for people.
        state: dataclass of the state, which pydantic validates.
        check: raises ValueError if a valid state contradicts itself.
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
            ValueError: one line; `decode` would not take it.
        """
        state = self._adapter.dump_json(checkpoint.state)
        self._state(state)
        if any(array.dtype.hasobject for array in checkpoint.arrays.values()):
            raise ValueError("an array holds Python objects")
        archive = io.BytesIO()
        np.savez(archive, **checkpoint.arrays)  # type: ignore[arg-type]
        about = b'"config":"%s","written_ns":%d,"state":%s}\n' % (
            checkpoint.config.encode(), checkpoint.written_ns, state
        )  # fmt: skip
        body = about + archive.getvalue()
        content = self.begins + b'"version":%d,"sha256":"%s",' % (VERSION, _sha256(body)) + body
        if len(content) > self.max_bytes:
            raise ValueError(f"{len(content)} bytes, at most {self.max_bytes} are written")
        return content

    def decode(self, content: bytes) -> Checkpoint[State]:
        """Return what `encode` was given. Memory is allocated within the limits only.

        Raises:
            ValueError: one line: what is wrong.
        """
        if len(content) > self.max_bytes:
            raise ValueError(f"more than {self.max_bytes} bytes")
        head = re.match(re.escape(self.begins) + _HEAD, content)
        if head is None:
            raise ValueError(f"not a whole {self.title}")
        if int(head[1]) != VERSION:
            raise ValueError(f"version {int(head[1])}, this program reads version {VERSION}")
        if _sha256(memoryview(content)[head.end() :]) != head[2]:
            raise ValueError("damaged: its checksum does not match")
        about = re.compile(_ABOUT).match(content, head.end(), head.end() + MAX_STATE_BYTES)
        if about is None:
            raise ValueError(f"not a whole {self.title}")
        arrays = _arrays(content[about.end() :])
        return Checkpoint(self._state(about[3]), arrays, about[1].decode(), int(about[2]))

    def _state(self, text: bytes) -> State:
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


def _arrays(content: bytes) -> Arrays:
    """Read an archive in which nothing is compressed, so that it takes no more than its length."""
    # Python lists the whole directory before anything can be asked of it.
    end = content[-_END_BYTES:]
    plain = end[:4] == b"PK\x05\x06" and end[-2:] == b"\0\0" and _ZIP64 not in content[-42:]
    if not plain or int.from_bytes(end[12:16], "little") > _MAX_DIRECTORY_BYTES:
        raise ValueError("its directory of arrays is too long, or none")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            stored = all(m.compress_type == zipfile.ZIP_STORED for m in members)
            if not stored or sum(m.file_size for m in members) > len(content):
                raise ValueError("more bytes than the file has")
            return {m.filename.removesuffix(".npy"): _array(archive.read(m)) for m in members}
    except Exception as error:  # whatever these parsers make of bytes that a stranger wrote
        raise ValueError(f"its arrays cannot be read: {one_line(error)}") from None


def _array(content: bytes) -> np.ndarray:
    """Read one array, if it declares no more bytes than there are: NumPy would allocate them."""
    file = io.BytesIO(content)
    np.lib.format.read_magic(file)
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    n_bytes = math.prod(shape) * dtype.itemsize
    if dtype.kind not in "biufU" or not dtype.itemsize or n_bytes != len(content) - file.tell():
        raise ValueError(f"an array {dtype} {shape} in {len(content)} bytes")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def check_arrays(
    state: Arrays,
    like: Arrays,
    rows: Rows,
    most: Mapping[str, float],
    unique: tuple[str, ...] = (),
) -> None:
    """Check arrays of a file against those that a part writes; all text in them is names.

    Args:
        like: the part's own `state_dict`; names, dtypes and shapes have to be the same.
        rows: arrays of any length: all of a group have as many rows, and at most this many.
        most: arrays whose values lie from 0 to this. Other floats lie within `FARTHEST_M`.
        unique: arrays that hold no value twice.

    Raises:
        ValueError: one line: which array is wrong.
    """
    if state.keys() != like.keys():
        name = min(state.keys() ^ like.keys())
        raise ValueError(f"{name!r:.60} is {'missing' if name in like else 'unknown'}")
    group_of = {name: group for group in rows for name in group}
    for name, array in state.items():
        group, model = group_of.get(name), like[name]
        shape = model.shape
        if group is not None:
            shape = (min((*state[group[0]].shape[:1], rows[group])), *shape[1:])
        is_text = array.dtype.kind == model.dtype.kind == "U"
        if array.shape != shape or not (is_text or array.dtype == model.dtype):
            raise ValueError(f"{name}: {array.dtype} {array.shape}, expected {model.dtype} {shape}")
        if is_text:
            _check_names(name, array)
        elif array.size and array.dtype.kind in "if":
            far = FARTHEST_M if array.dtype.kind == "f" else _FAR
            far = _FAR_NS if name.endswith(("_ns", "id")) else far
            low, high = (0, most[name]) if name in most else (-far, far)
            if not (array.min() >= low and array.max() <= high):  # NaN fails it too
                raise ValueError(f"{name} is not from {low:g} to {high:g}")
    for name in unique:
        if len(np.unique(state[name])) < len(state[name]):
            raise ValueError(f"{name} holds a value twice")


def _check_names(name: str, words: np.ndarray) -> None:
    try:
        for word in set(words.tolist()):
            names.normalise(word)
    except (UserError, SystemError) as error:  # NumPy raises the second for no character
        raise ValueError(f"{name}: {error}") from None


def save(path: Path, checkpoint: Checkpoint[State], form: CheckpointFormat[State]) -> None:
    """Replace a checkpoint; it has reached the disk when this returns.

    Raises:
        OSError: it cannot be written; the previous one is untouched.
        ValueError: `load` would not take it.
    """
    path, content = _real(path), form.encode(checkpoint)
    with replace_atomically(path, path.with_name(f".{path.name}.tmp")) as temporary:
        temporary.write_bytes(content)
    sync(path.parent)  # or the old file may be back after a power cut


def load(path: Path, form: CheckpointFormat[State]) -> tuple[Checkpoint[State] | None, str]:
    """Read a checkpoint. Set a damaged file, or one of another version, aside.

    Returns:
        The checkpoint or None, and the line that was logged if a file was set aside.

    Raises:
        CheckpointError: the file cannot be read, is no checkpoint, or cannot be set aside.
    """
    path = _real(path)
    content = _read(path, form, form.max_bytes + 1)
    if content is None:
        return None, ""
    try:
        return form.decode(content), ""
    except ValueError as error:
        return None, set_aside(path, one_line(error))


def set_aside(path: Path, problem: str) -> str:
    """Rename a file that is of no use to the first free `<name>.damaged-N`, and log that line.

    Raises:
        CheckpointError: it cannot be renamed.
    """
    path = _real(path)
    for n in itertools.count(1):
        aside = path.with_name(f"{path.name}.damaged-{n}")
        try:
            os.close(os.open(aside, os.O_CREAT | os.O_EXCL))  # renaming would overwrite a file
            os.replace(path, aside)
            break
        except FileExistsError:
            continue
        except OSError as error:
            raise _unusable(path, error) from None
    problem = f"mission.checkpoint: {path}: {problem}; kept as {aside.name}, starting without it"
    log.warning("%s", problem)
    return problem


class CheckpointWriter(Generic[State]):
    """Writes the newest checkpoint on its own thread, so that the loop never waits for a disk.

    Attributes:
        written: checkpoints that reached the disk; `failed`: those that did not.
        problem: why the last one did not, "" if it did.

    Raises:
        CheckpointError: nothing can be written there, or the file there is no checkpoint.
    """

    def __init__(self, path: Path, form: CheckpointFormat[State], period_s: float = 1.0) -> None:
        self.path = _real(path)
        self.written = self.failed = 0
        self.problem = ""
        self._form = form
        self._period_ns = int(period_s * 1e9)
        self._posted_ns: int | None = None
        _probe(self.path, form)
        self._worker = Worker("checkpoint", self._write, finishes=True)

    @property
    def idle(self) -> bool:
        """Whether everything posted is written or has failed."""
        return self._worker.idle

    def due(self, now_ns: int) -> bool:
        """Whether the last post is a period old; events need not wait for that."""
        return self._posted_ns is None or abs(now_ns - self._posted_ns) >= self._period_ns

    def post(self, make: Callable[[], Checkpoint[State]], now_ns: int) -> None:
        """Write this checkpoint next, instead of one that still waits. Never blocks.

        Args:
            make: called on the writer's thread, which has time.
            now_ns: of the clock that `due` is asked with.
        """
        self._posted_ns = now_ns
        self._worker.submit(make)

    def close(self, timeout_s: float = 5.0) -> bool:
        """Write what waits; return whether that took less than `timeout_s`."""
        return self._worker.close(timeout_s)

    def _write(self, make: Callable[[], Checkpoint[State]]) -> None:
        try:
            save(self.path, make(), self._form)
        except (OSError, ValueError) as error:
            if not self.problem:
                log.warning("mission.checkpoint: %s: not written: %s", self.path, _why(error))
            self.problem = _why(error)
            self.failed += 1
        else:
            if self.problem:
                log.info("mission.checkpoint: %s: written again", self.path)
            self.problem = ""
            self.written += 1


def _real(path: Path) -> Path:
    """Resolve links, so that a link to another disk stays one."""
    return Path(os.path.realpath(path))


def _read(path: Path, form: CheckpointFormat[State], most: int) -> bytes | None:
    """Return the first `most` bytes of a checkpoint, or None if there is no file.

    Raises:
        CheckpointError: the file cannot be read, or does not begin like a checkpoint.
    """
    # A folder, a device, a loop of links, a pipe: reading one might wait for ever.
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
            f"mission.checkpoint: {path}: not a {form.title}, and left as it is; name another "
            "file, or move this one away"
        )
    return content


def _probe(path: Path, form: CheckpointFormat[State]) -> None:
    """Raise CheckpointError unless a checkpoint can be written at `path`."""
    _read(path, form, len(form.begins))
    try:
        # Not the name that `save` takes: a running service may be writing there.
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

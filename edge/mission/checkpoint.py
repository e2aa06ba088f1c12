"""The state of a service in files, so that one that was killed goes on with it.

A file (`edge.mission.saved` has the mission's) is replaced as a whole, so only a broken disk or a
hand can damage it. What is damaged is set aside, never deleted: it may be all that is left. A
file that does not begin like a checkpoint is somebody else's, and is left alone.
"""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from edge.errors import FileError
from edge.host.files import replace_atomically, sync
from edge.host.worker import Worker
from edge.mission.saved import FILE, decode, encode
from edge.mission.sealed import Sealed
from edge.text import one_line

log = logging.getLogger("edge.mission.checkpoint")

State = TypeVar("State")


class CheckpointError(FileError):
    """No checkpoint can be kept there: which path, why, what to do."""


@dataclass(frozen=True)
class Loaded(Generic[State]):
    """What a checkpoint held. `problem`: one line when there was a file, but no use in it."""

    saved: State | None = None
    problem: str = ""


@dataclass(frozen=True)
class Format(Generic[State]):
    """How a state becomes a file's bytes, and these a state; both raise ValueError of one line."""

    encode: Callable[[State], bytes]
    decode: Callable[[bytes], State]
    file: Sealed


MISSION = Format(encode, decode, FILE)


def save(path: Path, saved: State, form: Format[State] = MISSION) -> None:
    """Replace the checkpoint; it has reached the disk when this returns.

    Raises:
        OSError: it cannot be written; the one before is untouched.
        ValueError: `saved` is no state that `load` would take.
    """
    path, content = _real(path), form.encode(saved)
    with replace_atomically(path, path.with_name(f".{path.name}.tmp")) as beside:
        beside.write_bytes(content)
    sync(path.parent)  # or the old file may be back after a power cut


def load(path: Path, form: Format[State] = MISSION) -> Loaded[State]:
    """Read a checkpoint; one that is damaged or newer than this program is set aside.

    Raises:
        CheckpointError: the file cannot be read, is no checkpoint, or cannot be set aside.
    """
    path = _real(path)
    content = _read(path, form, form.file.max_bytes + 1)
    if content is None:
        return Loaded()
    try:
        return Loaded(form.decode(content))
    except ValueError as error:
        return Loaded(problem=set_aside(path, one_line(error)))


def set_aside(path: Path, problem: str) -> str:
    """Rename a file that is of no use, and tell so; the line that tells it.

    Raises:
        CheckpointError: it cannot be renamed.
    """
    try:
        aside = _set_aside(_real(path))
    except OSError as error:
        raise _unusable(path, error) from None
    problem = f"mission.checkpoint: {path}: {problem}; kept as {aside.name}, starting without it"
    log.warning("%s", problem)
    return problem


class CheckpointWriter(Generic[State]):
    """Writes the newest state on a thread of its own, so that the loop never waits for a disk.

    Attributes:
        written: checkpoints that reached the disk; `failed`: that did not.
        problem: why the last one did not, "" when it did.

    Raises:
        CheckpointError: nothing can be written there, or the file there is no checkpoint.
    """

    def __init__(self, path: Path, period_s: float = 1.0, form: Format[State] = MISSION) -> None:
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
        """Whether all that was posted is written, or could not be."""
        return self._worker.idle

    def due(self, now_ns: int) -> bool:
        """Whether the last posted state is a period old; events need not wait for that."""
        return self._posted_ns is None or abs(now_ns - self._posted_ns) >= self._period_ns

    def post(self, make: Callable[[], State], now_ns: int) -> None:
        """Write this state next, in place of one that still waits. Never blocks.

        Args:
            make: gives the state; called on the writer's thread, which has time.
            now_ns: of the clock that `due` is asked with.
        """
        self._posted_ns = now_ns
        self._worker.submit(make)

    def close(self, timeout_s: float = 5.0) -> bool:
        """Write what waits, for at most `timeout_s`; whether it was done in time."""
        return self._worker.close(timeout_s)

    def _write(self, make: Callable[[], State]) -> None:
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
    """Without links, so that a link to another disk stays one."""
    return Path(os.path.realpath(path))


def _read(path: Path, form: Format[State], most: int) -> bytes | None:
    """Return the first `most` bytes of a checkpoint; None: there is no file.

    Raises:
        CheckpointError: the file cannot be read, or does not begin like a checkpoint.
    """
    _no_other_thing(path)
    try:
        with path.open("rb") as file:
            content = file.read(most)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unusable(path, error) from None
    if not content.startswith(form.file.begins):
        raise CheckpointError(
            f"mission.checkpoint: {path}: not a {form.file.what}, and left as it is; name another "
            "file, or move this one away"
        )
    return content


def _probe(path: Path, form: Format[State]) -> None:
    """CheckpointError unless a checkpoint can be written at `path`."""
    _read(path, form, len(form.file.begins))
    try:
        # Not the name that `save` takes: a running service may be writing there.
        with tempfile.NamedTemporaryFile(prefix=f".{path.name}.", dir=path.parent):
            pass
    except OSError as error:
        raise _unusable(path, error) from None


def _no_other_thing(path: Path) -> None:
    """CheckpointError for a folder, a device, a loop of links, a pipe (one would wait there)."""
    if os.path.lexists(path) and not os.path.isfile(path):  # those of a Path may raise
        raise CheckpointError(
            f"mission.checkpoint: {path}: not a file; name a file in a folder that can be written"
        )


def _set_aside(path: Path) -> Path:
    """Rename to the first free `<name>.damaged-N`."""
    n = 1
    while True:
        aside = path.with_name(f"{path.name}.damaged-{n}")
        try:
            os.close(os.open(aside, os.O_CREAT | os.O_EXCL))  # renaming would write over a file
        except FileExistsError:
            n += 1
            continue
        os.replace(path, aside)
        return aside


def _unusable(path: Path, error: OSError) -> CheckpointError:
    return CheckpointError(
        f"mission.checkpoint: {path}: {_why(error)}; name a file in a folder that can be written"
    )


def _why(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)

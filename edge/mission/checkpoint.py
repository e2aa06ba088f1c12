"""The whole state of a mission in a file, so that a service that was killed goes on with it.

The file (see `edge.mission.saved`) is replaced as a whole, so only a broken disk or a hand can
damage it. What is damaged is set aside, never deleted: it may be all that is left of a mission.
"""

from __future__ import annotations

import logging
import math
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from edge.errors import FileError
from edge.host.files import replace_atomically, sync
from edge.host.worker import Worker
from edge.mission.saved import MAX_BYTES, Saved, decode, encode

log = logging.getLogger("edge.mission.checkpoint")

_HASTE = 1.5  # robots are faster than they say
_DRIVES_ON_S = 10.0


class CheckpointError(FileError):
    """No checkpoint can be kept there: which path, why, what to do."""


@dataclass(frozen=True)
class Loaded:
    """What a checkpoint held. `problem`: one line when there was a file, but no use in it."""

    saved: Saved | None = None
    problem: str = ""


def save(path: Path, saved: Saved) -> None:
    """Replace the checkpoint; it has reached the disk when this returns.

    Raises:
        OSError: it cannot be written; the one before is untouched.
        ValueError: `saved` is no state that `load` would take.
    """
    path, content = _real(path), encode(saved)
    with replace_atomically(path, path.with_name(f".{path.name}.tmp")) as beside:
        beside.write_bytes(content)
    sync(path.parent)  # or the old file may be back after a power cut


def load(path: Path) -> Loaded:
    """Read a checkpoint; one that is damaged, foreign or newer than this program is set aside.

    Raises:
        CheckpointError: the file cannot be read, or not be set aside.
    """
    path = _real(path)
    _no_other_thing(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return Loaded()
    except OSError as error:
        raise _unusable(path, error) from None
    try:
        return Loaded(decode(content))
    except ValueError as error:
        problem = str(error)
    try:
        aside = _set_aside(path)
    except OSError as error:
        raise _unusable(path, error) from None
    problem = f"mission.checkpoint: {path}: {problem}; kept as {aside.name}, starting without it"
    log.warning("%s", problem)
    return Loaded(problem=problem)


def continuous(
    saved: Saved,
    pose: tuple[float, float, float] | None,
    stamp_ns: int,
    max_speed_mps: float,
    max_jump_m: float,
) -> bool:
    """Whether `map` is believed to be the frame that the checkpoint's places are in.

    It is where the robot stands no farther from its saved pose than `max_jump_m`, and what it
    could have driven since; without a service a robot ends its last goal and goes no farther, so
    only the first seconds count. Odometry that began anew is told by its pose, or by its clock;
    it is not where it began anew at the very place that the robot had been at.

    Args:
        pose: x and y in metres and yaw in radians now, at `stamp_ns`; None when not known.
    """
    if saved.pose is None or pose is None or stamp_ns < saved.stamp_ns:
        return False
    driving_s = min((stamp_ns - saved.stamp_ns) * 1e-9, _DRIVES_ON_S)
    return math.dist(pose[:2], saved.pose[:2]) <= max_jump_m + _HASTE * max_speed_mps * driving_s


class CheckpointWriter:
    """Writes the newest state on a thread of its own, so that the loop never waits for a disk.

    Attributes:
        written: checkpoints that reached the disk; `failed`: that did not.
        problem: why the last one did not, "" when it did.

    Raises:
        CheckpointError: nothing can be written there.
    """

    def __init__(self, path: Path, period_s: float = 1.0) -> None:
        self.path = _real(path)
        self.written = self.failed = 0
        self.problem = ""
        self._period_ns = int(period_s * 1e9)
        self._posted_ns: int | None = None
        _probe(self.path)
        self._worker = Worker("checkpoint", self._write, finishes=True)

    def due(self, now_ns: int) -> bool:
        """Whether the last posted state is a period old; events need not wait for that."""
        return self._posted_ns is None or abs(now_ns - self._posted_ns) >= self._period_ns

    def post(self, make: Callable[[], Saved], now_ns: int) -> None:
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

    def _write(self, make: Callable[[], Saved]) -> None:
        try:
            save(self.path, make())
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


def _probe(path: Path) -> None:
    """CheckpointError unless a file can be written at `path`."""
    _no_other_thing(path)
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

"""The latched stop of a robot: it lasts until it is released, over restarts and kills.

The stop is a file, written before the answer. The loop reads `StopLatch.reason` in every cycle
(`edge.loop.runner`).
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from pathlib import Path

from edge.errors import UserError
from edge.host import files
from edge.text import one_line, read_json_object

log = logging.getLogger("edge.host.stop_latch")

WITHDRAWN_S = 0.04
"""Longest time in seconds that an answer waits for the loop to withdraw the goal."""
MAX_WHY_CHARS = 200
"""Longest reason of a stop, in characters."""
_STOPPED_AGAIN = "still stopped: another stop came at the same time; release again"
_SIZE_BYTES = 4096  # more than a reason of `MAX_WHY_CHARS` as JSON
_BY_REQUEST = "by request"  # reason of a stop without a reason
RETRY_S = 5.0
"""Period in seconds of calls of `StopLatch.keep`, for a stop that could not be written."""


class StopLatch:
    """The stop of one robot; any thread may call its methods.

    The file has `_SIZE_BYTES`: blanks, or JSON while the robot is stopped. It is open with O_DSYNC,
    so one call of the system writes it to the disk. More calls would take longer, because other
    threads run in between. A file that cannot be read is a stop, too.

    Args:
        path: the file; None: the stop ends with the process.

    Attributes:
        reason: why the robot is stopped; "" if it is not stopped.
        problem: why the file could not be written; "" if it is up to date.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.reason, self._since_s = "" if path is None else read_stop(path), time.time()
        self.problem = "" if path is not None else "this run keeps no state"
        self._kept = bool(self.reason)  # True if the file holds the stop
        self._handle: int | None = None
        self._stops = self._stopping = 0  # calls of `stop`, and those that have not returned
        self._stopped_s = 0.0  # monotonic time of the stop
        self._state, self._disk = threading.Lock(), threading.Lock()
        self._withdrawn = threading.Event()
        if self.reason:
            log.warning("stopped: %s; `edge release` ends the stop", self.reason)
        self.keep()

    def stop(self, why: str) -> dict[str, object]:
        """Stop the robot; return the answer when the stop is on the disk.

        The answer also waits up to `WITHDRAWN_S` for the loop to withdraw the goal. The reason of
        the first stop stays.
        """
        with self._state:
            self._stops += 1
            self._stopping += 1
            if not self.reason:
                self._withdrawn.clear()
                self._since_s, self._stopped_s = time.time(), time.monotonic()
                self.reason = one_line(why, MAX_WHY_CHARS) or _BY_REQUEST
        try:
            with self._disk:
                self._write()
            left_s = self._stopped_s + WITHDRAWN_S - time.monotonic()
            if left_s > 0.0:
                self._withdrawn.wait(left_s)
            return self._answer()
        finally:
            with self._state:
                self._stopping -= 1

    def release(self) -> dict[str, object]:
        """End the stop; return the answer when that is on the disk.

        Raises:
            UserError: the file cannot be written, or another stop came at the same time. The robot
                stays stopped.
        """
        with self._disk:
            with self._state:
                stops, stopping = self._stops, self._stopping
            if stopping:
                raise UserError(_STOPPED_AGAIN)
            if self.path is not None:
                try:
                    self._put(self.path, "")
                except OSError as error:
                    raise UserError(
                        f"still stopped: {self.path} cannot be written: {error.strerror}; remove "
                        "it, and release again"
                    ) from None
            with self._state:
                self._kept = False
                if self._stops == stops:
                    self.reason = ""
            self._write()
        if self.reason:
            raise UserError(_STOPPED_AGAIN)
        return self._answer()

    def keep(self) -> None:
        """Open the file, and write a stop again if that failed or if the file was removed.

        Call this every `RETRY_S`.
        """
        with self._disk:
            if self.path is not None and not self.path.exists():
                self._close()
                self._kept = False
            self._write()

    def _write(self) -> None:
        """Open the file, and write the stop if it is not there yet; log a new failure."""
        if self.path is None or self._kept:
            return
        content = {"why": self.reason, "since_unix_s": round(self._since_s, 3)}
        try:
            if self.reason or self._handle is None:
                self._put(self.path, json.dumps(content) if self.reason else "")
        except OSError as error:
            problem = f"{self.path}: cannot be written: {error.strerror}"
            if problem != self.problem:
                log.error("a stop would end with this process: %s", problem)
            self.problem = problem
            self._close()
        else:
            self._kept, self.problem = bool(self.reason), ""

    def _put(self, path: Path, text: str) -> None:
        """Write the file, and return when it is on the disk; raise OSError."""
        is_new = self._handle is None
        if self._handle is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_DSYNC | os.O_CLOEXEC
            self._handle = os.open(path, flags, 0o644)
        os.pwrite(self._handle, text.encode().ljust(_SIZE_BYTES), 0)
        if is_new:
            os.ftruncate(self._handle, _SIZE_BYTES)
            files.sync(path.parent)

    def _close(self) -> None:
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def confirm(self, applied: str) -> None:
        """Tell waiting answers that the loop has applied this reason; called after each cycle."""
        if applied and not self._withdrawn.is_set() and applied == self.reason:
            self._withdrawn.set()

    def _answer(self) -> dict[str, object]:
        reason, withdrawn = self.reason, self._withdrawn.is_set()
        if not reason:
            return {"stopped": False, "text": "not stopped"}
        text = f"stopped: {reason}; `edge release` ends the stop"
        if not withdrawn:
            text += "; the loop has not withdrawn the goal yet: ask again"
        if self.problem:
            text += f"; a restart would forget the stop: {self.problem}"
        return {
            "stopped": True, "why": reason, "since_unix_s": round(self._since_s, 3),
            "kept": self._kept, "withdrawn": withdrawn, "text": text,
        }  # fmt: skip


def read_stop(path: Path) -> str:
    """Return the reason of the stop in a file; "" if there is none."""
    try:
        content = files.read_regular(path, 2 * _SIZE_BYTES).strip()
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{path} cannot be read: {error.strerror}"
    if not content:
        return ""
    try:
        why = read_json_object(content)["why"]
    except (ValueError, KeyError):
        return f"{path} is damaged"
    return one_line(why, MAX_WHY_CHARS) or _BY_REQUEST


def stop_file(prefix: str) -> Path | None:
    """Return the file that keeps the stop of the robot with this `zenoh.prefix`.

    Returns:
        A file below `$STATE_DIRECTORY` (set by systemd), else below `$XDG_STATE_HOME` or
        `~/.local/state`; None for a user without a home folder.
    """
    name = f"stop-{prefix.replace('/', '%')}.json"
    if state := os.environ.get("STATE_DIRECTORY"):
        return Path(state.split(":")[0]) / name
    try:
        home = Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser()
    except RuntimeError:
        return None
    return home / "edge-vln" / name

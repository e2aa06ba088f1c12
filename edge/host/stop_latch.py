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
_BY_REQUEST = "by request"  # reason of a stop without a reason
RETRY_S = 5.0
"""Period in seconds of calls of `StopLatch.keep`, for a stop that could not be written."""


class StopLatch:
    """The stop of one robot; any thread may call its methods.

    The file exists while the robot is stopped. A file that cannot be read is a stop, too.

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
        self._stops = self._stopping = 0  # calls of `stop`, and those that have not returned
        self._stopped_s = 0.0  # monotonic time of the stop
        self._state, self._disk = threading.Lock(), threading.Lock()
        self._withdrawn = threading.Event()
        if self.reason:
            log.warning("stopped: %s; `edge release` ends the stop", self.reason)

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
            self.keep()
            until_s = self._stopped_s + WITHDRAWN_S
            self._withdrawn.wait(max(until_s - time.monotonic(), 0.0))
            return self._answer()
        finally:
            with self._state:
                self._stopping -= 1

    def release(self) -> dict[str, object]:
        """End the stop; return the answer when the file is gone.

        Raises:
            UserError: the file cannot be removed, or another stop came at the same time. The robot
                stays stopped.
        """
        with self._disk:
            with self._state:
                stops, stopping = self._stops, self._stopping
            if stopping:
                raise UserError(_STOPPED_AGAIN)
            if self.path is not None:
                try:
                    self.path.unlink(missing_ok=True)
                    if self.path.parent.is_dir():
                        files.sync(self.path.parent)
                except OSError as error:
                    raise UserError(
                        f"still stopped: {self.path} cannot be removed: {error.strerror}; remove "
                        "it, and release again"
                    ) from None
            with self._state:
                self._kept = False
                if self._stops == stops:
                    self.reason = ""
        if self.reason:
            self.keep()
            raise UserError(_STOPPED_AGAIN)
        return self._answer()

    def keep(self) -> None:
        """Write the stop to the file, if it is not there yet; log a new failure."""
        with self._disk:
            if not self.reason or self._kept or self.path is None:
                return
            try:
                content = {"why": self.reason, "since_unix_s": round(self._since_s, 3)}
                _write(self.path, json.dumps(content).encode())
            except OSError as error:
                problem = f"{self.path}: cannot be written: {error.strerror}"
                if problem != self.problem:
                    log.error("the stop ends with this process: %s", problem)
                self.problem = problem
            else:
                self._kept, self.problem = True, ""

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


def _write(path: Path, content: bytes) -> None:
    """Write a file, and return when it and its name are on the disk.

    A file that a kill left half written is a stop, too. So no second file and no rename are needed,
    which would take longer: each call lets other threads run in between.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
    try:
        os.write(handle, content)
        os.fsync(handle)
    finally:
        os.close(handle)
    files.sync(path.parent)


def read_stop(path: Path) -> str:
    """Return the reason of the stop in a file; "" if there is no file."""
    try:
        content = files.read_regular(path, 4096)
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{path} cannot be read: {error.strerror}"
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

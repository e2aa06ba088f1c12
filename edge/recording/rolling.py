"""A recording in several files of limited size and age, in a folder of limited size.

For one thread, which may wait for the disk. While the disk is full, messages are lost.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from edge.recording.channels import Channel
from edge.recording.file import PARTIAL, McapWriter, RecordingError, is_being_written

log = logging.getLogger("edge.recording")

PREFIX = "edge-"
AGAIN_S = 5.0
"""Time in seconds until recording is tried again after an error."""
KEEP_MB = 4096.0
"""Default size of the folder in MB."""
MAX_S, SYNC_S = 600.0, 2.0
"""Age of a file in seconds at which the next file begins; time in which data reach the disk."""
_MB = 1_000_000
_TIME = "%Y%m%dT%H%M%S.%f"
# Such as `edge-20260131T123456.789Z.mcap`, or the same with `.partial`.
_NAME = re.compile(rf"{PREFIX}\d{{8}}T\d{{6}}\.\d{{3}}Z\.mcap({re.escape(PARTIAL)})?", re.ASCII)


class RollingRecorder:
    """Writes the files of one run.

    Args:
        folder: folder of the files; created if missing.
        max_mb: size of a file in MB at which the next file begins.
        keep_mb: size of the folder in MB. The oldest files are deleted, but none that is being
            written.
        compression: `none`, `lz4` or `zstd`.
        metadata: returns the metadata, by name, of a file, given the number of the file from 0.
        clock: returns a time in seconds.

    Attributes:
        messages: number of messages written.
        lost: number of messages lost because no file could be written, including those that were
            not yet on the disk when a write failed.
        problem: why nothing can be written now, in one line; empty if all is well.
    """

    def __init__(
        self,
        folder: Path,
        max_mb: float,
        keep_mb: float,
        compression: str,
        metadata: Callable[[int], dict[str, dict[str, str]]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.messages = self.lost = 0
        self.problem = ""
        self._folder, self._max_mb, self._keep_mb = folder, max_mb, keep_mb
        self._compression, self._metadata, self._clock = compression, metadata, clock
        self._file: McapWriter | None = None
        self._n_files = 0
        self._unsynced = 0  # messages that may not be on the disk yet
        self._began_s = self._synced_s = 0.0
        self._retry_s = -float("inf")

    @property
    def name(self) -> str:
        """Name of the file that is being written; empty if there is none."""
        file = self._file  # another thread may change it
        return "" if file is None else file.path.name

    def ready(self) -> None:
        """Begin a new file if needed. Call it before messages that must be in one file."""
        now_s = self._clock()
        if self._file is not None:
            is_full = self._file.bytes >= self._max_mb * _MB
            if is_full or now_s - self._began_s >= MAX_S:
                self._finish()
        if self._file is None and now_s >= self._retry_s:
            self._begin(now_s)

    def add(
        self, channel: Channel, log_ns: int, stamp_ns: int, *payload: Any, sequence: int = 0
    ) -> None:
        """Add one message; see `McapWriter.add`."""
        if self._file is None:
            self.lost += 1
            return
        try:
            self._file.add(channel, log_ns, stamp_ns, *payload, sequence=sequence)
            self.messages += 1
            self._unsynced += 1
        except OSError as error:
            self.lost += 1
            self._close_failed(error)

    def sync(self) -> None:
        """Write buffered messages to the disk if it is time."""
        now_s = self._clock()
        if self._file is None or now_s - self._synced_s < SYNC_S:
            return
        self._synced_s = now_s
        try:
            self._file.sync()
            self._unsynced = 0
        except OSError as error:
            self._close_failed(error)

    def close(self) -> None:
        """Complete the file."""
        if self._file is not None:
            self._finish()

    def _begin(self, now_s: float) -> None:
        """Open the next file; if that fails, report it and try again later."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = _free_name(self._folder)
            file = McapWriter(path, self._compression, self._metadata(self._n_files))
            # Leave room for the file that now begins.
            make_room(self._folder, int((self._keep_mb - self._max_mb) * _MB))
            file.open()
        except OSError as error:
            self._report(error)
            return
        if self.problem:
            log.warning("%s: recording again, in the file %s; %d messages were lost", self._folder,
                        path.name, self.lost)  # fmt: skip
            self.problem = ""
        self._file, self._n_files = file, self._n_files + 1
        self._began_s = self._synced_s = now_s

    def _finish(self) -> None:
        try:
            self._file.finish()
            self._file, self._unsynced = None, 0
        except OSError as error:
            self._close_failed(error)

    def _close_failed(self, error: OSError) -> None:
        """Close the file as it is; it can be read up to its end."""
        file, self._file = self._file, None
        with suppress(OSError):  # of an error that the caller has caught already
            file.abandon()
        self.messages -= self._unsynced
        self.lost += self._unsynced
        self._unsynced = 0
        self._report(error)

    def _report(self, error: OSError) -> None:
        self._retry_s = self._clock() + AGAIN_S
        why = error.strerror or str(error)
        if why != self.problem:
            log.error("%s: cannot record: %s; trying again every few seconds", self._folder,
                      why)  # fmt: skip
        self.problem = why


def _free_name(folder: Path) -> Path:
    """Return a file name of the current time, or later: after all names of the folder.

    The oldest name is deleted first, and the clock may be wrong: a computer without a battery
    begins in 1970.
    """
    now = datetime.now(timezone.utc)
    for path in reversed(files_of(folder)):
        with suppress(ValueError, OverflowError):  # no date, or the last one
            newest = datetime.strptime(path.name[len(PREFIX) :].split("Z")[0], _TIME)
            now = max(now, newest.replace(tzinfo=timezone.utc) + timedelta(milliseconds=1))
            break
    while True:
        path = folder / f"{PREFIX}{now.strftime(_TIME)[:-3]}Z.mcap"
        if not (path.exists() or path.with_name(path.name + PARTIAL).exists()):
            return path
        now += timedelta(milliseconds=1)


def files_of(folder: Path) -> list[Path]:
    """Return the recordings of a folder, complete or not, the oldest first.

    Only names of `_free_name` count: old files are deleted, and files that a person named or copied
    here must stay.
    """
    return sorted(path for path in folder.glob(f"{PREFIX}*") if _NAME.fullmatch(path.name))


def make_room(folder: Path, most_bytes: int) -> None:
    """Delete the oldest recordings until their total size is within the limit; may raise OSError.

    Files that are being written stay.
    """
    files = []
    for path in files_of(folder):
        with suppress(FileNotFoundError):  # deleted by another process
            files.append((path, path.stat().st_size))
    total = sum(size for _, size in files)
    for path, size in files:
        if total <= most_bytes:
            return
        try:
            if is_being_written(path):
                continue
        except RecordingError:  # deleted by another process, or no file
            continue
        path.unlink(missing_ok=True)
        total -= size

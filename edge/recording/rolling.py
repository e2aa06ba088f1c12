"""A recording in several files of limited size and age, in a folder of limited size.

For one thread, which may wait for the disk. A disk that is full costs what comes meanwhile.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from edge.recording.channels import Channel
from edge.recording.file import PARTIAL, McapFile, RecordingError, is_written

log = logging.getLogger("edge.recording")

PREFIX = "edge-"
AGAIN_S = 5.0
_MB = 1_000_000
_NAME = re.compile(rf"{PREFIX}\d{{8}}T\d{{6}}\.\d{{3}}Z\.mcap({re.escape(PARTIAL)})?", re.ASCII)


@dataclass(frozen=True)
class Limits:
    """
    Attributes:
        max_mb, max_s: of a file; then the next is begun.
        keep_mb: of the folder; the oldest files are deleted, never one that is being written.
        sync_s: what is older than that has reached the disk.
    """

    max_mb: float = 256.0
    max_s: float = 600.0
    keep_mb: float = 4096.0
    sync_s: float = 2.0


class Rolling:
    """Writes the files.

    Args:
        metadata: of the file of this number, by name.
        clock: seconds.

    Attributes:
        messages: that were written; `lost`: that were not, for want of a file to write to. What
            was not yet on the disk when that failed counts as lost.
        problem: why nothing can be written now, in one line; empty while it can.
    """

    def __init__(
        self,
        folder: Path,
        limits: Limits,
        compression: str,
        metadata: Callable[[int], dict[str, dict[str, str]]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.messages = self.lost = 0
        self.problem = ""
        self._folder, self._limits, self._compression = folder, limits, compression
        self._metadata, self._clock = metadata, clock
        self._file: McapFile | None = None
        self._parts = self._fresh = 0  # files; messages that may not be on the disk yet
        self._began_s = self._synced_s = 0.0
        self._again_s = -float("inf")

    @property
    def name(self) -> str:
        """Of the file that is being written; empty while there is none."""
        file = self._file  # of another thread
        return "" if file is None else file.path.name

    def ready(self) -> None:
        """What is added from here on may come into another file than what was before."""
        now_s = self._clock()
        if self._file is not None:
            full = self._file.bytes >= self._limits.max_mb * _MB
            if full or now_s - self._began_s >= self._limits.max_s:
                self._finish()
        if self._file is None and now_s >= self._again_s:
            self._begin(now_s)

    def add(
        self, channel: Channel, log_ns: int, stamp_ns: int, *payload: Any, sequence: int = 0
    ) -> None:
        """One message; see `McapFile.add`."""
        if self._file is None:
            self.lost += 1
            return
        try:
            self._file.add(channel, log_ns, stamp_ns, *payload, sequence=sequence)
            self.messages += 1
            self._fresh += 1
        except OSError as error:
            self.lost += 1
            self._give_up(error)

    def sync(self) -> None:
        """Have what was added on the disk, where it is time for that."""
        now_s = self._clock()
        if self._file is None or now_s - self._synced_s < self._limits.sync_s:
            return
        self._synced_s = now_s
        try:
            self._file.sync()
            self._fresh = 0
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """Complete the file."""
        if self._file is not None:
            self._finish()

    def _begin(self, now_s: float) -> None:
        path = _free_name(self._folder)
        file = McapFile(path, self._compression, self._metadata(self._parts))
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            make_room(self._folder, int((self._limits.keep_mb - self._limits.max_mb) * _MB))
            file.open()
        except OSError as error:
            self._tell(error)
            return
        if self.problem:
            log.warning("%s: goes on in %s; %d messages are lost", self._folder, path.name,
                        self.lost)  # fmt: skip
            self.problem = ""
        self._file, self._parts = file, self._parts + 1
        self._began_s = self._synced_s = now_s

    def _finish(self) -> None:
        try:
            self._file.finish()
            self._file, self._fresh = None, 0
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        """The file stays as it is: it can be read up to where it ends."""
        self._file.abandon()
        self._file = None
        self.messages -= self._fresh
        self.lost += self._fresh
        self._fresh = 0
        self._tell(error)

    def _tell(self, error: OSError) -> None:
        self._again_s = self._clock() + AGAIN_S
        why = error.strerror or str(error)
        if why != self.problem:
            log.error("%s: nothing can be recorded: %s; goes on as soon as it can", self._folder,
                      why)  # fmt: skip
        self.problem = why


def _free_name(folder: Path) -> Path:
    """The time of day, or the next millisecond of which there is no file."""
    now = datetime.now(timezone.utc)
    while True:
        path = folder / f"{PREFIX}{now.strftime('%Y%m%dT%H%M%S.%f')[:-3]}Z.mcap"
        if not (path.exists() or path.with_name(path.name + PARTIAL).exists()):
            return path
        now += timedelta(milliseconds=1)


def files_of(folder: Path) -> list[Path]:
    """The recordings of a folder, complete or not, the oldest first.

    Only names that `_free_name` gives: the oldest are deleted, and a file that a person named or
    copied here is not ours.
    """
    return sorted(path for path in folder.glob(f"{PREFIX}*") if _NAME.fullmatch(path.name))


def make_room(folder: Path, most_bytes: int) -> None:
    """Delete the oldest recordings until all together are no larger; those that are being written
    stay. Raises OSError."""
    files = [(path, path.stat().st_size) for path in files_of(folder)]
    total = sum(size for _, size in files)
    for path, size in files:
        if total <= most_bytes:
            return
        try:
            if is_written(path):
                continue
        except RecordingError:  # it is gone, or not ours
            continue
        os.unlink(path)
        total -= size

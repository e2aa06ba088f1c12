"""Check of a soaked service's recordings, with the `mcap` library and `edge replay`."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from edge.config import Config
from edge.config.loop import SinkConfig
from edge.errors import UserError
from edge.loop.warmup import warm_up
from edge.recording.file import PARTIAL, McapReader, RecordingError
from edge.recording.replay import replay
from edge.recording.rolling import KEEP_MB, files_of
from edge.recording.session import RecordedRun
from edge.text import one_line

FOLDER = "recordings"  # in the output folder of the soak
FIRST = "first.mcap"  # link to the first recording, which the service may delete
KIND = "mcap"  # of the sinks that record
_SPARE_MB = 2.0  # a file is closed with its last chunk and its index
_MB = 1e6


def move_folders(sinks: Iterable[SinkConfig], out: Path) -> tuple[SinkConfig, ...]:
    """Return the sinks, with the folder of those that record moved below `out`."""
    folder = {"folder": str(out / FOLDER)}
    return tuple(
        SinkConfig(kind=sink.kind, options={**sink.options, **folder})
        if sink.kind == KIND
        else sink
        for sink in sinks
    )


class RecordingCheck:
    """Reads each file once it is complete. The first file is kept as `FIRST` by a hard link.

    Attributes:
        problem: first problem of a file or of the folder's size; "" if there is none.
        files: number of files that were read to their end.
    """

    def __init__(self, config: Config, out: Path) -> None:
        sinks = [sink for sink in config.sinks if sink.kind == KIND]
        self.problem = ""
        self.files = self.messages = 0
        self.size_mb = 0.0
        self.first = out / FIRST
        self._folder = Path(sinks[0].options["folder"]) if sinks else None
        self._limit_mb = sum(sink.options.get("keep_mb", KEEP_MB) for sink in sinks)
        self._read: set[Path] = set()

    def check_next_file(self) -> None:
        """Read the oldest complete file that was not read yet."""
        if self._folder is None:
            return
        files = files_of(self._folder)
        with suppress(FileNotFoundError):  # deleted or renamed in between
            if files and not self.first.exists():
                os.link(files[0], self.first)  # stays valid if the file is renamed
        self.size_mb = sum(map(_size, files)) / _MB
        if self.size_mb > self._limit_mb + _SPARE_MB:
            self._report(
                f"recordings have {self.size_mb:.1f} MB, keep_mb allows {self._limit_mb:g} MB"
            )
        new = (path for path in files if not path.name.endswith(PARTIAL))
        if (path := next((path for path in new if path not in self._read), None)) is not None:
            self._read.add(path)
            self._read_complete(path)

    def judge(self) -> dict[str, Any]:
        """Read the remaining files and replay the first. Call it after the service has ended.

        Returns:
            JSON-ready: `files` and `messages` in all; `cut`, the number of files without an end;
            and of the replay `ticks`, `differing`, and the reason why it `ended` early.
        """
        if self._folder is None:
            return {}
        for path in files_of(self._folder):
            if path.name.endswith(PARTIAL):
                self._read_unfinished(path)
            elif path not in self._read:
                self._read_complete(path)
        cut = sum(path.name.endswith(PARTIAL) for path in files_of(self._folder))
        return {"files": self.files, "messages": self.messages, "cut": cut, **self._replay_first()}

    def _read_complete(self, path: Path) -> None:
        """Read a complete file by the library alone, using the index of the file."""
        try:
            with path.open("rb") as file:
                reader = make_reader(file, validate_crcs=True)
                summary = reader.get_summary()
                read = sum(1 for _ in reader.iter_messages(log_time_order=False))
        except FileNotFoundError:  # the service deletes the oldest
            return
        except Exception as error:  # a decompressor may raise anything for damaged data
            self._report(f"{path.name}: {one_line(error, 120) or type(error).__name__}")
            return
        indexed = summary and summary.statistics and summary.statistics.message_count
        if not read or read != indexed:
            self._report(f"{path.name}: {read} messages, but its index has {indexed}")
        self.files += 1
        self.messages += read

    def _read_unfinished(self, path: Path) -> None:
        """Read a file that was not completed, up to where it ends."""
        try:
            reading = McapReader(path)
            read = sum(1 for _ in reading)
        except RecordingError as error:
            self._report(str(error))
            return
        if reading.truncation not in ("", "cut off"):
            self._report(f"{path.name}: {reading.truncation}")
        self.files += 1
        self.messages += read

    def _replay_first(self) -> dict[str, Any]:
        if not self.first.exists():
            self._report("nothing was recorded")
            return {}
        logging.disable(logging.WARNING)  # the service logged this the first time
        try:
            session = RecordedRun(self.first, trust=True)  # it was made here
            warm_up(session.config())
            outcome = replay(session)
        except UserError as error:
            self._report(f"replay: {error}")
            return {}
        except Exception as error:  # a bug, which the report must name
            self._report(f"replay: {type(error).__name__}: {one_line(error)}")
            return {}
        finally:
            logging.disable(logging.NOTSET)
        if outcome.differing or not outcome.ticks:
            first = outcome.first.tick if outcome.first else 0
            self._report(
                f"replay: {outcome.differing} of {outcome.ticks} ticks differ, first tick {first}"
            )
        return {"ticks": outcome.ticks, "differing": outcome.differing, "ended": outcome.ended}

    def _report(self, problem: str) -> None:
        self.problem = self.problem or problem


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0

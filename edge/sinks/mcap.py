"""Sink that records a run: inputs, decisions, and everything that a replay needs.

The loop only copies; the sink's thread writes files, from a queue of limited size. If the queue is
full, images, depth and clouds are dropped first, and counted.

A page is one message of the journal: the inputs since the last page, and the decisions of the tick
after them. The journal is what a replay reads.
"""

from __future__ import annotations

import errno
import json
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from edge import __version__
from edge.config import Config
from edge.errors import ConfigError
from edge.host import resources
from edge.host.files import make_writable
from edge.host.worker import Worker
from edge.loop.input_log import LoopInput
from edge.loop.result import TickResult
from edge.recording import channels, journal
from edge.recording.file import COMPRESSIONS
from edge.recording.rolling import KEEP_MB, RollingRecorder
from edge.sinks.encoder import EncodedMessage, ResultEncoder, ResultSnapshot
from edge.text import one_line

PAGE_NS = 500_000_000
"""Longest time of ticks without observation that share one page of the journal."""
BATCH = 8
"""Number of ticks that are written together: this costs half as much as single writes.

They are written after a tick, when the loop is idle.
"""
PENDING_BYTES = 64_000_000
"""Limit of arrays that wait to be written."""
_CLOSE_S = 5.0  # longest time to write what is pending at the end


class _Item(NamedTuple):
    """One tick to write: its data, its result and the inputs before it.

    `bytes` is the size of the arrays in `snapshot`.
    """

    snapshot: ResultSnapshot
    inputs: tuple[LoopInput, ...]
    result: TickResult
    bytes: int


class McapSink:
    """Writes MCAP files into a folder; no method blocks.

    Args:
        folder: created if missing; `~` is the home directory.
        max_mb: see `edge.recording.rolling.RollingRecorder`.
        keep_mb: see `RollingRecorder`.
        rgb_hz: rate of images, stored as JPEG; 0: none.
        compression: `none`, `lz4` or `zstd`.

    Raises:
        ConfigError: the folder cannot be written.
    """

    def __init__(
        self,
        config: Config,
        folder: str,
        max_mb: float = 256.0,
        keep_mb: float = KEEP_MB,
        rgb_hz: float = 1.0,
        compression: str = "lz4",
    ) -> None:
        where = resources.expand(folder)
        try:
            make_writable(where)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):  # there may be space later
                why = f"{one_line(folder)}: cannot be written: {error.strerror}"
                raise ConfigError(f"sinks: mcap: folder: {why}") from None
        self._config = config
        self._session = uuid.uuid4().hex
        self._files = RollingRecorder(where, max_mb, keep_mb, compression, self._metadata)
        self._encoder = ResultEncoder(config, rgb_hz)
        self._inputs: list[LoopInput] = []
        self._page_ns: int | None = None  # start of the current page
        self._held_back: TickResult | None = None  # the last result of the page
        self._rig: dict[str, Any] = {}  # camera and mounts as last written to the journal
        self._pending_bytes, self._lock = 0, threading.Lock()  # the lock is for these bytes
        self._dropped = {"arrays": 0, "moments": 0}  # ticks without arrays; entire ticks
        # In lockstep the simulated time waits for writing, so nothing is dropped.
        self._lockstep = config.loop.lockstep
        self._failed, self._problem = 0, ""
        self._batch: list[_Item] = []
        self._worker: Worker[list[_Item], None] = Worker(
            "mcap-sink", self._write, inline=self._lockstep, drop=self._count_dropped,
            finish_on_close=True, periodic=self._files.sync,
        )  # fmt: skip

    # -- on the loop's thread -------------------------------------------------------------------

    @staticmethod
    def check_options(
        folder: str,
        max_mb: float = 256.0,
        keep_mb: float = KEEP_MB,
        rgb_hz: float = 1.0,
        compression: str = "lz4",
    ) -> None:
        """Raise an error for invalid numbers or names; see `edge.config.components`."""
        if not max_mb > 0:
            raise ConfigError(f"sinks: mcap: max_mb: must be more than 0, got {max_mb}")
        if not rgb_hz >= 0:
            raise ConfigError(f"sinks: mcap: rgb_hz: must be 0 or more, got {rgb_hz}")
        if not keep_mb >= 2 * max_mb:
            raise ConfigError(
                f"sinks: mcap: keep_mb: {keep_mb:g} is less than two files of max_mb, {max_mb:g} "
                "MB each: raise keep_mb, or lower max_mb"
            )
        if compression not in COMPRESSIONS:
            raise ConfigError(
                f"sinks: mcap: compression: unknown {compression!r} (choices: "
                f"{', '.join(COMPRESSIONS)})"
            )

    def tick(self, result: TickResult) -> None:
        """Queue the result for writing; see `edge.loop.result.Sink`."""
        self._inputs += result.inputs
        if self._page_ns is None:
            self._page_ns = result.now_ns
        may_wait = 0 <= result.now_ns - self._page_ns < PAGE_NS
        if may_wait and result.observation is None and not (result.goals or result.events):
            self._held_back = result
        else:
            self._queue(result)

    def _queue(self, result: TickResult) -> None:
        """Copy a result, with the inputs since the last one, into the batch."""
        has_room = self._pending_bytes < PENDING_BYTES
        snapshot = self._encoder.capture(result, arrays=has_room)
        self._dropped["arrays"] += result.observation is not None and not has_room
        size = snapshot.bytes
        with self._lock:
            self._pending_bytes += size
        self._batch.append(_Item(snapshot, tuple(self._inputs), result, size))
        self._inputs, self._page_ns, self._held_back = [], None, None
        if len(self._batch) >= BATCH:
            self._flush()

    def _flush(self) -> None:
        batch, self._batch = self._batch, []
        self._worker.enqueue(batch)

    def status(self) -> dict[str, Any]:
        """Return file and counters; see `edge.loop.result.Sink`.

        `messages` were written, `failed` were not; `dropped` counts ticks without their arrays, or
        dropped entirely.
        """
        files = self._files
        return {
            "file": files.name,
            "messages": files.messages,
            "failed": files.lost + self._failed,
            "dropped": sum(self._dropped.values()),
            "dropped_of": dict(self._dropped),
            "problem": files.problem or self._problem,
        }

    def close(self) -> None:
        """Write what is pending and complete the file."""
        if self._held_back is not None:
            self._queue(self._held_back)
        self._flush()
        if self._worker.close(_CLOSE_S):
            self._files.close()

    def _count_dropped(self, batch: list[_Item]) -> None:
        self._dropped["moments"] += len(batch)
        self._release(sum(item.bytes for item in batch))

    def _release(self, size: int) -> None:
        with self._lock:
            self._pending_bytes -= size

    # -- on the worker's thread ------------------------------------------------------------------

    def _write(self, batch: list[_Item]) -> None:
        """Encode all items, then write them.

        Encoding between image writes, which flush the CPU caches, would be twice as slow.
        """
        encoded = [list(self._messages_of(item)) for item in batch]
        for item, messages in zip(batch, encoded, strict=True):
            with self._count_errors():
                self._files.ready()
                for message in messages:
                    self._files.add(
                        message.channel, item.snapshot.now_ns, message.stamp_ns, *message.payload,
                        sequence=message.sequence,
                    )  # fmt: skip
            self._encoder.release(item.snapshot)
            self._release(item.bytes)
        self._files.sync()

    def _messages_of(self, item: _Item) -> Iterator[EncodedMessage]:
        """Yield the messages of a tick, the journal's page last, since its arrays come first."""
        snapshot = item.snapshot
        with self._count_errors():  # an error of the display must not lose data for the replay
            yield from self._encoder.encode(snapshot)
        with self._count_errors():
            page = journal.encode_page(item.inputs, item.result, snapshot.observation, self._rig)
            yield EncodedMessage(channels.JOURNAL, snapshot.now_ns, (page,))

    @contextmanager
    def _count_errors(self) -> Iterator[None]:
        """Count an error and continue with what follows."""
        try:
            yield
        except Exception as error:
            self._problem = one_line(f"{type(error).__name__}: {error}")
            self._failed += 1

    def _metadata(self, part: int) -> dict[str, dict[str, str]]:
        """Return the metadata, by name, of file number `part` of the run, from 0."""
        config = json.dumps(journal.config_text(self._config))
        fields = {
            "version": str(journal.VERSION), "edge": __version__, "session": self._session,
            "part": str(part), "config": config,
        }  # fmt: skip
        return {journal.FORMAT: fields}

"""Background work on a thread, without blocking the caller.

The loop gives items to a `Worker` and polls its newest result. `submit` replaces a waiting item,
`enqueue` keeps all (up to a limit).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from time import perf_counter_ns
from typing import Generic, TypeVar

from edge.errors import UserError
from edge.host.backoff import pause_after
from edge.text import one_line

log = logging.getLogger(__name__)

LONGEST_ERROR = 500
"""Longest text of an error, in characters."""
MAX_DOUBLINGS = 6
"""Limit of how often the number of dropped items doubles after failures."""
MAX_PAUSE_S = 30.0
"""Longest pause after failures, in seconds."""
MOST_QUEUED = 256
"""Largest number of items that `enqueue` keeps."""
PERIOD_S = 0.1
"""Period of `periodic` without items, in seconds."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(slots=True)
class WorkerStats:
    """Counts since the start. Any thread may read them at any time.

    Attributes:
        submitted: accepted items.
        replaced: items that a newer item replaced before they were processed.
        done: processed items.
        results_replaced: results that a newer result replaced before they were polled.
        failed: items whose processing raised.
        last_latency_ns: processing time of the newest result.
        last_error: newest failure in one line; "" if there was none.
        failures: type of exception → count. The dict is replaced, never changed.
        in_a_row: number of failures since the newest result.
    """

    submitted: int = 0
    replaced: int = 0
    done: int = 0
    results_replaced: int = 0
    failed: int = 0
    last_latency_ns: int = 0
    last_error: str = ""
    failures: dict[str, int] = field(default_factory=dict)
    in_a_row: int = 0

    def status(self) -> dict[str, object]:
        """Return failures and drops, JSON-ready, for the status of a sink."""
        return {"failed": self.failed, "dropped": self.replaced, "problem": self.last_error}


class Worker(Generic[Item, Result]):
    """Processes items on a thread of its own.

    A new item replaces the waiting item of the same key; a new result replaces one that was not
    polled. The worker owns submitted items: each is processed or dropped. Exceptions of `work` are
    logged and counted, and do not end the worker.

    Args:
        what: name of the work, for the log and the thread.
        work: called with each item. Its result can be polled, unless it is None.
        inline: True: no thread, `submit` does the work, so that a run replays bit for bit.
        rest_s: pause after a success.
        pause_s: pause after the first failure; it doubles with each further failure. With `inline`,
            2, 4, 8 … items are dropped instead.
        drop: called with each item that is not processed.
        drop_result: called with each result that is not polled.
        finish_on_close: True: `close` processes the waiting items instead of dropping them.
        periodic: called after each item, and every `PERIOD_S` if no item comes.

    Example:
        >>> worker = Worker("double", lambda x: 2 * x, inline=True)
        >>> worker.submit(21)
        >>> worker.poll()
        42
    """

    def __init__(
        self,
        what: str,
        work: Callable[[Item], Result | None],
        *,
        inline: bool = False,
        rest_s: float = 0.0,
        pause_s: float = 0.0,
        drop: Callable[[Item], object] = lambda item: None,
        drop_result: Callable[[Result], object] = lambda result: None,
        finish_on_close: bool = False,
        periodic: Callable[[], object] | None = None,
    ) -> None:
        self.stats = WorkerStats()
        self._name, self._work = what, work
        self._rest_s, self._pause_s = rest_s, pause_s
        self._drop, self._drop_result = drop, drop_result
        self._finish_on_close, self._periodic = finish_on_close, periodic
        self._changed = threading.Condition()
        self._waiting: dict[Hashable, Item] = {}
        self._result: Result | None = None
        self._busy = self._closed = False
        self._serial = 0  # number of the last queued item
        self._n_to_drop = 0  # with `inline`: next items to drop, as a pause
        # Number of calls of `discard_all`: so far, and when the present item began.
        self._n_discards = self._discards_at_begin = 0
        self._thread: threading.Thread | None = None
        if not inline:
            # A daemon, so that work that hangs does not keep the process alive.
            self._thread = threading.Thread(target=self._run, name=what, daemon=True)
            self._thread.start()

    @property
    def idle(self) -> bool:
        """True if no item waits or is processed, and no pause is left."""
        with self._changed:
            return not (self._waiting or self._busy)

    def submit(self, item: Item, key: Hashable = None) -> None:
        """Process this item next, in place of the waiting item of the same key.

        The call never blocks, unless `inline` is set.
        """
        if self._thread is None:
            self._process_inline(item)
            return
        with self._changed:
            displaced = item if self._closed else self._waiting.get(key)  # the item to drop
            if not self._closed:
                self._waiting[key] = item
                self.stats.submitted += 1
                self.stats.replaced += displaced is not None
                self._changed.notify_all()
        if displaced is not None:
            self._drop(displaced)

    def enqueue(self, item: Item) -> None:
        """Process this item after all that wait; beyond `MOST_QUEUED`, the oldest is dropped."""
        with self._changed:
            self._serial += 1
            serial = self._serial
        self.submit(item, serial)  # a key of its own, so it replaces no item
        oldest = None
        with self._changed:
            queued = [key for key in self._waiting if isinstance(key, int)]  # keys of `enqueue`
            if len(queued) > MOST_QUEUED:
                self.stats.replaced += 1
                oldest = self._waiting.pop(queued[0])
        if oldest is not None:
            self._drop(oldest)

    def poll(self) -> Result | None:
        """Return the newest result that was not polled yet, or None."""
        if self._result is None:  # as in nearly every tick
            return None
        with self._changed:
            result, self._result = self._result, None
        return result

    def discard_all(self) -> None:
        """Drop all submitted items and their results, also the result of the present item."""
        with self._changed:
            self._n_discards += 1
            waiting, unread = list(self._waiting.values()), self._result
            self._waiting.clear()
            self._result = None
        for item in waiting:
            self._drop(item)
        if unread is not None:
            self._drop_result(unread)

    def stop(self) -> None:
        """Accept no more items, and drop those that wait, unless `finish_on_close`."""
        with self._changed:
            self._closed = True
            dropped = [] if self._finish_on_close else list(self._waiting.values())
            if dropped:
                self._waiting.clear()
            self._changed.notify_all()
        for item in dropped:
            self._drop(item)

    def close(self, timeout_s: float | None = None) -> bool:
        """Stop, wait for the present item, and return True if that ended within `timeout_s`."""
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout_s)
        if (unread := self.poll()) is not None:
            self._drop_result(unread)
        return self._thread is None or not self._thread.is_alive()

    def _process_inline(self, item: Item) -> None:
        """Process an item in the caller's thread, or drop it as a pause after a failure."""
        if self._closed or self._n_to_drop > 0:
            self._n_to_drop -= 1
            self._drop(item)
            return
        self.stats.submitted += 1
        self._discards_at_begin = self._n_discards
        if not self._process(item) and self._pause_s:
            self._n_to_drop = 2 ** min(self.stats.in_a_row, MAX_DOUBLINGS)

    def _run(self) -> None:
        """Process items until the worker is closed."""
        while not self._closed or self._waiting:
            for item in self._take():  # at most one
                self._wait_s(self._rest_s if self._process(item) else self._pause_length_s())
            if self._periodic is not None:
                try:
                    self._periodic()
                except Exception as error:
                    self._failed(error)

    def _take(self) -> list[Item]:
        """Wait for an item, or for `PERIOD_S`; return the oldest item in a list, or []."""
        with self._changed:
            self._busy = False
            if not self._waiting and not self._closed:
                self._changed.wait(PERIOD_S if self._periodic is not None else None)
            self._busy, self._discards_at_begin = bool(self._waiting), self._n_discards
            return [self._waiting.pop(key) for key in list(self._waiting)[:1]]

    def _process(self, item: Item) -> bool:
        """Process an item; return True if that did not raise."""
        begin_ns = perf_counter_ns()
        try:
            result = self._work(item)
        except Exception as error:  # a model or sink may raise anything; the loop must go on
            self._failed(error)
            return False
        self._record_result(result, perf_counter_ns() - begin_ns)
        return True

    def _record_result(self, result: Result | None, took_ns: int) -> None:
        """Keep a result for `poll`; drop the one it replaces, or itself if not wanted."""
        stats, unread = self.stats, result  # `unread`: the result to drop
        with self._changed:
            stats.done += 1
            stats.in_a_row, stats.last_latency_ns = 0, took_ns
            is_wanted = not self._closed and self._discards_at_begin == self._n_discards
            if result is not None and is_wanted:
                unread, self._result = self._result, result
                stats.results_replaced += unread is not None
        if unread is not None:
            self._drop_result(unread)

    def _wait_s(self, seconds: float) -> None:
        if seconds > 0.0:
            with self._changed:
                self._changed.wait_for(lambda: self._closed, seconds)

    def _pause_length_s(self) -> float:
        return pause_after(self.stats.in_a_row, self._pause_s, MAX_PAUSE_S)

    def _failed(self, error: Exception, excused: bool = False) -> None:
        """Count a failure, and log the first of its type.

        With `pause_s`, the first of each series of failures is logged too.

        Args:
            error: the failure.
            excused: True: do not count it in `in_a_row`. Subclasses use it for a detector that
                has reported by itself that it is not ready.
        """
        kind, stats = type(error).__name__, self.stats
        stats.failed += 1
        stats.in_a_row += not excused
        text = str(error) if isinstance(error, UserError) else f"{kind}: {error}"
        stats.last_error = one_line(text, LONGEST_ERROR)
        stats.failures = {**stats.failures, kind: stats.failures.get(kind, 0) + 1}
        if stats.failures[kind] == 1 or (self._pause_s and stats.in_a_row == 1):
            log.error("%s: %s (more of these are only counted)", self._name, stats.last_error)

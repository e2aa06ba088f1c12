"""Hands items to a thread of their own, so that who posts them never waits."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

log = logging.getLogger("edge.host.mailbox")


class Mailbox:
    """Items leave in the order in which their keys came in.

    Args:
        deliver: called as `deliver(name, item)` on the mailbox's thread; may block, and what it
            raises is logged, not passed on.
        idle: called on that thread at least every `period_s`, between deliveries.
        capacity: how many queued items are kept; the oldest is let go (and counted) after that.

    Attributes:
        replaced: posted items that a newer one took the place of.
        overflowed: queued items that were let go.
        failed: deliveries that raised.
    """

    def __init__(
        self,
        name: str,
        deliver: Callable[[str, Any], None],
        idle: Callable[[], None] = lambda: None,
        period_s: float = 0.1,
        capacity: int = 256,
    ) -> None:
        self.replaced = self.overflowed = self.failed = 0
        self._deliver, self._idle, self._period_s = deliver, idle, period_s
        self._capacity = capacity
        self._items: OrderedDict[tuple[str, int], Any] = OrderedDict()
        self._serial = 0
        self._changed = threading.Condition()
        self._closing = False
        # A daemon: a delivery that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def post(self, name: str, item: Any) -> None:
        """Newest wins: takes the place of an item of this name that has not left yet."""
        with self._changed:
            self.replaced += (name, 0) in self._items
            self._items[(name, 0)] = item
            self._changed.notify()

    def queue(self, name: str, item: Any) -> None:
        """Every item counts; they leave in order."""
        with self._changed:
            self._serial += 1
            self._items[(name, self._serial)] = item
            if len(self._items) > self._capacity:
                oldest = next((key for key in self._items if key[1]), None)
                if oldest is not None:
                    del self._items[oldest]
                    self.overflowed += 1
            self._changed.notify()

    def close(self, timeout_s: float = 1.0) -> bool:
        """Deliver what is left, for at most `timeout_s`; whether all of it left."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                if not self._items and not self._closing:
                    self._changed.wait(self._period_s)
                if not self._items and self._closing:
                    return
                key, item = self._items.popitem(last=False) if self._items else (None, None)
            try:
                if key is not None:
                    self._deliver(key[0], item)
                self._idle()
            except Exception as error:
                self.failed += 1
                if self.failed == 1:
                    name = key[0] if key is not None else "idle"
                    log.warning("%s: %s: %s", self._thread.name, name, error)

"""A model process that is kept running: started, waited for, started again when it has ended."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple

from edge import config
from edge.errors import UserError
from edge.perception.process.link import Link
from edge.perception.process.wire import FrameFile
from edge.perception.runtime.health import Tell

BACKOFF_S, BACKOFF_MAX_S = 0.2, 5.0
"""Pause before a restart: the first, and the longest after doublings."""
MOST_ENDS, WINDOW_S = 8, 60.0
"""More ends in a row than this, none after a run of `WINDOW_S`: one more try each `WINDOW_S`."""
_CLOSE_S = 10.0  # for the thread to end once its process was killed


class Pause(NamedTuple):
    """How long to wait, and whether that is because the limit was reached."""

    seconds: float
    limit: bool


class Restarts:
    """Backoff and limit of restarts.

    Ends count in a row, however long each start takes: one after a run of over `WINDOW_S` is the
    first again. The backoff begins again after a run of over `BACKOFF_MAX_S`.
    """

    def __init__(self) -> None:
        self._ends = 0
        self._backoff_s = BACKOFF_S

    def after(self, ran_s: float) -> Pause:
        """What a process's end calls for.

        Args:
            ran_s: how long it was ready; 0 if it never was.
        """
        self._ends = 1 if ran_s > WINDOW_S else self._ends + 1
        if ran_s > BACKOFF_MAX_S:
            self._backoff_s = BACKOFF_S
        seconds, self._backoff_s = self._backoff_s, min(2 * self._backoff_s, BACKOFF_MAX_S)
        if self._ends > MOST_ENDS:
            return Pause(max(seconds, WINDOW_S), True)
        return Pause(seconds, False)


class KeptProcess(ABC):
    """A thread of its own starts the process, waits for its end, and starts it again by `Restarts`.

    Who inherits says what is started (`_run_once`, by `_run_link`), and is told of it (`_ready`,
    `_ended`), all on that thread.

    Attributes:
        name: of the model.
        restarts: how often it was begun to be started again.
    """

    def __init__(self, name: str, rules: config.ModelProcess) -> None:
        self.name, self.restarts = name, 0
        self._rules = rules
        self._frames = FrameFile()
        self._link: Link | None = None
        self._closing = threading.Event()

    def _begin(self, thread: str) -> None:
        """Start the thread, and wait until the process is ready for the first time.

        Raises:
            what keeps it from that; all is closed then.
        """
        first: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(first,), name=thread, daemon=True)
        self._thread.start()
        try:
            first.result()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the process, whatever it does; may be called from another thread.

        One that does not end though it was killed is left behind, and so is the thread.
        """
        self._closing.set()
        if (link := self._link) is not None:
            link.stop()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive() and (link := self._link) is not None:
            link.leave()
        self._frames.close()

    def _run(self, first: Future[None]) -> None:
        """Keep a process running until `close`; how its first start went goes to `first`."""
        restarts = Restarts()
        while not self._closing.is_set():
            ran_s, failed = 0.0, None
            try:
                ran_s, why = self._run_once(first)
            except Exception as error:  # it may be that the model cannot be loaded any more
                failed, why = error, str(error) if isinstance(error, UserError) else repr(error)
            if not first.done():
                first.set_exception(failed)
                return
            pause = restarts.after(ran_s)
            if not self._closing.is_set():
                self._ended(why, failed, pause)
            if not self._closing.wait(pause.seconds):
                self.restarts += 1

    @abstractmethod
    def _run_once(self, first: Future[None]) -> tuple[float, str]:
        """One process, from its start to its end: seconds that it was ready, and how it ended.

        Raises:
            as `Link.wait_ready`.
        """

    def _run_link(
        self, first: Future[None], told: dict[str, Any], progress: Tell, program: Sequence[str] = ()
    ) -> tuple[float, str]:
        """See `_run_once`; `told` and `program` as `Link` takes them."""
        link = Link(told, self.name, self._frames, program)
        try:
            link.wait_ready(self._rules.start_timeout_s, lambda: self._told_to_end(first), progress)
            ready_s, self._link = time.monotonic(), link
            self._ready(again=first.done())
            if not first.done():
                first.set_result(None)
            if not self._closing.is_set():  # else `close` may not have found this link
                link.join()
            return time.monotonic() - ready_s, link.fault
        finally:
            link.close()

    def _told_to_end(self, first: Future[None]) -> bool:
        """Whether what is being started is not wanted any more."""
        return self._closing.is_set()

    @abstractmethod
    def _ready(self, again: bool) -> None:
        """It can be asked; `again`: not for the first time."""

    @abstractmethod
    def _ended(self, why: str, failed: Exception | None, pause: Pause) -> None:
        """It has ended, or failed to start, and is started again after the pause."""

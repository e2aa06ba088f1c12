"""Supervision of a model process: start it, wait for its end, and start it again."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple

from edge import config
from edge.errors import UserError
from edge.host.backoff import pause_after
from edge.perception.process.link import ModelProcessClient
from edge.perception.process.wire import FrameFile
from edge.perception.runtime.health import ProgressCallback

BACKOFF_S = 0.2
"""First pause before a restart [s]; it doubles with each further restart."""
BACKOFF_MAX_S = 5.0
"""Longest such pause [s]. A process that was ready for longer starts with `BACKOFF_S` again."""
MOST_ENDS = 8
"""After more ends in a series than this, restarts are at least `WINDOW_S` apart."""
WINDOW_S = 60.0
"""If a process was ready for longer than this [s], its end starts a new series."""
_CLOSE_S = 10.0  # wait for the thread to end after its process was killed


class RestartDelay(NamedTuple):
    """The pause before a restart; as text: when the process is restarted, for a message's end.

    Attributes:
        seconds: length of the pause.
        limit: True if the process has ended too often (`MOST_ENDS`).
    """

    seconds: float
    limit: bool

    def __str__(self) -> str:
        if not self.limit:
            return f"restarts in {self.seconds:.1f} s"
        return f"ended too often, restarts in {self.seconds:.0f} s"


class RestartBackoff:
    """Computes the pause before each restart of a process.

    The pause doubles with each end, up to `BACKOFF_MAX_S`. It is `BACKOFF_S` again after the
    process was ready for over `BACKOFF_MAX_S`. After more than `MOST_ENDS` ends in a series, the
    pause is at least `WINDOW_S`. The end of a process that was ready for over `WINDOW_S` starts a
    new series.
    """

    def __init__(self) -> None:
        self._ends = self._short_runs = 0

    def after(self, ran_s: float) -> RestartDelay:
        """Return the pause after a process has ended.

        Args:
            ran_s: time that the process was ready, in seconds; 0 if it never was.
        """
        self._ends = 1 if ran_s > WINDOW_S else self._ends + 1
        self._short_runs = 1 if ran_s > BACKOFF_MAX_S else self._short_runs + 1
        seconds = pause_after(self._short_runs, BACKOFF_S, BACKOFF_MAX_S)
        if self._ends > MOST_ENDS:
            return RestartDelay(max(seconds, WINDOW_S), True)
        return RestartDelay(seconds, False)


class SupervisedProcess(ABC):
    """A thread that starts a process, waits for its end, and starts it again by `RestartBackoff`.

    A subclass starts the process in `_run_once` (by `_run_link`) and handles `_ready` and `_ended`,
    all on that thread.

    Attributes:
        restarts: number of restarts begun.
    """

    def __init__(self, name: str, rules: config.ModelProcessConfig) -> None:
        self.name, self.restarts = name, 0
        self._rules = rules
        self._frames = FrameFile()
        self._link: ModelProcessClient | None = None
        self._closing = threading.Event()

    def _begin(self, thread: str) -> None:
        """Start the thread, and wait until the process is ready for the first time.

        Raises:
            Exception: the process did not get ready; everything is closed then.
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
        """End the process in any state; may be called from another thread.

        A process that survives SIGKILL is left behind, and so is the thread.
        """
        self._closing.set()
        if (link := self._link) is not None:
            link.stop()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive() and (link := self._link) is not None:
            link.abandon()
        self._frames.close()

    def _run(self, first: Future[None]) -> None:
        """Keep a process running until `close`.

        Args:
            first: gets the outcome of the first start: a result, or the error.
        """
        restarts = RestartBackoff()
        while not self._closing.is_set():
            ran_s, failed = 0.0, None
            try:
                ran_s, why = self._run_once(first)
            except Exception as error:  # such as a model that can no longer be loaded
                failed, why = error, str(error) if isinstance(error, UserError) else repr(error)
            if not first.done():  # the first start failed: `_begin` raises the error
                first.set_exception(failed)
                return
            pause = restarts.after(ran_s)
            if not self._closing.is_set():
                self._ended(why, failed, pause)
            if not self._closing.wait(pause.seconds):
                self.restarts += 1

    @abstractmethod
    def _run_once(self, first: Future[None]) -> tuple[float, str]:
        """Run one process from its start to its end, by `_run_link`.

        Args:
            first: gets a result when the process is ready for the first time.

        Returns:
            (seconds that the process was ready, how it ended).

        Raises:
            ModelError, PromptError: see `ModelProcessClient.wait_ready`.
        """

    def _run_link(
        self,
        first: Future[None],
        request: dict[str, Any],
        progress: ProgressCallback,
        program: Sequence[str] = (),
    ) -> tuple[float, str]:
        """Run one process to its end; for the result and the errors see `_run_once`."""
        link = ModelProcessClient(request, self.name, self._frames, program)
        try:
            link.wait_ready(
                self._rules.start_timeout_s, lambda: self._is_cancelled(first), progress
            )
            ready_s, self._link = time.monotonic(), link
            self._ready(again=first.done())
            if not first.done():
                first.set_result(None)
            if not self._closing.is_set():  # if it is set, `close` may have missed this link
                link.join()
            return time.monotonic() - ready_s, link.fault
        finally:
            link.close()

    def _is_cancelled(self, first: Future[None]) -> bool:
        """Return True if the process that is starting is no longer wanted."""
        return self._closing.is_set()

    @abstractmethod
    def _ready(self, again: bool) -> None:
        """Handle a process that is ready; `again`: not for the first time."""

    @abstractmethod
    def _ended(self, why: str, failed: Exception | None, pause: RestartDelay) -> None:
        """Handle a process that ended or failed to start; it restarts after the pause."""

"""A detector that lives in a process of its own, and is brought back when that ends."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import NamedTuple

from edge import config
from edge.errors import UserError
from edge.perception.detector import Health, Tell, check_rgb, log_progress
from edge.perception.process.link import Link
from edge.perception.process.wire import FrameFile, ModelProcessError
from edge.perception.text import PromptError, check_prompts
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

_CHECK_S = 0.25  # how long the loop may wait to hear whether prompts will do
_CLOSE_S = 10.0  # for the thread to end once its process was killed


class Pause(NamedTuple):
    """How long to wait, and whether that is because the limit was reached."""

    seconds: float
    limit: bool


class Restarts:
    """Backoff and limit of `config.ModelProcess`.

    Ends count in a row, however long each start takes: one after a run of over `window_s` is the
    first again. The backoff begins anew after a run of over `backoff_max_s`.
    """

    def __init__(self, rules: config.ModelProcess) -> None:
        self._rules = rules
        self._ends = 0
        self._backoff_s = rules.backoff_s

    def after(self, ran_s: float) -> Pause:
        """What a process's end calls for.

        Args:
            ran_s: how long it was ready; 0 if it never was.

        Returns:
            The pause; infinite where no restart is allowed at all.
        """
        c = self._rules
        self._ends = 1 if ran_s > c.window_s else self._ends + 1
        if ran_s > c.backoff_max_s:
            self._backoff_s = c.backoff_s
        seconds, self._backoff_s = self._backoff_s, min(2 * self._backoff_s, c.backoff_max_s)
        if c.restarts == 0:
            return Pause(math.inf, True)
        if self._ends > c.restarts:
            return Pause(max(seconds, c.window_s), True)
        return Pause(seconds, False)


class ProcessDetector:
    """See `Detector`; `edge.perception.process` says how it works.

    A thread of its own starts the process, waits for its end, and starts it again. While there is
    no process `detect` raises at once.

    Attributes:
        restarts: how often it was begun to be started again.
    """

    def __init__(
        self,
        perception: config.Perception,
        prompts: Sequence[str],
        progress: Tell = log_progress,
        cancelled: threading.Event | None = None,
    ) -> None:
        """
        Args:
            progress: see `make_detector`; told at later starts too.
            cancelled: see `make_detector`.

        Raises:
            ModelError, PromptError: what keeps the model from loading.
            ModelProcessError: its process cannot be started, ends, is not ready in time, or
                `cancelled` was set.
        """
        self.name = perception.detector.model
        self.invalid_boxes = self.restarts = 0
        self._config = perception.process
        self._perception = perception.model_copy(update={"isolation": "thread"})
        self._prompts = self._looked_for = tuple(prompts)
        self._progress = progress
        self._own, self._told = Health(), Health()
        self._frames = FrameFile()
        self._link: Link | None = None
        self._answered: Link | None = None
        self._invalid_before = 0
        self._closing = threading.Event()
        self._cancelled = cancelled or threading.Event()
        first: Future[None] = Future()
        self._thread = threading.Thread(
            target=self._run, args=(first,), name="model-process", daemon=True
        )
        self._thread.start()
        try:
            first.result()
        except BaseException:
            self.close()
            raise

    @property
    def prompts(self) -> tuple[str, ...]:
        return self._prompts

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """See `Detector.set_prompts`.

        Prompts set while there is no process, or while it is too busy to answer, are looked for
        once there is one; that they cannot be is then what `detect` raises.
        """
        prompts = check_prompts(prompts)
        if self._link is not None:
            self._link.check(prompts, _CHECK_S)
        self._prompts = prompts

    def detect(self, observation: Observation) -> Detections:
        """See `Detector.detect`; takes at most `timeout_s`.

        Raises:
            ModelProcessError: the process is not there, or it ended or was killed over this image.
        """
        start_ns = time.perf_counter_ns()
        rgb = check_rgb(observation)
        if self._link is None or self._own.state != "ok":
            raise ModelProcessError(self._own.detail)
        link = self._link
        answer = link.detect(rgb, self._prompts, self._config.timeout_s)
        if link is not self._answered:  # a process counts from its own start
            self._answered, self._invalid_before = link, self.invalid_boxes
        self._looked_for, self._told = answer.found.prompts, answer.health
        self.invalid_boxes = self._invalid_before + answer.invalid_boxes
        took_ns = time.perf_counter_ns() - start_ns
        return replace(answer.found, observation=observation, model=self.name, latency_ns=took_ns)

    def health(self) -> Health:
        """See `Detector.health`: of the process, and if that is well, of the model in it."""
        if self._own.state != "ok":
            return self._own
        if self._link is not None and self._link.fault:  # the thread is about to say so
            return Health("restarting", self._link.fault)
        return self._told

    def close(self) -> None:
        """End the process; no detect afterwards.

        One that does not end though it was killed is left behind, and so is the thread.
        """
        self._closing.set()
        if self._link is not None:
            self._link.stop()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive() and self._link is not None:
            self._link.leave()
        self._frames.close()

    def _run(self, first: Future[None]) -> None:
        """Keep a process running until `close`; how its first start went goes to `first`."""
        restarts = Restarts(self._config)
        while not self._closing.is_set():
            ran_s, state = 0.0, "restarting"
            try:
                ran_s, why = self._run_once(first)
            except ModelProcessError as error:
                why, failed = str(error), error
            except Exception as error:  # the model cannot be loaded any more
                state, failed = "degraded", error
                why = str(error) if isinstance(error, UserError) else repr(error)
            if not first.done():
                first.set_exception(failed)
                return
            pause = restarts.after(ran_s)
            state = "degraded" if pause.limit else state
            if not self._closing.is_set():
                self._say(Health(state, f"{why}; {self._outlook(pause)}"))
            if not self._closing.wait(None if math.isinf(pause.seconds) else pause.seconds):
                self.restarts += 1

    def _run_once(self, first: Future[None]) -> tuple[float, str]:
        """One process, from its start to its end: seconds that it was ready, and how it ended.

        It starts with the prompts that are wanted: encoding them may take longer than an image.
        Where they will not do it starts with the last ones that did, and `detect` says so.

        Raises:
            as `Link.wait_ready`.
        """
        wanted = self._prompts
        try:
            return self._run_with(wanted, first)
        except PromptError:
            if wanted == self._looked_for:
                raise
            return self._run_with(self._looked_for, first)

    def _run_with(self, prompts: Sequence[str], first: Future[None]) -> tuple[float, str]:
        perception = self._perception.model_dump(mode="json")
        told = {"perception": perception, "prompts": list(prompts)}
        link = Link(told, self.name, self._frames)
        try:
            link.wait_ready(
                self._config.start_timeout_s, lambda: self._told_to_end(first), self._load
            )
            ready_s = time.monotonic()
            self._link, self._told = link, Health()
            self._say(Health())
            if not first.done():
                first.set_result(None)
            if not self._closing.is_set():  # else `close` may not have found this link
                link.join()
            return time.monotonic() - ready_s, link.fault
        finally:
            link.close()

    def _told_to_end(self, first: Future[None]) -> bool:
        return self._closing.is_set() or (self._cancelled.is_set() and not first.done())

    def _load(self, health: Health) -> None:
        """It is still loading."""
        self._own = health
        self._progress(health)

    def _outlook(self, pause: Pause) -> str:
        if not pause.limit:
            return f"started again in {pause.seconds:.1f} s"
        limit = f"(perception.process.restarts: {self._config.restarts})"
        if math.isinf(pause.seconds):
            return f"not started again {limit}"
        return f"ended too often {limit}, started again in {pause.seconds:.0f} s"

    def _say(self, health: Health) -> None:
        """Take on a state, and log that it changed."""
        level = {"ok": logging.INFO, "restarting": logging.WARNING}.get(health.state, logging.ERROR)
        if health != self._own:
            log.log(level, health.detail or f"model {self.name}: its process runs")
        self._own = health

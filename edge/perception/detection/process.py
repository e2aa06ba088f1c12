"""A detector in its own process, which is restarted when it ends."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace

from edge import config
from edge.perception.detection.detector import check_rgb
from edge.perception.embedding.text import PromptError, check_prompts
from edge.perception.process.link import ModelProcessClient
from edge.perception.process.supervised import RestartDelay, SupervisedProcess
from edge.perception.process.wire import ModelProcessError
from edge.perception.runtime.health import ModelHealth, ProgressCallback, log_progress
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

_CHECK_S = 0.25  # longest wait of the loop for the process to accept prompts


class ProcessDetector(SupervisedProcess):
    """A detector (`Detector`) whose model runs in its own process; see `edge.perception.process`.

    While no process is ready, `detect` raises at once.

    Raises:
        ModelError, PromptError: the model cannot be loaded.
        ModelProcessError: the process cannot be started, ends, is not ready in time, or
            `cancelled` was set.
    """

    def __init__(
        self,
        perception: config.PerceptionConfig,
        prompts: Sequence[str],
        progress: ProgressCallback = log_progress,
        cancelled: threading.Event | None = None,
    ) -> None:
        super().__init__(perception.detector.model, perception.process)
        self.invalid_boxes = 0
        self._perception = perception.model_copy(update={"isolation": "thread"})
        # The prompts to use, and those of the last answer, which the model accepted.
        self.prompts = self._accepted_prompts = tuple(prompts)
        self._progress = progress
        self._process_health, self._model_health = ModelHealth(), ModelHealth()
        self._last_link: ModelProcessClient | None = None  # the process that answered last
        self._invalid_before = 0  # invalid boxes of earlier processes
        self._cancelled = cancelled or threading.Event()
        self._begin("model-process")

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """See `Detector.set_prompts`.

        If no process is ready, or it is too busy to answer, the prompts are stored and used later.
        If they then turn out unusable, `detect` raises PromptError.
        """
        prompts = check_prompts(prompts)
        if self._link is not None:
            self._link.check(prompts, _CHECK_S)
        self.prompts = prompts

    def detect(self, observation: Observation) -> Detections:
        """See `Detector.detect`; takes at most twice `perception.process.timeout_s`.

        Raises:
            ModelProcessError: no process is ready, or it ended or was killed during this image.
        """
        start_ns = time.perf_counter_ns()
        rgb = check_rgb(observation)
        if self._link is None or self._process_health.state != "ok":
            raise ModelProcessError(self._process_health.detail)
        link = self._link
        answer = link.detect(rgb, self.prompts, self._rules.timeout_s)
        if link is not self._last_link:  # a new process counts from 0
            self._last_link, self._invalid_before = link, self.invalid_boxes
        self._accepted_prompts, self._model_health = answer.found.prompts, answer.health
        self.invalid_boxes = self._invalid_before + answer.invalid_boxes
        took_ns = time.perf_counter_ns() - start_ns
        return replace(answer.found, observation=observation, model=self.name, latency_ns=took_ns)

    def health(self) -> ModelHealth:
        """Return the health of the process, or if that is `ok`, of the model; see `Detector`."""
        if self._process_health.state != "ok":
            return self._process_health
        if self._link is not None and self._link.fault:  # the thread is about to report it
            return ModelHealth("restarting", self._link.fault)
        return self._model_health

    def _run_once(self, first: Future[None]) -> tuple[float, str]:
        """Run one process from its start to its end; see `SupervisedProcess._run_once`.

        The process starts with the current prompts, since encoding them later may take longer than
        an image. If they are unusable, the process starts with the last usable ones, and `detect`
        reports the error.
        """
        wanted = self.prompts
        try:
            return self._run_with(wanted, first)
        except PromptError:
            if wanted == self._accepted_prompts:
                raise
            return self._run_with(self._accepted_prompts, first)

    def _run_with(self, prompts: Sequence[str], first: Future[None]) -> tuple[float, str]:
        """Run one process that starts with these prompts; see `_run_once`."""
        perception = self._perception.model_dump(mode="json")
        request = {"perception": perception, "prompts": list(prompts)}
        return self._run_link(first, request, self._report_loading)

    def _ready(self, again: bool) -> None:
        self._model_health = ModelHealth()
        self._set_state(ModelHealth())

    def _ended(self, why: str, failed: Exception | None, pause: RestartDelay) -> None:
        """See `SupervisedProcess`; the state is `degraded` if the model can no longer be loaded."""
        is_process_fault = failed is None or isinstance(failed, ModelProcessError)
        state = "restarting" if is_process_fault and not pause.limit else "degraded"
        self._set_state(ModelHealth(state, f"{why}; {pause}"))

    def _is_cancelled(self, first: Future[None]) -> bool:
        """See `SupervisedProcess`; `cancelled` counts for the first start only."""
        return self._closing.is_set() or (self._cancelled.is_set() and not first.done())

    def _report_loading(self, health: ModelHealth) -> None:
        """Report that the model is still loading."""
        self._process_health = health
        self._progress(health)

    def _set_state(self, health: ModelHealth) -> None:
        """Set the state, and log it if it changed."""
        level = {"ok": logging.INFO, "restarting": logging.WARNING}.get(health.state, logging.ERROR)
        if health != self._process_health:
            log.log(level, health.detail or f"model {self.name}: its process runs")
        self._process_health = health

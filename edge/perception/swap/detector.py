"""Swap of the detector; see `base`.

The new detector is tried on images that the running one has seen. It must have the same prompts,
and is kept once it has run on `perception.swap.probation` images without a fault.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing

from edge.config import DetectorOnnx, PerceptionConfig
from edge.perception.detection.detector import Detector
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import ModelError, load_detector_card
from edge.perception.runtime.health import ModelHealth
from edge.perception.swap.base import POLL_S, LogCallback, ModelSwap, SwapAttempt
from edge.perception.swap.trial import (
    failure,
    invalid_output_reason,
    median_ms,
    run,
    run_trial,
    sample,
)
from edge.perception.worker import DetectorWorker
from edge.text import one_line
from edge.types import Detections, Observation

Make = Callable[..., Detector]
"""Called like `make_detector`."""

IMAGES = 4  # images of a trial
NO_IMAGES_S = 60.0  # a probation without images for this time has failed
_APART_NS = 200_000_000  # least time between two images of a trial


class DetectorSwap(ModelSwap[Detector]):
    """Replaces the worker's detector.

    Attributes:
        perception: configuration from which new models are made and by which they are judged; the
            model's name comes from the request. It may be set at any time.
    """

    def __init__(
        self,
        perception: PerceptionConfig,
        worker: DetectorWorker,
        report: LogCallback,
        make: Make = make_detector,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(worker, report, clock)
        self.perception, self._make = perception, make

    def step(self, now_ns: int = 0, *, idle: bool = False) -> None:
        """See `ModelSwap.step`; a probation without images ends."""
        if isinstance(self._attempt, _DetectorAttempt):
            self._attempt.check_images(now_ns)
        super().step(now_ns, idle=idle)

    def request(
        self, model: str, force: bool, now_ns: int, perception: PerceptionConfig | None = None
    ) -> None:
        """Begin to swap a model in.

        Args:
            model: card of a detector.
            force: True: a slow model, or one with other boxes, is reported but not rejected.
            now_ns: the loop's time.
            perception: used in place of `self.perception`; the model may then be the running one,
                loaded again.

        Raises:
            SwapError: the model runs already, another swap is running, or a refused model is
                still loading.
        """
        self._check_free(model, again=perception is not None)
        perception = perception or self.perception
        self._begin(_DetectorAttempt(model, force, perception, self._worker, self._make), now_ns)


class _DetectorAttempt(SwapAttempt[Detector, Observation]):
    """One detector that is to replace the worker's; see `SwapAttempt`.

    The steps: the attempt's thread loads the model, collects images, and runs the trial, which sets
    `finding`. Until the switch it copies the running detector's prompts to the new one. Then
    `switched` is set, and the probation begins. At the end `decided` is set, and the thread closes
    the model that lost.

    Attributes:
        perception: configuration from which the model is made and by which it is judged.
    """

    def __init__(
        self,
        model: str,
        force: bool,
        perception: PerceptionConfig,
        worker: DetectorWorker,
        make: Make,
    ) -> None:
        super().__init__(model, worker)
        self.perception, self._force, self._make = perception, force, make
        self._samples = deque(maxlen=IMAGES)
        self._latencies_ns: list[int] = []  # of the images of the probation
        self._n_noted, self._noted_ns = -1, 0  # images of the probation, and when they changed
        self._invalid_before = 0  # invalid boxes before the probation
        self._lock = threading.Lock()  # guards the model's prompts and `switched`

    @property
    def progress(self) -> str:
        n = len(self._samples)
        if self.switched:
            return f"{len(self._latencies_ns)} of {self.perception.swap.probation} images"
        if self.model is None or self.finding:
            return ""
        return f"{n} of {IMAGES} images collected" if n < IMAGES else f"tried on {n} images"

    @property
    def probation(self) -> str:
        return f"{self.perception.swap.probation} images"

    def switch(self) -> bool:
        """See `SwapAttempt.switch`; the model must have the running detector's prompts."""
        if not self.finding or not self._lock.acquire(blocking=False):
            return False
        try:
            if self.model.prompts != self._worker.detector.prompts:
                return False
            self._invalid_before = self.model.invalid_boxes
            self._samples.clear()
            self._worker.previous = self.previous
            return super().switch()
        finally:
            self._lock.release()

    def end(self) -> None:
        self._worker.previous = None
        self._samples.clear()
        super().end()

    def check_images(self, now_ns: int) -> None:
        """Set `fault` if the probation has got no image for `NO_IMAGES_S`, on the loop's clock."""
        if not self.switched:
            return
        if (n := len(self._latencies_ns)) != self._n_noted:
            self._n_noted, self._noted_ns = n, now_ns
        elif now_ns - self._noted_ns > NO_IMAGES_S * 1e9:
            self.fault = self.fault or f"no images for {NO_IMAGES_S:g} s"

    def verdict(self, idle: bool) -> str:
        """Return the result of the probation; "" while it lasts. If it failed, set `fault`.

        `idle` is ignored: a camera sends more images, or `check_images` ends the probation.
        """
        swap, health = self.perception.swap, self.model.health()
        if health.state in ("restarting", "degraded"):
            self.fault = self.fault or f"{health.state}: {health.detail}"
        if self.fault or len(self._latencies_ns) < swap.probation:
            return ""
        took_ms = median_ms(self._latencies_ns)
        pace = f"{len(self._latencies_ns)} images, median {took_ms:.1f} ms"
        if took_ms > swap.budget_ms and not self._force:
            self.fault = f"too slow: {pace}, perception.swap.budget_ms is {swap.budget_ms:g}"
        return pace

    def on_result(
        self, model: Detector, item: Observation, outcome: Detections | Exception
    ) -> None:
        """Keep the image for the trial, or count it for the probation; see `SwapAttempt`."""
        if item.rgb is None or self.fault:  # a missing image is not the detector's fault
            return
        try:
            if not self.switched:
                self._collect(item, outcome)
            elif model is self.model:
                self._check_probation(outcome)
        except Exception as error:  # such as no memory for a copy: the model would not fit either
            self.fault = f"it cannot be watched: {type(error).__name__}: {one_line(error, 300)}"

    def _collect(self, observation: Observation, outcome: Detections | Exception) -> None:
        """Keep a copy of the image for the trial, unless the last one is too recent."""
        last = self._samples[-1].observation.stamp_ns if self._samples else None
        if last is None or abs(observation.stamp_ns - last) >= _APART_NS:
            self._samples.append(sample(observation, outcome))

    def _check_probation(self, outcome: Detections | Exception) -> None:
        """Count an image of the probation; set `fault` if the detector failed."""
        if isinstance(outcome, Exception):
            self.fault = failure(outcome)
            return
        self.fault = invalid_output_reason(self.model, self._invalid_before, outcome)
        self._latencies_ns.append(outcome.latency_ns)

    def _try(self) -> None:
        """See `SwapAttempt`; afterwards it keeps the prompts equal until the switch."""
        target = with_model(self.perception, self.name)
        if target.isolation == "thread":
            self._try_in_other_process(target.model_copy(update={"isolation": "process"}))
            if self.decided.is_set():
                return
        self.model = self._load(target)
        self.load_progress = ""
        self._await_samples()
        if self.decided.is_set():  # aborted, perhaps while the model was loading
            return
        self._follow_prompts()
        running = self.previous.name
        self.finding = run_trial(
            self.model, tuple(self._samples), self.perception, running,
            same_family(self.name, running), self._force,
        )  # fmt: skip
        self.trying = False
        while not (self.switched or self.decided.wait(POLL_S)):
            self._follow_prompts()

    def _try_in_other_process(self, perception: PerceptionConfig) -> None:
        """Run the model on the samples in another process before it is loaded into this one.

        A model that never returns, crashes or takes all memory is killed there. In this process
        nothing could end it, and no other swap could begin.
        """
        with closing(self._load(perception)) as detector:
            self._await_samples()
            for image in tuple(self._samples):
                run(detector, image.observation)

    def _load(self, perception: PerceptionConfig) -> Detector:
        """Make the new detector, with the running one's prompts."""
        prompts = self._worker.detector.prompts
        return self._make(perception, prompts, self._note_progress, cancelled=self.decided)

    def _await_samples(self) -> None:
        """Wait until there are enough images for a trial, or the swap is decided."""
        while len(self._samples) < IMAGES and not self.decided.is_set():
            time.sleep(POLL_S)

    def _follow_prompts(self) -> None:
        """Give the new detector the running detector's prompts."""
        with self._lock:
            target = self._worker.detector.prompts
            if not self.switched and self.model.prompts != target:
                self.model.set_prompts(target)

    def _note_progress(self, health: ModelHealth) -> None:
        """Record the progress of an engine build, which takes minutes."""
        self.load_progress = ": ".join(filter(None, health))


def with_model(perception: PerceptionConfig, model: str) -> PerceptionConfig:
    """Return the configuration with another model.

    If the detector of the configuration runs no model, the new one has default settings.
    """
    detector = perception.detector
    if not isinstance(detector, DetectorOnnx):
        detector = DetectorOnnx()
    return perception.model_copy(update={"detector": detector.model_copy(update={"model": model})})


def same_family(model: str, running: str) -> bool:
    """Return True if both names are cards of one family."""
    try:
        return load_detector_card(model).family == load_detector_card(running).family
    except ModelError:  # the running detector may have no card, as `sim`
        return False

"""Another detector in the running service; see `base`.

It is tried on images that the running one was shown, must look for the same, and is kept once it
has run clean on `perception.swap.probation` images.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing

from edge.config import DetectorOnnx, Perception
from edge.perception.detection.detector import Detector
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import ModelError, load_detector_card
from edge.perception.runtime.health import Health
from edge.perception.swap.base import LOOK_S, Attempt, Swap, Tell
from edge.perception.swap.trial import failure, judge, median_ms, run, sample, unsound
from edge.perception.worker import DetectorWorker
from edge.text import one_line
from edge.types import Detections, Observation

Make = Callable[..., Detector]
"""Called like `make_detector`."""

IMAGES = 4  # that a model is tried on
_APART_NS = 200_000_000  # between two images that a model is tried on


class DetectorSwap(Swap[Detector]):
    """Swaps the worker's detector.

    Args:
        tell, clock: see `Swap`.
        make: makes the new detector.

    Attributes:
        perception: what models are made and judged by, but for their name; may be set.
    """

    def __init__(
        self,
        perception: Perception,
        worker: DetectorWorker,
        tell: Tell,
        make: Make = make_detector,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(worker, tell, clock)
        self.perception, self._make = perception, make

    def request(
        self, model: str, force: bool, now_ns: int, perception: Perception | None = None
    ) -> None:
        """Begin to swap a model in.

        Args:
            model: a detector's card.
            force: too slow or too different is told, not held against it.
            perception: to make and judge it by, in the place of `self.perception`; the model may
                then be the one that runs, made anew.

        Raises:
            SwapError: see `Swap._check_free`.
        """
        self._check_free(model, again=perception is not None)
        perception = perception or self.perception
        self._begin(_DetectorAttempt(model, force, perception, self._worker, self._make), now_ns)


class _DetectorAttempt(Attempt[Detector, Observation]):
    """See `Attempt`; its thread also keeps the model's prompts those of the running one.

    Attributes:
        perception: what the model is made and judged by.
    """

    def __init__(
        self, model: str, force: bool, perception: Perception, worker: DetectorWorker, make: Make
    ) -> None:
        super().__init__(model, worker)
        self.perception, self._force, self._make = perception, force, make
        self._samples = deque(maxlen=IMAGES)
        self._latencies_ns: list[int] = []
        self._invalid = 0
        self._hand = threading.Lock()  # on the model's prompts, and on whether it is switched to

    @property
    def progress(self) -> str:
        n = len(self._samples)
        if self.switched:
            return f"{len(self._latencies_ns)} of {self.perception.swap.probation} images"
        if self.model is None or self.finding:
            return ""
        return f"{n} of {IMAGES} images at hand" if n < IMAGES else f"tried on {n} images"

    @property
    def probation(self) -> str:
        return f"{self.perception.swap.probation} images"

    def switch(self) -> bool:
        """See `Attempt.switch`; the model must look for what the running one looks for."""
        if not self.finding or not self._hand.acquire(blocking=False):
            return False
        try:
            if self.model.prompts != self._worker.detector.prompts:
                return False
            self._invalid = self.model.invalid_boxes
            self._samples.clear()
            self._worker.spare = self.previous
            return super().switch()
        finally:
            self._hand.release()

    def end(self) -> None:
        self._worker.spare = None
        self._samples.clear()
        super().end()

    def verdict(self, idle: bool) -> str:
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

    def see(self, model: Detector, item: Observation, outcome: Detections | Exception) -> None:
        """See `Attempt.see`: an image to try the model on, or one of its probation."""
        if item.rgb is None or self.fault:  # no image is no detector's fault
            return
        try:
            if not self.switched:
                self._collect(item, outcome)
            elif model is self.model:
                self._watch(outcome)
        except Exception as error:  # no memory for a copy: none for the model either
            self.fault = f"it cannot be watched: {type(error).__name__}: {one_line(error, 300)}"

    def _collect(self, observation: Observation, outcome: Detections | Exception) -> None:
        last = self._samples[-1].observation.stamp_ns if self._samples else None
        if last is None or abs(observation.stamp_ns - last) >= _APART_NS:
            self._samples.append(sample(observation, outcome))

    def _watch(self, outcome: Detections | Exception) -> None:
        if isinstance(outcome, Exception):
            self.fault = failure(outcome)
            return
        self.fault = unsound(self.model, self._invalid, outcome)
        self._latencies_ns.append(outcome.latency_ns)

    def _try(self) -> None:
        wanted = variant(self.perception, self.name)
        if wanted.isolation == "thread":
            self._try_apart(wanted.model_copy(update={"isolation": "process"}))
            if self.over.is_set():
                return
        self.model = self._load(wanted)
        self.busy = ""
        self._await_samples()
        if self.over.is_set():  # given up, perhaps while it was loaded
            return
        self._follow_prompts()
        running = self.previous.name
        self.finding = judge(
            self.model, tuple(self._samples), self.perception, running,
            related(self.name, running), self._force,
        )  # fmt: skip
        self.trying = False
        while not (self.switched or self.over.wait(LOOK_S)):
            self._follow_prompts()

    def _try_apart(self, perception: Perception) -> None:
        """Run the model on the samples in a process of its own before it is loaded into this one.

        A model that never ends, crashes or takes all memory is killed there; here nothing could
        end it, and no other swap could begin.

        Raises:
            UserError: it fails, or returns what is not sound.
        """
        with closing(self._load(perception)) as detector:
            self._await_samples()
            for one in tuple(self._samples):
                run(detector, one.observation)

    def _load(self, perception: Perception) -> Detector:
        prompts = self._worker.detector.prompts
        return self._make(perception, prompts, self._loading, cancelled=self.over)

    def _await_samples(self) -> None:
        while len(self._samples) < IMAGES and not self.over.is_set():
            time.sleep(LOOK_S)

    def _follow_prompts(self) -> None:
        """Look for what the running detector looks for."""
        with self._hand:
            wanted = self._worker.detector.prompts
            if not self.switched and self.model.prompts != wanted:
                self.model.set_prompts(wanted)

    def _loading(self, health: Health) -> None:
        """An engine is built, which takes minutes."""
        self.busy = ": ".join(filter(None, health))


def variant(perception: Perception, model: str) -> Perception:
    """The configuration with another model; of a detector that has none, with defaults."""
    detector = perception.detector
    if not isinstance(detector, DetectorOnnx):
        detector = DetectorOnnx()
    return perception.model_copy(update={"detector": detector.model_copy(update={"model": model})})


def related(model: str, running: str) -> bool:
    """Whether both names are cards of one family."""
    try:
        return load_detector_card(model).family == load_detector_card(running).family
    except ModelError:  # the running one may be no model at all
        return False

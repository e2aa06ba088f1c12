"""A model on its way in: loaded and tried on a thread of its own, then watched at work."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from edge.config import DetectorOnnx, Perception
from edge.errors import UserError
from edge.host.interruptible import start_unjoined
from edge.host.worker import LONGEST_ERROR
from edge.perception.cards import ModelError, load_detector_card
from edge.perception.detector import Detector, Health
from edge.perception.swap.trial import Unfit, failure, judge, median_ms, not_finite, sample
from edge.perception.worker import DetectorWorker
from edge.text import one_line
from edge.types import Detections, Observation

log = logging.getLogger("edge.swap")

Make = Callable[..., Detector]
"""Called like `make_detector`."""

_APART_NS = 200_000_000  # between two images that a model is tried on
_LOOK_S = 0.02


class Attempt:
    """One model that is to take the place of the worker's detector.

    Three threads work on it, each in its turn: its own loads and tries the model; the worker's
    calls `see`; the loop's reads `ready`, `fault` and `verdict`, and does the exchange.

    Attributes:
        model: the card's name.
        previous: the detector that runs when the attempt begins.
        detector: the model once it is loaded.
        stage: what its own thread is at: `loading`, `checking`.
        busy: what loading takes its time with, in one line; empty when it is nothing special.
        finding: what the trial found, in one line.
        ready: the model was tried and looks for what the running one looks for.
        switched: it is at work, on probation.
        fault: why it cannot stay, in one line; empty while nothing speaks against it.
    """

    def __init__(
        self, model: str, force: bool, perception: Perception, worker: DetectorWorker, make: Make
    ) -> None:
        self.model, self.force = model, force
        self.previous = worker.detector
        self.detector: Detector | None = None
        self.stage = "loading"
        self.busy = self.finding = self.fault = ""
        self.ready = threading.Event()
        self.switched = False
        self._perception, self._worker, self._make = perception, worker, make
        self._samples = deque(maxlen=perception.swap.images)
        self._latencies_ns: list[int] = []
        self._invalid = 0
        self._cancelled = threading.Event()
        self._thread = self._begin(self._try)

    @property
    def progress(self) -> str:
        """How far it is, for a person; changes with every image."""
        if self.switched:
            return f"{len(self._latencies_ns)} of {self._perception.swap.probation} images"
        if self.stage == "checking" and not self.ready.is_set():
            n, wanted = len(self._samples), self._perception.swap.images
            return f"{n} of {wanted} images at hand" if n < wanted else f"tried on {n} images"
        return ""

    def adapt(self) -> None:
        """The running detector's prompts have changed: not ready before the model has them too."""
        self.ready.clear()
        self._thread = self._begin(self._adapt)

    def verdict(self) -> str | None:
        """How it did on probation, once that is over; a fault is set where it did badly."""
        swap, health = self._perception.swap, self.detector.health()
        if health.state in ("restarting", "degraded"):
            self.fault = self.fault or f"{health.state}: {health.detail}"
        if self.fault or len(self._latencies_ns) < swap.probation:
            return None
        took_ms = median_ms(self._latencies_ns)
        pace = f"{len(self._latencies_ns)} images, median {took_ms:.1f} ms"
        if took_ms > swap.budget_ms and not self.force:
            self.fault = f"too slow: {pace}, perception.swap.budget_ms is {swap.budget_ms:g}"
            return None
        return pace

    def see(
        self, detector: Detector, observation: Observation, outcome: Detections | Exception
    ) -> None:
        """For `DetectorWorker.watch`: an image to try the model on, or one of its probation."""
        try:
            self._take(detector, observation, outcome)
        except Exception as error:  # no memory for a copy: none for the model either
            why = f"{type(error).__name__}: {one_line(error, 300)}"
            self.fault = self.fault or f"it cannot be watched: {why}"

    def _take(
        self, detector: Detector, observation: Observation, outcome: Detections | Exception
    ) -> None:
        if observation.rgb is None:  # no detector's fault
            return
        if not self.switched:
            last = self._samples[-1].observation.stamp_ns if self._samples else None
            if last is None or abs(observation.stamp_ns - last) >= _APART_NS:
                self._samples.append(sample(observation, outcome))
        elif detector is self.detector and not self.fault:
            if isinstance(outcome, Exception):
                self.fault = failure(outcome)
                return
            self.fault = not_finite(detector, self._invalid, outcome)
            self._latencies_ns.append(outcome.latency_ns)

    def switch(self) -> None:
        """The exchange is about to be done, by the caller: what follows is probation."""
        self._invalid = self.detector.invalid_boxes
        self._samples.clear()
        self.switched = True

    def give_up(self, loser: Detector | None = None) -> threading.Thread:
        """Stop trying, and close a detector as soon as nobody uses it, on a thread.

        Args:
            loser: the detector to close; by default the attempt's own.
        """
        self._cancelled.set()
        return self._begin(self._close, loser)

    @property
    def at_work(self) -> bool:
        """Whether it is being loaded or tried at this moment."""
        return self._thread.is_alive()

    def _begin(self, target: Callable[..., None], *args: object) -> threading.Thread:
        return start_unjoined("swap", target, *args)

    def _try(self) -> None:
        with self._faults():
            perception = variant(self._perception, self.model)
            prompts = self._worker.detector.prompts
            self.detector = self._make(
                perception, prompts, self._loading, cancelled=self._cancelled
            )
            self.stage, self.busy = "checking", ""
            while len(self._samples) < self._perception.swap.images:
                if self._cancelled.wait(_LOOK_S):
                    break
            if self._cancelled.is_set():  # given up, perhaps while it was loaded
                return
            self._take_prompts()
            running = self.previous.name
            self.finding = judge(
                self.detector, tuple(self._samples), self._perception, running,
                related(self.model, running), self.force,
            )  # fmt: skip
            self.ready.set()

    def _loading(self, health: Health) -> None:
        """An engine is built, which takes minutes."""
        self.busy = ": ".join(filter(None, health))

    def _adapt(self) -> None:
        with self._faults():
            self._take_prompts()
            self.ready.set()

    def _take_prompts(self) -> None:
        wanted = self._worker.detector.prompts
        if self.detector.prompts != wanted:
            self.detector.set_prompts(wanted)

    @contextlib.contextmanager
    def _faults(self):  # type: ignore[no-untyped-def]
        """Whatever goes wrong speaks against the model, and against nothing else."""
        try:
            yield
        except (Unfit, UserError) as error:
            self.fault = one_line(error, LONGEST_ERROR)
        except Exception as error:  # whatever loading a model may raise
            log.debug("model %s", self.model, exc_info=True)
            self.fault = failure(error)

    def _close(self, loser: Detector | None) -> None:
        self._thread.join()
        detector = self.detector if loser is None else loser
        if detector is None:
            return
        while self._worker.uses(detector):
            time.sleep(_LOOK_S)
        detector.close()


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

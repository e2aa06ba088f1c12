"""Another model in the running service: loaded beside, tried, switched to, watched, kept or not.

The running model goes on until the new one was tried on its images, and it is kept, open, until
the new one has run clean on `perception.swap.probation` images. Loading and trying happen on a
thread; the loop only looks, once a tick, whether it is time for the next step. A swap that fails
at any point leaves the model that ran before, and one line.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing

from edge.config import DetectorOnnx, Perception
from edge.errors import UserError
from edge.host.interruptible import start_unjoined
from edge.host.worker import LONGEST_ERROR
from edge.perception.detection.detector import Detector
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import ModelError, load_detector_card
from edge.perception.runtime.health import Health
from edge.perception.swap.trial import failure, judge, median_ms, run, sample, unsound
from edge.perception.worker import DetectorWorker
from edge.text import one_line
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

Make = Callable[..., Detector]
"""Called like `make_detector`."""

OVER = ("kept", "rolled back", "refused")
IMAGES = 4  # that a model is tried on
LOAD_TIMEOUT_S = 600.0
_APART_NS = 200_000_000  # between two images that a model is tried on
_LOOK_S = 0.02
_CLOSE_S = 5.0


class SwapError(UserError):
    """Why no swap was begun; one line."""


class Swapper:
    """Swaps the worker's detector; `request`, `step` and `close` are for the loop's thread.

    Args:
        tell: called with a line for everything that happens, the loop's time, and the log's level
            for it where a model was refused or rolled back.
        make: makes the new detector.
        clock: seconds, for `LOAD_TIMEOUT_S`.

    Attributes:
        perception: what models are made and judged by, but for their name; may be set.
        outcomes: how many swaps ended how (`OVER`), since the start.
    """

    def __init__(
        self,
        perception: Perception,
        worker: DetectorWorker,
        tell: Callable[..., None],
        make: Make = make_detector,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.perception, self._worker, self._tell = perception, worker, tell
        self._make, self._clock = make, clock
        self._attempt: _Attempt | None = None
        self._ended: list[_Attempt] = []
        self._until_s = 0.0
        self._number = 0
        self.outcomes = dict.fromkeys(OVER, 0)
        self._over = {"state": "idle", "model": worker.detector.name, "previous": "", "detail": ""}

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
            SwapError: it runs already, another swap is under way, or a model that was refused
                is still being loaded and would be a third one in memory.
        """
        if self._attempt is not None:
            raise SwapError(f"{self._attempt.model} is still {self.state}; wait until that is over")
        running = self._worker.detector.name
        if model == running and perception is None:
            raise SwapError(f"{model} runs already")
        if late := next((one.model for one in self._ended if one.trying), None):
            raise SwapError(f"{late}, which was refused, is still being loaded; try again later")
        self._number += 1
        attempt = _Attempt(model, force, perception or self.perception, self._worker, self._make)
        self._attempt = attempt
        self._until_s = self._clock() + LOAD_TIMEOUT_S
        self._worker.watch = self._attempt.see
        self._tell(f"model {model}: loading beside {running}", now_ns)

    def step(self, now_ns: int) -> None:
        """Take the next step if it is time for one: between two ticks, and never waiting."""
        attempt = self._attempt
        if attempt is None:
            return
        previous = attempt.previous
        if attempt.switched:
            verdict = attempt.verdict()
            if attempt.fault:
                self._worker.exchange(previous)
                why = f"{attempt.fault}; {previous.name} runs again"
                self._end(attempt, "rolled back", why, now_ns)
            elif verdict:
                self._end(attempt, "kept", verdict, now_ns)
        elif not attempt.fault and attempt.switch():
            n, finding = attempt.perception.swap.probation, attempt.finding
            line = f"switched to, on probation for {n} images; {finding}"
            self._tell(f"model {attempt.model}: {line}", now_ns)
        elif fault := attempt.fault or self._overdue(attempt):
            self._end(attempt, "refused", f"{fault}; {previous.name} goes on", now_ns)

    @property
    def running(self) -> str:
        """The model at work."""
        return self._worker.detector.name

    @property
    def state(self) -> str:
        """`idle`, `loading`, `checking`, `on probation`, `kept`, `rolled back` or `refused`."""
        return str(self.status()["state"])

    def status(self) -> dict[str, object]:
        """The swap under way, or the outcome of the last one; JSON-ready.

        `detail` is a line that changes with the state, `progress` changes more often, and
        `number` counts the swaps since the start.
        """
        told = self._over if self._attempt is None else self._attempt.status()
        return {"progress": "", **told, "number": self._number}

    def close(self) -> None:
        """The worker's detector stays; whatever else is open is closed.

        A model that takes longer than `_CLOSE_S` to load is left to its thread; the process must
        then end without the interpreter's clearing up (see `edge.cli.main`).
        """
        if self._attempt is not None:
            self._let_go(self._attempt)
        until_s = time.monotonic() + _CLOSE_S
        for ended in self._ended:
            ended.thread.join(max(0.0, until_s - time.monotonic()))
        if any(ended.thread.is_alive() for ended in self._ended):
            log.warning("a model is still being loaded: not waited for")

    def _overdue(self, attempt: _Attempt) -> str:
        """Why a model is not waited for any longer; empty while it is."""
        if self._clock() <= self._until_s:
            return ""
        what = attempt.progress or ("not loaded" if attempt.detector is None else "not ready")
        return f"{what} after {LOAD_TIMEOUT_S:g} s"

    def _end(self, attempt: _Attempt, state: str, detail: str, now_ns: int) -> None:
        self.outcomes[state] += 1
        self._over = {
            "state": state, "model": attempt.model, "previous": attempt.previous.name,
            "detail": detail,
        }  # fmt: skip
        self._let_go(attempt)
        level = logging.INFO if state == "kept" else logging.WARNING
        self._tell(f"model {attempt.model}: {state}: {detail}", now_ns, level)

    def _let_go(self, attempt: _Attempt) -> None:
        """No swap is under way any more; the detector that is not at work is closed."""
        self._attempt = self._worker.watch = self._worker.spare = None
        self._ended = [one for one in self._ended if one.thread.is_alive()] + [attempt]
        attempt.end()


class _Attempt:
    """One model that is to take the place of the worker's detector.

    Its own thread loads and tries the model, keeps its prompts those of the running one, and
    closes the loser. The worker's thread calls `see`, the loop's the other methods.

    Attributes:
        model: the card's name.
        perception: what it is made and judged by.
        previous: the detector that runs when the attempt begins.
        detector: the model once it is loaded.
        busy: what loading takes its time with, in one line; empty when it is nothing special.
        finding: what the trial found, in one line; empty before.
        trying: it is being loaded or tried.
        switched: it was put to work, on probation.
        fault: why it cannot stay, in one line; empty while nothing speaks against it.
        over: set once it is decided which of the two stays.
    """

    def __init__(
        self, model: str, force: bool, perception: Perception, worker: DetectorWorker, make: Make
    ) -> None:
        self.model, self._force = model, force
        self.previous = worker.detector
        self.detector: Detector | None = None
        self.busy = self.finding = self.fault = ""
        self.trying, self.switched, self._won = True, False, False
        self.over = threading.Event()
        self.perception, self._worker, self._make = perception, worker, make
        self._samples = deque(maxlen=IMAGES)
        self._latencies_ns: list[int] = []
        self._invalid = 0
        self._hand = threading.Lock()  # on the model's prompts, and on whether it is switched to
        self.thread = start_unjoined("swap", self._run)

    @property
    def progress(self) -> str:
        """How far it is, for a person; changes with every image."""
        n = len(self._samples)
        if self.switched:
            return f"{len(self._latencies_ns)} of {self.perception.swap.probation} images"
        if self.detector is None or self.finding:
            return ""
        return f"{n} of {IMAGES} images at hand" if n < IMAGES else f"tried on {n} images"

    def status(self) -> dict[str, str]:
        """See `Swapper.status`."""
        before = "loading" if self.detector is None else "checking"
        return {
            "state": "on probation" if self.switched else before,
            "model": self.model,
            "previous": self.previous.name,
            "detail": self.finding if self.switched else self.busy,
            "progress": self.progress,
        }

    def switch(self) -> bool:
        """Put the model to work if it was tried and looks for what the running one looks for;
        whether that was done."""
        if not self.finding or not self._hand.acquire(blocking=False):
            return False
        try:
            if self.detector.prompts != self._worker.detector.prompts:
                return False
            self._invalid = self.detector.invalid_boxes
            self._samples.clear()
            self.switched = True
            self._worker.spare = self._worker.exchange(self.detector)
        finally:
            self._hand.release()
        return True

    def end(self) -> None:
        """It is decided, by which detector is at work: the other is closed, by the thread."""
        self._won = self._worker.detector is self.detector
        self.over.set()

    def verdict(self) -> str:
        """How it did on probation, once that is over; a fault is set where it did badly."""
        swap, health = self.perception.swap, self.detector.health()
        if health.state in ("restarting", "degraded"):
            self.fault = self.fault or f"{health.state}: {health.detail}"
        if self.fault or len(self._latencies_ns) < swap.probation:
            return ""
        took_ms = median_ms(self._latencies_ns)
        pace = f"{len(self._latencies_ns)} images, median {took_ms:.1f} ms"
        if took_ms > swap.budget_ms and not self._force:
            self.fault = f"too slow: {pace}, perception.swap.budget_ms is {swap.budget_ms:g}"
        return pace

    def see(
        self, detector: Detector, observation: Observation, outcome: Detections | Exception
    ) -> None:
        """For `DetectorWorker.watch`: an image to try the model on, or one of its probation."""
        if observation.rgb is None or self.fault:  # no image is no detector's fault
            return
        try:
            if not self.switched:
                self._collect(observation, outcome)
            elif detector is self.detector:
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
        self.fault = unsound(self.detector, self._invalid, outcome)
        self._latencies_ns.append(outcome.latency_ns)

    def _run(self) -> None:
        """The thread: ends with the loser closed."""
        try:
            self._try()
        except UserError as error:
            self.fault = one_line(error, LONGEST_ERROR)
        except Exception as error:  # whatever loading a model may raise
            log.debug("model %s", self.model, exc_info=True)
            self.fault = failure(error)
        self.trying = False
        self.over.wait()
        loser = self.previous if self._won else self.detector
        self.previous = self.detector = None
        self._samples.clear()
        if loser is None:
            return
        while self._worker.uses(loser):
            time.sleep(_LOOK_S)
        loser.close()

    def _try(self) -> None:
        wanted = variant(self.perception, self.model)
        if wanted.isolation == "thread":
            self._try_apart(wanted.model_copy(update={"isolation": "process"}))
            if self.over.is_set():
                return
        self.detector = self._load(wanted)
        self.busy = ""
        self._await_samples()
        if self.over.is_set():  # given up, perhaps while it was loaded
            return
        self._follow_prompts()
        running = self.previous.name
        self.finding = judge(
            self.detector, tuple(self._samples), self.perception, running,
            related(self.model, running), self._force,
        )  # fmt: skip
        self.trying = False
        while not (self.switched or self.over.wait(_LOOK_S)):
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
            time.sleep(_LOOK_S)

    def _follow_prompts(self) -> None:
        """Look for what the running detector looks for."""
        with self._hand:
            wanted = self._worker.detector.prompts
            if not self.switched and self.detector.prompts != wanted:
                self.detector.set_prompts(wanted)

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

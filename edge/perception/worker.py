"""The detector's own thread: newest image in, newest detections out, nobody waits."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from edge.perception.detector import Detector
from edge.perception.text import PromptError
from edge.text import one_line
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

LONGEST_ERROR = 500


@dataclass(slots=True)
class WorkerStats:
    """Counts since the start; written by the worker and its user, read by anyone at any time.

    Attributes:
        replaced: observations that a newer one displaced before their turn.
        unread: detections that a newer result displaced before they were polled.
        last_latency_ns: image to boxes of the newest result.
        last_error: the newest failure in words, one line, empty when there was none.
        failures: type of failure → how many; replaced by another dict, never changed.
        in_a_row: failures since the newest result, but for those while the detector itself was not
            `ok` (see `Detector.health`).
    """

    submitted: int = 0
    replaced: int = 0
    done: int = 0
    unread: int = 0
    failed: int = 0
    last_latency_ns: int = 0
    last_error: str = ""
    failures: dict[str, int] = field(default_factory=dict)
    in_a_row: int = 0

    def count_result(self, detections: Detections) -> None:
        """Count what a model found."""
        self.done += 1
        self.last_latency_ns = detections.latency_ns
        self.in_a_row = 0

    def count_failure(self, error: Exception, expected: bool = False) -> bool:
        """Count what a model raised; whether it is the first of its kind.

        Args:
            expected: the detector itself says that it is not `ok`.
        """
        kind = type(error).__name__
        self.failed += 1
        self.in_a_row += not expected
        self.last_error = one_line(f"{kind}: {error}", LONGEST_ERROR)
        self.failures = {**self.failures, kind: self.failures.get(kind, 0) + 1}
        return self.failures[kind] == 1


Watch = Callable[[Detector, Observation, "Detections | Exception"], None]
"""Called with every image that a detector was run on, held meanwhile, and with what came of it."""


class WorkerBase:
    """What both workers share: the detector at work, and how another takes its place.

    Attributes:
        detector: runs on the next image.
        spare: the one before, kept until the present one has proved itself; None otherwise.
        watch: told of every image, on the thread that detects; what it raises is only logged.
    """

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        self.spare: Detector | None = None
        self.watch: Watch | None = None
        self.stats = WorkerStats()
        self._using: Detector | None = None
        self._hand = threading.Lock()

    def exchange(self, detector: Detector) -> Detector:
        """Have another detector run on the next image; the one before, still open."""
        with self._hand:
            before, self.detector = self.detector, detector
        return before

    def uses(self, detector: Detector) -> bool:
        """Whether it may be detecting now: such a one must not be closed yet."""
        with self._hand:
            return detector is self.detector or detector is self._using

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """Look for something else from the next image on; see `Detector.set_prompts`.

        Raises:
            PromptError, ModelError: the detector, or the spare one, cannot; nothing has changed
                then.
        """
        spare = self.spare
        if spare is None:
            self.detector.set_prompts(prompts)
            return
        # First the one that does not detect: where it fails, nothing at work need be undone.
        before = spare.prompts
        try:
            spare.set_prompts(prompts)
        except PromptError as error:
            raise PromptError(
                f"{spare.name}, kept until {self.detector.name} has proved itself: {error}; "
                "try again after that"
            ) from None
        try:
            self.detector.set_prompts(prompts)
        except Exception:
            spare.set_prompts(before)
            raise

    def _detect(self, observation: Observation) -> Detections | Exception:
        """What the detector finds, or the failure it ends with, after `watch` was told."""
        with self._hand:
            detector = self._using = self.detector
        outcome: Detections | Exception
        try:
            outcome = detector.detect(observation)
        except Exception as error:  # the loop must outlive whatever a model does
            outcome = error
        if (watch := self.watch) is not None:
            try:
                watch(detector, observation, outcome)
            except Exception:
                log.exception("whoever watches the detector failed")
        self._using = None
        return outcome

    def _failed(self, error: Exception) -> None:
        """Count a failure, and say once what kind of failure a detector has."""
        detector = self.detector
        if self.stats.count_failure(error, expected=detector.health().state != "ok"):
            reason = one_line(f"{type(error).__name__}: {error}", LONGEST_ERROR)
            log.error("detector %s: %s (more of these are only counted)", detector.name, reason)


class DetectorWorker(WorkerBase):
    """Runs a detector beside the loop.

    Observations are held (`Observation.hold`) while they wait and while they are detected in.
    Whoever polls detections owns that hold: call `detections.observation.release()` when done.
    """

    def __init__(self, detector: Detector) -> None:
        super().__init__(detector)
        self._wake = threading.Condition()
        self._pending: Observation | None = None
        self._result: Detections | None = None
        self._busy = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="detector", daemon=True)
        self._thread.start()

    def submit(self, observation: Observation) -> None:
        """Detect in this next; a waiting older one is let go and counted. Never blocks."""
        observation.hold()
        with self._wake:
            if self._closed:
                displaced = observation
            else:
                displaced, self._pending = self._pending, observation
                self.stats.submitted += 1
                self.stats.replaced += displaced is not None
                self._wake.notify_all()
        if displaced is not None:
            displaced.release()

    def poll(self) -> Detections | None:
        """The newest finished detections that were not polled yet, or None."""
        with self._wake:
            result, self._result = self._result, None
        return result

    def idle(self) -> bool:
        """Whether nothing waits and nothing is being detected in."""
        with self._wake:
            return self._pending is None and not self._busy

    def close(self) -> None:
        """Finish the image at hand, stop the thread, release every observation still held."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()
        self._thread.join()
        if self._pending is not None:
            self._pending.release()
        if self._result is not None:
            self._result.observation.release()
        self._pending = self._result = None
        self.detector.close()

    def _run(self) -> None:
        while (observation := self._next()) is not None:
            outcome = self._detect(observation)
            if isinstance(outcome, Exception):
                self._failed(outcome)
                observation.release()
                continue
            with self._wake:
                unread, self._result = self._result, outcome
                self.stats.unread += unread is not None
                self.stats.count_result(outcome)
            if unread is not None:
                unread.observation.release()

    def _next(self) -> Observation | None:
        with self._wake:
            self._busy = False
            while self._pending is None and not self._closed:
                self._wake.wait()
            if self._closed:
                return None
            observation, self._pending = self._pending, None
            self._busy = True
            return observation

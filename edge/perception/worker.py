"""The detector's own thread: newest image in, newest detections out, nobody waits."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass, field

from edge.perception.detector import Detector
from edge.types import Detections, Observation

log = logging.getLogger(__name__)


@dataclass(slots=True)
class WorkerStats:
    """Counts since the start; written by the worker and its user, read by anyone.

    Attributes:
        replaced: observations that a newer one displaced before their turn.
        unread: detections that a newer result displaced before they were polled.
        last_latency_ns: image to boxes of the newest result.
        last_error: the newest failure in words, empty when there was none.
    """

    submitted: int = 0
    replaced: int = 0
    done: int = 0
    unread: int = 0
    failed: int = 0
    last_latency_ns: int = 0
    last_error: str = ""
    failures: dict[str, int] = field(default_factory=dict)

    def count_failure(self, error: Exception) -> bool:
        """Count what a model raised; whether it is the first of its kind."""
        kind = type(error).__name__
        self.failed += 1
        self.last_error = f"{kind}: {error}"
        self.failures[kind] = self.failures.get(kind, 0) + 1
        return self.failures[kind] == 1


class DetectorWorker:
    """Runs a detector beside the loop.

    Observations are held (`Observation.hold`) while they wait and while they are detected in.
    Whoever polls detections owns that hold: call `detections.observation.release()` when done.
    """

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        self.stats = WorkerStats()
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
            try:
                detections = self.detector.detect(observation)
            except Exception as error:  # the loop must outlive whatever a model does
                self._failed(error)
                observation.release()
                continue
            with self._wake:
                unread, self._result = self._result, detections
                self.stats.done += 1
                self.stats.unread += unread is not None
                self.stats.last_latency_ns = detections.latency_ns
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

    def _failed(self, error: Exception) -> None:
        with self._wake:
            first = self.stats.count_failure(error)
        if first:
            log_failure(self.detector, error)


def log_failure(detector: Detector, error: Exception) -> None:
    """Say once what kind of failure a detector has."""
    log.error("detector %s: %s: %s (more of these are only counted)",
              detector.name, type(error).__name__, error)  # fmt: skip

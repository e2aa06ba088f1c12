"""Detection inside the tick, for lockstep runs that must replay the same."""

from __future__ import annotations

from edge.perception.detector import Detector
from edge.perception.worker import WorkerBase
from edge.types import Detections, Observation


class InlineWorker(WorkerBase):
    """Has the methods of `DetectorWorker`, but `submit` runs the model at once.

    Args:
        every: the model runs on every `every`-th observation.
    """

    def __init__(self, detector: Detector, every: int = 1) -> None:
        super().__init__(detector)
        self._every = every
        self._result: Detections | None = None

    def submit(self, observation: Observation) -> None:
        """Detect in this now if it is its turn; the result waits for `poll`."""
        turn = self.stats.submitted % self._every == 0
        self.stats.submitted += 1
        if not turn:
            return
        self._drop()
        outcome = self._detect(observation)
        if isinstance(outcome, Exception):
            self._failed(outcome)
            return
        observation.hold()
        self._result = outcome
        self.stats.count_result(outcome)

    def poll(self) -> Detections | None:
        """The detections of the last `submit`, once."""
        result, self._result = self._result, None
        return result

    def close(self) -> None:
        self._drop()
        self.detector.close()

    def _drop(self) -> None:
        if self._result is not None:
            self._result.observation.release()
            self._result = None

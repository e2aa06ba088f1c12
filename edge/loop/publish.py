"""Stage 9: every sink is handed the result, with all that has happened since the one before."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from edge.loop.faults import Faults
from edge.loop.result import Event, Sink, TickResult
from edge.types import Detections, Goal, GoalStatus

_KEPT = 256  # of what happens between two results, the newest


class Publisher:
    """For one thread, the loop's.

    Attributes:
        goals, answers, events: since the last result; bounded, however long ago that is.
        detections: what came in; its frame is held until the result that tells of it is out.
    """

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.goals: deque[Goal] = deque(maxlen=_KEPT)
        self.answers: deque[GoalStatus] = deque(maxlen=_KEPT)
        self.events: deque[Event] = deque(maxlen=_KEPT)
        self.detections: Detections | None = None
        self._sinks = sinks

    def saw(self, detections: Detections) -> None:
        """Boxes came in."""
        self.let_go()
        detections.observation.hold()
        self.detections = detections

    def publish(self, result: TickResult, faults: Faults) -> None:
        """Hand it to every sink; one that fails costs the others nothing, and is told of next."""
        for told in (self.goals, self.answers, self.events):
            told.clear()
        for sink in self._sinks:
            with faults.outlived(f"{type(sink).__name__}.tick", result.now_ns):
                sink.tick(result)

    def let_go(self) -> None:
        """The frame of what was seen may be used again."""
        if self.detections is not None:
            self.detections.observation.release()
            self.detections = None

"""Stage 9: every sink is handed the result, with all that has happened since the one before."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from typing import Any

from edge.loop.faults import Faults
from edge.loop.result import Event, Sink, TickResult
from edge.text import one_line
from edge.types import Detections, Goal, GoalStatus

_KEPT = 256  # of what happens between two results, the newest


def statuses(sinks: Sequence[Sink]) -> dict[str, dict[str, Any]]:
    """How those sinks are that tell it, by their classes' names; a second of a class is `Name.2`.

    One that fails at that says so; any thread may ask.
    """
    told: dict[str, dict[str, Any]] = {}
    seen: Counter[str] = Counter()
    for sink in sinks:
        name = type(sink).__name__
        seen[name] += 1
        if not hasattr(sink, "status"):
            continue
        try:
            said = dict(sink.status())
        except Exception as error:
            said = {"problem": f"status(): {one_line(f'{type(error).__name__}: {error}')}"}
        told[name if seen[name] == 1 else f"{name}.{seen[name]}"] = said
    return told


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

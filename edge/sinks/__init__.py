"""Things that take results. A sink's methods never block and never raise into the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edge.types import Detections, Goal, GoalStatus, Observation

if TYPE_CHECKING:
    from edge.loop.service import Service


class Sink(Protocol):
    """What the loop tells; a sink ignores what it has no use for (see `SinkBase`)."""

    def goal(self, goal: Goal) -> None: ...

    def answered(self, answer: GoalStatus) -> None: ...

    def detections(self, detections: Detections) -> None: ...

    def event(self, text: str, now_ns: int) -> None: ...

    def tick(self, service: Service, observation: Observation | None, now_ns: int) -> None: ...

    def close(self) -> None: ...


class SinkBase:
    """Ignores everything."""

    def goal(self, goal: Goal) -> None:
        """A new goal was chosen."""

    def answered(self, answer: GoalStatus) -> None:
        """The controller answered a goal."""

    def detections(self, detections: Detections) -> None:
        """Boxes came in; the arrays are valid during the call only."""

    def event(self, text: str, now_ns: int) -> None:
        """Something happened that a person would want to know."""

    def tick(self, service: Service, observation: Observation | None, now_ns: int) -> None:
        """A tick ended; `observation` is None when there was nothing to see."""

    def close(self) -> None:
        """No more will come."""

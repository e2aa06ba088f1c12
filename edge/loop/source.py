"""What the loop listens to: a source of observations, and the motion controller's answers."""

from __future__ import annotations

from typing import Protocol

from edge.geometry import SE2
from edge.types import GoalStatus, Observation

NO_DROPS = ("received", "observations", "overrun")
"""Counters of messages that came, of observations given out, and of looks that found more messages
than there was room for once more."""


class Source(Protocol):
    """Yields what the robot sees; for one thread.

    Attributes:
        counters: for the report, by name; may be empty. What is not one of `NO_DROPS` is a reason
            for which messages were dropped (see `edge.sources.synchronizer`).
        inbox: the controller's answers.
        epoch: rises when poses before and after have nothing to do with each other.
        pose: from the newest odometry; None before there was any.
    """

    counters: dict[str, int]
    inbox: GoalAnswers

    @property
    def epoch(self) -> int: ...

    @property
    def pose(self) -> SE2 | None: ...

    def poll(self) -> Observation | None:
        """The newest observation that was not yet given out, or None; never blocks.

        It is held once for the caller, who calls `release` when done with it; another reader
        (the detector's worker) calls `hold` and `release` for itself.
        """

    def wait(self, timeout_s: float) -> bool:
        """Block until a message arrives or time is up; False when none came."""

    def close(self) -> None: ...


class GoalAnswers(Protocol):
    """Yields what the motion controller says of the goals it was given; for one thread.

    Attributes:
        overruns: looks that found more than there was room for once more.
    """

    @property
    def overruns(self) -> int: ...

    def poll(self) -> list[GoalStatus]:
        """What came since the last call, oldest first; never blocks."""

"""What the loop listens to: a source of observations, and the motion controller's answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol

from edge.geometry import SE2
from edge.types import GoalStatus, Observation

NO_DROPS = ("received", "observations", "old_pose", "overrun")
"""Counters of messages that came, of observations given out, of those whose pose is older than they
are, and of looks that found more messages than there was room for once more."""


InputState = Literal["ok", "missing", "silent", "dropped", "unused"]
"""`missing`: no message ever came; `silent`: none comes any more; `dropped`: messages come, and
none of them can be used; `unused`: another input of its group comes instead."""


@dataclass(frozen=True, slots=True)
class InputRow:
    """One input of a source, as it stands at one moment.

    Attributes:
        name: the topic, as `camera/depth`.
        where: the key, the ROS topic or the address where it is listened to.
        group: inputs of one group stand in for each other, as `lidar/points` and `lidar/scan`.
        needed: whether the robot cannot do its work without the group.
        why: the reason for which messages are dropped, if none can be used; of an input that is ok,
            what is wrong with those that are used.
        hz: how often messages come, as measured; `expected_hz`: as configured, 0 = on events.
        age_s: time since the newest message; None before the first.
        received: messages; `dropped`: those that became part of no observation, by reason.
    """

    name: str
    where: str
    group: str
    needed: bool
    state: InputState
    why: str
    hz: float
    expected_hz: float
    age_s: float | None
    received: int
    dropped: Mapping[str, int]

    @property
    def lacks(self) -> bool:
        """Whether the robot cannot do its work for want of this input."""
        return self.needed and self.state in ("missing", "silent", "dropped")

    def __str__(self) -> str:
        """Name it as a user would look for it."""
        return self.where if self.where.endswith(self.name) else f"{self.name} ({self.where})"


def lacking(rows: Sequence[InputRow]) -> str:
    """Say in one line which needed inputs are missing, silent or dropped; "" if none is.

    No number in it changes all the time: it is told again whenever it changes.
    """
    return "; ".join(_lacking([row for row in rows if row.lacks]))


def _lacking(rows: Sequence[InputRow]) -> Iterator[str]:
    for state, said in (("missing", "no message yet on"), ("silent", "no message any more on")):
        groups: dict[str, list[str]] = {}
        for row in rows:
            if row.state == state:
                groups.setdefault(row.group, []).append(str(row))
        if groups:
            yield f"{said} {', '.join(' or '.join(names) for names in groups.values())}"
    for row in rows:
        if row.state == "dropped":
            yield f"every message on {row} is dropped: {row.why}"


def inputs_status(rows: Sequence[InputRow]) -> dict[str, Any]:
    """Return the table for the status message: `lacking` or ok, why, and each input by name."""
    why = lacking(rows)
    topics = {row.name: asdict(row) for row in rows}
    return {"state": "lacking" if why else "ok", "detail": why, "topics": topics}


class Source(Protocol):
    """Yields what the robot sees; for one thread.

    It may have a method `input_table()`, which returns its table of inputs (`InputRow`) to any
    thread: readiness, status, console, live page and metrics then say which one is missing.

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

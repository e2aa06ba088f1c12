"""Interfaces of the loop's inputs: `Source`, `GoalStatusReader`, and the state of each input.

`edge.sources` has the sources. An *input* is a topic, for example `camera/depth`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol

from edge.geometry import SE2
from edge.types import GoalStatus, Observation

NO_DROPS = ("received", "observations", "old_pose", "overrun", "pose_jump", "clock_reset")
"""Counters of a source that are not reasons for drops: messages received, observations returned,
observations whose pose is older than they are, reads that found a message ring full, and messages
that began a new frame or a new clock."""


InputState = Literal["ok", "missing", "silent", "dropped", "unused"]
"""`missing`: no message came yet; `silent`: messages stopped; `dropped`: messages come, but none is
usable; `unused`: another input of the group is used instead."""


@dataclass(frozen=True, slots=True)
class InputStatus:
    """State of one input of a source.

    Attributes:
        name: Topic, for example `camera/depth`.
        where: Zenoh key, ROS topic or address of the input.
        group: Inputs of one group replace each other, for example `lidar/points` and `lidar/scan`.
        needed: True if the robot cannot work without the group.
        state: See `InputState`.
        why: Reason why the messages are dropped. If the state is `ok`: a problem of the messages
            that are used; may be empty.
        hz: Measured message rate.
        expected_hz: Configured message rate; 0 if messages come only on events.
        age_s: Time since the newest message; None before the first.
        received: Number of messages received.
        dropped: Number of messages that became part of no observation, by reason.
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
    def is_lacking(self) -> bool:
        """True if the robot cannot work because this input is missing, silent or dropped."""
        return self.needed and self.state in ("missing", "silent", "dropped")

    def __str__(self) -> str:
        """Return the name that a user knows."""
        return self.where if self.where.endswith(self.name) else f"{self.name} ({self.where})"


def missing_inputs(rows: Sequence[InputStatus]) -> str:
    """Return one line that lists the needed inputs that are missing, silent or dropped; "" if none.

    The line is logged whenever it changes, so it holds no number that changes all the time.
    """
    return "; ".join(_problem_texts([row for row in rows if row.is_lacking]))


def _problem_texts(rows: Sequence[InputStatus]) -> Iterator[str]:
    """Yield one text for each problem of these inputs: missing, silent, then dropped."""
    for state, text in (("missing", "no message yet on"), ("silent", "no more messages on")):
        groups: dict[str, list[str]] = {}
        for row in rows:
            if row.state == state:
                groups.setdefault(row.group, []).append(str(row))
        if groups:
            yield f"{text} {', '.join(' or '.join(names) for names in groups.values())}"
    for row in rows:
        if row.state == "dropped":
            yield f"every message on {row} is dropped: {row.why}"


def inputs_status(rows: Sequence[InputStatus]) -> dict[str, Any]:
    """Return the inputs for the status: `ok` or `lacking`, the reason, and each input."""
    why = missing_inputs(rows)
    topics = {row.name: asdict(row) for row in rows}
    return {"state": "lacking" if why else "ok", "detail": why, "topics": topics}


class Source(Protocol):
    """The interface of a source of observations; for one thread.

    A source may have a method `input_table()` that returns its inputs (`InputStatus`) to any
    thread. Readiness, status, console, live page and metrics then show which input is missing.

    Attributes:
        counters: Counts by name; may be empty. Each name that is not in `NO_DROPS` is a reason why
            messages were dropped (see `edge.sources.synchronizer`).
        inbox: Goal statuses of the controller.
        epoch: Number that increases when the pose jumps to an unrelated frame.
        pose: Newest pose of the odometry; None before the first.

    Example:
        >>> from types import SimpleNamespace
        >>> import numpy as np
        >>> class ListSource:
        ...     epoch, pose = 0, SE2(0.0, 0.0, 0.0)
        ...
        ...     def __init__(self, observations: list[Observation]) -> None:
        ...         self.observations, self.counters = observations, {}
        ...         self.inbox = SimpleNamespace(overruns=0, poll=list)  # no controller
        ...
        ...     def poll(self) -> Observation | None:
        ...         return self.observations.pop() if self.observations else None
        ...
        ...     def wait(self, timeout_s: float) -> bool:
        ...         return bool(self.observations)
        ...
        ...     def close(self) -> None:
        ...         pass
        >>> source = ListSource([Observation(0, 0, np.eye(4))])
        >>> source.wait(1.0), source.poll().stamp_ns, source.poll()
        (True, 0, None)
    """

    counters: dict[str, int]
    inbox: GoalStatusReader

    @property
    def epoch(self) -> int: ...

    @property
    def pose(self) -> SE2 | None: ...

    def poll(self) -> Observation | None:
        """Return the newest observation that was not returned before, or None. Never block.

        It is held once for the caller, who must call `release`. Another reader, such as the
        detector's worker, calls `hold` and `release` itself.
        """

    def wait(self, timeout_s: float) -> bool:
        """Block until a message arrives, at most `timeout_s`; return False if none came."""

    def close(self) -> None: ...


class GoalStatusReader(Protocol):
    """The interface of a reader of the motion controller's goal statuses; for one thread.

    Attributes:
        overruns: Number of reads that found the message ring full.
    """

    @property
    def overruns(self) -> int: ...

    def poll(self) -> list[GoalStatus]:
        """Return the statuses since the last call, oldest first. Never block."""

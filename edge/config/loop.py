"""The sensor loop: where observations come from, when it ticks, what it tells."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from edge.config.section import Positive, Section


class Zenoh(Section):
    """The service listens; simulator and controller connect to the same endpoint."""

    endpoint: str = "tcp/127.0.0.1:7447"
    prefix: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")] = "edge"
    mode: Literal["peer", "client"] = "peer"
    shared_memory: bool = True


class Source(Section):
    """Limits on what is let in; everything outside is dropped and counted."""

    max_message_mb: Positive = 64.0
    max_pose_gap_s: Positive = 0.25
    max_pose_jump_m: Positive = 1.0
    max_cloud_points: Annotated[int, Field(ge=16)] = 131072
    pool_slots: Annotated[int, Field(ge=3, le=32)] = 6
    odometry_ring: Annotated[int, Field(ge=64)] = 256


class Loop(Section):
    """`priority` is the loop's among real-time threads (SCHED_FIFO; 0 = an ordinary thread).

    `lockstep` waits for nothing in real time: every observation is one tick and the
    detector runs inside it every `detect_every` ticks, so a run replays the same."""

    hz: Positive = 30.0
    priority: Annotated[int, Field(ge=0, le=99)] = 0
    lockstep: bool = False
    detect_every: Annotated[int, Field(ge=1)] = 1


class Report(Section):
    frames: Annotated[int, Field(ge=0, le=100)] = 8
    status_hz: Positive = 1.0
    map_hz: Positive = 2.0


class Sink(Section):
    """Where results go: a short name (`edge/sinks/__init__.py`), or `module:Class` of one's own.

    `options` are given to the class; a name alone needs none."""

    kind: str
    options: dict[str, Any] = Field(default_factory=dict)


Sinks = tuple[
    Annotated[
        Sink, BeforeValidator(lambda given: {"kind": given} if isinstance(given, str) else given)
    ],
    ...,
]

"""The result of a tick (`TickResult`), and the interface of sinks that receive it (`Sink`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from edge.geometry import SE2, Grid
from edge.loop.input_log import LoopInput
from edge.loop.latency import LatencyReport, Span
from edge.mapping.zones import ZonePolygons
from edge.memory import KnownObject, MappedRoom, Site
from edge.mission.planning.plan import MissionKnowledge, TargetPlan
from edge.mission.run import MissionRun
from edge.mission.spec import MissionSpec
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies.base import Candidates
from edge.tasks.facts import TaskStatus
from edge.types import (
    Detections,
    Goal,
    GoalStatus,
    Instance,
    MissionEvent,
    MissionStatus,
    Observation,
)

VALUE_LAYER = "value of "
"""Prefix of the layer names of value maps. The target follows."""
MAX_OBJECTS = 300
"""Limit of the objects that displays get."""


class Event(NamedTuple):
    """An event for people, with its loop time."""

    now_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class MissionFacts:
    """A snapshot of a mission.

    Attributes:
        trace: Propositions that led to this state.
        knowledge: Sets D, R and B (ViTL IV-A2).
        reached: Set R in the order of reaching.
        forbidden: Targets that must not be reached next, since the mission could not succeed then.
        paused: True if the mission is paused.
        log: Mission log, oldest first.
        id: Id that the client gave to the mission; "" if none.
        question: Text about an object that a person may confirm as the target; "" if none.
    """

    spec: MissionSpec
    state: int
    trace: tuple[str, ...]
    plan: TargetPlan
    knowledge: MissionKnowledge
    reached: tuple[str, ...]
    forbidden: tuple[str, ...]
    paused: bool
    log: tuple[MissionEvent, ...]
    id: str
    question: str = ""


def mission_facts(mission: MissionRun) -> MissionFacts:
    """Return a snapshot of a mission."""
    return MissionFacts(
        mission.spec, mission.progress.state, mission.progress.trace, mission.plan,
        mission.sets.knowledge, mission.sets.reached, mission.progress.forbidden, mission.paused,
        mission.log, mission.id, mission.question,
    )  # fmt: skip


class ScoredCandidates(NamedTuple):
    """Copies of a tick's candidates as parallel arrays; see `edge.policies.base.Candidates`.

    Attributes:
        kind: (n,) int8.
        id: (n,) int64.
        xy_m: (n, 2) float32 in `map`.
        score: (n,) float32, score of the policy.
        path_m: (n,) float32, path length; inf if no path is known.
        blocked: (n,) bool, True if the candidate is not used for now.
    """

    kind: np.ndarray
    id: np.ndarray
    xy_m: np.ndarray
    score: np.ndarray
    path_m: np.ndarray
    blocked: np.ndarray


def scored_candidates(candidates: Candidates, scores: np.ndarray) -> ScoredCandidates:
    """Return copies of the candidates that have a score."""
    c, n = candidates, min(candidates.n, len(scores))
    parts = (c.kind, c.id, c.xy_m, scores, c.path_m, c.blocked)
    return ScoredCandidates(*(part[:n].copy() for part in parts))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TickResult:
    """The result of a tick, or of a loop cycle without an observation.

    Expensive values are functions. A sink calls them in `Sink.tick`, or after the loop has ended.
    `mission`, `task`, `instances`, `objects`, `frontiers`, `candidates` and `path` compute their
    value at the first call and then return the same value. `known_m2`, `snapshot`, `layers`,
    `latency`, `spans` and `parts` return the current value at each call. Only `snapshot`,
    `latency`, `spans` and the functions in `layers` may be called at other times by another thread.

    Attributes:
        observation: The observation that was handled, held until `Sink.tick` returns; None if
            there was none.
        pose: Newest pose in `map`; None before the first.
        goal: Current goal of the robot, or None.
        goal_status: Newest status of this goal from the controller; None before the first.
        has_controller: True if a controller answers, or if no answers are expected.
        stopped: Why the robot is stopped; "" if it is not.
        proposals: Returns the proposals of agents that wait for a person, JSON-ready.
        targets: The mission's targets, with the label that detections of each have.
        goals: Goals that were sent since the last result.
        goal_statuses: Goal statuses that were received since the last result.
        events: Events since the last result.
        inputs: Entries of the input log since the last result (`edge.loop.input_log`).
        detections: New detections with their frame, valid until `Sink.tick` returns; None if there
            are none.
        mission: Returns state, plan and log of the mission.
        task: Returns the trajectory of a task and its progress; None if there is no task.
        instances: Returns copies of the instances of all targets that are worth driving to, best
            first for each target. An instance that matches two targets is listed twice. The
            arrays of the copies never change.
        objects: Returns the remembered objects, the most confident first, `MAX_OBJECTS` at most.
        rooms: Rooms of the map, by id.
        site: Places and zones, with the place `start`.
        zones: Polygons of all zones that are closed now; another object after each change.
        frontiers: Returns a copy of the frontiers, (n, 2) float32 in `map`.
        path: Returns the shortest path to the goal, (k, 2) float32 in `map`; (0, 2) if there is
            none.
        choice: Newest answer of the model that chooses directions; None if there is none.
        known_m2: Returns the known area in m².
        snapshot: Returns a copy of the map; see `edge.mapping.grid.RollingMap.snapshot`.
        layers: Returns functions by layer name. Each returns a copy of a map layer, uint8, 0 where
            it has no value.
        latency: See `edge.loop.latency.LatencyRing.report`.
        spans: See `edge.loop.latency.LatencyRing.spans`.
        parts: Returns the status of loop, checkpoint, detector, swap, scorers and the other parts,
            JSON-ready.
    """

    now_ns: int
    observation: Observation | None
    pose: SE2 | None
    status: MissionStatus
    goal: Goal | None
    goal_status: GoalStatus | None
    has_controller: bool
    stopped: str
    proposals: Callable[[], list[dict[str, object]]]
    targets: Mapping[str, str]
    goals: tuple[Goal, ...]
    goal_statuses: tuple[GoalStatus, ...]
    events: tuple[Event, ...]
    inputs: tuple[LoopInput, ...]
    detections: Detections | None
    mission: Callable[[], MissionFacts]
    task: Callable[[], TaskStatus | None]
    instances: Callable[[], list[Instance]]
    objects: Callable[[], list[KnownObject]]
    rooms: tuple[MappedRoom, ...]
    site: Site
    zones: ZonePolygons
    frontiers: Callable[[], np.ndarray]
    candidates: Callable[[], ScoredCandidates]
    path: Callable[[], np.ndarray]
    choice: FrontierChoice | None
    known_m2: Callable[[], float]
    snapshot: Callable[..., Grid]
    layers: Callable[[], dict[str, Callable[[], Grid]]]
    latency: Callable[..., LatencyReport]
    spans: Callable[..., list[Span]]
    parts: Callable[[], dict[str, Any]]


class Sink(Protocol):
    """The interface of a receiver of results. Its methods never block.

    An exception of a sink is counted and does not affect the loop or other sinks.

    A sink may have a method `status()` that returns its state, JSON-ready. The status message of
    the service includes it. `/metrics` shows its fields `failed` (not sent or written) and
    `dropped` (replaced by newer data, or no room), if they exist. The loop's thread and other
    threads call it.

    Example:
        >>> class PoseLogger:
        ...     def tick(self, result: TickResult) -> None:
        ...         print(result.pose)
        ...
        ...     def close(self) -> None:
        ...         pass
    """

    def tick(self, result: TickResult) -> None:
        """Handle the result of a tick, or of a cycle without an observation."""

    def close(self) -> None:
        """Release all resources. No more results follow."""

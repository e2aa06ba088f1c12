"""What a tick comes to, and the sinks that are handed it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from edge.geometry import SE2, Grid
from edge.loop.journal import Input
from edge.loop.latency import LatencyReport, Span
from edge.mission.brief import Brief
from edge.mission.planning.plan import Knowledge, Plan
from edge.mission.run import MissionRun
from edge.perception.scoring.choice.question import Choice
from edge.policies.base import Candidates
from edge.tasks.facts import TaskFacts
from edge.types import Detections, Goal, GoalStatus, Instance, MissionStatus, Observation, Step

VALUE_LAYER = "value of "
"""What the names of the value maps' layers begin with; the target's follows."""


class Event(NamedTuple):
    """Something that a person would want to know, at a time of the loop."""

    now_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class MissionFacts:
    """A mission as it stood at one moment.

    Attributes:
        state: of the automaton; `word`: the letters that led there.
        knowledge: the sets D, R and B (ViTL IV-A2); `reached`: R in order of reaching.
        forbidden: targets from which, reached next, success would be impossible.
        steps: what happened, oldest first.
        id: what whoever asked for it calls it; "" where it has no name.
    """

    brief: Brief
    state: int
    word: tuple[str, ...]
    plan: Plan
    knowledge: Knowledge
    reached: tuple[str, ...]
    forbidden: tuple[str, ...]
    paused: bool
    steps: tuple[Step, ...]
    id: str


def facts_of(mission: MissionRun) -> MissionFacts:
    """A mission as it stands."""
    return MissionFacts(
        mission.brief, mission.state, mission.word, mission.plan, mission.knowledge,
        mission.reached, mission.forbidden, mission.paused, mission.steps, mission.id,
    )  # fmt: skip


class ScoredCandidates(NamedTuple):
    """The candidates of a tick as parallel arrays, copies; see `edge.policies.base.Candidates`.

    Attributes:
        kind: (n,) int8; `id`: (n,) int64.
        xy_m: (n, 2) float32 in `map`.
        score: (n,) float32, the policy's; `path_m`: (n,) float32, inf where no way leads to.
        blocked: (n,) bool.
    """

    kind: np.ndarray
    id: np.ndarray
    xy_m: np.ndarray
    score: np.ndarray
    path_m: np.ndarray
    blocked: np.ndarray


def scored(candidates: Candidates, scores: np.ndarray) -> ScoredCandidates:
    """Candidates as they stand, those that have a score."""
    c, n = candidates, min(candidates.n, len(scores))
    parts = (c.kind, c.id, c.xy_m, scores, c.path_m, c.blocked)
    return ScoredCandidates(*(part[:n].copy() for part in parts))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TickResult:
    """All that a sink may know of a tick, or of a moment in which there was nothing to see.

    What is dear to gather is to be called for, in `Sink.tick` or after the loop's end: `mission`,
    `task`, `instances`, `frontiers`, `candidates` and `way` say the same from their first call on;
    `known_m2`, `snapshot`, `layers`, `latency`, `spans` and `health` tell how things stand at each.
    Only `snapshot`, `latency`, `spans` and what `layers` holds may be called at other times, by
    another thread.

    Attributes:
        now_ns: the loop's time.
        observation: what was dealt with, held until `Sink.tick` returns; None: there was none.
        pose: the newest in `map`; None before there was any.
        goal: where the robot is sent; None: nowhere.
        answer: the controller's newest answer to that goal; None before it came.
        controlled: whether a controller answers, or none is expected to.
        targets: of the mission.
        goals: that went out since the result before; so `answers` that came, and `events`.
        inputs: what came into the loop from beside it, likewise.
        detections: what came in, with its frame, valid until `Sink.tick` returns; None: nothing.
        mission: the mission's state, plan and story.
        task: how a task's trajectory came about, and how far it is driven; None: there is no task.
        instances: those of all targets that are worth driving to, best first a target; one that
            answers to two targets stands twice. They are copies, whose arrays nobody writes to.
        frontiers: (n, 2) float32 in `map`, a copy.
        candidates: where the robot could go, and the policy's score of each.
        way: (k, 2) float32 in `map`, the shortest way to the goal; (0, 2) where there is none.
        choice: the newest answer about directions, where a model is asked.
        known_m2: area that was seen.
        snapshot: a copy of the map; see `edge.mapping.grid.RollingMap.snapshot`.
        layers: by name what makes a copy of a layer of the map, uint8, 0 where it says nothing.
        latency: see `edge.loop.latency.LatencyRing.report`; `spans`: see `LatencyRing.spans`.
        health: of loop, checkpoint, detector, swap and scorers, JSON-ready.
    """

    now_ns: int
    observation: Observation | None
    pose: SE2 | None
    status: MissionStatus
    goal: Goal | None
    answer: GoalStatus | None
    controlled: bool
    targets: tuple[str, ...]
    goals: tuple[Goal, ...]
    answers: tuple[GoalStatus, ...]
    events: tuple[Event, ...]
    inputs: tuple[Input, ...]
    detections: Detections | None
    mission: Callable[[], MissionFacts]
    task: Callable[[], TaskFacts | None]
    instances: Callable[[], list[Instance]]
    frontiers: Callable[[], np.ndarray]
    candidates: Callable[[], ScoredCandidates]
    way: Callable[[], np.ndarray]
    choice: Choice | None
    known_m2: Callable[[], float]
    snapshot: Callable[..., Grid]
    layers: Callable[[], dict[str, Callable[[], Grid]]]
    latency: Callable[..., LatencyReport]
    spans: Callable[..., list[Span]]
    health: Callable[[], dict[str, Any]]


class Sink(Protocol):
    """Takes results. Its methods never block; what they raise is counted and costs no one else.

    It may have a method `status()`, which tells how it is, JSON-ready: the service's status message
    shows all of it, `/metrics` how much could not be sent or written (`failed`) and how much gave
    way to what came later, or found no room (`dropped`), each where it is there. It is called by
    the loop's thread and by others.
    """

    def tick(self, result: TickResult) -> None:
        """A tick ended, or there was nothing to see for a moment."""

    def close(self) -> None:
        """No more will come."""

"""Stage `publish`: pass the result of a tick, and the events since the last one, to all sinks."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from edge.geometry import SE2
from edge.loop.error_boundary import ErrorBoundary
from edge.loop.goals.goal import GoalTracker
from edge.loop.input_log import InputLog
from edge.loop.latency import LatencyRing
from edge.loop.result import MAX_OBJECTS, Event, Sink, TickResult, mission_facts, scored_candidates
from edge.loop.scoring.scorers import Scorers
from edge.loop.semantic_map import SemanticMap
from edge.mapping.grid import RollingMap
from edge.memory import KnownObject, SiteFile, known_objects
from edge.mission.run import MissionRun
from edge.tasks.facts import TaskStatus
from edge.text import one_line
from edge.types import Detections, Goal, GoalStatus, Observation

_MAX_EVENTS = 256  # largest number of events between two results; older ones are dropped


def statuses(sinks: Sequence[Sink]) -> dict[str, dict[str, Any]]:
    """Return the status of each sink that has `status()`, by class name.

    The second sink of a class is `Name.2`. If `status()` raises, the entry has the reason. Any
    thread may call this.
    """
    by_name: dict[str, dict[str, Any]] = {}
    counts: Counter[str] = Counter()
    for sink in sinks:
        name = type(sink).__name__
        counts[name] += 1
        if not hasattr(sink, "status"):
            continue
        try:
            status = dict(sink.status())
        except Exception as error:
            status = {"problem": f"status(): {one_line(f'{type(error).__name__}: {error}')}"}
        by_name[name if counts[name] == 1 else f"{name}.{counts[name]}"] = status
    return by_name


class Outbox:
    """Goals, goal statuses and events since the last result; all bounded."""

    def __init__(self) -> None:
        self.goals: deque[Goal] = deque(maxlen=_MAX_EVENTS)
        self.goal_statuses: deque[GoalStatus] = deque(maxlen=_MAX_EVENTS)
        self.events: deque[Event] = deque(maxlen=_MAX_EVENTS)


class ResultPublisher:
    """Builds the result of a tick and passes it to the sinks; for the loop's thread.

    Attributes:
        proposals: Returns the proposals of agents that wait for a person, at a loop time; set by
            `edge.loop.requests.agent_requests`.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        outbox: Outbox,
        semantic_map: SemanticMap,
        site: SiteFile,
        goals: GoalTracker,
        scorers: Scorers | None,
        input_log: InputLog,
        latency: LatencyRing,
        parts: Callable[[], dict[str, Any]],
    ) -> None:
        self.proposals: Callable[[int], list[dict[str, object]]] = lambda now_ns: []
        self._sinks, self._outbox = sinks, outbox
        self._map, self._site = semantic_map, site
        self._goal_tracker, self._scorers = goals, scorers
        self._input_log, self._latency, self._parts = input_log, latency, parts

    def result(
        self,
        now_ns: int,
        stamp_ns: int,
        observation: Observation | None,
        pose: SE2 | None,
        mission: MissionRun,
        task: Callable[[], TaskStatus | None],
        detections: Detections | None,
        scores: np.ndarray,
    ) -> TickResult:
        """Return the current state, and all events since the last published result.

        Args:
            now_ns: Loop time.
            stamp_ns: Stamp of the newest observation, for the age of objects.
            observation: The observation that was handled, if any.
            pose: Newest pose in `map`; None before the first.
            mission: The mission.
            task: Returns the status of a task; see `TickResult.task`.
            detections: New detections of this tick.
            scores: The policy's scores of the candidates.
        """
        semantic_map, grid, goals = self._map, self._map.grid, self._goal_tracker
        spec, goal, scorers, outbox = mission.spec, goals.goal, self._scorers, self._outbox
        return TickResult(
            now_ns=now_ns,
            observation=observation,
            pose=pose,
            status=mission.status(goals.phase),
            goal=goal,
            goal_status=goals.goal_status,
            has_controller=goals.client.has_controller,
            stopped=mission.stopped,
            proposals=partial(self.proposals, now_ns),
            targets=spec.labels,
            goals=tuple(outbox.goals),
            goal_statuses=tuple(outbox.goal_statuses),
            events=tuple(outbox.events),
            inputs=tuple(self._input_log.pending),
            detections=detections,
            mission=cache(partial(mission_facts, mission)),
            task=cache(task),
            instances=cache(
                lambda: [
                    instance.copied()
                    for target in spec.targets
                    for instance in semantic_map.tracker.of(spec.object_name(target))
                ]
            ),
            objects=cache(partial(_objects, semantic_map, stamp_ns)),
            rooms=semantic_map.rooms.rooms,
            site=self._site.known,
            zones=grid.zones.polygons,
            frontiers=cache(lambda: grid.frontiers.xy_m[: grid.frontiers.n].copy()),
            candidates=cache(partial(scored_candidates, semantic_map.pool.candidates, scores)),
            path=cache(partial(_path_m, grid, goal)),
            choice=None if scorers is None else scorers.answers.choice,
            known_m2=lambda: grid.known_m2,
            snapshot=grid.snapshot,
            # The likely places of targets mean nothing without a mission.
            layers=lambda: semantic_map.layers(likely=mission.ended != "idle"),
            latency=self._latency.report,
            spans=self._latency.spans,
            parts=self._parts,
        )

    def publish(self, result: TickResult, boundary: ErrorBoundary) -> None:
        """Publish the result to every sink. An error of a sink does not affect the others.

        Such an error is an event of the next result.
        """
        outbox = self._outbox
        for recent in (outbox.goals, outbox.goal_statuses, outbox.events, self._input_log.pending):
            recent.clear()
        for sink in self._sinks:
            with boundary.contain(f"{type(sink).__name__}.tick", result.now_ns):
                sink.tick(result)


def _objects(semantic_map: SemanticMap, stamp_ns: int) -> list[KnownObject]:
    """Return the remembered objects; see `TickResult.objects`."""
    min_hits = semantic_map.config.perception.min_hits
    return known_objects(semantic_map.objects.read_only, stamp_ns, min_hits, most=MAX_OBJECTS)


def _path_m(grid: RollingMap, goal: Goal | None) -> np.ndarray:
    """Return the shortest path to the goal; see `TickResult.path`."""
    if goal is None:
        return np.zeros((0, 2), np.float32)
    return grid.travel_cost.path_xy_m(goal.pose.x_m, goal.pose.y_m)

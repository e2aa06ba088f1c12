"""Stage 9: every sink is handed the result, with all that has happened since the one before."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from edge.geometry import SE2
from edge.loop.faults import Faults
from edge.loop.goal import GoalTracker
from edge.loop.journal import Journal
from edge.loop.latency import LatencyRing
from edge.loop.result import Event, Sink, TickResult, facts_of, scored
from edge.loop.scorers import Scorers
from edge.loop.semantic_map import SemanticMap
from edge.mapping.grid import RollingMap
from edge.mission.run import MissionRun
from edge.tasks.facts import TaskFacts
from edge.text import one_line
from edge.types import Detections, Goal, GoalStatus, Observation

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

    Args:
        sinks: take the results; their methods never block.
        map, goals, scorers, journal, latency, health: what a result tells of.

    Attributes:
        goals, answers, events: since the last result; bounded, however long ago that is.
        detections: what came in; its frame is held until the result that tells of it is out.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        map: SemanticMap,
        goals: GoalTracker,
        scorers: Scorers | None,
        journal: Journal,
        latency: LatencyRing,
        health: Callable[[], dict[str, Any]],
    ) -> None:
        self.goals: deque[Goal] = deque(maxlen=_KEPT)
        self.answers: deque[GoalStatus] = deque(maxlen=_KEPT)
        self.events: deque[Event] = deque(maxlen=_KEPT)
        self.detections: Detections | None = None
        self._sinks = sinks
        self._map, self._tracker, self._scorers = map, goals, scorers
        self._journal, self._latency, self._health = journal, latency, health

    def result(
        self,
        now_ns: int,
        observation: Observation | None,
        pose: SE2 | None,
        mission: MissionRun,
        task: Callable[[], TaskFacts | None],
        scores: np.ndarray,
    ) -> TickResult:
        """How all stands, and what has happened since the last result was published.

        Args:
            observation: what was dealt with, if anything.
            pose: the newest in `map`; None before there was any.
            scores: the policy's, of the candidates.
        """
        map, grid, goals = self._map, self._map.grid, self._tracker
        targets, goal, scorers = mission.brief.targets, goals.goal, self._scorers
        return TickResult(
            now_ns=now_ns,
            observation=observation,
            pose=pose,
            status=mission.status(goals.phase),
            goal=goal,
            answer=goals.answer,
            controlled=goals.client.heard,
            targets=targets,
            goals=tuple(self.goals),
            answers=tuple(self.answers),
            events=tuple(self.events),
            inputs=tuple(self._journal.pending),
            detections=self.detections,
            mission=cache(partial(facts_of, mission)),
            task=cache(task),
            instances=cache(
                lambda: [found.copied() for label in targets for found in map.tracker.of(label)]
            ),
            frontiers=cache(lambda: grid.frontiers.xy_m[: grid.frontiers.n].copy()),
            candidates=cache(partial(scored, map.pool.candidates, scores)),
            way=cache(partial(_way_m, grid, goal)),
            choice=None if scorers is None else scorers.answers.choice,
            known_m2=lambda: grid.known_m2,
            snapshot=grid.snapshot,
            layers=lambda: map.layers(likely=not mission.idle),
            latency=self._latency.report,
            spans=self._latency.spans,
            health=self._health,
        )

    def saw(self, detections: Detections) -> None:
        """Boxes came in."""
        self.let_go()
        detections.observation.hold()
        self.detections = detections

    def publish(self, result: TickResult, faults: Faults) -> None:
        """Hand it to every sink; one that fails costs the others nothing, and is told of next."""
        for told in (self.goals, self.answers, self.events, self._journal.pending):
            told.clear()
        for sink in self._sinks:
            with faults.outlived(f"{type(sink).__name__}.tick", result.now_ns):
                sink.tick(result)

    def let_go(self) -> None:
        """The frame of what was seen may be used again."""
        if self.detections is not None:
            self.detections.observation.release()
            self.detections = None


def _way_m(grid: RollingMap, goal: Goal | None) -> np.ndarray:
    """See `TickResult.way`."""
    if goal is None:
        return np.zeros((0, 2), np.float32)
    return grid.reach.way_m(goal.pose.x_m, goal.pose.y_m)

"""The live progress line and the run's record, as sinks of the loop."""

from __future__ import annotations

import time

import numpy as np

from edge.cli.progress import Progress, ProgressWriter
from edge.config import Config
from edge.loop.service import Service
from edge.mission.run import MissionRun
from edge.report.record import RunRecord, Story
from edge.report.recorder import Recorder
from edge.sinks import SinkBase
from edge.text import shorten
from edge.types import Detections, Goal, Instance, Observation

# Reports draw it apart from what is occupied itself.
_TOO_CLOSE = 50


class ConsoleSink(SinkBase):
    """Keeps one line on the terminal up to date."""

    def __init__(self) -> None:
        self._writer = ProgressWriter()

    def tick(self, service: Service, observation: Observation | None, now_ns: int) -> None:
        # The line's own beat is the wall clock's: simulated time may run faster or slower.
        wall_ns = time.monotonic_ns()
        if self._writer.due(wall_ns):
            self._writer.update(progress_of(service), wall_ns)

    def close(self) -> None:
        self._writer.close()


def progress_of(service: Service) -> Progress:
    """How the service stands, for one line."""
    status, goal, pose = service.status, service.goal, service.pose
    report = service.latency.report(last=150)
    detect = report.stage("detect")
    return Progress(
        phase=status.phase if pose is not None else "waiting for sensors, looking for",
        target=_ahead(service.mission),
        elapsed_s=status.elapsed_s,
        goal_kind=None if goal is None else goal.kind,
        goal_distance_m=0.0
        if goal is None or pose is None
        else pose.distance_to(*goal.candidate_xy_m),
        instances=len(service.tracker.of(status.target)),
        map_m2=service.grid.known_m2,
        tick_p95_ms=report.tick.p95_ms if report.tick.n else None,
        detector_ms=detect.p50_ms if detect.n else None,
    )


def _ahead(mission: MissionRun) -> str:
    """What is pursued, and what the plan holds after it.

    Why it was chosen is in the log: each step of a mission is an event.
    """
    then = ", ".join(letter or "nothing" for letter in mission.plan.steps[1:])
    return (
        f"{mission.target} (then {shorten(then, 60)})"
        if then and not mission.done
        else mission.target
    )


class RecorderSink(SinkBase):
    """Feeds a `Recorder` from the loop."""

    def __init__(self, config: Config) -> None:
        self._recorder = Recorder(config)

    def goal(self, goal: Goal) -> None:
        self._recorder.goal(goal)

    def detections(self, detections: Detections) -> None:
        self._recorder.targets = detections.prompts  # the detector is asked for nothing else
        self._recorder.frame(detections)

    def event(self, text: str, now_ns: int) -> None:
        self._recorder.event(now_ns, text)

    def tick(self, service: Service, observation: Observation | None, now_ns: int) -> None:
        if observation is not None:
            self._recorder.pose(observation.stamp_ns, observation.pose)

    def record(self, service: Service, counters: dict[str, int]) -> RunRecord:
        """The run so far, with the map as it stands now."""
        grid = service.grid
        self._recorder.targets = service.mission.brief.targets
        return self._recorder.finish(
            service.status,
            service.latency.report(),
            grid.snapshot(inflated=_TOO_CLOSE),
            np.array(grid.frontiers.xy_m[: grid.frontiers.n]),
            _instances(service),
            counters,
            story_of(service.mission),
        )


def _instances(service: Service) -> list[Instance]:
    """Those of all targets; one that answers to two of them stands once."""
    found = [i for label in service.mission.brief.targets for i in service.tracker.of(label)]
    return list({instance.id: instance for instance in found}.values())


def story_of(mission: MissionRun) -> Story:
    """A mission as its report tells it."""
    translation, automaton = mission.brief.translation, mission.brief.automaton
    return Story(
        instruction=translation.instruction,
        english=translation.english,
        formula=str(automaton.formula),
        backend=translation.backend,
        automaton=automaton,
        state=mission.state,
        word=mission.word,
        plan=() if automaton.accepting[mission.state] else mission.plan.steps,
        steps=mission.steps,
    )

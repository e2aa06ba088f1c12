"""Sink that collects data for a run's report, in bounded memory and without delaying the loop."""

from __future__ import annotations

import os
import platform
from collections import deque
from collections.abc import Mapping
from typing import Generic, TypeVar

from edge.config import Config
from edge.host.machine import this_cpu
from edge.lab.report.choices import ChoiceFrameBuffer
from edge.lab.report.keyframes import FRAMES, KeyframeBuffer
from edge.lab.report.record import RunRecord
from edge.live.trail import DrivenPath
from edge.loop.result import VALUE_LAYER, Event, TickResult
from edge.mission.translate import Translation
from edge.tasks.facts import TaskStatus
from edge.tasks.refine import RefinedTrajectory
from edge.text import redact, shorten
from edge.types import Goal, MissionStatus

MAX_TITLE = 160  # characters
_TOO_CLOSE = 50
"""Map value of free cells that are too near to an obstacle: reports have an own colour for them."""
_NS = 1e-9

T = TypeVar("T")


class HeadTailBuffer(Generic[T]):
    """Keeps the first and the last items of a sequence of any length.

    Attributes:
        count: number of items so far, with those that were left out.
    """

    def __init__(self, first: int = 100, last: int = 400) -> None:
        self._first: list[T] = []
        self._n_first = first
        self._last: deque[T] = deque(maxlen=last)
        self.count = 0

    def append(self, item: T) -> None:
        """Add an item; drop the oldest of the last ones if they are too many."""
        self.count += 1
        if len(self._first) < self._n_first:
            self._first.append(item)
        else:
            self._last.append(item)

    @property
    def left_out(self) -> int:
        """Number of items that were not kept."""
        return self.count - len(self._first) - len(self._last)

    def items(self) -> tuple[T, ...]:
        """Return the kept items in order."""
        return (*self._first, *self._last)


class ReportRecorder:
    """Sink that keeps data for the report of a run; every call is cheap."""

    def __init__(self, config: Config, frames: int = FRAMES) -> None:
        self._config = config
        self._path = DrivenPath()
        self._keyframes = KeyframeBuffer(frames)
        self._choices = ChoiceFrameBuffer(frames)
        self._goals: HeadTailBuffer[Goal] = HeadTailBuffer()
        self._events: HeadTailBuffer[Event] = HeadTailBuffer()
        self._begun_tasks: HeadTailBuffer[TaskStatus] = HeadTailBuffer(20, 80)
        self._refined: RefinedTrajectory | None = None  # the newest trajectory of a task
        self._start_ns: int | None = None

    def tick(self, result: TickResult) -> None:
        seen, observation = result.detections, result.observation
        if self._start_ns is None:
            self._start_ns = _first_ns(result)
        if seen is not None:
            self._keyframes.offer(seen, result.targets.values())
        self._choices.offer(result)
        for event in result.events:
            self._events.append(event)
        if result.events:  # each new trajectory comes with an event
            self._keep_trajectory(result.task())
        for goal in result.goals:
            self._goals.append(goal)
        if observation is not None:
            self._path.append(observation.stamp_ns, observation.pose)

    def _keep_trajectory(self, task: TaskStatus | None) -> None:
        """Keep a task's trajectory if it is a new one."""
        refined = None if task is None else task.refined
        if task is not None and refined is not None and refined is not self._refined:
            self._begun_tasks.append(task)
        self._refined = refined

    def close(self) -> None:
        """See `edge.loop.result.Sink`."""

    def record(self, end: TickResult, counters: Mapping[str, float]) -> RunRecord:
        """Return the record of the run, with its end."""
        self.tick(end)
        start_ns = self._start_ns or 0
        poses, stamps_ns = self._path.arrays()
        events = [((stamp - start_ns) * _NS, text) for stamp, text in self._events.items()]
        counts = {"goals": self._goals.count}
        if self._events.left_out:
            counts["events not shown"] = self._events.left_out
        facts = end.mission()
        return RunRecord(
            title=_title(facts.spec.translation, end.status),
            config_path=self._config.path,
            robot=self._config.robot_name,
            detector=detector_name(self._config),
            targets=end.targets,
            mission=end.status,
            latency=end.latency(),
            start_ns=start_ns,
            map=end.snapshot(inflated=_TOO_CLOSE),
            trajectory=poses,
            trajectory_t_s=(stamps_ns - start_ns) * _NS,
            frontiers_m=end.frontiers(),
            goals=self._goals.items(),
            instances=tuple(end.instances()),
            objects=tuple(end.objects()),
            rooms=end.rooms,
            site=end.site,
            frames=self._keyframes.frames(),
            asked=self._choices.frames(),
            values={n: make() for n, make in end.layers().items() if n.startswith(VALUE_LAYER)},
            events=tuple(sorted(events, key=lambda event: event[0])),
            counters={**counts, **counters},
            config=redact(self._config.model_dump(mode="json")),
            machine=machine(),
            mission_facts=facts,
            task=end.task(),
            task_at_trajectory_start=self._begun_tasks.items(),
        )


def _first_ns(result: TickResult) -> int | None:
    """Return the stamp of the first observation or event in this result; None without one."""
    if result.observation is not None:
        return result.observation.stamp_ns
    return result.events[0].now_ns if result.events else None


def _title(asked: Translation, mission: MissionStatus) -> str:
    """Return the instruction, or its meaning if the mission was given as a single target."""
    if asked.backend == "target":
        return f"Find the {mission.target}"
    return shorten(asked.instruction, MAX_TITLE)


def detector_name(config: Config) -> str:
    """Return the detector as text; the simulated detector is named as such."""
    detector = config.perception.detector
    if detector.kind == "sim":
        return "simulated (object ids of the ray caster with a noise model, no neural network)"
    return f"{detector.model} on {', '.join(detector.providers)}"


def machine() -> str:
    """Return this machine as text: processor, usable cores, system, Python version."""
    cores, system = len(os.sched_getaffinity(0)), f"{platform.system()} {platform.release()}"
    return (
        f"{this_cpu()} ({platform.machine()}), {cores} cores, {system}, "
        f"Python {platform.python_version()}"
    )

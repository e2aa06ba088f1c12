"""Collects what a run's report needs, in bounded memory and without holding the loop up."""

from __future__ import annotations

import os
import platform
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from edge.config import Config
from edge.geometry import SE2, Grid
from edge.loop.latency import LatencyReport
from edge.report.album import Album
from edge.report.record import RunRecord, Story
from edge.text import shorten, without_secrets
from edge.types import Detections, Goal, Instance, MissionStatus

STEP_M = 0.05
STEP_NS = 100_000_000
MAX_TITLE = 160
_NS = 1e-9

T = TypeVar("T")


class Ends(Generic[T]):
    """The first and the last items of a sequence that may grow without limit."""

    def __init__(self, first: int = 100, last: int = 400) -> None:
        self._first: list[T] = []
        self._room = first
        self._last: deque[T] = deque(maxlen=last)
        self.count = 0

    def append(self, item: T) -> None:
        self.count += 1
        if len(self._first) < self._room:
            self._first.append(item)
        else:
            self._last.append(item)

    @property
    def left_out(self) -> int:
        return self.count - len(self._first) - len(self._last)

    def items(self) -> tuple[T, ...]:
        return (*self._first, *self._last)


class Trail:
    """A trajectory in a fixed array: when it is full, every other pose goes and steps double."""

    def __init__(self, capacity: int = 16384) -> None:
        self._poses = np.zeros((capacity, 3))
        self._stamp_ns = np.zeros(capacity, dtype=np.int64)
        self._n = 0
        self._stride = 1
        self._last: tuple[int, SE2] | None = None

    def append(self, stamp_ns: int, pose: SE2) -> None:
        """Keep the pose if it is `STEP_M` or `STEP_NS` (times the stride) from the last kept."""
        if self._last is not None:
            last_ns, last = self._last
            moved_m = last.distance_to(pose.x_m, pose.y_m)
            near = moved_m < STEP_M * self._stride
            if near and stamp_ns - last_ns < STEP_NS * self._stride:
                return
        if self._n == len(self._poses):
            self._halve()
        self._poses[self._n] = pose.x_m, pose.y_m, pose.yaw_rad
        self._stamp_ns[self._n] = stamp_ns
        self._n += 1
        self._last = (stamp_ns, pose)

    def _halve(self) -> None:
        kept = (self._n + 1) // 2
        self._poses[:kept] = self._poses[: self._n : 2].copy()
        self._stamp_ns[:kept] = self._stamp_ns[: self._n : 2].copy()
        self._n = kept
        self._stride *= 2

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) float64 poses and (n,) int64 stamps, copies."""
        return self._poses[: self._n].copy(), self._stamp_ns[: self._n].copy()


class Recorder:
    """What the loop tells about a run; every call is cheap.

    Args:
        config: the run's configuration.
        targets: what is looked for, by any of its names; the configuration's by default.

    Attributes:
        targets: may change when the mission does.
    """

    def __init__(self, config: Config, targets: Sequence[str] | None = None) -> None:
        self.targets = (config.mission.target,) if targets is None else tuple(targets)
        self._config = config
        self._trail = Trail()
        self._album = Album(config.report.frames)
        self._goals: Ends[Goal] = Ends()
        self._events: Ends[tuple[int, str]] = Ends()
        self._goal_ns: int | None = None
        self._start_ns: int | None = None

    def pose(self, stamp_ns: int, pose: SE2) -> None:
        self._began(stamp_ns)
        self._trail.append(stamp_ns, pose)

    def goal(self, goal: Goal) -> None:
        """A goal was published; sending it again changes nothing."""
        self._began(goal.stamp_ns)
        if goal.stamp_ns != self._goal_ns:
            self._goal_ns = goal.stamp_ns
            self._goals.append(goal)

    def frame(self, detections: Detections) -> None:
        """Boxes came back; their observation must still be held."""
        self._began(detections.observation.stamp_ns)
        self._album.offer(detections, self.targets)

    def event(self, stamp_ns: int, text: str) -> None:
        """Something that belongs in the timeline happened."""
        self._began(stamp_ns)
        self._events.append((stamp_ns, text))

    def _began(self, stamp_ns: int) -> None:
        if self._start_ns is None:
            self._start_ns = stamp_ns

    def finish(
        self,
        mission: MissionStatus,
        latency: LatencyReport,
        map_snapshot: Grid | None = None,
        frontiers_m: np.ndarray | None = None,
        instances: Iterable[Instance] = (),
        counters: Mapping[str, float] | None = None,
        story: Story | None = None,
    ) -> RunRecord:
        """Everything that was recorded, with how the run ended; the arrays given are kept."""
        start_ns = self._start_ns or 0
        poses, stamps_ns = self._trail.arrays()
        events = [((stamp - start_ns) * _NS, text) for stamp, text in self._events.items()]
        more = {"goals": self._goals.count}
        if self._events.left_out:
            more["events not shown"] = self._events.left_out
        frontiers = np.zeros((0, 2), np.float32) if frontiers_m is None else frontiers_m
        return RunRecord(
            title=_title(story, mission),
            config_path=self._config.path,
            robot=self._config.robot.name,
            detector=detector_name(self._config),
            targets=self.targets,
            mission=mission,
            latency=latency,
            start_ns=start_ns,
            map=map_snapshot,
            trajectory=poses,
            trajectory_t_s=(stamps_ns - start_ns) * _NS,
            frontiers_m=np.asarray(frontiers, dtype=np.float32).reshape(-1, 2),
            goals=self._goals.items(),
            instances=tuple(instances),
            frames=self._album.frames(),
            events=tuple(sorted(events, key=lambda event: event[0])),
            counters={**more, **(counters or {})},
            config=without_secrets(self._config.model_dump(mode="json")),
            machine=machine(),
            story=story,
        )


def _title(story: Story | None, mission: MissionStatus) -> str:
    if story is None or story.backend == "target":
        return f"Find the {mission.target}"
    return shorten(story.instruction, MAX_TITLE)


def detector_name(config: Config) -> str:
    """The detector in words; one that is no neural network is called what it is."""
    detector = config.perception.detector
    if detector.kind == "sim":
        return "simulated (object ids of the ray caster with a noise model, no neural network)"
    return f"{detector.model} on {', '.join(detector.providers)}"


def machine() -> str:
    """This machine in a few words: processor, cores that may be used, system, Python."""
    cores = len(os.sched_getaffinity(0))
    processor = platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            names = [
                line.split(":", 1)[1].strip() for line in file if line.startswith("model name")
            ]
        processor = f"{names[0]} ({processor})" if names else processor
    except OSError:
        pass
    system = f"{platform.system()} {platform.release()}"
    return f"{processor}, {cores} cores, {system}, Python {platform.python_version()}"

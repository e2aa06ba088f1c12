"""Collects what a run's report needs, in bounded memory and without holding the loop up."""

from __future__ import annotations

import os
import platform
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from edge import names
from edge.config import Config
from edge.geometry import SE2
from edge.latency import LatencyReport
from edge.types import Detections, Goal, Instance, MissionStatus

STEP_M = 0.05
STEP_NS = 100_000_000
FRAME_NS = 1_000_000_000
BETTER_SCORE = 0.05
MAX_FRAME_PX = 640
_NS = 1e-9

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class MapSnapshot:
    """The occupancy map at one moment.

    Attributes:
        cells: (h, w) int8, row = y, column = x; -1 unknown, 0 free, 100 occupied; 1 to 99 for
            cells that are closed only by inflation, where the map tells them apart.
        origin_xy_m: the corner of cell (0, 0) in `map`.
    """

    cells: np.ndarray
    origin_xy_m: tuple[float, float]
    resolution_m: float

    @property
    def known_m2(self) -> float:
        return float(np.count_nonzero(self.cells >= 0)) * self.resolution_m**2


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A camera image with its boxes.

    Attributes:
        rgb: (h, w, 3) uint8, a copy; larger images are thinned to `MAX_FRAME_PX`.
        xyxy_px: (n, 4) float32 in pixels of `rgb`.
        score: (n,) float32.
        labels: n prompts.
        is_target: (n,) bool.
    """

    stamp_ns: int
    rgb: np.ndarray
    xyxy_px: np.ndarray
    score: np.ndarray
    labels: tuple[str, ...]
    is_target: np.ndarray

    @property
    def target_score(self) -> float:
        """Score of the best box of the target; 0 when there is none."""
        return float(self.score[self.is_target].max(initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """Everything a report shows.

    Attributes:
        target: boxes and instances of this name, or another for the same, are the target's.
        start_ns: stamp that `trajectory_t_s` and `events` count from.
        trajectory: (n, 3) float64: x_m, y_m, yaw_rad in `map`.
        trajectory_t_s: (n,) float64.
        frontiers_m: (n, 2) float32 cells or centroids in `map`, as they are at the end.
        events: (t_s, text) in order of time.
        config: the whole configuration, as JSON types.
    """

    title: str
    config_path: str
    robot: str
    detector: str
    target: str
    mission: MissionStatus
    latency: LatencyReport
    start_ns: int = 0
    map: MapSnapshot | None = None
    trajectory: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    trajectory_t_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    frontiers_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    goals: tuple[Goal, ...] = ()
    instances: tuple[Instance, ...] = ()
    frames: tuple[Frame, ...] = ()
    events: tuple[tuple[float, str], ...] = ()
    counters: Mapping[str, float] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    machine: str = ""

    def is_target(self, label: str) -> bool:
        """Whether a prompt or an instance's label is another word for the target."""
        return names.same(label, self.target)

    def seconds(self, stamp_ns: int) -> float:
        """A stamp as seconds since the run began."""
        return (stamp_ns - self.start_ns) * _NS


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


class Album:
    """At most `capacity` frames: half for the best views of the target, the rest for the newest.

    Frames with boxes come before frames without.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._best = (capacity + 1) // 2
        self._frames: list[Frame] = []
        self._taken_ns: int | None = None

    def offer(self, detections: Detections, target: str) -> None:
        """Copy the frame if the last is a second old, or shows the target less well."""
        if self._capacity == 0 or detections.observation.rgb is None:
            return
        stamp_ns = detections.observation.stamp_ns
        soon = self._taken_ns is not None and 0 <= stamp_ns - self._taken_ns < FRAME_NS
        if soon:
            if not self._better_than_last(detections, target):
                return
            self._frames = [f for f in self._frames if f.stamp_ns != self._taken_ns]
        self._frames.append(_copy(detections, target))
        self._taken_ns = stamp_ns
        if len(self._frames) > self._capacity:
            self._frames.remove(self._least())

    def _better_than_last(self, detections: Detections, target: str) -> bool:
        last = [f.target_score for f in self._frames if f.stamp_ns == self._taken_ns]
        return _target_score(detections, target) > (last[0] if last else 0.0) + BETTER_SCORE

    def _least(self) -> Frame:
        by_target = sorted(self._frames, key=lambda f: (f.target_score, f.stamp_ns))
        best = [f for f in by_target if f.target_score > 0][-self._best :]
        others = [f for f in self._frames if not any(f is b for b in best)]
        return min(others, key=lambda f: (len(f.labels) > 0, f.stamp_ns))

    def frames(self) -> tuple[Frame, ...]:
        return tuple(sorted(self._frames, key=lambda f: f.stamp_ns))


def _target_score(detections: Detections, target: str) -> float:
    wanted = [i for i, prompt in enumerate(detections.prompts) if names.same(prompt, target)]
    if not wanted or not len(detections):
        return 0.0
    return float(detections.score[np.isin(detections.class_id, wanted)].max(initial=0.0))


def _copy(detections: Detections, target: str) -> Frame:
    rgb = detections.observation.rgb
    assert rgb is not None  # `Album.offer` has looked
    stride = -(-max(rgb.shape[:2]) // MAX_FRAME_PX)
    labels = tuple(detections.prompts[i] for i in detections.class_id)
    return Frame(
        detections.observation.stamp_ns,
        np.array(rgb[::stride, ::stride]),
        detections.xyxy_px / np.float32(stride),
        np.array(detections.score),
        labels,
        np.array([names.same(label, target) for label in labels], dtype=bool),
    )


class Recorder:
    """What the loop tells about a run; every call is cheap.

    Args:
        config: the run's configuration.
        target: what is looked for, by any of its names; the mission's target by default.
    """

    def __init__(self, config: Config, target: str | None = None) -> None:
        self._config = config
        self._target = config.mission.target if target is None else target
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
        self._album.offer(detections, self._target)

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
        map_snapshot: MapSnapshot | None = None,
        frontiers_m: np.ndarray | None = None,
        instances: Iterable[Instance] = (),
        counters: Mapping[str, float] | None = None,
        title: str = "",
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
            title=title or f"Find the {mission.target}",
            config_path=self._config.path,
            robot=self._config.robot.name,
            detector=detector_name(self._config),
            target=self._target,
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
            config=self._config.model_dump(mode="json"),
            machine=machine(),
        )


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

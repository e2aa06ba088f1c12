"""Data that a run's report shows; `recorder` collects them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from edge import names
from edge.geometry import Grid
from edge.loop.latency import LatencyReport
from edge.loop.result import MissionFacts
from edge.memory import KnownObject, MappedRoom, Site
from edge.tasks.facts import TaskStatus
from edge.types import Goal, Instance, MissionEvent, MissionStatus

_NS = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A camera image with its boxes.

    Attributes:
        rgb: (h, w, 3) uint8, a copy, downsampled if the image was large.
        xyxy_px: (n, 4) float32 boxes in pixels of `rgb`.
        score: (n,) float32 of each box.
        is_target: (n,) bool, True for a box of a target.
    """

    stamp_ns: int
    rgb: np.ndarray
    xyxy_px: np.ndarray
    score: np.ndarray
    labels: tuple[str, ...]
    is_target: np.ndarray

    @property
    def best(self) -> dict[str, float]:
        """Score of the best box of each target, highest first."""
        pairs = zip(self.labels, self.score, self.is_target, strict=True)
        scores: dict[str, float] = {}
        for label, score, wanted in sorted(pairs, key=lambda pair: -pair[1]):
            if wanted:
                scores.setdefault(label, float(score))
        return scores

    @property
    def target_score(self) -> float:
        """Score of the best box of a target; 0 without one."""
        return max(self.best.values(), default=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceFrame:
    """An answer of the choice model, with its image.

    Attributes:
        rgb: (h, w, 3) uint8, the image with letters drawn on it.
        target: object that the question was about.
        letters: (letter, P of ViTL eq. 4) of each mark whose frontier still exists.
        elsewhere: see `FrontierChoice`.
        scene: see `FrontierChoice`.
    """

    stamp_ns: int
    rgb: np.ndarray
    target: str
    letters: tuple[tuple[str, float], ...]
    elsewhere: float
    scene: float


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """Everything that a report shows.

    Attributes:
        title: the instruction, or "Find the TARGET".
        targets: the mission's targets, with the label that boxes and instances of each have.
        mission_facts: instruction, translation and outcome of the mission; None if unknown.
        task: the task at the end of the run; None if the mission was no task.
        task_at_trajectory_start: status of the task when each of its trajectories began, in order
            of time.
        start_ns: stamp that `trajectory_t_s` and `events` count from.
        map: occupancy grid at the end; None if nothing was mapped.
        trajectory: (n, 3) float64: x_m, y_m, yaw_rad of the robot in `map`.
        trajectory_t_s: (n,) float64, time of each of these poses.
        frontiers_m: (n, 2) float32, points of frontiers in `map`, at the end of the run.
        goals: goals that were sent, in order of time.
        instances: objects that the mission looked for.
        objects: remembered objects, the most confident first.
        site: places and zones.
        frames: camera images with boxes.
        asked: answers of the choice model, in order of time.
        values: value maps (ViTL eq. 6) by name, uint8, 0 for no value.
        events: (t_s, text) in order of time.
        counters: number of messages, goals and the like, by name.
        config: the entire configuration as JSON types, without the secrets of its URLs.
        machine: the computer as text.
    """

    title: str
    config_path: str
    robot: str
    detector: str
    targets: Mapping[str, str]
    mission: MissionStatus
    latency: LatencyReport
    start_ns: int = 0
    map: Grid | None = None
    trajectory: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    trajectory_t_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    frontiers_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    goals: tuple[Goal, ...] = ()
    instances: tuple[Instance, ...] = ()
    objects: tuple[KnownObject, ...] = ()
    rooms: tuple[MappedRoom, ...] = ()
    site: Site = field(default_factory=Site)
    frames: tuple[Keyframe, ...] = ()
    asked: tuple[ChoiceFrame, ...] = ()
    values: Mapping[str, Grid] = field(default_factory=dict)
    events: tuple[tuple[float, str], ...] = ()
    counters: Mapping[str, float] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    machine: str = ""
    mission_facts: MissionFacts | None = None
    task: TaskStatus | None = None
    task_at_trajectory_start: tuple[TaskStatus, ...] = ()

    @property
    def has_single_target(self) -> bool:
        """True if the mission was only to reach one object, as far as is known."""
        if self.mission_facts is None:
            return True
        automaton = self.mission_facts.spec.automaton
        return len(automaton.propositions) <= 1 and automaton.n_states <= 2

    @property
    def steps(self) -> tuple[MissionEvent, ...]:
        """Steps of the mission, in order of time."""
        return () if self.mission_facts is None else self.mission_facts.log

    @property
    def trajectories(self) -> tuple[TaskStatus, ...]:
        """One status of the task for each of its trajectories, in order of time.

        It is the status at the trajectory's start, but for the last trajectory that at the end of
        the run.
        """
        last = self.task
        if last is None or last.refined is None:
            return self.task_at_trajectory_start
        begun = self.task_at_trajectory_start
        return (*(task for task in begun if task.refined is not last.refined), last)

    @property
    def reached(self) -> tuple[MissionEvent, ...]:
        """Steps in which a target was reached."""
        return tuple(step for step in self.steps if step.kind == "reached")

    def is_target(self, label: str) -> bool:
        """Return True if a prompt or an instance's label is that of a target or a synonym."""
        return names.same_as_any(label, self.targets.values())

    def seconds(self, stamp_ns: int) -> float:
        """Return a stamp as seconds since the start of the run."""
        return (stamp_ns - self.start_ns) * _NS

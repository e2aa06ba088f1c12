"""Robot, controller and service in one process and one thread: exact, fast, no Zenoh."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from edge.config import Config
from edge.geometry import SE2
from edge.loop.result import Sink, TickResult
from edge.loop.scorers import make_scorers
from edge.loop.service import Service
from edge.mission.brief import prepare
from edge.motion.controller import Controller
from edge.perception.factory import make_detector
from edge.perception.sim_detector import Segmentation
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy
from edge.sim.base import World
from edge.sim.robot import DriveTrain
from edge.sim.sensors import CameraRig
from edge.sim.worlds import load_world
from edge.types import Goal, GoalStatus, Observation

START_NS = 1_000_000_000


class Notes:
    """Everything a run said."""

    def __init__(self) -> None:
        self.goals: list[Goal] = []
        self.events: list[str] = []
        self.answers: list[GoalStatus] = []

    def tick(self, result: TickResult) -> None:
        self.goals += result.goals
        self.answers += result.answers
        self.events += (event.text for event in result.events)

    def close(self) -> None: ...


@dataclass
class ClosedLoop:
    """A simulated robot that obeys a service; `step` is one tick and what follows from it."""

    config: Config
    notes: Notes = field(default_factory=Notes)
    sinks: list[Sink] = field(default_factory=list)

    def __post_init__(self) -> None:
        config = self.config
        self.world: World = load_world(config)
        self.drive = DriveTrain(config.robot, config.sim, self.world, self.world.start, START_NS)
        self.rig = CameraRig(config, self.world)
        self.labels = tuple(o.label for o in self.world.objects)
        brief = prepare(config.mission)
        detector = make_detector(config.perception, brief.targets, truth=self.truth)
        worker = DetectorWorker(detector, inline=True)
        self.scorers = make_scorers(config, brief.targets)
        sinks = [self.notes, *self.sinks]
        policy = make_policy(config.policy, config.path)
        self.service = Service(config, brief, worker, policy, sinks, scorers=self.scorers)
        self.controller = Controller(config)
        self._seq = 0
        self._map_due_ns = 0

    def truth(self, stamp_ns: int) -> Segmentation:
        """What the last picture shows."""
        return Segmentation(self.rig.ids, self.labels)

    def observe(self) -> Observation:
        motion = self.drive.motion
        self.rig.look(motion.pose)
        self._seq += 1
        return Observation(
            self._seq, motion.stamp_ns, motion.odometry.matrix(),
            rgb=self.rig.rgb.copy(), depth_m=self.rig.depth_m.copy(), camera=self.rig.model,
            T_base_camera=self.rig.T_base_camera,
        )  # fmt: skip

    def step(self) -> None:
        motion, now_ns = self.drive.motion, self.drive.motion.stamp_ns
        before = len(self.notes.goals)
        self.service.latency.begin_tick(0)
        self.service.tick(self.observe(), now_ns)
        self.service.latency.end_tick(0)
        if now_ns >= self._map_due_ns:
            self._map_due_ns = now_ns + 500_000_000
            grid = self.service.grid.snapshot()
            self.controller.on_map(grid)
        answers: list[GoalStatus] = []
        for goal in self.notes.goals[before:]:
            answers += self.controller.on_goal(goal.stamp_ns, goal.pose)
        command, more = self.controller.step(motion.odometry, motion.v_mps, motion.w_radps, now_ns)
        for answer in answers + more:
            self.service.goal_answered(answer)
        self.drive.step(self.config.sim.step_s, command.v_mps, command.w_radps)

    def run(self, seconds: float) -> ClosedLoop:
        """Step until the mission is over or time is up."""
        end_ns = START_NS + int(seconds * 1e9)
        while self.drive.motion.stamp_ns < end_ns and not self.service.status.done:
            self.step()
        return self

    def close(self) -> None:
        """Needed where scorers run beside the loop."""
        if self.scorers is not None:
            self.scorers.close()

    def distance_m(self, label: str) -> float:
        """True distance to the nearest footprint of that label."""
        pose = self.drive.motion.pose
        return min(o.distance_m(pose.x_m, pose.y_m) for o in self.world.objects if o.label == label)


def blank_observation(seq: int, stamp_ns: int, pose: SE2, loop: ClosedLoop) -> Observation:
    """A frame in which nothing returned."""
    depth = np.full(loop.rig.depth_m.shape, np.nan, np.float32)
    return Observation(
        seq, stamp_ns, pose.matrix(), rgb=np.zeros_like(loop.rig.rgb), depth_m=depth,
        camera=loop.rig.model, T_base_camera=loop.rig.T_base_camera,
    )  # fmt: skip

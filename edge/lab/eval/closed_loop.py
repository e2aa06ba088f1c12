"""Robot, controller and service in one process and one thread, without Zenoh.

Evaluations and tests use it: it is fast, and its result depends only on the configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter_ns

from edge.config import Config, PolicyPlugin
from edge.geometry import SE2
from edge.lab.eval.ghosts import GhostClock
from edge.lab.motion.controller import Controller
from edge.lab.sim.base import World
from edge.lab.sim.people import PeopledWorld, with_people
from edge.lab.sim.robot import DriveTrain
from edge.lab.sim.sensors import CameraRig, LidarRig
from edge.lab.sim.worlds import load_world
from edge.loop.result import Sink, TickResult
from edge.loop.scoring.scorers import make_scorers
from edge.loop.service import Service
from edge.memory import Site, SiteFile
from edge.perception.detection.sim import Segmentation
from edge.perception.factory import make_detector
from edge.perception.masks.ground import make_ground_classifier
from edge.perception.masks.masker import make_masker
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy
from edge.tasks.mission_spec import prepare_mission
from edge.types import Goal, GoalStatus, Observation

START_NS = 1_000_000_000  # stamp of the first observation


class RunLog:
    """Sink that collects what happened in a run.

    Attributes:
        goals: the goals that the service sent.
        events: texts of the events of the mission log.
        goal_statuses: the goal statuses that the service received.
    """

    def __init__(self) -> None:
        self.goals: list[Goal] = []
        self.events: list[str] = []
        self.goal_statuses: list[GoalStatus] = []

    def tick(self, result: TickResult) -> None:
        self.goals += result.goals
        self.goal_statuses += result.goal_statuses
        self.events += (event.text for event in result.events)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


@dataclass
class ClosedLoop:
    """A simulated robot that obeys a service. Each `step` is one tick with its consequences.

    If the sensor's rate is below that of the steps, some steps only drive.

    The order is that of `edge sim` and `edge run` in lockstep over Zenoh: the service's tick; the
    map and the goal to the controller; its goal statuses to the service; its velocity command to
    the robot. If `loop.lockstep` is set, scorers and planners answer within the tick. A policy
    plugin may ask for the simulator's `world` and `robot_radius_m` (`edge.lab.eval.bounds`).

    Attributes:
        notes: collects the goals, events and goal statuses.
        sinks: more sinks; each gets the result of each tick, as in a service.
        world: the world, already loaded with `config`; None: load `sim.world`.
        colour: False: render only depth and object ids, which is faster. Only for detectors and
            scorers that need no colour (see `wants_colour`).
        task: replaces the configuration's mission (`edge.tasks.mission_spec`).
        site: places and zones at the start.
        ghosts: measures cells that stay occupied behind people; None: no people.
        drive: the robot's motion; it knows its true pose.
        rig: the robot's camera; of two, which take turns, that of the last image.
        lidar: the robot's LiDAR; None: it has none.
        labels: names of the world's objects; `labels[i - 1]` is the name of the object with id i.
        worker: runs the detector.
        scorers: run the scoring models; None: there are none.

    Raises:
        edge.errors.UserError: the world, the mission, a model or the start cannot be used.

    Example:
        >>> from edge.config import load
        >>> loop = ClosedLoop(load("demo"), colour=False).run(2.0)
        >>> round(loop.seconds, 1)
        2.0
    """

    config: Config
    notes: RunLog = field(default_factory=RunLog)
    sinks: Sequence[Sink] = ()
    world: World | None = None
    colour: bool = True
    task: str | None = None
    site: Site = field(default_factory=Site)

    def __post_init__(self) -> None:
        config = self.config
        self.world = world = self.world or load_world(config)
        start = world.start if config.sim.start is None else SE2(*config.sim.start)
        self.world = world = with_people(world, config, start)
        self.ghosts = GhostClock(world) if isinstance(world, PeopledWorld) else None
        self.drive = DriveTrain(config.robot, config.sim, world, start, START_NS)
        n_cameras = len(config.sensors.cameras)
        self._cameras = [CameraRig(config, world, self.colour, i) for i in range(n_cameras)]
        self.rig = self._cameras[0]
        self.lidar = None if config.sensors.lidar is None else LidarRig(config, world)
        self.labels = tuple(o.label for o in world.objects)
        spec = prepare_mission(config, self.task, self.site)
        masker = make_masker(config.perception, timed=False)
        detector = make_detector(config.perception, spec.prompts, truth=self.truth)
        self.worker = DetectorWorker(detector, True, masker)
        self.scorers = make_scorers(config, spec.prompts)
        sinks = [self.notes, *self.sinks]
        truth = {"world": world, "robot_radius_m": config.robot.radius_m}
        policy = make_policy(config.policy, config.origin("policy"), truth)
        self.service = Service(
            config, spec, self.worker, policy, sinks, scorers=self.scorers,
            site=SiteFile(site=self.site), ground=make_ground_classifier(config.tasks),
        )  # fmt: skip
        self.controller = Controller(config)
        self._seq = 0
        # The service gets no more frames than a robot's: `observed_hz`.
        self._frame_due_ns, self._frame_period_ns = START_NS, int(1e9 / config.observed_hz)
        self._map_due_ns = 0
        self._map_period_ns = int(1e9 / config.report.map_hz)

    def truth(self, seen: Observation) -> Segmentation:
        """Return the object ids of the last rendered picture."""
        return Segmentation(self.rig.ids, self.labels)

    def observe(self) -> Observation:
        """Render an observation at the robot's pose. Its arrays are valid until the next call."""
        motion = self.drive.motion
        self.rig = self._cameras[self._seq % len(self._cameras)]
        self.rig.look(motion.pose)
        if self.lidar is not None:
            self.lidar.look(motion.pose)
        self._seq += 1
        return self.rig.observation(
            self._seq, motion.stamp_ns, motion.odometry.matrix(), self.lidar
        )

    def step(self) -> None:
        """Observe and run one tick if the sensor has a new frame; drive for `sim.step_s`."""
        motion, now_ns = self.drive.motion, self.drive.motion.stamp_ns
        n_goals, step_ns = len(self.notes.goals), int(1e9 * self.config.sim.step_s)
        if now_ns + step_ns // 2 >= self._frame_due_ns:
            self._tick(now_ns)
            # Frames that are late already are skipped.
            self._frame_due_ns = max(self._frame_due_ns, now_ns - step_ns) + self._frame_period_ns
        if now_ns >= self._map_due_ns:
            self._map_due_ns = now_ns + self._map_period_ns
            self.controller.on_map(self.service.map.grid.snapshot())
        answers: list[GoalStatus] = []
        for goal in self.notes.goals[n_goals:]:
            answers += self.controller.on_goal(goal.stamp_ns, goal.pose)
        command, later_answers = self.controller.step(
            motion.odometry, motion.v_mps, motion.w_radps, now_ns
        )
        for answer in answers + later_answers:
            self.service.on_goal_status(answer)
        self.drive.step(self.config.sim.step_s, command.v_mps, command.w_radps)

    def _tick(self, now_ns: int) -> None:
        """Observe, and run one tick of the service."""
        observation = self.observe()
        self.service.latency.begin_tick(perf_counter_ns())
        self.service.tick(observation, now_ns)
        if self.service.refused:
            self.service.idle(now_ns, self.drive.motion.odometry, observation)
        self.service.latency.end_tick(perf_counter_ns())
        if self.ghosts is not None:
            T_map_camera = self.drive.motion.pose.matrix() @ self.rig.T_base_camera
            self.ghosts.observe(
                self.service.map.grid, self.rig.model, T_map_camera, self.rig.depth_m,
                max(self.config.sim.step_s, 1e-9 * self._frame_period_ns),
            )  # fmt: skip

    @property
    def seconds(self) -> float:
        """Simulated time since the start [s]."""
        return 1e-9 * (self.drive.motion.stamp_ns - START_NS)

    def run(self, seconds: float) -> ClosedLoop:
        """Step until the mission ends or `seconds` of simulated time have passed."""
        end_ns = START_NS + int(seconds * 1e9)
        while self.drive.motion.stamp_ns < end_ns and not self.service.status.done:
            self.step()
        return self

    def close(self) -> None:
        """Stop model processes and scorer threads, if there are any."""
        self.service.close()
        self.worker.close()
        if self.scorers is not None:
            self.scorers.close()

    def distance_m(self, label: str) -> float:
        """Return the true distance to the nearest footprint of an object with this label."""
        pose = self.drive.motion.pose
        return min(o.distance_m(pose.x_m, pose.y_m) for o in self.world.objects if o.label == label)


def wants_colour(config: Config) -> bool:
    """Return True if any configured part uses the colours of the pictures."""
    perception = config.perception
    scored = perception.similarity is not None or perception.choice.kind in ("openai", "onnx")
    # A plugin may use the image. The policies of `edge` (`edge.lab.eval.bounds`) do not.
    is_user_plugin = isinstance(config.policy, PolicyPlugin) and not config.policy.kind.startswith(
        "edge."
    )
    masked = perception.segmenter.kind != "none" or config.tasks.ground is not None
    return scored or masked or is_user_plugin or perception.detector.kind != "sim"

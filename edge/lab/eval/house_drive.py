"""A seeded drive through the built-in house, as the messages of the robot's sensors.

`edge bench` records one and replays it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle

import numpy as np

from edge.bus.topics import Topic
from edge.config import Config, WorldHouse
from edge.lab.motion.controller import Controller
from edge.lab.sim.base import World, free_poses
from edge.lab.sim.robot import DriveTrain, MotionState
from edge.lab.sim.sensors import make_rigs, odometry_message
from edge.lab.sim.worlds import load_world

_START_NS = 1_000_000_000  # stamp of the first message
_MARGIN_M = 0.3  # free space around the robot at a pose to drive to
_STOPS = 40  # number of random poses to drive to


def house_drive(config: Config, seconds: float) -> Iterator[tuple[Topic, int, bytes]]:
    """Yield the messages of a robot that drives from room to room, in order of time.

    They are (topic, stamp in ns, CDR or JSON payload) of the sensors and the odometry, each at its
    rate. The world is the built-in house; the sensors and the robot are those of `config`.
    """
    sim = config.sim.model_copy(update={"world": WorldHouse(), "start": None})
    config = config.model_copy(update={"sim": sim})
    world = load_world(config)
    rigs = make_rigs(config, world)
    due_ns = [_START_NS] * len(rigs)
    for motion in _drive(config, world, seconds):
        batch = [odometry_message(motion)]
        for k, rig in enumerate(rigs):
            if motion.stamp_ns >= due_ns[k]:
                due_ns[k] += int(1e9 / rig.rate_hz)
                rig.look(motion.pose)
                batch += [*rig.description(motion.stamp_ns), *rig.messages(motion.stamp_ns)]
        for topic, payload in batch:
            yield topic, motion.stamp_ns, payload


def _drive(config: Config, world: World, seconds: float) -> Iterator[MotionState]:
    """Yield the robot's motion at the odometry's rate.

    It drives from one random pose to the next, on the true map. A long drive repeats the poses.
    """
    train = DriveTrain(config.robot, config.sim, world, world.start, _START_NS)
    controller = Controller(config)
    plan = world.plan
    inflated = plan.clearance_m <= config.robot.radius_m
    controller.on_map(replace(plan.grid, cells=np.where(inflated, np.int8(100), np.int8(0))))
    stops = cycle(free_poses(world, _STOPS, config.sim.seed, config.robot.radius_m, _MARGIN_M))
    dt_s = 1.0 / config.sensors.odometry_hz
    goal_id = 0
    arrived = True  # or gave up: drive to the next pose
    while train.motion.stamp_ns < _START_NS + int(seconds * 1e9):
        now_ns = train.motion.stamp_ns
        if arrived:
            goal_id += 1
            controller.on_goal(goal_id, next(stops))
        motion = train.motion
        command, answers = controller.step(motion.pose, motion.v_mps, motion.w_radps, now_ns)
        arrived = any(a.state in ("reached", "failed") for a in answers)
        yield motion
        train.step(dt_s, command.v_mps, command.w_radps)

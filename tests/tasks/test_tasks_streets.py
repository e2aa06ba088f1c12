"""A hairpin, a side and a stop, followed in built-in streets as they were said."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.config import TasksConfig
from edge.geometry import SE2
from edge.lab.eval.trajectories.outdoor import outdoor_episode
from edge.lab.eval.trajectories.references import possible_tasks
from edge.lab.sim.generator.rng import PortableRng
from edge.tasks.follow import goal_ahead
from edge.tasks.functions import TURNS
from edge.tasks.refine import refine
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.sentences.object_phrases import centre_m
from edge.tasks.sentences.reading import parse_steps
from edge.tasks.write import write_trajectory
from edge.trajectory.pursuit import MotionLimits
from edge.trajectory.smoothing import resample

CONFIG = TasksConfig()
STEP_M = 0.1


def trail(refined, robot):
    """Return the places (n, 2) of a robot that drives straight to the goal ahead."""
    places, index = [], 0
    for _ in range(3000):
        places.append((robot.x_m, robot.y_m))
        goal, index = goal_ahead(refined, robot, 1.5, index)
        away_m = robot.distance_to(goal.x_m, goal.y_m)
        if index == len(refined.poses) - 1 and away_m < 0.01:
            break
        robot = SE2(robot.x_m, robot.y_m, robot.yaw_rad + robot.bearing_to(goal.x_m, goal.y_m))
        robot = SE2(*robot.ahead(min(STEP_M, away_m)), robot.yaw_rad)
    return np.array(places)


def first_near(places, at_m):
    """Return the index of the first place within 0.2 m of a point; fail if there is none."""
    away_m = np.hypot(*(places - at_m).T)
    assert away_m.min() <= 0.2
    return int(np.argmax(away_m <= 0.2))


@pytest.mark.parametrize(
    "number", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 20))]
)
def test_a_hairpin_a_side_and_a_stop_are_driven(number):
    episode = outdoor_episode(number)
    task = next(possible_tasks(episode.place, "past", PortableRng(7, number)))
    past, to = parse_steps(task.instruction, episode.scene)
    instruction = (
        "go straight for 2 metres, turn around, go straight for 1 metre, "
        f"go past the {past.side} of object {past.objects[0].id}, stop at object {to.objects[0].id}"
    )
    written = write_trajectory(instruction, episode.scene, CONFIG)
    ends_m = [segment[-1, :2] for segment in written.coarse.segments]
    refined = refine(
        written.reachable.scene, written.coarse.segments, written.coarse.regions,
        PathMargins(CONFIG.trajectory.clearance_m), MotionLimits(1.0, 1.0, 0.5, 1.0),
        heading_rad=written.coarse.heading_rad,
    )  # fmt: skip
    places = trail(refined, episode.scene.pose)
    rest = places[first_near(places, ends_m[0]) :]  # from the tip on
    rest = rest[first_near(rest, ends_m[2]) :]
    offset = resample(rest, STEP_M) - centre_m(past.objects[0])
    turned_rad = TURNS[past.side] * np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    assert turned_rad.max() - turned_rad[0] > math.radians(90)
    assert turned_rad.min() - turned_rad[0] > -math.radians(70)
    assert math.dist(rest[-1], ends_m[-1]) < 0.2

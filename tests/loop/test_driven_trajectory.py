"""Driven trajectory of a task: its stops, and the steps that are done."""

from __future__ import annotations

import numpy as np
from task_scenes import street

from edge.geometry import SE2
from edge.loop.behaviours.driven_trajectory import RESEND_M, DrivenTrajectory
from edge.loop.behaviours.plan_worker import PlanResult
from edge.mission.task_step import TaskStep
from edge.tasks.refine import refine
from edge.tasks.scene.value_map import PathMargins
from edge.trajectory.pursuit import MotionLimits

VAN = ((3, "van"),)


def driven(*stops: tuple[tuple[int, str], ...]) -> DrivenTrajectory:
    """Return a drive of two steps, each straight for 2 m."""
    limits = MotionLimits(1.0, 1.0, 1.0, 1.0)
    to_m = [np.array([[x, 0.0]]) for x in (2.0, 4.0)]
    refined = refine(street(), to_m, {1}, PathMargins(0.3), limits)
    steps = (TaskStep("to the van"), TaskStep("on"))
    return DrivenTrajectory(PlanResult(n_done=2, stops=stops), refined, steps, 0)


def drive(drive: DrivenTrajectory) -> tuple[SE2, float]:
    """Drive to each goal until it stays, and return the last one."""
    goal, before = drive.goal(SE2(0.0, 0.0, 0.0))[0], None
    while goal != before:
        before, (goal, apart_m) = goal, drive.goal(goal)
    return goal, apart_m


def test_without_objects_the_only_stop_is_the_end():
    trajectory = driven()
    assert (trajectory.stop_objects, trajectory.stop_is_end) == ((), True)
    assert trajectory.n_steps_driven == 0
    assert trajectory.goal(SE2(0.0, 0.0, 0.0))[1] == RESEND_M
    goal, apart_m = drive(trajectory)
    assert (round(goal.x_m, 6), apart_m) == (4.0, 0.0)
    assert trajectory.n_steps_driven == 1
    assert trajectory.on_arrived(goal)


def test_no_goal_lies_behind_a_stop_before_its_objects_are_verified():
    trajectory = driven(VAN, ())
    assert (trajectory.stop_objects, trajectory.stop_is_end) == (VAN, False)
    goal, apart_m = drive(trajectory)
    assert (round(goal.x_m, 1), apart_m) == (2.0, 0.0)
    assert trajectory.on_arrived(goal)
    trajectory.leave_stop()
    assert (trajectory.n_verified, trajectory.n_steps_driven) == (1, 1)
    assert (trajectory.stop_objects, trajectory.stop_is_end) == ((), True)
    assert round(drive(trajectory)[0].x_m, 6) == 4.0

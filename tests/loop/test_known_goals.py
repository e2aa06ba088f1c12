"""Goals at known poses: when a goal stays, and when another takes its place."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge.geometry import SE2
from edge.loop.goals.known_goals import (
    AT_PLACE_M,
    SAME_POINT_M,
    goal_at_place,
    goal_at_point,
    goal_at_pose,
    scores_towards,
)
from edge.types import Goal

HERE = SE2(0.0, 0.0, 0.0)
CONTEXT = SimpleNamespace(now_ns=7, pose=HERE)


class Map:
    """Free cells on the x axis, and cells that are blocked since."""

    def __init__(self, *free_x_m: float, blocked_x_m: tuple[float, ...] = ()) -> None:
        self.free_x_m, self.blocked_x_m = free_x_m, blocked_x_m
        self.travel_cost = self

    def nearest(self, x_m: float, y_m: float, radius_m: float) -> tuple[float, float, float] | None:
        near = [x for x in self.free_x_m if math.hypot(x - x_m, y_m) <= radius_m]
        best = min(near, key=lambda x: math.hypot(x - x_m, y_m), default=None)
        return None if best is None else (best, 0.0, best)

    def state_at(self, x_m: float, y_m: float) -> int:
        return 100 * (x_m in self.blocked_x_m)

    def distance_m(self, x_m: float, y_m: float) -> float:
        return abs(x_m)

    def path_lengths_m(self, points_m, kind, snap_m, n: int, path_m: np.ndarray) -> None:
        for k, (x, y) in enumerate(points_m.tolist()):
            path_m[k] = math.inf if self.nearest(x, y, snap_m[0]) is None else abs(x)


def test_a_place_without_a_path_has_no_goal():
    assert goal_at_place(None, CONTEXT, Map(), SE2(3.0, 0.0, 1.0), "dock") is None
    assert goal_at_point(None, CONTEXT, Map(), np.array([[3.0, 0.0]]), "kitchen", True) is None


def test_the_goal_at_a_place_stays_until_its_cell_is_blocked():
    place, cell_x_m = SE2(3.0, 0.0, 1.0), 3.0 + 0.8 * AT_PLACE_M
    goal = goal_at_place(None, CONTEXT, Map(cell_x_m), place, "dock")
    assert (goal.pose, goal.kind, goal.target) == (SE2(cell_x_m, 0.0, 1.0), "place", "dock")
    assert goal_at_place(goal, CONTEXT, Map(3.0), place, "dock") is goal
    moved = goal_at_place(goal, CONTEXT, Map(3.0, blocked_x_m=(cell_x_m,)), place, "dock")
    assert moved.pose == place


@pytest.mark.parametrize(
    ("shift_m", "keep", "target", "stays"),
    [
        (0.9 * SAME_POINT_M, True, "kitchen", True),
        (0.9 * SAME_POINT_M, False, "kitchen", False),
        (0.9 * SAME_POINT_M, True, "bath", False),
        (1.1 * SAME_POINT_M, True, "kitchen", False),
    ],
)
def test_the_goal_at_a_point_stays_near_a_new_point(shift_m, keep, target, stays):
    points_m = np.array([[9.0, 0.0], [3.0, 0.0]], np.float32)
    goal = goal_at_point(None, CONTEXT, Map(3.0, 9.0), points_m, "kitchen", True)
    assert goal.pose == SE2(3.0, 0.0, 0.0), "the nearer point"
    new_m = points_m + np.array([shift_m, 0.0], np.float32)
    grid = Map(*(new_m[:, 0].tolist()))
    assert (goal_at_point(goal, CONTEXT, grid, new_m, target, keep) is goal) == stays


@pytest.mark.parametrize(
    ("x_m", "apart_m", "stays"),
    [(1.0, 0.0, True), (1.01, 0.0, False), (1.2, 0.3, True), (1.4, 0.3, False)],
)
def test_the_goal_on_a_trajectory_moves_in_steps(x_m, apart_m, stays):
    goal = goal_at_pose(None, "trajectory", SE2(1.0, 0.0, 0.0), "oven", 7, 0.0)
    assert goal.kind == "trajectory"
    assert (
        goal_at_pose(goal, "trajectory", SE2(x_m, 0.0, 0.0), "oven", 8, apart_m) is goal
    ) == stays
    spin = Goal(7, goal.pose, "spin", 0, (1.0, 0.0), 0.0, "oven")
    assert goal_at_pose(spin, "trajectory", goal.pose, "oven", 8, apart_m) is not spin


def test_the_frontier_on_the_way_to_a_point_scores_highest():
    xy_m, path_m = np.array([[1.0, 0.0], [-1.0, 0.0], [4.0, 0.0]]), np.array([1.0, 1.0, np.inf])
    context = SimpleNamespace(candidates=SimpleNamespace(n=3, xy_m=xy_m, path_m=path_m))
    scores = scores_towards(context, (5.0, 0.0))
    assert scores.argsort().tolist() == [2, 1, 0]

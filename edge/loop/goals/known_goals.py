"""Goals at known poses, which are for no candidate: a place, a point in a room, a trajectory.

Each function returns the current goal if that may stay. `GoalChooser.drive_to` sets the goal.
"""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.policies.base import PolicyInput
from edge.types import CandidateKind, Goal

AT_PLACE_M = 0.5
"""Largest distance of a goal from its place: if the place is blocked, the goal is next to it."""
POINT_SNAP_M = np.array([0.08])
"""Largest distance of a goal from a point in a room: the cell of the point, or the next cell. An
array of one radius, because `path_lengths_m` takes one for each kind of point."""
SAME_POINT_M = 0.6
"""A goal is kept if one of the new points is this near: points move as the map grows."""


def goal_at_place(
    goal: Goal | None, context: PolicyInput, grid: RollingMap, place: SE2, target: str
) -> Goal | None:
    """Return a goal at a place, or None while no path to it is known."""
    cell = grid.travel_cost.nearest(place.x_m, place.y_m, AT_PLACE_M)
    if cell is None:
        return None
    if goal is None or goal.kind != "place" or grid.state_at(goal.pose.x_m, goal.pose.y_m):
        pose = SE2(cell[0], cell[1], place.yaw_rad)
        goal = Goal(context.now_ns, pose, "place", 0, (place.x_m, place.y_m), 1.0, target)
    return goal


def goal_at_point(
    goal: Goal | None,
    context: PolicyInput,
    grid: RollingMap,
    points_m: np.ndarray,
    target: str,
    keep: bool,
) -> Goal | None:
    """Return a goal at the nearest of some points, or None if no path to any of them is known.

    Args:
        goal: Current goal.
        context: Pose and time of the tick.
        grid: The map.
        points_m: (n, 2) float32 in `map`, n > 0.
        target: Name of the target.
        keep: True if the current goal may stay while it is free and near one of the points.
    """
    n = len(points_m)
    if (
        keep
        and goal is not None
        and (goal.kind, goal.target) == ("place", target)
        and not grid.state_at(goal.pose.x_m, goal.pose.y_m)
        and math.isfinite(grid.travel_cost.distance_m(goal.pose.x_m, goal.pose.y_m))
        and np.hypot(*(points_m - goal.candidate_xy_m).T).min() <= SAME_POINT_M
    ):
        return goal
    path_m, kind = np.empty(n, np.float32), np.zeros(n, np.int8)  # one kind of points
    grid.travel_cost.path_lengths_m(points_m, kind, POINT_SNAP_M, n, path_m)
    best = int(path_m.argmin())
    at = points_m[best].tolist()
    cell = grid.travel_cost.nearest(at[0], at[1], float(POINT_SNAP_M[0]))
    if cell is None or not math.isfinite(path_m[best]):
        return None
    pose, x_m, y_m = context.pose, cell[0], cell[1]
    yaw_rad = math.atan2(y_m - pose.y_m, x_m - pose.x_m)
    return Goal(context.now_ns, SE2(x_m, y_m, yaw_rad), "place", 0, (at[0], at[1]), 1.0, target)


def goal_at_pose(
    goal: Goal | None, kind: CandidateKind, pose: SE2, target: str, now_ns: int, apart_m: float
) -> Goal:
    """Return a goal of a task, or one outside a zone.

    Args:
        goal: Current goal.
        kind: Kind of the wanted goal.
        pose: Wanted pose.
        target: Target of the mission.
        now_ns: Loop time.
        apart_m: The current goal of this kind is kept while it is at most this far from `pose`.
            0: it is kept only if it equals `pose`.
    """
    if (
        goal is None
        or goal.kind != kind
        or goal.pose.distance_to(pose.x_m, pose.y_m) > apart_m
        or (not apart_m and goal.pose != pose)
    ):
        goal = Goal(now_ns, pose, kind, 0, (pose.x_m, pose.y_m), 0.0, target)
    return goal


def scores_towards(context: PolicyInput, at_m: tuple[float, float]) -> np.ndarray:
    """Return scores (n,) of the candidates on the way to a point to which no path is known."""
    frontiers, n = context.candidates, context.candidates.n
    left_m = np.hypot(*(frontiers.xy_m[:n] - at_m).T)
    return (1.0 / (1.0 + frontiers.path_m[:n] + left_m)).astype(np.float32)

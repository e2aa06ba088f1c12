"""Functions to follow a refined trajectory: a goal ahead of the robot, and obstacles on the path.

`FollowBehaviour` calls them in each tick.
"""

from __future__ import annotations

import math

import numpy as np

from edge.bus.wire.transforms import encode_path
from edge.geometry import SE2
from edge.mapping.view import MapView
from edge.tasks.refine import RefinedTrajectory
from edge.tasks.scene.ground import ESCAPE_M
from edge.trajectory.pursuit import index_ahead, nearest_index

SEARCH_M = 3.0
"""Length of the path ahead on which the pose nearest to the robot is searched for.

It is short, so that no part is skipped where a path crosses itself.
"""
CHECKED_M = 10.0
"""Length of the path ahead that is checked for obstacles."""
MAX_CUT_M = 0.25
"""Largest distance by which a controller that drives straight to the goal may leave the path.

The robot's current distance from the path is added. Only the path itself was checked for obstacles.
"""
MIN_AHEAD_M = 0.5
"""Smallest distance of the goal, so that the robot keeps moving through a bend."""
PASSED_M = 0.14
"""A leg is driven when the robot was this near to its last pose.

That pose is within half of `edge.tasks.refine.SPACING_M` of the leg's end, so within 0.2 m.
"""
MAX_END_CUT_M = 0.1
"""Largest distance between the straight line to a goal and the end of a leg that it passes."""


def goal_ahead(
    trajectory: RefinedTrajectory,
    pose: SE2,
    look_ahead_m: float,
    from_index: int = 0,
    last_index: int | None = None,
) -> tuple[SE2, int]:
    """Return the goal ahead of the robot, and the robot's index on the path.

    The goal is the farthest pose within `look_ahead_m` along the path that the robot can drive to
    straight without cutting a bend (`MAX_CUT_M`). The robot must come within `PASSED_M` of each
    leg's end: where a path doubles back, the way back is as near as the way there.

    Args:
        trajectory: the trajectory.
        pose: the robot's.
        look_ahead_m: largest distance of the goal along the path.
        from_index: index that the last call returned; the search for the robot begins here.
        last_index: index of the last pose that may be driven to; None: the end.

    Returns:
        The goal, which is the last pose near the end, and the index of the pose nearest to the
        robot.
    """
    path_m = trajectory.poses[: None if last_index is None else last_index + 1, :2]
    robot_m = np.array([pose.x_m, pose.y_m])
    end = min(end_of_current_leg(trajectory, from_index), len(path_m) - 1)
    window = index_ahead(path_m, from_index, SEARCH_M)
    index = nearest_index(path_m[: min(window, end) + 1], pose.x_m, pose.y_m, from_index)
    # Up to the end of the leg, and further only if the robot has come to that end.
    while end < min(window, len(path_m) - 1) and math.dist(robot_m, path_m[end]) <= PASSED_M:
        begin, end = end + 1, min(end_of_current_leg(trajectory, end + 1), len(path_m) - 1)
        index = nearest_index(path_m[: min(window, end) + 1], pose.x_m, pose.y_m, begin)
    # The goal is between these two: the farthest one that cuts no bend.
    nearest = min(index_ahead(path_m, index, min(MIN_AHEAD_M, look_ahead_m)), end)
    farthest = index_ahead(path_m, index, look_ahead_m)
    # Largest deviation at each pose from `index` on; less at the ends of legs.
    max_cut_m = np.full(farthest - index + 1, MAX_CUT_M + math.dist(robot_m, path_m[index]))
    max_cut_m[:-1][np.diff(trajectory.leg[index : farthest + 1]) > 0] = MAX_END_CUT_M
    ahead = next(
        (
            k
            for k in range(farthest, nearest, -1)
            if (_deviation_m(path_m[index : k + 1], robot_m) <= max_cut_m[: k + 1 - index]).all()
        ),
        nearest,
    )
    x_m, y_m, _, heading_rad = trajectory.poses[ahead].tolist()
    return SE2(x_m, y_m, heading_rad), index


def end_of_current_leg(trajectory: RefinedTrajectory, index: int) -> int:
    """Return the index of the last pose of the leg that contains a pose."""
    return end_of_leg(trajectory, int(trajectory.leg[index]))


def end_of_leg(trajectory: RefinedTrajectory, leg: int) -> int:
    """Return the index of the last pose of a leg; if it has no pose, of the last pose before it."""
    return max(int(np.searchsorted(trajectory.leg, leg, side="right")) - 1, 0)


def index_at_goal(trajectory: RefinedTrajectory, goal: SE2, from_index: int) -> int:
    """Return the robot's index on the path after the controller reported a goal as reached.

    `from_index` is the index before. If the goal was the end of a leg, the index is after this end.
    Else it is at the goal, but not after the end of the leg.
    """
    # Poses that equal the goal in x, y and heading (columns 0, 1 and 3).
    at = np.flatnonzero(
        (trajectory.poses[from_index:, [0, 1, 3]] == (goal.x_m, goal.y_m, goal.yaw_rad)).all(axis=1)
    )
    end, last = end_of_current_leg(trajectory, from_index), len(trajectory.poses) - 1
    index = from_index + int(at[0]) if len(at) else from_index
    return min(end + 1, last) if index == end else min(index, end)


def _deviation_m(path_m: np.ndarray, from_m: np.ndarray) -> np.ndarray:
    """Return the distance (n,) of each point of a path (n, 2) from the straight line to its end."""
    line, offset = path_m[-1] - from_m, path_m - from_m
    along = np.clip(offset @ line / max(float(line @ line), 1e-12), 0.0, 1.0)
    return np.hypot(*(offset - along[:, None] * line).T)


def blocked_ahead_m(trajectory: RefinedTrajectory, view: MapView, index: int = 0) -> float | None:
    """Return how far along the path, from `index` on, the robot would hit something now.

    The cost depends on the length `CHECKED_M`, not on the size of the map.

    Args:
        trajectory: the trajectory.
        view: its inflated cells block. Unknown cells and cells outside its window do not.
        index: pose that the robot has reached.

    Returns:
        Metres to the first blocked pose; None if the path is free.
    """
    path_m = trajectory.poses[index:, :2]
    path_m = path_m[: index_ahead(path_m, 0, CHECKED_M) + 1]
    window, (ox, oy), n = view.window, view.window.origin, view.window.n
    x, y = np.floor(path_m / window.resolution_m).astype(np.int64).T
    blocked = view.layers.near[y % n, x % n] > 0
    blocked &= (x >= ox) & (x < ox + n) & (y >= oy) & (y < oy + n)
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(path_m, axis=0).T)))
    if blocked[0]:
        # The robot is too close to an obstacle already, and the path leads away from it.
        blocked &= along_m > ESCAPE_M
    return float(along_m[np.argmax(blocked)]) if blocked.any() else None


def path_message(
    trajectory: RefinedTrajectory | None, stamp_ns: int, frame_id: str = "map"
) -> bytes:
    """Encode a trajectory as nav_msgs/Path; None gives an empty path."""
    if trajectory is None:
        return encode_path(stamp_ns, frame_id, np.empty((0, 3)))
    x_m, y_m, z_m, heading_rad = trajectory.poses.T
    return encode_path(stamp_ns, frame_id, np.column_stack([x_m, y_m, heading_rad]), z_m)

"""A refined trajectory as it is driven: a goal that moves ahead of the robot, what blocks it."""

from __future__ import annotations

import math

import numpy as np

from edge.bus.wire.transforms import encode_path
from edge.geometry import SE2
from edge.mapping.view import MapView
from edge.tasks.ground import ESCAPE_M
from edge.tasks.refine import Refined
from edge.trajectory.pursuit import index_ahead, nearest_index

LOST_M = 3.0
"""The robot is looked for on so much of the path ahead, so that where a path crosses itself no part
of it is left out."""
LOOK_M = 10.0
"""So much of the path ahead is looked at for what blocks it."""


CUT_M = 0.25
"""A controller that drives straight to the goal leaves the path by so much at most, beyond what the
robot is off it already: what was checked is the path."""
LEAST_M = 0.5
"""A goal no nearer than this keeps a robot moving through a bend."""
PASSED_M = 0.14
"""A leg is driven once the robot was so near to its last pose, which lies within half of
`edge.tasks.refine.SPACING_M` of its end: 0.2 m."""
CUT_END_M = 0.1
"""The straight way to a goal leads so near past the end of a leg: the robot is to come to it."""


def goal_ahead(
    trajectory: Refined,
    pose: SE2,
    look_ahead_m: float,
    since: int = 0,
    until: int | None = None,
) -> tuple[SE2, int]:
    """Return the goal ahead of the robot, and where the robot is on the path.

    The goal is the farthest pose within `look_ahead_m` along the path that can be driven to
    straight without cutting a bend (`CUT_M`). The robot passes no leg's end before it was within
    `PASSED_M` of it: where the path doubles back, the way back is as near as the way there.

    Args:
        since: the index that the last call gave; the robot is not looked for before it.
        until: index of the last pose that may be driven to; None: the end.

    Returns:
        The goal, the last pose near the end, and the index of the robot's nearest pose.
    """
    path_m = trajectory.poses[: None if until is None else until + 1, :2]
    robot_m = np.array([pose.x_m, pose.y_m])
    end = min(leg_end(trajectory, since), len(path_m) - 1)
    window = index_ahead(path_m, since, LOST_M)
    index = nearest_index(path_m[: min(window, end) + 1], pose.x_m, pose.y_m, since)
    while end < min(window, len(path_m) - 1) and math.dist(robot_m, path_m[end]) <= PASSED_M:
        begin, end = end + 1, min(leg_end(trajectory, end + 1), len(path_m) - 1)
        index = nearest_index(path_m[: min(window, end) + 1], pose.x_m, pose.y_m, begin)
    least = min(index_ahead(path_m, index, min(LEAST_M, look_ahead_m)), end)
    most = index_ahead(path_m, index, look_ahead_m)
    may_m = np.full(most - index + 1, CUT_M + math.dist(robot_m, path_m[index]))
    may_m[:-1][np.diff(trajectory.leg[index : most + 1]) > 0] = CUT_END_M
    ahead = next(
        (
            k
            for k in range(most, least, -1)
            if (_cut_m(path_m[index : k + 1], robot_m) <= may_m[: k + 1 - index]).all()
        ),
        least,
    )
    x_m, y_m, _, heading_rad = trajectory.poses[ahead].tolist()
    return SE2(x_m, y_m, heading_rad), index


def leg_end(trajectory: Refined, index: int) -> int:
    """The index of the last pose of the leg that a pose is in."""
    return end_of(trajectory, int(trajectory.leg[index]))


def end_of(trajectory: Refined, leg: int) -> int:
    """The index of the pose at which a leg ends: of a leg without any, where it begins."""
    return max(int(np.searchsorted(trajectory.leg, leg, side="right")) - 1, 0)


def index_at_goal(trajectory: Refined, goal: SE2, since: int) -> int:
    """Where the robot is on the path when the controller says that it reached a goal of it.

    Args:
        since: where it was before.

    Returns:
        Behind the end of a leg where that was the goal; else at the goal, but behind no leg's end.
    """
    at = np.flatnonzero(
        (trajectory.poses[since:, [0, 1, 3]] == (goal.x_m, goal.y_m, goal.yaw_rad)).all(axis=1)
    )
    end, last = leg_end(trajectory, since), len(trajectory.poses) - 1
    index = since + int(at[0]) if len(at) else since
    return min(end + 1, last) if index == end else min(index, end)


def _cut_m(path_m: np.ndarray, from_m: np.ndarray) -> np.ndarray:
    """How far each point of a path (n, 2) lies from the straight line to its end: (n,)."""
    way, off = path_m[-1] - from_m, path_m - from_m
    along = np.clip(off @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    return np.hypot(*(off - along[:, None] * way).T)


def blocked_ahead_m(trajectory: Refined, map: MapView, index: int = 0) -> float | None:
    """How far along the path from `index` on the robot would touch something, at this instant.

    Costs with what is looked at of the path, `LOOK_M`, and not with the map.

    Args:
        map: tells what is nearer to something occupied than it inflates that by. Where nobody has
            looked, and outside its window, nothing is known, and nothing blocks.

    Returns:
        Metres to the first such pose; None: free.
    """
    path_m = trajectory.poses[index:, :2]
    path_m = path_m[: index_ahead(path_m, 0, LOOK_M) + 1]
    window, (ox, oy), n = map.window, map.window.origin, map.window.n
    x, y = np.floor(path_m / window.resolution_m).astype(np.int64).T
    blocked = map.layers.near[y % n, x % n] > 0
    blocked &= (x >= ox) & (x < ox + n) & (y >= oy) & (y < oy + n)
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(path_m, axis=0).T)))
    if blocked[0]:
        # The robot is too near already, and the path leads out.
        blocked &= along_m > ESCAPE_M
    return float(along_m[np.argmax(blocked)]) if blocked.any() else None


def path_message(trajectory: Refined | None, stamp_ns: int, frame_id: str = "map") -> bytes:
    """nav_msgs/Path; without a trajectory an empty one."""
    if trajectory is None:
        return encode_path(stamp_ns, frame_id, np.empty((0, 3)))
    x_m, y_m, z_m, heading_rad = trajectory.poses.T
    return encode_path(stamp_ns, frame_id, np.column_stack([x_m, y_m, heading_rad]), z_m)

"""A refined trajectory as it is driven: a goal that moves ahead of the robot, what blocks it."""

from __future__ import annotations

import numpy as np

from edge.bus.wire.transforms import encode_path
from edge.geometry import SE2, Grid
from edge.motion.pursuit import index_ahead, nearest_index
from edge.tasks.ground import ESCAPE_M
from edge.tasks.refine import Refined
from edge.tasks.value_map import closed_cells

LOST_M = 3.0
"""The robot is looked for on so much of the path ahead, so that where a path crosses itself no part
of it is left out."""


def goal_ahead(
    trajectory: Refined, pose: SE2, look_ahead_m: float, since: int = 0
) -> tuple[SE2, int]:
    """The pose on the path that lies `look_ahead_m` ahead of the robot, and where the robot is.

    Args:
        since: the index that the last call gave; the robot is not looked for before it.

    Returns:
        The goal, the last pose near the end, and the index of the robot's nearest pose.
    """
    path_m = trajectory.poses[:, :2]
    window = path_m[: index_ahead(path_m, since, LOST_M) + 1]
    index = nearest_index(window, pose.x_m, pose.y_m, since)
    x_m, y_m, _, heading_rad = trajectory.poses[index_ahead(path_m, index, look_ahead_m)].tolist()
    return SE2(x_m, y_m, heading_rad), index


def blocked_ahead_m(
    trajectory: Refined, occupancy: Grid, clearance_m: float, index: int = 0
) -> float | None:
    """How far along the path from `index` on the robot would come too near to something.

    Args:
        occupancy: int8 of this instant; outside it and where nobody has looked nothing is known,
            and nothing blocks.
        clearance_m: as the trajectory was refined with.

    Returns:
        Metres to the first such pose; None: free to the end.
    """
    path_m = trajectory.poses[index:, :2]
    cells = np.floor(occupancy.of_metres(path_m)).astype(np.int64)
    inside = ((cells >= 0) & (cells < occupancy.cells.shape[::-1])).all(axis=1)
    blocked = np.zeros(len(path_m), bool)
    blocked[inside] = closed_cells(occupancy, clearance_m)[cells[inside, 1], cells[inside, 0]]
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(path_m, axis=0).T)))
    if blocked[0]:
        # The robot is too near already, and the path leads out.
        blocked &= along_m > ESCAPE_M
    return float(along_m[np.argmax(blocked)]) if blocked.any() else None


def path_message(trajectory: Refined, stamp_ns: int, frame_id: str = "map") -> bytes:
    """nav_msgs/Path."""
    x_m, y_m, z_m, heading_rad = trajectory.poses.T
    return encode_path(stamp_ns, frame_id, np.column_stack([x_m, y_m, heading_rad]), z_m)

"""Recovery of a robot that does not move: drive back the way it came, else back up, else turn.

If that does not move it, the next attempt drives away from the blocked cells around it. Blocked are
cells of the cost map that the robot may not enter.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from edge.geometry import SE2, wrap_angle
from edge.trajectory.costmap import CostMap
from edge.trajectory.pursuit import TURN_GAIN, MotionLimits, VelocityCommand, turn_by

BACK_MPS = 0.12  # speed on the way back
BACK_M = 0.3  # length of the way back
AWAY_M = 0.15  # length of the way from the blocked cells within `BACK_M`
HELD_M = 0.05  # a robot that moved less in an attempt was held by something
TURN_RAD = 0.6  # angle to turn, if there is no way back
TIME_NS = 5_000_000_000  # longest time of an attempt
FACING_RAD = 0.5  # with a larger bearing of the trail, turn to it before driving
STEP_M = 0.05  # distance between two points of the trail
JUMP_M = 0.5  # a longer step is a jump of the pose
MAX_POINTS = 40  # of the trail


class BacktrackPath:
    """Trail of the robot: the last metres that it drove, without loops.

    Attributes:
        xy_m: points `STEP_M` apart, oldest first.
    """

    def __init__(self) -> None:
        self.xy_m: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)

    def extend(self, pose: SE2) -> None:
        """Add the pose if the robot moved; start again after a jump.

        If the robot comes back to the trail, the loop since then is removed.
        """
        moved_m = pose.distance_to(*self.xy_m[-1]) if self.xy_m else math.inf
        if moved_m > JUMP_M:
            self.xy_m.clear()
        if moved_m < STEP_M:
            return
        # Index of the first point that the robot has come back to; -1 for none.
        back_at = next((i for i, at in enumerate(self.xy_m) if pose.distance_to(*at) < STEP_M), -1)
        if back_at < 0:
            self.xy_m.append((pose.x_m, pose.y_m))
        else:
            while len(self.xy_m) > back_at + 1:
                self.xy_m.pop()

    def back_from(self, pose: SE2) -> list[tuple[float, float]]:
        """Return the path back from a pose, nearest point first, to the first point `BACK_M` away.

        The path is empty if the trail is shorter.
        """
        path: list[tuple[float, float]] = []
        for at in reversed(self.xy_m):
            away_m = pose.distance_to(*at)
            if away_m >= STEP_M:
                path.append(at)
            if away_m >= BACK_M:
                break
        return path if path and pose.distance_to(*path[-1]) >= BACK_M else []


class Recovery:
    """One recovery attempt, at most `TIME_NS` long.

    The robot drives back along its trail, in reverse if this needs less turning. If it has not been
    `BACK_M` away, it backs up straight if the map is free there, else it turns.

    The trail is None if the way back did not move the robot. It then drives away from the blocked
    cells around it, if the map is free there, else it turns.
    """

    def __init__(
        self,
        pose: SE2,
        costmap: CostMap | None,
        trail: BacktrackPath | None,
        limits: MotionLimits,
        now_ns: int,
    ) -> None:
        self._start, self._since_ns, self._limits = pose, now_ns, limits
        self._path = [] if trail is None else trail.back_from(pose)
        if not self._path and costmap is not None:
            place = _away_from_blocked(costmap, pose) if trail is None else pose.ahead(-BACK_M)
            self._path = [place] if costmap.is_free(*place) else []
        self._turns = not self._path  # the attempt only turns
        self._drove_back = False  # True once it drove in reverse

    def is_held(self, pose: SE2) -> bool:
        """Return True if the attempt drove in reverse and the robot has not moved."""
        return self._drove_back and not self.has_moved(pose)

    def has_moved(self, pose: SE2) -> bool:
        """Return True if the attempt has moved the robot."""
        return pose.distance_to(self._start.x_m, self._start.y_m) >= HELD_M

    def step(self, pose: SE2, now_ns: int) -> VelocityCommand | None:
        """Return the command for now; None if the attempt is over."""
        if not 0 <= now_ns - self._since_ns < TIME_NS:
            return None
        if self._turns:
            left = TURN_RAD - abs(wrap_angle(pose.yaw_rad - self._start.yaw_rad))
            return None if left <= 0.05 else turn_by(left, self._limits)
        while self._path and pose.distance_to(*self._path[0]) < STEP_M:
            self._path.pop(0)
        if not self._path or pose.distance_to(self._start.x_m, self._start.y_m) >= BACK_M:
            return None
        error = pose.bearing_to(*self._path[0])
        reverse = abs(error) > 0.5 * math.pi  # the point is behind the robot
        if reverse:
            error = wrap_angle(error + math.pi)
        if abs(error) > FACING_RAD:
            return turn_by(error, self._limits)
        self._drove_back = reverse
        return self._limits.clip(-BACK_MPS if reverse else BACK_MPS, TURN_GAIN * error)


def _away_from_blocked(costmap: CostMap, pose: SE2) -> tuple[float, float]:
    """Return the place `AWAY_M` from the robot, away from the blocked cells within `BACK_M`.

    Near cells count most: each pushes with the inverse of its distance. Without a blocked cell, the
    place is behind the robot.
    """
    rows, columns = np.nonzero(costmap.weight == 0)  # weight 0: blocked
    xy_m = costmap.metres_of(np.stack((columns, rows), axis=1) + 0.5)
    from_m = np.array((pose.x_m, pose.y_m)) - xy_m
    distance_m = np.hypot(*from_m.T)
    near = (distance_m > 0.0) & (distance_m <= BACK_M)
    x, y = (from_m[near] / np.square(distance_m[near, None])).sum(axis=0).tolist()
    if math.hypot(x, y) < 1e-9:
        return pose.ahead(-AWAY_M)
    return SE2(pose.x_m, pose.y_m, math.atan2(y, x)).ahead(AWAY_M)

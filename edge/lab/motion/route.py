"""The route to a goal: plans a path on the newest map, and follows it."""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import SE2
from edge.trajectory import astar, costmap, smoothing
from edge.trajectory.pursuit import (
    STOP,
    MotionLimits,
    VelocityCommand,
    index_ahead,
    length_m,
    nearest_index,
    pursue,
    turn_by,
)

GOAL_TOLERANCE_M = 0.12  # distance from a goal within which it is reached
NEAR_M = 0.4  # cells within this distance of an obstacle cost more
LOOKAHEAD_M = 0.45  # distance along the path to the point that the robot aims at
REPLAN_S = 0.5  # longest time between two plans of a path
GIVE_UP_NS = 3_000_000_000  # a goal without a path for longer fails
AIM_FRACTIONS = (1.0, 0.6, 0.35)  # of `LOOKAHEAD_M`, tried until the straight line is free
SAFE_M = 0.3  # length of path ahead that must be free in the newest map
DRIFT_M = 0.4  # farther off the path than this: plan again
BETTER_SHARE = 0.85  # a new path must cost less than this share of the old path's rest
SNAP_M = 0.25  # a goal that a newer map has blocked moves at most this far
ARC_TIMES_S = (0.15, 0.3, 0.45)  # times along a command's arc at which cells must be free
CAREFUL_MPS = 0.15  # speed if no arc is free, for example if the robot is inside an obstacle
FACING_RAD = 0.2  # with a larger bearing of the path, a careful robot turns on the spot
# The robot drives until it is within this share of the goal tolerance; then it stops and turns.
ARRIVE_SHARE = 0.7


class Route:
    """The path to one goal.

    Attributes:
        limits: highest speeds and accelerations.
        map: the newest map; None: there is none yet.
        path_m: (n, 2) float64, the path that the robot follows; (0, 2) if there is none.
        target: x and y of the goal, or of a free cell next to it, see `SNAP_M`.
    """

    def __init__(self, limits: MotionLimits) -> None:
        self.map: costmap.CostMap | None = None
        self.limits = limits
        self._workspace = astar.Workspace()
        self.start(None)

    def start(self, goal: SE2 | None) -> None:
        """Start with a goal, or with none."""
        self.target = self._goal_m = (goal.x_m, goal.y_m) if goal else (0.0, 0.0)
        self._arrived = False
        self.pause()
        self.drop_path()

    def pause(self) -> None:
        """Do not count the time of a pause as time without a path."""
        self._no_path_since_ns: int | None = None

    def drop_path(self) -> None:
        """Forget the path; the next step plans a new one."""
        self.path_m = np.empty((0, 2))
        self._index = 0  # of the path's point nearest to the robot
        self._planned_ns: int | None = None  # None: plan at the next step

    def on_map(self, newest: costmap.CostMap) -> None:
        """Use a newer map; if it blocks the path, plan again at the next step."""
        self.map = newest
        if len(self.path_m) and not self._is_path_free():
            self._planned_ns = None

    def has_arrived(self, pose: SE2) -> bool:
        """Return True near the goal.

        The tolerance is larger once the robot has arrived, so that turning there does not restart
        driving.
        """
        tolerance = GOAL_TOLERANCE_M * (1.0 if self._arrived else ARRIVE_SHARE)
        self._arrived = pose.distance_to(*self.target) <= tolerance
        return self._arrived

    def is_due(self, pose: SE2, now_ns: int) -> bool:
        """Return True if the last plan is too old, or the robot is too far from its path."""
        if self._planned_ns is None or now_ns - self._planned_ns >= REPLAN_S * 1e9:
            return True
        return len(self.path_m) > 0 and pose.distance_to(*self.path_m[self._index]) > DRIFT_M

    def _is_path_free(self) -> bool:
        """Return True if the rest of the path is free in the newest map.

        Blocked cells at its start do not count: the robot is in them and drives out.
        """
        rest = self.path_m[self._index :]
        free = [self.map.is_free(*point) for point in rest]
        return any(free) and all(free[free.index(True) :])

    def plan(self, pose: SE2, now_ns: int) -> str:
        """Plan a path; keep the old one unless it is blocked or clearly worse.

        Returns:
            Why the goal fails, if there was no path for `GIVE_UP_NS`; else "".
        """
        self._planned_ns = now_ns
        if self.map is None:
            return self._wait("no map", now_ns)
        self.target = self._free_target()
        found = astar.plan(self.map, (pose.x_m, pose.y_m), self.target, self._workspace)
        old_cost = self._remaining_cost_m(pose)
        if found.ok:
            self._no_path_since_ns = None
            path = smoothing.smooth(self.map, found.path_m)
            is_better = smoothing.polyline_cost_m(self.map, path) < BETTER_SHARE * old_cost
            if is_better or found.escape_m:  # the path begins in blocked cells
                self.path_m, self._index = path, 0
        elif math.isinf(old_cost):
            self.path_m, self._index = np.empty((0, 2)), 0
            return self._wait(found.reason, now_ns)
        return ""

    def _wait(self, reason: str, now_ns: int) -> str:
        """Return why there is no path, if there was none for `GIVE_UP_NS`; else ""."""
        if self._no_path_since_ns is None or now_ns < self._no_path_since_ns:
            self._no_path_since_ns = now_ns
        return reason if now_ns - self._no_path_since_ns >= GIVE_UP_NS else ""

    def _free_target(self) -> tuple[float, float]:
        """Return x and y of the goal, or of the nearest free cell if a newer map has blocked it."""
        goal = self._goal_m
        cell = self.map.cell_of(*goal)
        if cell is None or self.map.weight[cell] != 0:  # off the map, or free (weight 0: blocked)
            return goal
        cell = astar.nearest_free(self.map, cell, goal, SNAP_M)
        if cell is None:
            return goal
        x, y = self.map.metres_of(np.array([cell[1] + 0.5, cell[0] + 0.5]))
        return float(x), float(y)

    def _remaining_cost_m(self, pose: SE2) -> float:
        """Return the cost of the rest of the path: its length, more in cells near obstacles.

        It is inf if the path is empty, blocked, far away, or leads to another target.
        """
        if not len(self.path_m) or math.dist(self.path_m[-1], self.target) > 1e-6:
            return math.inf
        if pose.distance_to(*self.path_m[self._index]) > DRIFT_M:
            return math.inf
        return smoothing.polyline_cost_m(self.map, self.path_m[self._index :])

    def follow(self, pose: SE2, remaining_m: float) -> VelocityCommand:
        """Aim as far along the path as a straight line is free."""
        here = (pose.x_m, pose.y_m)
        escaping = not self.map.is_free(*here)  # the robot is in blocked cells
        ahead = self.path_m[self._index : index_ahead(self.path_m, self._index, SAFE_M) + 1]
        # Stop before a newly blocked path. A robot in blocked cells must drive to get out of them.
        if not escaping and math.isinf(smoothing.polyline_cost_m(self.map, ahead)):
            self._planned_ns = None
            return STOP
        for fraction in AIM_FRACTIONS:
            k = index_ahead(self.path_m, self._index, fraction * LOOKAHEAD_M)
            aim = (float(self.path_m[k, 0]), float(self.path_m[k, 1]))
            command = pursue(pose, *aim, remaining_m, self.limits)
            if smoothing.line_is_free(self.map, here, aim) and self._is_clear(pose, command):
                return command
        # Every arc touches an obstacle: face the nearest aim, then creep towards it.
        bearing = pose.bearing_to(*aim)
        if abs(bearing) > FACING_RAD:
            return turn_by(bearing, self.limits)
        scale = CAREFUL_MPS / max(command.v_mps, CAREFUL_MPS)
        return VelocityCommand(command.v_mps * scale, command.w_radps * scale)

    def _is_clear(self, pose: SE2, command: VelocityCommand) -> bool:
        """Return True if the arc of a command stays on free cells at all times of `ARC_TIMES_S`."""
        for t_s in ARC_TIMES_S:
            yaw = pose.yaw_rad + 0.5 * command.w_radps * t_s
            x = pose.x_m + command.v_mps * t_s * math.cos(yaw)
            y = pose.y_m + command.v_mps * t_s * math.sin(yaw)
            if not self.map.is_free(x, y):
                return False
        return True

    def remaining_m(self, pose: SE2) -> float:
        """Find the path's point nearest to a pose; return the length of the path from there."""
        near = self.path_m[: index_ahead(self.path_m, self._index, 4 * LOOKAHEAD_M) + 1]
        self._index = nearest_index(near, pose.x_m, pose.y_m, self._index)
        rest = self.path_m[self._index :]
        return length_m(rest) + pose.distance_to(*rest[0])

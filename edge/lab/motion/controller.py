"""Reference motion controller as a state machine: plans on the published map, drives to goals.

It needs no Zenoh and no clock: `step` gets the time as an argument. `edge/lab/motion/process.py`
runs it as a process.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import replace

import numpy as np

from edge import config
from edge.geometry import SE2, Grid, wrap_angle
from edge.lab.motion.progress import ContactDetector, ProgressMonitor
from edge.lab.motion.recovery import BacktrackPath, Recovery
from edge.stuck import STUCK_M, StuckDetector
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
    turn_to,
)
from edge.types import GoalStatus

log = logging.getLogger("edge.lab.motion")

# A goal is reached within both tolerances.
GOAL_TOLERANCE_M, YAW_TOLERANCE_RAD = 0.12, 0.15
NEAR_M = 0.4  # cells within this distance of an obstacle cost more
LOOKAHEAD_M = 0.45  # distance along the path to the point that the robot aims at
REPLAN_S = 0.5  # longest time between two plans of a path
GIVE_UP_NS = 3_000_000_000  # a goal without a path for longer fails
CONTACT_M = 0.3  # commanded distance without movement that counts as contact with an obstacle
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
# A goal fails if the robot gets stuck again nearer than this to its last recovery: after a
# standstill, or after a contact.
REPEAT_M, REPEAT_CONTACT_M = 1.0, 0.3
STILL_MPS, STILL_RADPS = 0.03, 0.1  # a robot that is not faster stands still
MIN_CELL_M, MAX_CELL_M = 0.001, 10.0  # limits of a usable map's resolution
RESTART_NS = 1_000_000_000  # a larger step back in time is a restart, a larger step on is a gap
MAX_REPLACED = 64  # number of replaced goals to remember


class Controller:
    """State machine that drives to one goal at a time.

    The goal that came last replaces the one before. The stamps of goals do not decide which is
    newer: two services, or one service whose clock was set, give stamps that cannot be compared.
    Each goal is answered `accepted`, then `reached` or `failed` with a reason. If a goal is sent
    again, its current status is sent again. If the robot was commanded to drive but was held up,
    the answer has the place (`blocked`).

    Example:
        >>> from edge.config import parse
        >>> controller = Controller(parse({"perception": {"detector": {"kind": "sim"}}}))
        >>> [status.state for status in controller.on_goal(1, SE2(1.0, 0.0, 0.0))]
        ['accepted']
    """

    def __init__(self, settings: config.Config) -> None:
        self._motion = settings.motion
        self._limits = MotionLimits.of(settings.robot)
        self._workspace = astar.Workspace()
        self._map: costmap.CostMap | None = None  # the newest one
        self._stuck = StuckDetector(settings.motion.stuck_s)
        self._contact = ContactDetector(CONTACT_M, STUCK_M)
        self._progress = ProgressMonitor(6 * settings.motion.stuck_s)
        self._radius_m = settings.robot.radius_m
        self._trail = BacktrackPath()  # the last metres that the robot drove
        self._recovery_failed_at: SE2 | None = None  # pose, if the last recovery did not move it
        self._now_ns: int | None = None
        self._last_command = STOP
        self._goal: SE2 | None = None  # None: the robot stands
        self._newest_goal: tuple[int, SE2] | None = None  # stamp and pose, also after its end
        self._replaced: deque[tuple[int, SE2]] = deque(maxlen=MAX_REPLACED)
        self._status: GoalStatus | None = None  # of the newest goal
        self._blocked: tuple[float, float] | None = None  # where this step was held up
        self._start_goal(None)

    def _start_goal(self, goal: SE2 | None) -> None:
        """Start with a goal, or with none; reset all state of the goal before."""
        self._goal = goal
        self._target = (goal.x_m, goal.y_m) if goal else (0.0, 0.0)  # see `_free_target`
        self._arrived = False
        self._recovery: Recovery | None = None
        self._last_recovery_at: SE2 | None = None
        self._no_path_since_ns: int | None = None
        # Not for a new goal: a blocked robot that gets one goal after another is still stuck.
        if goal is None:
            self._stuck.reset()
            self._contact.reset()
        self._progress.reset()
        self._drop_path()

    def _drop_path(self) -> None:
        """Forget the path; the next step plans a new one."""
        self._path = np.empty((0, 2))
        self._path_index = 0  # of the path's point nearest to the robot
        self._planned_ns: int | None = None  # None: plan at the next step

    @property
    def path_m(self) -> np.ndarray:
        """(n, 2) float64, the path that the robot follows; (0, 2) if there is none."""
        return self._path

    # -- inputs ---------------------------------------------------------------------------------

    def on_map(self, grid: Grid) -> None:
        """Use a newer map; if it blocks the path, plan again at the next step.

        Raises:
            ValueError: the map cannot be used; the map before stays.
        """
        if not MIN_CELL_M <= grid.resolution_m <= MAX_CELL_M:
            raise ValueError(
                f"resolution of the map: expected {MIN_CELL_M:g} to {MAX_CELL_M:g} m, got "
                f"{grid.resolution_m:g} m"
            )
        clearance_m = self._motion.clearance_m
        self._map = costmap.from_occupancy(grid, clearance_m=clearance_m, near_m=NEAR_M)
        if len(self._path) and not self._is_path_free():
            self._planned_ns = None

    def on_goal(self, stamp_ns: int, goal: SE2) -> list[GoalStatus]:
        """Start a new goal, or answer again for a repeated one; return the answers."""
        received = (stamp_ns, goal)
        if received == self._newest_goal:
            return [self._status]
        if received in self._replaced:
            return [GoalStatus(stamp_ns, "failed", "replaced by a newer goal")]
        if not _is_finite(goal):
            return [GoalStatus(stamp_ns, "failed", "goal pose is not finite")]
        if self._newest_goal is not None:
            self._replaced.append(self._newest_goal)
        self._newest_goal = received
        self._start_goal(goal)
        self._status = GoalStatus(stamp_ns, "accepted")
        return [self._status]

    def step(
        self, pose: SE2, v_mps: float, w_radps: float, now_ns: int
    ) -> tuple[VelocityCommand, list[GoalStatus]]:
        """Run one control step.

        Returns:
            The command until the next step, and answers to the goal (none, or one).
        """
        dt_s = self._advance_time(now_ns)
        wanted, answers = STOP, []
        self._blocked = None
        if _is_finite(pose):
            self._trail.extend(pose)
        if self._goal is not None and _is_finite(pose):
            before = self._status
            still = abs(v_mps) <= STILL_MPS and abs(w_radps) <= STILL_RADPS
            wanted = self._drive(self._goal, pose, still, dt_s, now_ns)
            if self._status is not before or self._blocked is not None:
                # Report the place once; the stored status does not have it.
                answers = [replace(self._status, blocked=self._blocked)]
        last = self._last_command
        self._last_command = self._limits.ramp(wanted, last, dt_s) if wanted.moves else STOP
        return self._last_command, answers

    def pause(self) -> None:
        """Stop outside of a step: keep the goal, and do not count the standstill as being stuck."""
        self._last_command = STOP
        self._recovery = None
        self._no_path_since_ns = None
        self._stuck.reset()
        self._contact.reset()
        self._progress.reset()

    def _advance_time(self, now_ns: int) -> float:
        """Handle a new stamp (restart, gap or normal step); return the step's length in s."""
        last = now_ns if self._now_ns is None else self._now_ns
        if now_ns < last - RESTART_NS:
            self._start_goal(None)
            self._newest_goal = self._status = self._map = None
            self._replaced.clear()
        elif now_ns > last + RESTART_NS:
            self.pause()  # the robot's motion during the gap is unknown
        self._now_ns = now_ns
        # A first step, or one after a gap, may change the speed like any other.
        return min(max((now_ns - last) / 1e9, 1.0 / self._motion.rate_hz), 0.2)

    # -- driving --------------------------------------------------------------------------------

    def _drive(
        self, goal: SE2, pose: SE2, still: bool, dt_s: float, now_ns: int
    ) -> VelocityCommand:
        """Return the command of this step: recover, turn to the goal's heading, or drive on."""
        if self._recovery is not None:
            command = self._recovery.step(pose, now_ns)
            if command is not None:
                return command
            if self._recovery.is_held(pose):  # something behind the robot blocks it
                self._blocked = pose.ahead(-self._radius_m)
            # If no attempt moved the robot here, the next one takes another way (`_recover`).
            self._recovery_failed_at = None if self._recovery.has_moved(pose) else pose
            self._recovery = None
            self._contact.reset()
            self._drop_path()
        if self._contact.update(pose, self._last_command.v_mps, dt_s):
            return self._recover(pose, REPEAT_CONTACT_M, now_ns)
        if self._has_arrived(pose):
            command = self._align(goal, pose, still)
        else:
            command = self._travel(pose, now_ns)
        if self._goal is not None and self._stuck.update(pose, self._last_command.moves, now_ns):
            return self._recover(pose, REPEAT_M, now_ns)
        return command

    def _has_arrived(self, pose: SE2) -> bool:
        """Return True near the goal.

        The tolerance is larger once the robot has arrived, so that turning there does not restart
        driving.
        """
        tolerance = GOAL_TOLERANCE_M * (1.0 if self._arrived else ARRIVE_SHARE)
        self._arrived = pose.distance_to(*self._target) <= tolerance
        return self._arrived

    def _align(self, goal: SE2, pose: SE2, still: bool) -> VelocityCommand:
        """Turn to the goal's heading; the goal is reached when the robot stands still there."""
        error = abs(wrap_angle(goal.yaw_rad - pose.yaw_rad))
        if still and error <= YAW_TOLERANCE_RAD:
            self._finish("reached")
            return STOP
        # Stop well inside the tolerance, so that coasting does not leave it.
        return (
            STOP if error <= 0.5 * YAW_TOLERANCE_RAD else turn_to(pose, goal.yaw_rad, self._limits)
        )

    def _travel(self, pose: SE2, now_ns: int) -> VelocityCommand:
        """Drive along the path; plan first if it is time for that."""
        if self._is_plan_due(pose, now_ns):
            self._plan(pose, now_ns)
        if self._goal is None or not len(self._path):
            return STOP
        remaining = self._remaining_m(pose)
        if not self._progress.update(remaining, now_ns):
            self._finish("failed", "no progress towards the goal")
            return STOP
        return self._follow(pose, remaining)

    def _follow(self, pose: SE2, remaining_m: float) -> VelocityCommand:
        """Aim as far along the path as a straight line is free."""
        here = (pose.x_m, pose.y_m)
        escaping = not self._map.is_free(*here)  # the robot is in blocked cells
        ahead = self._path[self._path_index : index_ahead(self._path, self._path_index, SAFE_M) + 1]
        # Stop before a newly blocked path. A robot in blocked cells must drive to get out of them.
        if not escaping and math.isinf(smoothing.polyline_cost_m(self._map, ahead)):
            self._planned_ns = None
            return STOP
        for fraction in AIM_FRACTIONS:
            k = index_ahead(self._path, self._path_index, fraction * LOOKAHEAD_M)
            aim = (float(self._path[k, 0]), float(self._path[k, 1]))
            command = pursue(pose, *aim, remaining_m, self._limits)
            if smoothing.line_is_free(self._map, here, aim) and self._is_clear(pose, command):
                return command
        # Every arc touches an obstacle: face the nearest aim, then creep towards it.
        bearing = pose.bearing_to(*aim)
        if abs(bearing) > FACING_RAD:
            return turn_by(bearing, self._limits)
        scale = CAREFUL_MPS / max(command.v_mps, CAREFUL_MPS)
        return VelocityCommand(command.v_mps * scale, command.w_radps * scale)

    def _is_clear(self, pose: SE2, command: VelocityCommand) -> bool:
        """Return True if the arc of a command stays on free cells at all times of `ARC_TIMES_S`."""
        for t_s in ARC_TIMES_S:
            yaw = pose.yaw_rad + 0.5 * command.w_radps * t_s
            x = pose.x_m + command.v_mps * t_s * math.cos(yaw)
            y = pose.y_m + command.v_mps * t_s * math.sin(yaw)
            if not self._map.is_free(x, y):
                return False
        return True

    def _remaining_m(self, pose: SE2) -> float:
        """Update `_path_index` for a pose; return the length of the path from there."""
        near = self._path[: index_ahead(self._path, self._path_index, 4 * LOOKAHEAD_M) + 1]
        self._path_index = nearest_index(near, pose.x_m, pose.y_m, self._path_index)
        rest = self._path[self._path_index :]
        return length_m(rest) + pose.distance_to(*rest[0])

    # -- planning -------------------------------------------------------------------------------

    def _is_plan_due(self, pose: SE2, now_ns: int) -> bool:
        """Return True if the last plan is too old, or the robot is too far from its path."""
        if self._planned_ns is None or now_ns - self._planned_ns >= REPLAN_S * 1e9:
            return True
        return len(self._path) > 0 and pose.distance_to(*self._path[self._path_index]) > DRIFT_M

    def _is_path_free(self) -> bool:
        """Return True if the rest of the path is free in the newest map.

        Blocked cells at its start do not count: the robot is in them and drives out.
        """
        rest = self._path[self._path_index :]
        free = [self._map.is_free(*point) for point in rest]
        return any(free) and all(free[free.index(True) :])

    def _plan(self, pose: SE2, now_ns: int) -> None:
        """Plan a path; keep the old one unless it is blocked or clearly worse."""
        self._planned_ns = now_ns
        if self._map is None:
            self._on_no_path("no map", now_ns)
            return
        self._target = self._free_target()
        found = astar.plan(self._map, (pose.x_m, pose.y_m), self._target, self._workspace)
        old_cost = self._remaining_cost_m(pose)
        if found.ok:
            self._no_path_since_ns = None
            path = smoothing.smooth(self._map, found.path_m)
            is_better = smoothing.polyline_cost_m(self._map, path) < BETTER_SHARE * old_cost
            if is_better or found.escape_m:  # the path begins in blocked cells
                self._path, self._path_index = path, 0
        elif math.isinf(old_cost):
            self._path, self._path_index = np.empty((0, 2)), 0
            self._on_no_path(found.reason, now_ns)

    def _free_target(self) -> tuple[float, float]:
        """Return x and y of the goal, or of the nearest free cell if a newer map has blocked it."""
        goal = (self._goal.x_m, self._goal.y_m)
        cell = self._map.cell_of(*goal)
        if cell is None or self._map.weight[cell] != 0:  # off the map, or free (weight 0: blocked)
            return goal
        cell = astar.nearest_free(self._map, cell, goal, SNAP_M)
        if cell is None:
            return goal
        x, y = self._map.metres_of(np.array([cell[1] + 0.5, cell[0] + 0.5]))
        return float(x), float(y)

    def _remaining_cost_m(self, pose: SE2) -> float:
        """Return the cost of the rest of the path: its length, more in cells near obstacles.

        It is inf if the path is empty, blocked, far away, or leads to another target.
        """
        if not len(self._path) or math.dist(self._path[-1], self._target) > 1e-6:
            return math.inf
        if pose.distance_to(*self._path[self._path_index]) > DRIFT_M:
            return math.inf
        return smoothing.polyline_cost_m(self._map, self._path[self._path_index :])

    # -- failures and recovery --------------------------------------------------------------------

    def _on_no_path(self, reason: str, now_ns: int) -> None:
        """Handle a missing path: wait for a better map, at most `GIVE_UP_NS`, then fail."""
        if self._no_path_since_ns is None or now_ns < self._no_path_since_ns:
            self._no_path_since_ns = now_ns
        elif now_ns - self._no_path_since_ns >= GIVE_UP_NS:
            self._finish("failed", reason)

    def _recover(self, pose: SE2, repeat_m: float, now_ns: int) -> VelocityCommand:
        """Start a recovery; fail if the last one was nearer than `repeat_m`."""
        if self._last_command.v_mps != 0.0:
            self._blocked = pose.ahead(math.copysign(self._radius_m, self._last_command.v_mps))
        last = self._last_recovery_at
        if last is not None and pose.distance_to(last.x_m, last.y_m) < repeat_m:
            self._finish("failed", "stuck")
            return STOP
        log.info("robot stuck at (%.2f, %.2f) m: backing up or turning", pose.x_m, pose.y_m)
        self._last_recovery_at, failed_at = pose, self._recovery_failed_at
        failed_here = (
            failed_at is not None
            and pose.distance_to(failed_at.x_m, failed_at.y_m) < REPEAT_CONTACT_M
        )
        trail = None if failed_here else self._trail  # None: try another way than back
        self._recovery = Recovery(pose, self._map, trail, self._limits, now_ns)
        return STOP

    def _finish(self, state: str, reason: str = "") -> None:
        """End the goal as "reached" or "failed"."""
        self._status = GoalStatus(self._status.stamp_ns, state, reason)
        self._start_goal(None)


def _is_finite(pose: SE2) -> bool:
    return all(map(math.isfinite, (pose.x_m, pose.y_m, pose.yaw_rad)))

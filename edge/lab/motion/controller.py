"""The reference motion controller as a state machine: no Zenoh, no clock.

`step` is told the time; see `edge/lab/motion/process.py` for the process around it.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import replace

import numpy as np

from edge import config
from edge.geometry import SE2, Grid, wrap_angle
from edge.lab.motion.progress import Contact, Progress
from edge.lab.motion.recovery import Recovery, Trail
from edge.stuck import STUCK_M, StuckDetector
from edge.trajectory import astar, costmap, smoothing
from edge.trajectory.pursuit import (
    STOP,
    Command,
    MotionLimits,
    index_ahead,
    length_m,
    nearest_index,
    pursue,
    turn,
    turn_to,
)
from edge.types import GoalStatus

log = logging.getLogger("edge.lab.motion")

GOAL_TOLERANCE_M, YAW_TOLERANCE_RAD = 0.12, 0.15
NEAR_M = 0.4  # cells so near to an obstacle cost more
LOOKAHEAD_M = 0.45
REPLAN_S = 0.5
GIVE_UP_NS = 3_000_000_000  # so long a goal may stay without a path
CONTACT_M = 0.3  # driven, as it was told, without coming anywhere: it pushes against something
AIM_FRACTIONS = (1.0, 0.6, 0.35)  # of the look-ahead, tried until the way there is free
SAFE_M = 0.3  # this much of the path has to be free in the newest map
DRIFT_M = 0.4  # off the path by more than this: plan again
BETTER = 0.85  # a new path has to cost less than this part of the old one's rest
SNAP_M = 0.25  # a goal that a newer map has closed is moved by at most this
CLEAR_S = (0.15, 0.3, 0.45)  # looked at along the arc of a command
CAREFUL_MPS = 0.15  # where no arc is clear, for example out of an obstacle that the robot is in
FACING_RAD = 0.2
ARRIVE = 0.7  # of the goal tolerance: nearer than this the robot stops and turns
# Driven since the last recovery, the next standstill, or contact, gets one of its own.
AGAIN_M, AGAIN_CONTACT_M = 1.0, 0.3
STILL_MPS, STILL_RADPS = 0.03, 0.1
MIN_CELL_M, MAX_CELL_M = 0.001, 10.0  # what a map to drive by can be made of
RESTART_NS = 1_000_000_000  # time that goes back by more is another run; on, nobody looked
REPLACED = 64  # goals that are remembered as replaced


class Controller:
    """Drives to one goal at a time.

    The goal that came last replaces the one before, whatever their stamps: those of two services,
    or of one whose clock was set, do not compare. Each goal is answered `accepted`, then `reached`
    or `failed` with a reason; a goal that is sent again is answered again with how it stands.
    Where the robot was told to drive and was held up is told with the answer (`blocked`).
    """

    def __init__(self, settings: config.Config) -> None:
        self._motion = settings.motion
        self._limits = MotionLimits.of(settings.robot)
        self._workspace = astar.Workspace()
        self._map: costmap.CostMap | None = None
        self._stuck = StuckDetector(settings.motion.stuck_s)
        self._contact = Contact(CONTACT_M, STUCK_M)
        self._progress = Progress(6 * settings.motion.stuck_s)
        self._radius_m = settings.robot.radius_m
        self._trail = Trail()
        self._now_ns: int | None = None
        self._last = STOP
        self._goal: SE2 | None = None
        self._order: tuple[int, SE2] | None = None  # the newest goal as it came
        self._replaced: deque[tuple[int, SE2]] = deque(maxlen=REPLACED)
        self._status: GoalStatus | None = None
        self._blocked: tuple[float, float] | None = None
        self._begin(None)

    def _begin(self, goal: SE2 | None) -> None:
        """Forget everything that belonged to the goal before."""
        self._goal = goal
        self._target = (goal.x_m, goal.y_m) if goal else (0.0, 0.0)
        self._arrived = False
        self._recovery: Recovery | None = None
        self._recovered_at: SE2 | None = None
        self._trouble_ns: int | None = None
        if goal is None:  # a robot that is held up may be given one goal after another
            self._stuck.reset()
            self._contact.reset()
        self._progress.reset()
        self._drop_path()

    def _drop_path(self) -> None:
        self._path = np.empty((0, 2))
        self._index = 0
        self._planned_ns: int | None = None

    @property
    def path_m(self) -> np.ndarray:
        """(n, 2) float64: the path being followed; (0, 2) when there is none."""
        return self._path

    # -- what comes in --------------------------------------------------------------------------

    def on_map(self, grid: Grid) -> None:
        """Take a newer map; a path that it closes is planned again at the next step.

        Args:
            grid: an occupancy grid, inflated by the robot's radius.

        Raises:
            ValueError: not a map; the one before stays.
        """
        if not MIN_CELL_M <= grid.resolution_m <= MAX_CELL_M:
            raise ValueError(
                f"map resolution has to be {MIN_CELL_M:g} to {MAX_CELL_M:g} m, "
                f"got {grid.resolution_m:g}"
            )
        clearance_m = self._motion.clearance_m
        self._map = costmap.from_occupancy(grid, clearance_m=clearance_m, near_m=NEAR_M)
        if len(self._path) and not self._path_is_open():
            self._planned_ns = None

    def on_goal(self, stamp_ns: int, goal: SE2) -> list[GoalStatus]:
        """Take a goal, or answer for one that is sent again."""
        order = (stamp_ns, goal)
        if order == self._order:
            return [self._status]
        if order in self._replaced:
            return [GoalStatus(stamp_ns, "failed", "replaced by a newer goal")]
        if not _is_finite(goal):
            return [GoalStatus(stamp_ns, "failed", "goal pose is not finite")]
        if self._order is not None:
            self._replaced.append(self._order)
        self._order = order
        self._begin(goal)
        self._status = GoalStatus(stamp_ns, "accepted")
        return [self._status]

    def step(
        self, pose: SE2, v_mps: float, w_radps: float, now_ns: int
    ) -> tuple[Command, list[GoalStatus]]:
        """One control step.

        Args:
            pose: of the robot in `map`; `v_mps` and `w_radps` are its measured speeds.
            now_ns: of the pose.

        Returns:
            What to do until the next step, and answers to the goal (none, or one).
        """
        dt_s = self._pass_time(now_ns)
        wanted, answers = STOP, []
        self._blocked = None
        if _is_finite(pose):
            self._trail.extend(pose)
        if self._goal is not None and _is_finite(pose):
            before = self._status
            still = abs(v_mps) <= STILL_MPS and abs(w_radps) <= STILL_RADPS
            wanted = self._drive(self._goal, pose, still, dt_s, now_ns)
            if self._status is not before or self._blocked is not None:
                # Told once: a goal that is sent again is answered without it.
                answers = [replace(self._status, blocked=self._blocked)]
        self._last = self._limits.ramp(wanted, self._last, dt_s) if wanted.moves else STOP
        return self._last, answers

    def pause(self) -> None:
        """The robot is being stopped without a step; the goal stays, standing still is no fault."""
        self._last = STOP
        self._recovery = None
        self._trouble_ns = None
        self._stuck.reset()
        self._contact.reset()
        self._progress.reset()

    def _pass_time(self, now_ns: int) -> float:
        """Take up what the step's time tells of the run; how long the step is, in seconds."""
        last = now_ns if self._now_ns is None else self._now_ns
        if now_ns < last - RESTART_NS:
            self._begin(None)
            self._order = self._status = self._map = None
            self._replaced.clear()
        elif now_ns > last + RESTART_NS:
            self.pause()  # what the robot did meanwhile, nobody saw
        self._now_ns = now_ns
        # A first step, or one after a gap, may change the speed like any other.
        return min(max((now_ns - last) / 1e9, 1.0 / self._motion.rate_hz), 0.2)

    # -- driving --------------------------------------------------------------------------------

    def _drive(self, goal: SE2, pose: SE2, still: bool, dt_s: float, now_ns: int) -> Command:
        if self._recovery is not None:
            command = self._recovery.step(pose, now_ns)
            if command is not None:
                return command
            if self._recovery.is_held(pose):
                self._blocked = pose.ahead(-self._radius_m)
            self._recovery = None
            self._contact.reset()
            self._drop_path()
        if self._contact.update(pose, self._last.v_mps, dt_s):
            return self._unstick(pose, AGAIN_CONTACT_M, now_ns)
        if self._has_arrived(pose):
            command = self._align(goal, pose, still)
        else:
            command = self._travel(pose, now_ns)
        if self._goal is not None and self._stuck.update(pose, self._last.moves, now_ns):
            return self._unstick(pose, AGAIN_M, now_ns)
        return command

    def _has_arrived(self, pose: SE2) -> bool:
        """Near the goal, with hysteresis, so that turning does not begin driving again."""
        tolerance = GOAL_TOLERANCE_M * (1.0 if self._arrived else ARRIVE)
        self._arrived = pose.distance_to(*self._target) <= tolerance
        return self._arrived

    def _align(self, goal: SE2, pose: SE2, still: bool) -> Command:
        error = abs(wrap_angle(goal.yaw_rad - pose.yaw_rad))
        if still and error <= YAW_TOLERANCE_RAD:
            self._finish("reached")
            return STOP
        # Stop a little inside the tolerance, so that coasting does not lead out of it.
        return (
            STOP if error <= 0.5 * YAW_TOLERANCE_RAD else turn_to(pose, goal.yaw_rad, self._limits)
        )

    def _travel(self, pose: SE2, now_ns: int) -> Command:
        if self._is_plan_due(pose, now_ns):
            self._plan(pose, now_ns)
        if self._goal is None or not len(self._path):
            return STOP
        remaining = self._remaining_m(pose)
        if not self._progress.update(remaining, now_ns):
            self._finish("failed", "no progress towards the goal")
            return STOP
        return self._follow(pose, remaining)

    def _follow(self, pose: SE2, remaining_m: float) -> Command:
        """Aim as far along the path as can be driven to in a straight line."""
        here = (pose.x_m, pose.y_m)
        escaping = not self._map.is_free(*here)
        ahead = self._path[self._index : index_ahead(self._path, self._index, SAFE_M) + 1]
        if not escaping and math.isinf(smoothing.polyline_cost_m(self._map, ahead)):
            self._planned_ns = None
            return STOP
        for fraction in AIM_FRACTIONS:
            k = index_ahead(self._path, self._index, fraction * LOOKAHEAD_M)
            aim = (float(self._path[k, 0]), float(self._path[k, 1]))
            command = pursue(pose, *aim, remaining_m, self._limits)
            if smoothing.line_is_free(self._map, here, aim) and self._is_clear(pose, command):
                return command
        # No way round without touching: face the nearest aim, then creep towards it.
        bearing = pose.bearing_to(*aim)
        if abs(bearing) > FACING_RAD:
            return turn(bearing, self._limits)
        scale = CAREFUL_MPS / max(command.v_mps, CAREFUL_MPS)
        return Command(command.v_mps * scale, command.w_radps * scale)

    def _is_clear(self, pose: SE2, command: Command) -> bool:
        """Whether the arc of a command stays on open cells for a while."""
        for t_s in CLEAR_S:
            yaw = pose.yaw_rad + 0.5 * command.w_radps * t_s
            x = pose.x_m + command.v_mps * t_s * math.cos(yaw)
            y = pose.y_m + command.v_mps * t_s * math.sin(yaw)
            if not self._map.is_free(x, y):
                return False
        return True

    def _remaining_m(self, pose: SE2) -> float:
        near = self._path[: index_ahead(self._path, self._index, 4 * LOOKAHEAD_M) + 1]
        self._index = nearest_index(near, pose.x_m, pose.y_m, self._index)
        return length_m(self._path[self._index :]) + pose.distance_to(*self._path[self._index])

    # -- planning -------------------------------------------------------------------------------

    def _is_plan_due(self, pose: SE2, now_ns: int) -> bool:
        if self._planned_ns is None or now_ns - self._planned_ns >= REPLAN_S * 1e9:
            return True
        return len(self._path) > 0 and pose.distance_to(*self._path[self._index]) > DRIFT_M

    def _path_is_open(self) -> bool:
        """Whether the rest of the path is open in the newest map, but for where it begins."""
        rest = self._path[self._index :]
        free = [self._map.is_free(*point) for point in rest]
        return any(free) and all(free[free.index(True) :])

    def _plan(self, pose: SE2, now_ns: int) -> None:
        """Look for a path; keep the old one unless it is closed or clearly worse."""
        self._planned_ns = now_ns
        if self._map is None:
            self._trouble("no map", now_ns)
            return
        self._target = self._open_target()
        found = astar.plan(self._map, (pose.x_m, pose.y_m), self._target, self._workspace)
        old_cost = self._rest_cost(pose)
        if found.ok:
            self._trouble_ns = None
            path = smoothing.smooth(self._map, found.path_m)
            if smoothing.polyline_cost_m(self._map, path) < BETTER * old_cost or found.escape_m:
                self._path, self._index = path, 0
        elif math.isinf(old_cost):
            self._path, self._index = np.empty((0, 2)), 0
            self._trouble(found.reason, now_ns)

    def _open_target(self) -> tuple[float, float]:
        """The goal, or the nearest open cell where a newer map has closed it."""
        goal = (self._goal.x_m, self._goal.y_m)
        cell = self._map.cell_of(*goal)
        if cell is None or self._map.weight[cell] != 0:
            return goal
        cell = astar.nearest_open(self._map, cell, goal, SNAP_M)
        if cell is None:
            return goal
        x, y = self._map.metres_of(np.array([cell[1] + 0.5, cell[0] + 0.5]))
        return float(x), float(y)

    def _rest_cost(self, pose: SE2) -> float:
        """Cost of the path still to drive; inf when there is none, or it is closed or far off."""
        if not len(self._path) or math.dist(self._path[-1], self._target) > 1e-6:
            return math.inf
        if pose.distance_to(*self._path[self._index]) > DRIFT_M:
            return math.inf
        return smoothing.polyline_cost_m(self._map, self._path[self._index :])

    # -- when it does not go well -----------------------------------------------------------------

    def _trouble(self, reason: str, now_ns: int) -> None:
        """No way now: wait for a better map, but not for ever."""
        if self._trouble_ns is None or now_ns < self._trouble_ns:
            self._trouble_ns = now_ns
        elif now_ns - self._trouble_ns >= GIVE_UP_NS:
            self._finish("failed", reason)

    def _unstick(self, pose: SE2, again_m: float, now_ns: int) -> Command:
        """Back up or turn once; a second standstill within `again_m` is a failure."""
        if self._last.v_mps != 0.0:
            self._blocked = pose.ahead(math.copysign(self._radius_m, self._last.v_mps))
        last = self._recovered_at
        if last is not None and pose.distance_to(last.x_m, last.y_m) < again_m:
            self._finish("failed", "stuck")
            return STOP
        log.info("stuck at (%.2f, %.2f): backing up", pose.x_m, pose.y_m)
        self._recovered_at = pose
        self._recovery = Recovery(pose, self._map, self._trail, self._limits, now_ns)
        return STOP

    def _finish(self, state: str, reason: str = "") -> None:
        self._status = GoalStatus(self._status.stamp_ns, state, reason)
        self._begin(None)


def _is_finite(pose: SE2) -> bool:
    return all(map(math.isfinite, (pose.x_m, pose.y_m, pose.yaw_rad)))

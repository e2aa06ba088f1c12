"""Reference motion controller as a state machine: plans on the published map, drives to goals.

It needs no Zenoh and no clock: `step` gets the time as an argument. `edge/lab/motion/process.py`
runs it as a process.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import replace

from edge import config
from edge.geometry import SE2, Grid, wrap_angle
from edge.lab.motion.progress import ContactDetector, ProgressMonitor
from edge.lab.motion.recovery import BacktrackPath, Recovery
from edge.lab.motion.route import NEAR_M, Route
from edge.stuck import STUCK_M, StuckDetector
from edge.trajectory import costmap
from edge.trajectory.pursuit import STOP, MotionLimits, VelocityCommand, turn_to
from edge.types import GoalStatus

log = logging.getLogger("edge.lab.motion")

YAW_TOLERANCE_RAD = 0.15  # with `GOAL_TOLERANCE_M`: a goal is reached within both
STUCK_S = 4.0  # a robot that does not move for this time, although it should, is stuck
CONTACT_M = 0.3  # commanded distance without movement that counts as contact with an obstacle
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
        self._settings = settings
        self.route = Route(MotionLimits.of(settings.robot))
        self._stuck = StuckDetector(STUCK_S)
        self._contact = ContactDetector(CONTACT_M, STUCK_M)
        self._progress = ProgressMonitor(6 * STUCK_S)
        self._trail = BacktrackPath()  # the last metres that the robot drove
        self._recovery_failed_at: SE2 | None = None  # pose, if the last recovery did not move it
        self._now_ns: int | None = None
        self._last_command = STOP
        self._goal: SE2 | None = None  # None: the robot stands
        # Received goals (stamp, pose), the newest last. A goal stays here after its end.
        self._received: deque[tuple[int, SE2]] = deque(maxlen=1 + MAX_REPLACED)
        self._status: GoalStatus | None = None  # of the newest goal
        self._blocked: tuple[float, float] | None = None  # where this step was held up
        self._start_goal(None)

    def _start_goal(self, goal: SE2 | None) -> None:
        """Start with a goal, or with none; reset all state of the goal before."""
        self._goal = goal
        self._recovery: Recovery | None = None
        self._last_recovery_at: SE2 | None = None
        # Not for a new goal: a blocked robot that gets one goal after another is still stuck.
        if goal is None:
            self._stuck.reset()
            self._contact.reset()
        self._progress.reset()
        self.route.start(goal)

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
        self.route.on_map(costmap.from_occupancy(grid, near_m=NEAR_M))

    def on_goal(self, stamp_ns: int, goal: SE2) -> list[GoalStatus]:
        """Start a new goal, or answer again for a repeated one; return the answers."""
        received = (stamp_ns, goal)
        if received in self._received:
            is_newest = received == self._received[-1]
            replaced = GoalStatus(stamp_ns, "failed", "replaced by a newer goal")
            return [self._status if is_newest else replaced]
        if not _is_finite(goal):
            return [GoalStatus(stamp_ns, "failed", "goal pose is not finite")]
        self._received.append(received)
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
        self._last_command = self.route.limits.ramp(wanted, last, dt_s) if wanted.moves else STOP
        return self._last_command, answers

    def pause(self) -> None:
        """Stop outside of a step: keep the goal, and do not count the standstill as being stuck."""
        self._last_command = STOP
        self._recovery = None
        self.route.pause()
        self._stuck.reset()
        self._contact.reset()
        self._progress.reset()

    def _advance_time(self, now_ns: int) -> float:
        """Handle a new stamp (restart, gap or normal step); return the step's length in s."""
        last = now_ns if self._now_ns is None else self._now_ns
        if now_ns < last - RESTART_NS:
            self._start_goal(None)
            self._status = self.route.map = None
            self._received.clear()
        elif now_ns > last + RESTART_NS:
            self.pause()  # the robot's motion during the gap is unknown
        self._now_ns = now_ns
        # A first step, or one after a gap, may change the speed like any other.
        return min(max((now_ns - last) / 1e9, 1.0 / self._settings.motion.rate_hz), 0.2)

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
                self._blocked = pose.ahead(-self._settings.robot.radius_m)
            # If no attempt moved the robot here, the next one takes another way (`_recover`).
            self._recovery_failed_at = None if self._recovery.has_moved(pose) else pose
            self._recovery = None
            self._contact.reset()
            self.route.drop_path()
        if self._contact.update(pose, self._last_command.v_mps, dt_s):
            return self._recover(pose, REPEAT_CONTACT_M, now_ns)
        if self.route.has_arrived(pose):
            command = self._align(goal, pose, still)
        else:
            command = self._travel(pose, now_ns)
        if self._goal is not None and self._stuck.update(pose, self._last_command.moves, now_ns):
            return self._recover(pose, REPEAT_M, now_ns)
        return command

    def _align(self, goal: SE2, pose: SE2, still: bool) -> VelocityCommand:
        """Turn to the goal's heading; the goal is reached when the robot stands still there."""
        error = abs(wrap_angle(goal.yaw_rad - pose.yaw_rad))
        if still and error <= YAW_TOLERANCE_RAD:
            self._finish("reached")
            return STOP
        if error <= 0.5 * YAW_TOLERANCE_RAD:  # well inside the tolerance: coasting stays in it
            return STOP
        return turn_to(pose, goal.yaw_rad, self.route.limits)

    def _travel(self, pose: SE2, now_ns: int) -> VelocityCommand:
        """Drive along the path; plan first if it is time for that."""
        route = self.route
        if route.is_due(pose, now_ns) and (reason := route.plan(pose, now_ns)):
            self._finish("failed", reason)
        if not len(route.path_m):
            return STOP
        remaining = route.remaining_m(pose)
        if not self._progress.update(remaining, now_ns):
            self._finish("failed", "no progress towards the goal")
            return STOP
        return route.follow(pose, remaining)

    # -- failures and recovery --------------------------------------------------------------------

    def _recover(self, pose: SE2, repeat_m: float, now_ns: int) -> VelocityCommand:
        """Start a recovery; fail if the last one was nearer than `repeat_m`."""
        if self._last_command.v_mps != 0.0:
            radius_m = self._settings.robot.radius_m
            self._blocked = pose.ahead(math.copysign(radius_m, self._last_command.v_mps))
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
        self._recovery = Recovery(pose, self.route.map, trail, self.route.limits, now_ns)
        return STOP

    def _finish(self, state: str, reason: str = "") -> None:
        """End the goal as "reached" or "failed"."""
        self._status = GoalStatus(self._status.stamp_ns, state, reason)
        self._start_goal(None)


def _is_finite(pose: SE2) -> bool:
    return all(map(math.isfinite, (pose.x_m, pose.y_m, pose.yaw_rad)))

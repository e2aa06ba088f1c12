"""Driven trajectory of a task: the goal ahead of the robot, the steps done and the next stop."""

from __future__ import annotations

from collections.abc import Sequence

from edge.geometry import SE2
from edge.loop.behaviours.plan_worker import PlanResult
from edge.mapping.view import MapView
from edge.mission.task_step import TaskStep
from edge.tasks.follow import (
    blocked_ahead_m,
    end_of_current_leg,
    end_of_leg,
    goal_ahead,
    index_at_goal,
)
from edge.tasks.refine import RefinedTrajectory

AHEAD_M = 1.5
"""Distance of the goal ahead of the robot on the trajectory."""
RESEND_M = 0.3
"""The goal is sent again when it has moved by this distance."""
CHECK_PERIOD_NS = 500_000_000
"""Period of the check for obstacles on the path ahead."""


class DrivenTrajectory:
    """A refined trajectory, and the robot's progress on it.

    The robot stops at the objects of each step that the plan names, and at the end.

    Attributes:
        index: Pose that the robot has come to.
        stop_index: Pose of the next stop, or the last pose.
        stop_objects: Id and label of each object at the next stop; empty at an end without objects.
        n_verified: Number of steps of the task whose stops were verified.
        checked: True after the first check for obstacles.
    """

    def __init__(
        self,
        plan: PlanResult,
        refined: RefinedTrajectory,
        steps: Sequence[TaskStep],
        n_verified: int,
    ) -> None:
        self._refined, self._steps, self._n_done = refined, steps, plan.n_done
        self._stops = plan.stops
        self._last = len(refined.poses) - 1
        self._checked_ns = 0
        self.index, self.checked = 0, False
        self.n_verified = n_verified
        self._find_next_stop()

    @property
    def stop_is_end(self) -> bool:
        """True if the next stop is the end of the trajectory."""
        return self.stop_index == self._last

    @property
    def n_steps_driven(self) -> int:
        """Number of steps of the task that are driven. The rules write one segment for each."""
        refined = self._refined
        ahead = refined.legs[refined.leg[self.index] :]  # the present leg and all after it
        driven = max(self._n_done - sum(leg.ends_segment for leg in ahead), 0)
        while self._steps[driven].joined:  # this step is one leg with the step before it
            driven -= 1
        return driven

    def goal(self, pose: SE2) -> tuple[SE2, float]:
        """Return the goal ahead of the robot, and the distance by which it must move to be sent."""
        refined, until = self._refined, self.stop_index
        ahead, self.index = goal_ahead(refined, pose, AHEAD_M, self.index, until)
        ends = (end_of_current_leg(refined, self.index), self._last)
        # The ends of legs and of the trajectory are sent exactly, however near they are.
        exact = any(self._is_at(ahead, end) for end in ends if end <= until)
        return ahead, 0.0 if exact else RESEND_M

    def on_arrived(self, goal: SE2) -> bool:
        """Record that the robot arrived at a goal; return True if that is the next stop."""
        if self._is_at(goal, self.stop_index):
            return True
        self.index = index_at_goal(self._refined, goal, self.index)
        return False

    def leave_stop(self) -> None:
        """Go on to the next stop, because the objects of this one were verified."""
        self.n_verified, self.index = self._stop_step + 1, self.stop_index + 1
        self._find_next_stop()

    def blocked_ahead_m(self, view: MapView, now_ns: int) -> float | None:
        """Return the distance to an obstacle on the path, None if there is none.

        It is checked only every `CHECK_PERIOD_NS`; in between, the result is None.
        """
        if now_ns - self._checked_ns < CHECK_PERIOD_NS:
            return None
        self._checked_ns, self.checked = now_ns, True
        return blocked_ahead_m(self._refined, view, self.index)

    def _find_next_stop(self) -> None:
        """Find the next step that stops at objects, and the pose of its end."""
        last_legs = [k for k, leg in enumerate(self._refined.legs) if leg.ends_segment]  # of steps
        end, stops = self._n_done, self._stops
        self._stop_step, self.stop_index = end - 1, self._last
        self.stop_objects: tuple[tuple[int, str], ...] = ()
        # `stops` ends with step `end` - 1, so `stops[step - end]` counts from its end.
        for step, leg in zip(range(end - len(last_legs), end), last_legs, strict=True):
            if step >= max(self.n_verified, end - len(stops)) and stops[step - end]:
                self._stop_step, self.stop_index = step, end_of_leg(self._refined, leg)
                self.stop_objects = stops[step - end]
                return

    def _is_at(self, goal: SE2, index: int) -> bool:
        """Return True if a goal is exactly this pose of the trajectory."""
        x_m, y_m, _, yaw_rad = self._refined.poses[index].tolist()
        return goal == SE2(x_m, y_m, yaw_rad)

"""A mission with one target: go near it, confirm it, or say why not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from edge.config import Mission
from edge.geometry import SE2
from edge.types import Goal, GoalStatus, Instance, MissionStatus

# A detector that stands still refutes nothing: this many results have to come on the spot.
MIN_LOOKS = 5


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the mission decided about the instance that was being approached."""

    kind: Literal["reached", "refuted", "out_of_reach"]
    instance: Instance


class TargetMission:
    """Follows one target until it is reached, refused by a limit, or nowhere to be found.

    `reached` is declared only when the robot stopped on a goal of its own choosing within
    `reach_m` of the instance's nearest surface point and the detector confirmed it
    (DESIGN.md, "Reached means").
    """

    def __init__(self, config: Mission) -> None:
        self.status = MissionStatus(config.target, "searching")
        self._config = config
        self._started_ns: int | None = None
        self._last_pose: SE2 | None = None
        self._verifying_since_ns: int | None = None
        self._looks_before = 0

    def observe(self, pose: SE2 | None, now_ns: int) -> None:
        """Count time, from the first call on, and path; a jump of the pose is not driving.

        Args:
            pose: None while it is not known; time passes all the same.
        """
        if self._started_ns is None:
            self._started_ns = now_ns
        step = 0.0
        if pose is not None:
            if self._last_pose is not None:
                step = self._last_pose.distance_to(pose.x_m, pose.y_m)
            self._last_pose = pose
        if not self.status.done:
            self.status = replace(
                self.status,
                elapsed_s=(now_ns - self._started_ns) * 1e-9,
                path_m=self.status.path_m + (step if step < 1.0 else 0.0),
            )

    def check_limits(self, exhausted: bool) -> None:
        """Fail at the time or path limit, or when there is nowhere left to look."""
        c, s = self._config, self.status
        if s.done:
            return
        if s.elapsed_s > c.time_limit_s:
            self.fail(f"time limit of {c.time_limit_s:g} s")
        elif s.path_m > c.path_limit_m:
            self.fail(f"path limit of {c.path_limit_m:g} m")
        elif exhausted:
            self.fail(f"explored all that can be reached, found no {s.target}")

    def fail(self, reason: str) -> None:
        """Give up; what is already over stays as it ended."""
        if not self.status.done:
            self._finish("failed", reason)

    def advance(
        self,
        goal: Goal | None,
        instance: Instance | None,
        confirmed: bool,
        answer: GoalStatus | None,
        now_ns: int,
        looks: int,
    ) -> Verdict | None:
        """One step of approach and verification.

        Args:
            goal: the goal now being driven to.
            instance: the instance that it is for; None for other goals.
            confirmed: whether the detector has confirmed that instance.
            answer: the controller's newest answer to this goal.
            looks: how often the detector has answered so far.
        """
        if self.status.done:
            return None
        if goal is None or instance is None:
            self._verifying_since_ns = None
            self._phase("searching")
            return None
        if answer is None or answer.state != "reached":
            self._verifying_since_ns = None
            self._phase("approaching")
            return None
        return self._verify(instance, confirmed, now_ns, looks)

    def _verify(
        self, instance: Instance, confirmed: bool, now_ns: int, looks: int
    ) -> Verdict | None:
        """The robot stands where it meant to stand: is this the thing, and is it near?"""
        assert self._last_pose is not None
        if instance.distance_m(self._last_pose.x_m, self._last_pose.y_m) > self._config.reach_m:
            return Verdict("out_of_reach", instance)
        self._phase("verifying")
        if self._verifying_since_ns is None:
            self._verifying_since_ns, self._looks_before = now_ns, looks
        if confirmed:
            self._finish("reached", f"confirmed, seen in {instance.hits} images")
            return Verdict("reached", instance)
        long_enough = (now_ns - self._verifying_since_ns) * 1e-9 > self._config.verify_s
        if long_enough and looks - self._looks_before >= MIN_LOOKS:
            self._verifying_since_ns = None
            return Verdict("refuted", instance)
        return None

    def _phase(self, phase: Literal["searching", "approaching", "verifying"]) -> None:
        if self.status.phase != phase:
            self.status = replace(self.status, phase=phase)

    def _finish(self, phase: Literal["reached", "failed"], reason: str) -> None:
        self.status = replace(self.status, phase=phase, reason=reason)

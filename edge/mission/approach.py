"""Going up to one instance of the target: is it the thing, and is the robot near it?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from edge.config import Mission
from edge.geometry import SE2
from edge.types import Goal, GoalStatus, Instance

# A detector that stands still refutes nothing: this many results have to come on the spot.
MIN_LOOKS = 5


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was decided about the instance that was being approached."""

    kind: Literal["reached", "refuted", "out_of_reach"]
    instance: Instance


class Approach:
    """Decides about the instance that the present goal is for.

    `reached` is declared only when the robot stopped on a goal of its own choosing within
    `reach_m` of the instance's nearest surface point and the detector confirmed it
    (DESIGN.md, "Reached means").

    Attributes:
        phase: what the robot is at.
    """

    def __init__(self, config: Mission) -> None:
        self.phase: Literal["searching", "approaching", "verifying"] = "searching"
        self._config = config
        self._goal: Goal | None = None
        self._verifying_since_ns: int | None = None
        self._looks_before = 0

    def advance(
        self,
        goal: Goal | None,
        instance: Instance | None,
        confirmed: bool,
        answer: GoalStatus | None,
        pose: SE2,
        now_ns: int,
        looks: int,
    ) -> Verdict | None:
        """One step of approach and verification.

        Args:
            goal: the goal now being driven to.
            instance: the instance that it is for; None for other goals.
            confirmed: whether the detector has confirmed that instance.
            answer: the controller's newest answer to this goal.
            pose: where the robot is.
            looks: how often the detector has answered so far.
        """
        if goal is not self._goal:
            # A controller that is there already may answer before a tick sees it under way.
            self._goal, self._verifying_since_ns = goal, None
        if goal is None or instance is None:
            self._verifying_since_ns, self.phase = None, "searching"
            return None
        if answer is None or answer.state != "reached":
            self._verifying_since_ns, self.phase = None, "approaching"
            return None
        if instance.distance_m(pose.x_m, pose.y_m) > self._config.reach_m:
            return Verdict("out_of_reach", instance)
        return self._verify(instance, confirmed, now_ns, looks)

    def _verify(
        self, instance: Instance, confirmed: bool, now_ns: int, looks: int
    ) -> Verdict | None:
        """The robot stands where it meant to stand, and near enough: is this the thing?"""
        self.phase = "verifying"
        if self._verifying_since_ns is None:
            self._verifying_since_ns, self._looks_before = now_ns, looks
        if confirmed:
            self._verifying_since_ns = None
            return Verdict("reached", instance)
        long_enough = (now_ns - self._verifying_since_ns) * 1e-9 > self._config.verify_s
        if long_enough and looks - self._looks_before >= MIN_LOOKS:
            self._verifying_since_ns = None
            return Verdict("refuted", instance)
        return None

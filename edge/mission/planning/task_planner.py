"""The planner of tasks: the robot must detect the objects that the remaining steps name."""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.planning.plan import MissionKnowledge, TargetPlan, and_list, explain_blocked
from edge.mission.task_step import TaskStep


class TaskPlanner:
    """Planner that pursues objects not detected yet, in the order of the instruction.

    Args:
        targets: names that the detector looks for, at least one.
    """

    def __init__(self, targets: Sequence[str], steps: Sequence[TaskStep]) -> None:
        self._targets, self._steps = targets, steps

    def plan(
        self, state: int, knowledge: MissionKnowledge, current: str | None = None
    ) -> TargetPlan:
        """Return the plan; it has no steps if nothing is left to detect."""
        to_see = dict.fromkeys(name for step in self._steps[state:] for name in step.names)
        failed = tuple(label for label in to_see if label in knowledge.failed)
        if failed:
            return TargetPlan(None, (), float("inf"), False, failed, explain_blocked(failed), ())
        unseen = tuple(label for label in to_see if label not in knowledge.detected)
        if not unseen:
            target = current or [*to_see, *self._targets][0]
            return TargetPlan(target, (), 0.0, True, (), "all objects of the task were seen", ())
        cost = float(len(unseen))
        are = "are" if len(unseen) > 1 else "is"
        reason = f"{and_list(unseen)} {are} still to be seen"
        return TargetPlan(unseen[0], unseen, cost, True, (), reason, ((unseen[0], cost),))

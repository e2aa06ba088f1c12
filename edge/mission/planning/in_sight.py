"""The planner of tasks: what the steps not driven yet name has to be seen, one after another."""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.planning.plan import Knowledge, Plan, explain_blocked, listed
from edge.mission.task_step import TaskStep


class InSightPlanner:
    """Goes for what was not seen yet, in the order in which the instruction names it.

    Args:
        targets: what is looked for, at least one name.
    """

    def __init__(self, targets: Sequence[str], steps: Sequence[TaskStep]) -> None:
        self._targets, self._steps = targets, steps

    def plan(self, state: int, knowledge: Knowledge, current: str | None = None) -> Plan:
        """See `Planner.plan`; a plan without steps: all that has to be seen was seen.

        Args:
            state: how many steps were driven.
        """
        to_see = dict.fromkeys(name for step in self._steps[state:] for name in step.names)
        failed = tuple(label for label in to_see if label in knowledge.failed)
        if failed:
            return Plan(None, (), float("inf"), False, failed, explain_blocked(failed), ())
        unseen = tuple(label for label in to_see if label not in knowledge.detected)
        if not unseen:
            target = current or [*to_see, *self._targets][0]
            return Plan(target, (), 0.0, True, (), "all that it names was seen", ())
        cost = float(len(unseen))
        reason = f"{listed(unseen)} {_is(unseen)} to be seen yet"
        return Plan(unseen[0], unseen, cost, True, (), reason, ((unseen[0], cost),))


def _is(labels: Sequence[str]) -> str:
    return "are" if len(labels) > 1 else "is"

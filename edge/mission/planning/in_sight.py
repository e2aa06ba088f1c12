"""The planner of tasks: what a trajectory is written about has to be seen, one after another."""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.planning.plan import Knowledge, Plan, explain_blocked, listed


class InSightPlanner:
    """Goes for what was not seen yet, in the order in which the instruction names it.

    Args:
        targets: what is looked for, at least one name; `to_see`: those that have to be seen.
    """

    def __init__(self, targets: Sequence[str], to_see: Sequence[str]) -> None:
        self._targets, self._to_see = targets, to_see

    def plan(self, state: int, knowledge: Knowledge, current: str | None = None) -> Plan:
        """See `Planner.plan`; a plan without steps: all that has to be seen was seen."""
        failed = tuple(label for label in self._to_see if label in knowledge.failed)
        if failed:
            return Plan(None, (), float("inf"), False, failed, explain_blocked(failed), ())
        unseen = tuple(label for label in self._to_see if label not in knowledge.detected)
        if not unseen:
            target = current or [*self._to_see, *self._targets][0]
            return Plan(target, (), 0.0, True, (), "all that it names was seen", ())
        cost = float(len(unseen))
        reason = f"a trajectory is written once {listed(unseen)} {_is(unseen)} seen"
        return Plan(unseen[0], unseen, cost, True, (), reason, ((unseen[0], cost),))


def _is(labels: Sequence[str]) -> str:
    return "are" if len(labels) > 1 else "is"

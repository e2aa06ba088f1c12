"""Baseline planner: targets in the order of the instruction."""

from __future__ import annotations

import numpy as np

from edge.config import PlannerInOrder, PlannerVitl
from edge.mission.logic.automaton import NOTHING, Automaton
from edge.mission.planning.plan import ACCEPTED, DEAD, MissionKnowledge, TargetPlan, step_text
from edge.mission.planning.vitl import VitlPlanner


class InOrderPlanner:
    """Planner that takes the first proposition that changes the state and keeps success possible.

    `NOTHING` comes after all propositions. A state is hopeful if acceptance can be reached from it
    without a failed object; all planned steps lead to hopeful states. So the plan respects the
    constraints of the mission. It ignores detections and distances: a comparison with it shows
    their value. It may loop if the automaton leads back to an earlier state.
    """

    def __init__(self, config: PlannerInOrder, automaton: Automaton) -> None:
        self.config = config
        self.automaton = automaton

    def plan(
        self, state: int, knowledge: MissionKnowledge, current: str | None = None
    ) -> TargetPlan:
        """Return the plan; see `Planner.plan`. The cost is the number of steps."""
        a = self.automaton
        if a.accepting[state]:
            return ACCEPTED
        if a.steps_left[state] < 0:
            return DEAD
        hopeful = self._hopeful_states(knowledge.failed)
        if not hopeful[state]:  # there is no plan; this one names the failed objects as the reason
            return VitlPlanner(PlannerVitl(), a).plan(state, knowledge, current)
        steps: list[str] = []
        seen: set[int] = set()
        while not a.accepting[state] and state not in seen:
            seen.add(state)
            steps.append(self._first_step(state, hopeful, knowledge.failed))
            state = a.step(state, steps[-1])
        cost, first = float(len(steps)), steps[0]
        reason = f"{step_text(first)} is the first in the sentence that is possible now"
        return TargetPlan(
            target=first or None,
            steps=tuple(steps),
            cost=cost,
            feasible=True,
            blocked_by=(),
            reason=reason,
            options=((first, cost),),
        )

    def _first_step(self, state: int, hopeful: np.ndarray, failed: frozenset[str]) -> str:
        """Return the first step that leads to another hopeful state."""
        for proposition in (*self.automaton.propositions, NOTHING):
            after = self.automaton.step(state, proposition)
            if proposition not in failed and after != state and hopeful[after]:
                return proposition
        raise AssertionError("a bug in edge: no step leads on from a state that can still succeed")

    def _hopeful_states(self, failed: frozenset[str]) -> np.ndarray:
        """Return (n,) bool: states from which acceptance needs no failed object."""
        a = self.automaton
        usable = [i for i, name in enumerate((*a.propositions, NOTHING)) if name not in failed]
        hopeful = a.accepting.copy()
        while True:
            more = hopeful | hopeful[a.delta[:, usable]].any(axis=1)
            if (more == hopeful).all():
                return hopeful
            hopeful = more

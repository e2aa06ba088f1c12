"""Planners by name, and what they are asked and answer.

A new planner is a file with a class that plans, a section in `edge/config/mission.py` and a line
in `REGISTRY`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from edge.config import PlannerExpected, PlannerInOrder, PlannerVitl
from edge.mission.automaton import Automaton
from edge.mission.ltl import Formula
from edge.mission.planning import distances
from edge.mission.planning.expected import ExpectedPlanner, PlannerError
from edge.mission.planning.in_order import InOrderPlanner
from edge.mission.planning.plan import Knowledge, Plan, Planner
from edge.mission.planning.vitl import VitlPlanner

__all__ = ["Knowledge", "Plan", "Planner", "PlannerError", "make_planner", "warm_up"]

REGISTRY: dict[str, Any] = {
    "vitl": VitlPlanner,
    "expected": ExpectedPlanner,
    "in_order": InOrderPlanner,
}


def make_planner(
    config: PlannerVitl | PlannerExpected | PlannerInOrder, automaton: Automaton, **keywords: Any
) -> Planner:
    """The planner that a configuration's `mission.planner` section names.

    Args:
        keywords: `known_reached` of `VitlPlanner`, `universe_extra` of `ExpectedPlanner`.

    Raises:
        PlannerError: the automaton is too large for the expected-cost planner.
    """
    return REGISTRY[config.kind](config, automaton, **keywords)


def warm_up() -> None:
    """Compile the kernels of all planners and of `distances`, or read them from the cache."""
    automaton = Automaton(
        formula=Formula("ap", name="a"),
        letters=("a",),
        delta=np.array([[1, 0], [1, 1]], np.int32),
        accepting=np.array([False, True]),
        steps_left=np.array([1, 0], np.int32),
    )
    for config in (PlannerVitl(), PlannerVitl(weights="distance"), PlannerExpected()):
        make_planner(config, automaton).plan(0, Knowledge())
    distances.warm_up()

"""Construction of planners by name.

To add a planner: write a class that plans, add a section to `edge/config/mission.py` and a line
to `REGISTRY`. A plugin is named as `module:Class`. It is called with its options, and with the
mission's `automaton` and `instruction` if it has such parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from edge.config import PlannerInOrder, PlannerPlugin, PlannerVitl
from edge.config.components import component_factory
from edge.mission.logic.automaton import Automaton
from edge.mission.planning.in_order import InOrderPlanner
from edge.mission.planning.plan import MissionKnowledge, Planner, TargetPlan
from edge.mission.planning.vitl import VitlPlanner

__all__ = ["MissionKnowledge", "Planner", "TargetPlan", "make_planner"]

# Kind of a planner → its class.
REGISTRY: dict[str, Any] = {"vitl": VitlPlanner, "in_order": InOrderPlanner}


def make_planner(
    config: PlannerVitl | PlannerInOrder | PlannerPlugin,
    automaton: Automaton,
    instruction: str = "",
) -> Planner:
    """Return the planner of a configuration's `mission.planner` section.

    Raises:
        ConfigError: the plugin cannot be created.

    Example:
        >>> from edge.mission.logic.automaton import compile_formula
        >>> from edge.mission.logic.ltl import parse
        >>> planner = make_planner(PlannerVitl(), compile_formula(parse("F (bed | sofa)")))
        >>> planner.plan(0, MissionKnowledge(detected=frozenset({"sofa"}))).target
        'sofa'
    """
    if isinstance(config, PlannerPlugin):
        make = find_plugin_planner(config, "mission.planner")
        return make(automaton=automaton, instruction=instruction)
    return REGISTRY[config.kind](config, automaton)


def find_plugin_planner(config: PlannerPlugin, where: str) -> Callable[..., Planner]:
    """Return a function that creates the configured plugin for a mission.

    Raises:
        ConfigError: see `edge.config.components.component_factory`.
    """
    needs, given = ("plan()",), ("automaton", "instruction")
    return component_factory("planner", config.kind, config.options, REGISTRY, where, needs, given)

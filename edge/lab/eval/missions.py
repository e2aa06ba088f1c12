"""Missions with several targets in a world, and the shortest path of each (ViTL V-D).

Sentences and formulas are those of the task-level benchmark, for the objects of the world. The
shortest path is exact: over every order that satisfies the formula, and over every place where an
object counts as reached.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import islice

import numpy as np

from edge import names
from edge.lab.eval import geodesic
from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.planning.templates import BenchmarkTask, Family, different_tasks, draws
from edge.lab.eval.true_rooms import in_room_of_kind
from edge.lab.sim.base import World, objects_named
from edge.mission.logic.automaton import NOTHING, Automaton

TARGETS = (2, 4)
"""Fewest and most objects that a mission names."""

FAMILIES = (
    Family("sequence", 0.2),
    Family("any-order", 0.3, any_order=True),
    Family("choice", 0.25, length=(2, 3), either=0.6, must_choose=True),
    Family("branches", 0.15, branches=(2, 2), length=(1, 2)),
    Family("any-order-until", 0.1, any_order=True, untils=(1, 1)),
)
_MAX_DRAWS = 10_000  # templates to draw for the missions of a world


def draw_missions(targets: Sequence[str], count: int, seed: int) -> list[BenchmarkTask]:
    """Draw satisfiable missions with different formulas for these targets, at most `count`."""
    objects_here = sorted({names.canonical(target) for target in targets})
    if len(objects_here) < TARGETS[0]:
        return []
    drawn = islice(draws(random.Random(seed), FAMILIES, objects_here), _MAX_DRAWS)
    # Leave out templates with too few or too many objects, or a placeholder without an object.
    fitting = (
        (family, template, objects)
        for family, template, objects in drawn
        if TARGETS[0] <= len(template.placeholders) <= TARGETS[1]
        and max(template.placeholders) < len(objects)
    )
    return different_tasks(fitting, count)


class MissionCostFields:
    """Cost-to-go fields of the missions in a world, for a robot of this radius."""

    def __init__(self, world: World, robot_radius_m: float) -> None:
        self._world = world
        self.plan = world.plan
        self._radius_m = robot_radius_m
        self._free = world.plan.clearance_m > robot_radius_m
        start = world.start
        self._reachable = world.plan.reachable(start.x_m, start.y_m, robot_radius_m)
        self._near: dict[str, np.ndarray] = {}

    def has(self, target: str) -> bool:
        """Return True if the world has this object and the robot can reach it from the start."""
        return bool(self.near(target).any())

    def has_kinds(self, target: str) -> bool:
        """Return True if the world has a narrower kind of this object under another name."""
        labels = {item.label for item in self._world.objects}
        kinds = {label for label in labels if names.is_kind_of(label, target)}
        return any(not names.same_name(label, target) for label in kinds)

    def near(self, target: str) -> np.ndarray:
        """Return (rows, columns) bool: True where this object or kind of room counts as reached."""
        if target in self._near:
            return self._near[target]
        if target in self._world.room_kinds:
            near = in_room_of_kind(self._world, target, self._radius_m)
        else:
            objects = objects_named(self._world, target)
            near = geodesic.near(self._world.plan, objects, self._radius_m, REACHED_M)
        self._near[target] = near & self._reachable
        return self._near[target]

    def distance_m(self, target: str) -> np.ndarray:
        """Return the distance to drive to a target, (rows, columns) float64; inf: no path."""
        return geodesic.distance_to(self.plan, self.near(target), self._radius_m)

    def cost_to_go_m(self, automaton: Automaton) -> np.ndarray:
        """Return the distance to drive from each place until a new mission is fulfilled.

        It is the least over all traces that the automaton accepts, and over the places where their
        objects are reached. An object that the robot only passes is not reached.

        Returns:
            (rows, columns) float64 in metres; inf if there is no path.
        """
        near = {name: self.near(name) for name in automaton.propositions}
        cells = cost_to_go_cells(automaton, near, self._free)
        return cells * self._world.plan.grid.resolution_m


def cost_to_go_cells(
    automaton: Automaton, near: Mapping[str, np.ndarray], free: np.ndarray
) -> np.ndarray:
    """Return Dijkstra's distances over places and states, from the automaton's initial state.

    `near` has, by proposition, (rows, columns) bool: True where its step can be taken. `free` is
    True where the robot can drive, 8-connected. Distances are in cells, inf without a path.
    """
    # By state: the distance that is left, and the edges into the state (state before, proposition).
    left = {s: np.full(free.shape, np.inf) for s in range(automaton.n_states)}
    before: dict[int, list[tuple[int, str]]] = {s: [] for s in left}
    for s in left:
        for proposition, after in automaton.edges(s):
            if after != s and not automaton.accepting[s]:
                before[after].append((s, proposition))
    queue = deque(s for s in left if automaton.accepting[s])
    for s in queue:
        left[s][free] = 0.0
    # Propagate backwards from the accepting states, until no distance becomes shorter.
    while queue:
        after = queue.popleft()
        for s, proposition in before[after]:
            can_step = free if proposition == NOTHING else near[proposition] & free
            shorter = can_step & (left[after] < left[s])
            if shorter.any():
                left[s][shorter] = left[after][shorter]
                while geodesic.relax(free, left[s]):
                    pass
                if s not in queue:
                    queue.append(s)
    return left[0]

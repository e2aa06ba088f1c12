"""What a planner is told and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """The sets of ViTL IV-A2, by letter of the automaton. Other names are no obstacle.

    Attributes:
        detected: D, seen and not reached yet.
        reached: R.
        failed: B, given up on; wins where a letter is in another set too.
        distance_m: (k + 1, k) float64, metres to drive from letter i (row k: from the robot) to
            letter j; inf or NaN where that is not known. Only read with distances as weights.
    """

    detected: frozenset[str] = frozenset()
    reached: frozenset[str] = frozenset()
    failed: frozenset[str] = frozenset()
    distance_m: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """A way to acceptance, or why there is none.

    Attributes:
        target: the object to go to now; None when accepted, infeasible, or when the first step
            is one in which nothing of the formula is reached.
        steps: letters along the way, `NOTHING` ("") possible; () when accepted or infeasible.
        cost: the sum of eq. 2, or the expected cost; inf when infeasible.
        feasible: whether acceptance can be reached without a failed object.
        blocked_by: failed objects that would open the shortest way to acceptance if they were
            found after all; () when feasible, and when success is impossible in any case.
        reason: one plain line: why this target.
        options: (first letter, cost of the best way that begins with it), cheapest first.
            Letters that lead to a dead state or change nothing are left out.
    """

    target: str | None
    steps: tuple[str, ...]
    cost: float
    feasible: bool
    blocked_by: tuple[str, ...]
    reason: str
    options: tuple[tuple[str, float], ...]


class Planner(Protocol):
    """Chooses the next object. Ties go to the way with the fewest steps, then to the current
    target, then to the letter that comes first in the formula."""

    def plan(self, state: int, knowledge: Knowledge, current: str | None = None) -> Plan:
        """The best way from a state of the automaton.

        Args:
            current: the target that is being pursued; None right after one was reached.
        """
        ...


ACCEPTED = Plan(None, (), 0.0, True, (), "done: the formula is satisfied", ())
DEAD = Plan(
    None, (), float("inf"), False, (), "the formula can no longer be satisfied, whatever is "
    "reached from here on", (),
)  # fmt: skip

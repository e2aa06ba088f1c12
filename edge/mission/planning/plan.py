"""What a planner is told and what it answers, in sets, steps and words for the operator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from edge.mission.logic.automaton import NOTHING


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
        cost: the sum of eq. 2; inf when infeasible.
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


_TARGET = {
    "nothing": "{} comes first",
    "failed": "{} failed",
    "seen": "{} was seen",
    "reached": "{} was reached before",
    "unknown": "{} has to be found",
}
_RIVAL = {**_TARGET, "unknown": "{} would have to be found", "nothing": "{} first"}
_SAME = 1e-9


def named(letter: str) -> str:
    """The letter, or what to call the step that reaches nothing."""
    return "a step with none of the objects" if letter == NOTHING else letter


def status(letter: str, knowledge: Knowledge) -> str:
    """A key of the tables above."""
    if letter == NOTHING:
        return "nothing"
    for key in ("failed", "detected", "reached"):
        if letter in getattr(knowledge, key):
            return "seen" if key == "detected" else key
    return "unknown"


def explain(
    target: str,
    options: Sequence[tuple[str, float]],
    knowledge: Knowledge,
    text: Callable[[float], str],
) -> str:
    """What is known of the target, what it costs, and the best other choice.

    Args:
        options: see `Plan.options`.
        text: writes a cost.

    >>> known = Knowledge(detected=frozenset({"sofa"}))
    >>> explain("sofa", [("sofa", 1.01), ("chair", 2.0)], known, "{:.2f}".format)
    'sofa was seen: 1.01 to the end; chair would have to be found: 2.00'
    """
    cost = dict(options)
    words = _TARGET[status(target, knowledge)].format(named(target))
    words = f"{words}: {text(cost[target])} to the end"
    rival = next((letter for letter, _ in options if letter != target), None)
    if rival is None:
        return f"{words}; nothing else can come first"
    kind = status(rival, knowledge)
    other = _RIVAL[kind].format(named(rival))
    if kind == "failed":
        return f"{words}; {other}"
    if abs(cost[rival] - cost[target]) < _SAME:
        return f"{words}; {named(rival)} first would cost the same"
    return f"{words}; {other}: {text(cost[rival])}"


def explain_kept(current: str, rival: str, gain: str, margin: str) -> str:
    """Why the current target stays although another is a little better."""
    return f"{current} is kept: {named(rival)} first would save {gain}, not more than {margin}"


def explain_blocked(needed: Sequence[str]) -> str:
    """Why there is no plan."""
    return f"every way to the end needs an object that failed; the shortest needs {listed(needed)}"


def listed(words: Sequence[str]) -> str:
    """Words as English lists them.

    >>> listed(["chair", "sofa", "bed"])
    'chair, sofa and bed'
    """
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)

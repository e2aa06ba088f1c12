"""Input and output of a planner, and explanations for the operator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from edge.mission.logic.automaton import NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class MissionKnowledge:
    """The sets D, R and B of ViTL IV-A2, of propositions; unknown names are ignored.

    Attributes:
        detected: D, detected and not reached yet.
        failed: B, abandoned. Takes precedence if a proposition is in another set too.
        distance_m: (k + 1, k) float64, driving distance in metres from object i (row k: from the
            robot) to object j; inf or NaN if unknown. Only used with distances as weights.
    """

    detected: frozenset[str] = frozenset()
    reached: frozenset[str] = frozenset()
    failed: frozenset[str] = frozenset()
    distance_m: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class TargetPlan:
    """A path to acceptance, or the reason why there is none.

    Attributes:
        target: the next object; None if accepted, if infeasible, or if the first step reaches no
            object of the formula.
        steps: the trace along the path; `NOTHING` ("") is a step that reaches no object. () if
            accepted or infeasible.
        cost: the sum of eq. 2; inf if infeasible.
        feasible: True if acceptance can be reached without a failed object.
        blocked_by: failed objects on the shortest path to acceptance; () if feasible, or if
            success is impossible in any case.
        options: (first proposition, cost of the best path that begins with it), cheapest first.
            Those that lead to a dead state or change nothing are left out.
    """

    target: str | None
    steps: tuple[str, ...]
    cost: float
    feasible: bool
    blocked_by: tuple[str, ...]
    reason: str
    options: tuple[tuple[str, float], ...]


class Planner(Protocol):
    """Interface that chooses the next object.

    Ties go to the path with the fewest steps, then to the current target, then to the proposition
    that comes first in the formula.
    """

    def plan(
        self, state: int, knowledge: MissionKnowledge, current: str | None = None
    ) -> TargetPlan:
        """Return the best path from a state of the automaton.

        Args:
            state: state of the automaton.
            knowledge: what is known about the objects.
            current: the pursued target; None right after one was reached.
        """
        ...


# The plans if the formula is fulfilled, and if it can no longer be fulfilled.
ACCEPTED = TargetPlan(None, (), 0.0, True, (), "done: the formula is satisfied", ())
DEAD = TargetPlan(
    None, (), float("inf"), False, (), "the formula can no longer be satisfied, whatever is "
    "reached from here on", (),
)  # fmt: skip


_TARGET_PHRASES = {
    "nothing": "{} comes first",
    "failed": "{} failed",
    "seen": "{} can come next",
    "reached": "{} was reached before",
    "unknown": "{} has to be found",
}
_OTHER_PHRASES = {**_TARGET_PHRASES, "unknown": "{} would have to be found", "nothing": "{} first"}
_SAME_COST = 1e-9  # costs that differ by less are equal


def step_text(reached: str) -> str:
    """Return the name of the reached object, or a phrase for the step that reaches nothing."""
    return "a step with none of the objects" if reached == NOTHING else reached


def status(proposition: str, knowledge: MissionKnowledge) -> str:
    """Return the state of a proposition, as a key of `_TARGET_PHRASES`."""
    if proposition == NOTHING:
        return "nothing"
    for key in ("failed", "detected", "reached"):
        if proposition in getattr(knowledge, key):
            return "seen" if key == "detected" else key
    return "unknown"


def explain(
    target: str,
    options: Sequence[tuple[str, float]],
    knowledge: MissionKnowledge,
    in_metres: bool,
) -> str:
    """Return the status of the target, and the best other choice, in one line.

    With costs in metres, it has the cost to the end of the mission of both.

    >>> known = MissionKnowledge(detected=frozenset({"sofa"}))
    >>> explain("sofa", [("sofa", 1.0), ("chair", 2.0)], known, in_metres=True)
    'sofa can come next: 1.0 m to the end; chair would have to be found: 2.0 m'
    """
    cost = dict(options)
    words = _TARGET_PHRASES[status(target, knowledge)].format(step_text(target))
    if in_metres:
        words = f"{words}: {cost[target]:.1f} m to the end"
    second = next((name for name, _ in options if name != target), None)
    if second is None:
        return words
    kind = status(second, knowledge)
    other = _OTHER_PHRASES[kind].format(step_text(second))
    if kind == "failed":
        return f"{words}; {other}"
    if abs(cost[second] - cost[target]) < _SAME_COST:
        return f"{words}; {step_text(second)} first would cost the same"
    return f"{words}; {other}: {cost[second]:.1f} m" if in_metres else f"{words}; {other}"


def explain_hysteresis(current: str, best: str, gain_m: float, margin_m: float) -> str:
    """Return why the current target is kept although another one is slightly better."""
    saves = f"{step_text(best)} first would save {gain_m:.1f} m, not more than {margin_m:.1f} m"
    return f"{current} is kept: {saves}"


def explain_blocked(needed: Sequence[str]) -> str:
    """Return why there is no plan."""
    return (
        f"every way to the end needs an object that failed; the shortest needs {and_list(needed)}"
    )


def and_list(words: Sequence[str]) -> str:
    """Return words as an English list.

    >>> and_list(["chair", "sofa", "bed"])
    'chair, sofa and bed'
    """
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)

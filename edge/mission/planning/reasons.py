"""Why a planner chose a target, in words for the operator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from edge.mission.automaton import NOTHING
from edge.mission.planning.plan import Knowledge

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

"""How a task stands, for those who show it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from edge.tasks.refine import Refined
from edge.tasks.write import Round

TaskPhase = Literal["looking", "writing", "driving", "verifying", "reached", "failed"]
StepState = Literal["driven", "under way", "looked for", "to come", "not driven"]


@dataclass(frozen=True, slots=True)
class StepFacts:
    """A step of a task: its part of the instruction, and how it stands.

    Attributes:
        state: `looked for`: what it names was not seen yet; `not driven`: the task is over.
    """

    said: str
    state: StepState


@dataclass(frozen=True, slots=True, eq=False)
class TaskFacts:
    """A task as it stood at one moment.

    Attributes:
        phase: `looking` for what it names, `writing` its trajectory (the robot stands), `driving`,
            `verifying` that what it stopped at is what was named.
        writer: who writes: "rules", or a model and its server.
        missing: what its steps that were not driven name, and nobody has seen yet.
        understood: what the rules read, in words; "" of a model.
        prompt: all that a model was told, in words; "" of the rules.
        rounds: of a model.
        coarse_m: (n, 2) float64 in `map`, what was written; None before.
        refined: what is driven; None before.
        index: of the pose in `refined` that the robot has come to.
        refinements: how often it was refined; each after the first since the map had changed.
        notes: what became otherwise than it was asked for, a line each.
        steps: in their order; with a model one.
    """

    instruction: str
    phase: TaskPhase
    writer: str
    missing: tuple[str, ...] = ()
    understood: str = ""
    prompt: str = ""
    rounds: tuple[Round, ...] = ()
    coarse_m: np.ndarray | None = None
    refined: Refined | None = None
    index: int = 0
    refinements: int = 0
    notes: tuple[str, ...] = ()
    steps: tuple[StepFacts, ...] = ()


def same_words(one: TaskFacts | None, other: TaskFacts | None) -> bool:
    """Whether two say the same, but for how far it is driven: what was told has not to be told
    again."""
    if one is None or other is None:
        return one is other
    same_line = (
        one.coarse_m is other.coarse_m
        if one.coarse_m is None or other.coarse_m is None
        else np.array_equal(one.coarse_m, other.coarse_m)
    )
    return same_line and all(getattr(one, name) == getattr(other, name) for name in _WORDS)


_WORDS = tuple(name for name in TaskFacts.__slots__ if name not in ("coarse_m", "index"))


def thinned(refined: Refined, index: int, most: int) -> tuple[np.ndarray, int]:
    """A trajectory to draw: of many poses some, the last among them.

    Returns:
        (k, 3) float64, x, y [m] and heading [rad], k <= most; and the index in it of the newest
        that lies not ahead of pose `index` of `refined`, -1 where all do.
    """
    n = len(refined.poses)
    stride = -(-n // most)
    first = (n - 1) % stride
    return refined.poses[first::stride][:, [0, 1, 3]], (index - first) // stride


def lengths_m(refined: Refined, index: int) -> tuple[float, float]:
    """How long it is in all, and up to pose `index`."""
    steps_m = np.hypot(*np.diff(refined.poses[:, :2], axis=0).T)
    return float(steps_m.sum()), float(steps_m[:index].sum())

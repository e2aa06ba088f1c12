"""Status of a task (`TaskStatus`), for display and messages, and numbers that displays need."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edge.tasks.refine import RefinedTrajectory
from edge.tasks.write import PlanAttempt

TaskPhase = Literal["looking", "writing", "driving", "verifying", "reached", "failed"]
StepState = Literal["driven", "under way", "looked for", "to come", "not driven"]


@dataclass(frozen=True, slots=True)
class StepStatus:
    """One step of a task: its part of the instruction, and its state.

    Attributes:
        said: the part of the instruction.
        state: `looked for`: its object was not seen yet; `not driven`: the task ended before it.
    """

    said: str
    state: StepState


@dataclass(frozen=True, slots=True, eq=False)
class TaskStatus:
    """Status of a task at one moment.

    Attributes:
        phase: `looking` for its objects, `writing` its trajectory (the robot stands still),
            `driving`, or `verifying` that the object at the stop is the named one; `reached` or
            `failed` at the end.
        writer: "rules", or the model and its server.
        missing: objects that steps not driven yet name, and that were never seen.
        understood: interpretation by the rules, in words; "" for a model.
        prompt: the full text prompt of a model; "" for the rules.
        rounds: answers of a model.
        coarse_m: (n, 2) float64 in `map`, the coarse trajectory; None before it is written.
        refined: the trajectory that is driven; None before it is refined.
        index: pose in `refined` that the robot has reached.
        refinements: number of refinements; each after the first because the map changed.
        notes: differences from the request, a line each.
        steps: steps in their order; one step for a model.
    """

    instruction: str
    phase: TaskPhase
    writer: str
    missing: tuple[str, ...] = ()
    understood: str = ""
    prompt: str = ""
    rounds: tuple[PlanAttempt, ...] = ()
    coarse_m: np.ndarray | None = None
    refined: RefinedTrajectory | None = None
    index: int = 0
    refinements: int = 0
    notes: tuple[str, ...] = ()
    steps: tuple[StepStatus, ...] = ()


def same_text(one: TaskStatus | None, other: TaskStatus | None) -> bool:
    """Return True if two statuses have the same text and trajectory, apart from progress.

    The publisher need not send a status again if only the progress differs.
    """
    if one is None or other is None:
        return one is other
    same_coarse = (
        one.coarse_m is other.coarse_m
        if one.coarse_m is None or other.coarse_m is None
        else np.array_equal(one.coarse_m, other.coarse_m)
    )
    return same_coarse and all(getattr(one, name) == getattr(other, name) for name in _COMPARED)


_COMPARED = tuple(name for name in TaskStatus.__slots__ if name not in ("coarse_m", "index"))
"""Attributes that `same_text` compares with `==`."""


def thinned(refined: RefinedTrajectory, index: int, max_poses: int) -> tuple[np.ndarray, int]:
    """Return a trajectory with fewer poses for drawing; the last pose is always kept.

    Returns:
        (k, 3) float64: x, y [m] and heading [rad], k <= max_poses; and the index in it of the last
        pose that is not after pose `index` of `refined`, -1 if there is none.
    """
    n = len(refined.poses)
    stride = math.ceil(n / max_poses)
    first = (n - 1) % stride
    return refined.poses[first::stride][:, [0, 1, 3]], (index - first) // stride


def lengths_m(refined: RefinedTrajectory, index: int) -> tuple[float, float]:
    """Return the length of a trajectory, and its length up to pose `index`."""
    steps_m = np.hypot(*np.diff(refined.poses[:, :2], axis=0).T)
    return float(steps_m.sum()), float(steps_m[:index].sum())

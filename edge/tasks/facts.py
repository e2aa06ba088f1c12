"""How a task stands, for those who show it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from edge.tasks.refine import Refined
from edge.tasks.write import Round

TaskPhase = Literal["looking", "writing", "driving", "reached", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class TaskFacts:
    """A task as it stood at one moment.

    Attributes:
        phase: `looking` for what it names, `writing` its trajectory (the robot stands), `driving`.
        writer: who writes: "rules", or a model and its server.
        missing: what it names and nobody has seen yet.
        understood: what the rules read, in words; "" of a model.
        prompt: all that a model was told, in words; "" of the rules.
        rounds: of a model.
        coarse_m: (n, 2) float64 in `map`, what was written; None before.
        refined: what is driven; None before.
        index: of the pose in `refined` that the robot has come to.
        refinements: how often it was refined; each after the first since the map had changed.
        notes: what became otherwise than it was asked for, a line each.
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

"""The interface of a behaviour: one way to carry out a mission."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from edge.config import Config
from edge.policies.base import Context
from edge.tasks.facts import TaskFacts
from edge.types import Goal, Instance


class Behaviour(Protocol):
    """One way to carry out one mission; the loop's thread calls it.

    It holds the mission, the semantic map and the goals that it was made with, and nothing of the
    sensors: each tick's observation comes in the `Context`.

    """

    @property
    def searching(self) -> bool:
        """Whether the active target is looked for, so the time counts as searching it."""

    def gather(self) -> Sequence[Instance]:
        """Stage 5: return the objects that are candidates in this tick, next to the frontiers."""

    def plan(self, context: Context, images: int) -> None:
        """Stage 7: handle what was seen and what became of the goal; advance the mission.

        Args:
            images: how many the detector has searched so far.
        """

    def select(self, context: Context, scores: np.ndarray, images: int) -> Goal | None:
        """Stage 8: return the goal of this tick, or None to stand. The mission is under way.

        Args:
            scores: float32 (n,), of `context.candidates`.
            images: how many the detector has searched so far.
        """

    def facts(self) -> TaskFacts | None:
        """Return what is known of a trajectory; None for a behaviour that follows none."""

    def reconfigure(self, config: Config) -> None:
        """Use another configuration from the next tick on."""

    def forget(self) -> None:
        """Drop what is held in the old frame: the pose jumped."""

    def close(self) -> None:
        """Stop work in the background: the mission is replaced, or the service ends."""

"""The interface of behaviours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from edge.config import Config
from edge.policies.base import PolicyInput
from edge.tasks.facts import TaskStatus
from edge.tasks.scene.pipeline import GroundKinds
from edge.types import Goal, Instance


class Behaviour(Protocol):
    """A way to carry out one mission. The loop's thread calls it.

    A behaviour keeps the mission, the semantic map and the goal tracker, but no sensor data. The
    observation of each tick comes in the `PolicyInput`.
    """

    @property
    def searching(self) -> bool:
        """True while the behaviour searches for the active target. The time counts as search."""

    def target_objects(self) -> Sequence[Instance]:
        """Stage `candidates`: return the objects to add to the candidates of this tick."""

    def plan(self, context: PolicyInput, images: int) -> None:
        """Stage `plan`: handle the detections and the goal's progress; advance the mission.

        Args:
            context: Observation, candidates and time of the tick.
            images: Number of images that the detector has processed so far.
        """

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Stage `select`: return the goal of this tick; None to stand still. The mission is active.

        Args:
            context: Observation, candidates and time of the tick.
            scores: (n,) float32, scores of `context.candidates`.
            images: Number of images that the detector has processed so far.
        """

    def task_status(self) -> TaskStatus | None:
        """Return the state of the trajectory; None for a behaviour without one."""

    def reconfigure(self, config: Config, ground: GroundKinds | None) -> None:
        """Use another configuration, and what names kinds of ground, from the next tick on."""

    def on_pose_jump(self) -> None:
        """Drop all data in the old frame, after a pose jump."""

    def close(self) -> None:
        """Stop background work: the mission is replaced, or the service ends."""

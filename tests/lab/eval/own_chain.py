"""A user's own pipeline: one box, at the configured place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.tasks.scene.pipeline import PerceptionPipeline
from edge.types import Detections, Observation


def make(words: tuple[str, ...], box: Sequence[float], fails: str = "") -> PerceptionPipeline:
    def tags(observation: Observation) -> tuple[str, ...]:
        return ("mailbox", *words)

    def boxes(observation: Observation, tags: Sequence[str]) -> Detections:
        if fails:
            raise RuntimeError(fails)
        return Detections(
            observation, np.array([box], np.float32), np.ones(1, np.float32),
            np.zeros(1, np.int32), tuple(tags),
        )  # fmt: skip

    return PerceptionPipeline(
        tags, boxes, lambda found: found, lambda found: ["a yellow box"] * len(found)
    )


def made_of_nothing() -> object:
    return object()

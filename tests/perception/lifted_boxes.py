"""Back-projected boxes of objects at known places, as if a detector had found them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.perception.tracking.back_projection import POINTS, BackProjectedBoxes
from edge.types import Detections, Observation


def lifted(
    frame: Observation,
    things: Sequence[tuple[str, float, float, float]],
    words: tuple[str, ...],
    seed: int,
    size_m: float = 0.1,
    z_m: float = 0.4,
    competing_score: float = 0.0,
) -> BackProjectedBoxes:
    """Return (label, x, y, score) each, if its label is one of the words, best first."""
    mine = sorted((t for t in things if t[0] in words), key=lambda t: -t[3])
    n = len(mine)
    places = np.array([(t[1], t[2], z_m) for t in mine], np.float32).reshape(n, 3)
    spread = np.random.default_rng(seed).uniform(-size_m, size_m, (n, POINTS, 3))
    detections = Detections(
        frame, np.zeros((n, 4), np.float32), np.array([t[3] for t in mine], np.float32),
        np.array([words.index(t[0]) for t in mine], np.int32), words,
        np.full(n, competing_score, np.float32),
    )  # fmt: skip
    full = np.full(n, POINTS, np.int32)
    points = (places[:, None] + spread).astype(np.float32)
    return BackProjectedBoxes(detections, places, points, full, np.ones(n, np.bool_))

"""Frames: one whose holders are counted, and one that shows nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edge.geometry import SE2
from edge.types import Observation

if TYPE_CHECKING:
    from edge.lab.eval.closed_loop import ClosedLoop


class Slot:
    """Counts holds as a frame pool does."""

    def __init__(self, holds: int = 0) -> None:
        self.holds = holds

    def hold(self) -> None:
        self.holds += 1

    def release(self) -> None:
        assert self.holds > 0
        self.holds -= 1


def blank_observation(seq: int, stamp_ns: int, pose: SE2, loop: ClosedLoop) -> Observation:
    """Return a frame of a working camera that adds nothing to the map: every pixel is too near."""
    depth = np.full(loop.rig.depth_m.shape, 0.01, np.float32)
    rgb = np.zeros((*depth.shape, 3), np.uint8)
    rgb[len(rgb) // 2 :] = 255
    return Observation(
        seq, stamp_ns, pose.matrix(), rgb=None if loop.rig.rgb is None else rgb, depth_m=depth,
        camera=loop.rig.model, T_base_camera=loop.rig.T_base_camera,
    )  # fmt: skip

"""The semantic map says when the floor is not where the sensor's mount has it."""

from __future__ import annotations

import logging

import numpy as np
from simulated import simulated

from edge.geometry import CameraModel, optical, se3
from edge.loop.semantic_map import SemanticMap
from edge.types import Observation

CAMERA = CameraModel.from_hfov(64, 48, 1.3)
T_BASE_CAMERA = optical(se3(0.1, 0.0, 0.6, pitch_rad=0.3))


def floor_at(z_m: float | None, seq: int) -> Observation:
    """A camera over a level floor at a height of `map`; None: nothing returns."""
    row = (np.arange(48) - CAMERA.cy_px) / CAMERA.fy_px
    fall = -(T_BASE_CAMERA[2, 1] * row + T_BASE_CAMERA[2, 2])
    depth = np.full(48, np.nan)
    if z_m is not None:
        depth[fall > 0] = (0.6 - z_m) / fall[fall > 0]
    image = np.repeat(depth[:, None], 64, axis=1).astype(np.float32)
    return Observation(
        seq, seq, np.eye(4), depth_m=image, camera=CAMERA, T_base_camera=T_BASE_CAMERA
    )


def test_a_missing_floor_is_told_once_and_that_it_is_found(caplog):
    known = SemanticMap(simulated(), ("bed",))
    with caplog.at_level(logging.INFO, "edge.loop.semantic_map"):
        for seq, z_m in enumerate((None, -2.0, -2.0, None, -2.0, 0.0, 0.0, None)):
            known.update(floor_at(z_m, seq), seq)
    known.close()
    said = [
        (record.levelname, record.getMessage().split(" m of map")[0]) for record in caplog.records
    ]
    assert said == [("WARNING", "no floor near z = 0.00"), ("INFO", "floor found at z = 0.00")]

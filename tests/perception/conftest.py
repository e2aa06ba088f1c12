"""Fixtures for perception: a vocabulary of three words, observations, model cards."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from edge.geometry import CameraModel, se3, to_optical
from edge.types import Observation

sys.path.insert(0, str(Path(__file__).parent))  # for `twins`, `tiny_clip`


@pytest.fixture
def vocabulary(tmp_path):
    """Return a small vocabulary with orthogonal embeddings of length 512."""
    words = ["chair", "sofa", "trash can", "desk", "bed", "window"]
    path = tmp_path / "words.npz"
    np.savez(path, names=np.array(words), emb=2 * np.eye(len(words), 512, dtype=np.float16))
    return path


@pytest.fixture
def make_observation():
    """Observation of a camera 0.6 m up that looks along x, from keyword arrays."""

    def make(seq=0, stamp_ns=None, x_m=0.0, y_m=0.0, hw=(64, 80), **arrays):
        T = np.eye(4)
        T[:2, 3] = x_m, y_m
        return Observation(
            seq=seq,
            stamp_ns=seq * 100_000_000 if stamp_ns is None else stamp_ns,
            T_map_base=T,
            camera=CameraModel.from_hfov(hw[1], hw[0], 1.3),
            T_base_camera=to_optical(se3(0.0, 0.0, 0.6)),
            **arrays,
        )

    return make

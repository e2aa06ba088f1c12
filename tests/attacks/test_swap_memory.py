"""Swapping models again and again: what a swap takes is given back."""

from __future__ import annotations

import gc
import shutil

import numpy as np
import psutil
import pytest
import yaml
from patience import eventually

from edge import resources
from edge.config import parse
from edge.geometry import CameraModel
from edge.perception.detector import make_detector
from edge.perception.swap.swapper import OVER, Swapper
from edge.perception.worker import DetectorWorker
from edge.types import Observation

pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.slow

SHIPPED = "mini-house-256x320-int8-cpu"
# The allocator has found its size by half of them, give or take 5 MB; each model kept takes 10.
SPREAD_MB = 16.0


@pytest.fixture
def names(tmp_path, monkeypatch) -> tuple[str, str]:
    """The shipped model under two names."""
    shipped = resources.data_dir("models")
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir()
    for name in ("first", "second"):
        card = yaml.safe_load((shipped / f"{SHIPPED}.yaml").read_text())
        card.update(name=name, file=f"{name}.onnx")
        (resources.models_dir() / f"{name}.yaml").write_text(yaml.safe_dump(card))
        shutil.copy(shipped / f"{SHIPPED}.onnx", resources.models_dir() / f"{name}.onnx")
    return "first", "second"


@pytest.mark.parametrize(("isolation", "swaps"), [("thread", 24), ("process", 8)])
def test_memory_and_descriptors_are_flat_over_many_swaps(names, isolation, swaps):
    perception = parse({
        "perception": {
            "detector": {"kind": "onnx", "model": names[0], "threads": 1},
            "isolation": isolation,
            "process": {"timeout_s": 60.0},
            "swap": {"images": 2, "probation": 4, "budget_ms": 1e5},
        },
    }).perception  # fmt: skip
    worker, me, told = DetectorWorker(make_detector(perception, ["chair"])), psutil.Process(), []
    swapper = Swapper(perception, worker, lambda text, now_ns: told.append(text))
    rgb = np.random.default_rng(0).integers(0, 255, (256, 320, 3), np.uint8)
    camera, seq = CameraModel.from_hfov(320, 256, 1.3), 0

    def over() -> bool:
        """Whether a swap is, after one more image."""
        nonlocal seq
        seq += 1
        worker.submit(Observation(seq, seq * 200_000_000, np.eye(4), rgb=rgb, camera=camera))
        swapper.step(seq)
        if (found := worker.poll()) is not None:
            found.observation.release()
        return swapper.state in OVER

    resident_mb, descriptors = [], []
    try:
        for k in range(swaps):
            swapper.request(names[(k + 1) % 2], False, seq)
            eventually(over, "the swap never ended")
            assert swapper.state == "kept", told[-1]
            eventually(lambda: not any(t.is_alive() for t in swapper._closing))
            gc.collect()
            resident_mb.append(me.memory_info().rss / 1e6)
            descriptors.append(me.num_fds())
    finally:
        swapper.close()
        worker.close()
    settled_mb = resident_mb[swaps // 2 :]
    assert max(settled_mb) - settled_mb[0] < SPREAD_MB, resident_mb
    assert max(descriptors[1:]) <= descriptors[0], descriptors

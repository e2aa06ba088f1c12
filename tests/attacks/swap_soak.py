"""Soak of model swaps: `python swap_soak.py ISOLATION SWAPS FIRST SECOND`.

Swaps one model for the other and back, and prints the process's memory after each swap.
"""

from __future__ import annotations

import gc
import json
import sys

import numpy as np
from fresh_process import descriptors, resident_mb
from live_patience import eventually

from edge.config import parse
from edge.geometry import CameraModel
from edge.perception.factory import make_detector
from edge.perception.swap.base import FINAL_STATES
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker
from edge.types import Observation


def swap(isolation: str, swaps: int, names: tuple[str, str]) -> dict:
    perception = parse({
        "perception": {
            "detector": {"kind": "onnx", "model": names[0], "threads": 1},
            "isolation": isolation,
            "process": {"timeout_s": 60.0},
            "swap": {"probation": 4, "budget_ms": 1e5},
        },
    }).perception  # fmt: skip
    worker, told = DetectorWorker(make_detector(perception, ["chair"])), []
    swapper = DetectorSwap(perception, worker, lambda text, *_: told.append(text))
    rgb = np.random.default_rng(0).integers(0, 255, (256, 320, 3), np.uint8)
    camera, seq = CameraModel.from_hfov(320, 256, 1.3), 0

    def over() -> bool:
        """Return True if a swap has ended, after one more image."""
        nonlocal seq
        seq += 1
        worker.submit(Observation(seq, seq * 200_000_000, np.eye(4), rgb=rgb, camera=camera))
        swapper.step(seq)
        if (found := worker.poll()) is not None:
            found.observation.release()
        return swapper.state in FINAL_STATES

    resident, opened = [], []
    try:
        for k in range(swaps):
            swapper.request(names[(k + 1) % 2], False, seq)
            eventually(over, "the swap never ended")
            assert swapper.state == "kept", told[-1]
            eventually(lambda: not any(ended.thread.is_alive() for ended in swapper._ended))
            gc.collect()
            resident.append(resident_mb())
            opened.append(descriptors())
    finally:
        swapper.close()
        worker.close()
    return {"resident_mb": resident, "descriptors": opened}


def main(isolation: str, swaps: str, first: str, second: str) -> None:
    print(json.dumps(swap(isolation, int(swaps), (first, second))))


if __name__ == "__main__":
    main(*sys.argv[1:])

"""One model alone in a process: `python -m edge.models.bench.worker JOB.json`.

Whatever it costs here, in time or memory, is this model's doing; if it crashes, nothing else does.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from edge import config
from edge.errors import UserError
from edge.eval.bench import resident_mb
from edge.host import machine
from edge.logs import setup
from edge.perception.backends.cuda import gpu_of
from edge.perception.detector import Health
from edge.perception.factory import make_detector
from edge.perception.warmup import warmup
from edge.text import one_line
from edge.types import Detections, Observation

WARM_FRAMES = 5


def main(argv: list[str]) -> int:
    """Do what the job says; 0, or 1 with one line on stdout."""
    setup("error")
    job = json.loads(Path(argv[0]).read_text(encoding="utf-8"))
    try:
        np.savez(job["out"], **measure(job))
    except UserError as error:
        print(one_line(error, 1000))
        return 1
    except Exception as error:  # of the runtime: one row of the table
        print(one_line(f"{type(error).__name__}: {error}"))
        return 1
    return 0


def measure(job: dict) -> dict[str, np.ndarray]:
    """Run the model over all frames.

    Args:
        job: `detector` (settings), `prompts`, `frames` (an .npz with arrays `f0`, `f1`, …),
            `tau_det`.

    Returns:
        stages_ns (n, 3) of pre, session, post; boxes (`xyxy_px`, `score`, `class_id`) of all
        frames one after another, `count` (n,) how many each has; `load_s`, `memory_mb`,
        `gpu_memory_mb` and `others_cores` (NaN where unknown), `invalid_boxes`; `gpu`, its name,
        empty on the CPU.
    """
    with np.load(job["frames"]) as file:
        seen = [_observation(k, file[f"f{k}"]) for k in range(len(file.files))]
    warmup()  # compiling is not the model's doing
    before_mb, gpu_before_mb = resident_mb(), machine.gpu_memory_mb()
    began = time.perf_counter()
    perception = config.Perception(detector=config.DetectorOnnx(**job["detector"]))
    detector = make_detector(perception, job["prompts"], _tell)
    for observation in seen[:WARM_FRAMES]:
        detector.detect(observation)
    load_s = time.perf_counter() - began
    stages_ns, found, others = [], [], _Others()
    for observation in seen:
        found.append(strong(detector.detect(observation), job["tau_det"]))
        stages_ns.append(detector.stages_ns)  # type: ignore[attr-defined]
    others_cores = others.cores()
    gpu_after_mb = machine.gpu_memory_mb()
    gpu_mb = np.nan if None in (gpu_before_mb, gpu_after_mb) else gpu_after_mb - gpu_before_mb
    return {
        "stages_ns": np.array(stages_ns, np.int64),
        "count": np.array([len(d[1]) for d in found]),
        **{name: np.concatenate([d[k] for d in found]) for k, name in enumerate(_FOUND)},
        "load_s": np.array(load_s),
        "memory_mb": np.array(resident_mb() - before_mb),
        "gpu_memory_mb": np.array(gpu_mb),
        "others_cores": np.array(others_cores),
        "invalid_boxes": np.array(getattr(detector, "invalid_boxes", 0)),
        "gpu": np.array(used_gpu(perception.detector)),
    }


def used_gpu(settings: config.DetectorOnnx) -> str:
    """The name of the GPU that a detector runs on, empty where it is the CPU."""
    on_cpu = settings.providers[0] == "CPUExecutionProvider"
    return "" if on_cpu else gpu_of(settings.device_id)[0]


_FOUND = ("xyxy_px", "score", "class_id")


def strong(detections: Detections, tau_det: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes, scores and prompts that the running service would found an instance on."""
    kept = (detections.score > tau_det) & detections.unrivalled()
    return detections.xyxy_px[kept], detections.score[kept], detections.class_id[kept]


class _Others:
    """How many cores other processes keep busy, from when this is made."""

    def __init__(self) -> None:
        self._start = self._now()

    def cores(self) -> float:
        """On average; NaN where it is not told."""
        all_s, own_s, wall_s = (b - a for a, b in zip(self._start, self._now(), strict=True))
        return max(0.0, all_s - own_s) / wall_s if all_s == all_s else np.nan

    @staticmethod
    def _now() -> tuple[float, float, float]:
        busy_s = machine.busy_s()
        return np.nan if busy_s is None else busy_s, time.process_time(), time.perf_counter()


def _tell(health: Health) -> None:
    print(f"{health.state}: {health.detail}", file=sys.stderr, flush=True)


def _observation(seq: int, rgb: np.ndarray) -> Observation:
    return Observation(seq=seq, stamp_ns=seq * 100_000_000, T_map_base=np.eye(4), rgb=rgb)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""What a process of its own measures of a detector (see `alone`)."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.config import DetectorOnnx, Perception
from edge.host import machine
from edge.lab.bench import alone
from edge.lab.bench.boxes import Found
from edge.lab.bench.service import resident_mb
from edge.perception.factory import make_detector
from edge.perception.runtime.cuda import gpu_of
from edge.perception.runtime.health import Health
from edge.perception.warmup import warmup
from edge.types import Detections, Observation

WARM_FRAMES = 5


@dataclass(frozen=True, slots=True)
class Job:
    """What such a process does.

    Attributes:
        detector: the model and how to run it.
        rgb: frames, (h, w, 3) uint8 each.
        tau_det: boxes at or below it are left out.
    """

    detector: DetectorOnnx
    prompts: Sequence[str]
    rgb: Sequence[np.ndarray]
    tau_det: float


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What such a process leaves.

    Attributes:
        stages_ns: (n, 3) int64: making the input, the session, finding boxes, of each frame.
        found: the boxes of each frame.
        load_s: making it ready, with the first runs.
        memory_mb: what the process grew by.
        gpu_memory_mb: what the GPU's memory in use grew by; None where unknown.
        others_cores: how many cores other processes kept busy meanwhile; None where unknown.
        invalid_boxes: how many boxes were not sound.
        gpu: its name; None on the CPU.
    """

    stages_ns: np.ndarray
    found: list[Found]
    load_s: float
    memory_mb: float
    gpu_memory_mb: float | None
    others_cores: float | None
    invalid_boxes: int
    gpu: str | None


def measure(job: Job) -> Measured:
    """Run the model over all frames."""
    seen = [Observation(k, k * 100_000_000, np.eye(4), rgb) for k, rgb in enumerate(job.rgb)]
    warmup()  # compiling is not the model's doing
    before_mb, gpu_before_mb = resident_mb(), machine.gpu_memory_mb()
    began = time.perf_counter()
    detector = make_detector(Perception(detector=job.detector), job.prompts, _tell)
    for observation in seen[:WARM_FRAMES]:
        detector.detect(observation)
    load_s = time.perf_counter() - began
    stages_ns, found, since = [], [], _clocks()
    for observation in seen:
        found.append(strong(detector.detect(observation), job.tau_det))
        stages_ns.append(detector.stages_ns)  # type: ignore[attr-defined]
    others_cores = _others_cores(since, _clocks())
    return Measured(
        stages_ns=np.array(stages_ns, np.int64),
        found=found,
        load_s=load_s,
        memory_mb=resident_mb() - before_mb,
        gpu_memory_mb=_grown(gpu_before_mb, machine.gpu_memory_mb()),
        others_cores=others_cores,
        invalid_boxes=getattr(detector, "invalid_boxes", 0),
        gpu=used_gpu(job.detector),
    )


def _grown(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else after - before


def used_gpu(settings: DetectorOnnx) -> str | None:
    """The name of the GPU that a detector runs on, None where it is the CPU."""
    on_cpu = settings.providers[0] == "CPUExecutionProvider"
    return None if on_cpu else gpu_of(settings.device_id)[0]


def strong(detections: Detections, tau_det: float) -> Found:
    """What the running service would found an instance on."""
    kept = (detections.score > tau_det) & detections.unrivalled()
    return Found(detections.xyxy_px[kept], detections.score[kept], detections.class_id[kept])


def _clocks() -> tuple[float | None, float, float]:
    """Seconds that all cores were busy, that this process was, and of the wall clock."""
    return machine.busy_s(), time.process_time(), time.perf_counter()


def _others_cores(
    before: tuple[float | None, float, float], after: tuple[float | None, float, float]
) -> float | None:
    """How many cores other processes kept busy, on average."""
    if before[0] is None or after[0] is None:
        return None
    all_s, own_s, wall_s = (b - a for a, b in zip(before, after, strict=True))
    return max(0.0, all_s - own_s) / wall_s


def _tell(health: Health) -> None:
    print(f"{health.state}: {health.detail}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    from edge.lab.bench import measure as module  # whose types are pickled by this name

    sys.exit(alone.main(sys.argv[1:], module.measure))

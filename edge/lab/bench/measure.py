"""Speed and memory of one detector, measured in its own process (`edge.lab.bench.isolated`)."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.config import DetectorOnnx, PerceptionConfig
from edge.host import machine
from edge.lab.bench import isolated
from edge.lab.bench.boxes import DetectedBoxes
from edge.lab.bench.service import resident_mb
from edge.loop.warmup import warm_perception
from edge.perception.factory import make_detector
from edge.perception.runtime.cuda import gpu_of
from edge.perception.runtime.health import ModelHealth
from edge.types import Detections, Observation

WARM_FRAMES = 5  # frames before the measurement


@dataclass(frozen=True, slots=True)
class DetectorJob:
    """Job of a measuring process.

    Attributes:
        detector: the model and how to run it.
        rgb: frames, (h, w, 3) uint8 each.
        tau_det: boxes with this score or less are left out.
    """

    detector: DetectorOnnx
    prompts: Sequence[str]
    rgb: Sequence[np.ndarray]
    tau_det: float


@dataclass(frozen=True, slots=True, eq=False)
class DetectorMeasurement:
    """Result of a measuring process.

    Attributes:
        stages_ns: (n, 3) int64, time of preprocessing, session and postprocessing of each frame.
        load_s: time to load the model and run the warm-up frames.
        memory_mb: growth of the process's resident memory.
        gpu_memory_mb: growth of the GPU memory in use; None if unknown.
        others_cores: cores that other processes kept busy during the run; None if unknown.
        invalid_boxes: number of boxes with invalid values.
        gpu: name of the GPU; None on the CPU.
    """

    stages_ns: np.ndarray
    found: list[DetectedBoxes]
    load_s: float
    memory_mb: float
    gpu_memory_mb: float | None
    others_cores: float | None
    invalid_boxes: int
    gpu: str | None


def measure(job: DetectorJob) -> DetectorMeasurement:
    """Load the model, run it over all frames, and return times, memory and boxes."""
    seen = [Observation(k, k * 100_000_000, np.eye(4), rgb) for k, rgb in enumerate(job.rgb)]
    warm_perception()  # compile first: the time does not belong to the model
    before_mb, gpu_before_mb = resident_mb(), machine.gpu_memory_mb()
    began = time.perf_counter()
    detector = make_detector(PerceptionConfig(detector=job.detector), job.prompts, _print_health)
    for observation in seen[:WARM_FRAMES]:
        detector.detect(observation)
    load_s = time.perf_counter() - began
    stages_ns, found, since = [], [], _clocks()
    for observation in seen:
        found.append(usable_boxes(detector.detect(observation), job.tau_det))
        stages_ns.append(detector.stages_ns)  # type: ignore[attr-defined]
    others_cores = _others_cores(since, _clocks())
    return DetectorMeasurement(
        stages_ns=np.array(stages_ns, np.int64),
        found=found,
        load_s=load_s,
        memory_mb=resident_mb() - before_mb,
        gpu_memory_mb=_growth(gpu_before_mb, machine.gpu_memory_mb()),
        others_cores=others_cores,
        invalid_boxes=getattr(detector, "invalid_boxes", 0),
        gpu=used_gpu(job.detector),
    )


def _growth(before: float | None, after: float | None) -> float | None:
    """Return the difference; None if one of the two is unknown."""
    return None if before is None or after is None else after - before


def used_gpu(settings: DetectorOnnx) -> str | None:
    """Return the name of the GPU that a detector runs on; None on the CPU."""
    on_cpu = settings.providers[0] == "CPUExecutionProvider"
    return None if on_cpu else gpu_of(settings.device_id)[0]


def usable_boxes(detections: Detections, tau_det: float) -> DetectedBoxes:
    """Return the boxes that the service would use for its objects."""
    kept = (detections.score > tau_det) & detections.not_suppressed()
    return DetectedBoxes(
        detections.xyxy_px[kept], detections.score[kept], detections.class_id[kept]
    )


def _clocks() -> tuple[float | None, float, float]:
    """Return busy seconds of all cores, CPU seconds of this process, and wall-clock seconds."""
    return machine.busy_s(), time.process_time(), time.perf_counter()


def _others_cores(
    before: tuple[float | None, float, float], after: tuple[float | None, float, float]
) -> float | None:
    """Return how many cores other processes kept busy on average, between two `_clocks`."""
    if before[0] is None or after[0] is None:
        return None
    all_s, own_s, wall_s = (b - a for a, b in zip(before, after, strict=True))
    return max(0.0, all_s - own_s) / wall_s


def _print_health(health: ModelHealth) -> None:
    print(f"{health.state}: {health.detail}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    from edge.lab.bench import measure as module  # pickles name its types by this module

    sys.exit(isolated.main(sys.argv[1:], module.measure))

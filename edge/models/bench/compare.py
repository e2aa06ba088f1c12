"""All variants over the same frames, and what comes out of it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any, Union

import numpy as np

from edge.config import Config, DetectorOnnx
from edge.errors import UserError
from edge.host import machine
from edge.host.private_folder import private_folder
from edge.models.bench import figures, frames
from edge.models.bench.figures import Measured
from edge.models.bench.frames import Frames
from edge.models.bench.runs import Bench
from edge.models.bench.variants import Variant
from edge.perception.encoders import make_text_encoder
from edge.perception.model_file import remembered_sha256

log = logging.getLogger("edge.eval.bench")

Report = dict[str, Any]
Results = list[tuple[Variant, Union[Measured, str]]]
VERSION = 1
_FRAME_S = 2.0
"""What one frame may take at most, on average."""


def compare(
    config: Config, todo: Sequence[Variant], pictures: Frames, settings: DetectorOnnx
) -> Report:
    """Run all variants, each in a process of its own, and work out the figures.

    A variant's boxes are held against those of its FP32 model of the same input size and, where
    it is known, against what is there.

    Raises:
        UserError: the text encoder knows nothing of what is in the frames, or is not there.
    """
    resolve = make_text_encoder(todo[0].card, settings.vocabulary).resolve
    prompts, unknown = frames.prompts_for(pictures.labels, resolve)
    if not prompts:
        raise UserError("models bench: the text encoder knows nothing of what is in the frames")
    # The configured model's background may be foreign to another family's encoder.
    background = tuple(frames.words_for(settings.background, resolve))
    settings = settings.model_copy(update={"background": background})
    tau_det, perception = config.perception.tau_det, config.perception
    limit_s = perception.swap.load_timeout_s + _FRAME_S * len(pictures.rgb)
    before = machine.describe()
    with private_folder("edge-bench-") as folder:
        bench = Bench(folder, pictures.rgb, prompts, settings, tau_det, limit_s)
        results = _run_all(bench, todo)
        again = _again(bench, results)
    answers = frames.answers_of(pictures.labels, prompts)
    return {
        "version": VERSION,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "family": todo[0].card.family,
        "config": config.path,
        "machine": before,
        "clock_after": machine.describe().get("cpu_clock"),
        "frames": {
            "source": pictures.source,
            "count": len(pictures.rgb),
            "hw": sorted({image.shape[:2] for image in pictures.rgb}),
            "things": None if pictures.truth is None else pictures.counted,
        },
        "prompts": prompts,
        "unknown_labels": unknown if pictures.truth is not None else (),
        "tau_det": tau_det,
        "threads": settings.threads,
        "rows": [_row(*pair, results, pictures, prompts, answers) for pair in results],
        "again": again,
    }


def _run_all(bench: Bench, todo: Sequence[Variant]) -> Results:
    results = []
    for number, variant in enumerate(todo, 1):
        log.info("%d of %d: %s on %s", number, len(todo), variant.card.name, variant.on)
        results.append((variant, bench.run(variant)))
    return results


def _row(
    variant: Variant,
    result: Measured | str,
    results: Results,
    pictures: Frames,
    prompts: tuple[str, ...],
    answers: np.ndarray,
) -> dict[str, Any]:
    row = {"name": variant.card.name, "on": variant.on}
    if isinstance(result, str):
        state = "failed" if variant.card.is_here() else "missing"
        return {**row, "state": state, "why": result}
    truth = None
    if pictures.truth is not None:
        truth = figures.against_truth(result.found, pictures.truth, answers, prompts)
    return {
        **row,
        "state": "ran",
        "gpu": result.gpu or None,
        "sha256": remembered_sha256(variant.card.path),
        "latency_ms": figures.latency_ms(result.stages_ns),
        "load_s": round(result.load_s, 2),
        "memory_mb": round(result.memory_mb, 1),
        "gpu_memory_mb": _known(result.gpu_memory_mb),
        "others_cores": _known(result.others_cores),
        "invalid_boxes": result.invalid_boxes,
        "agreement": _agreement(variant, result, results),
        "truth": truth,
    }


def _known(value: float) -> float | None:
    return None if np.isnan(value) else round(value, 2)


def _agreement(variant: Variant, result: Measured, results: Results) -> dict[str, Any] | None:
    """Against FP32 of the same size, on the first provider where that ran; None for itself."""
    for other, reference in results:
        alike = other.card.precision == "fp32" and other.card.input == variant.card.input
        if alike and isinstance(reference, Measured):
            itself = reference is result
            return None if itself else figures.agreement(reference.found, result.found)
    return None


def _again(bench: Bench, results: Results) -> dict[str, Any] | None:
    """The first variant once more, to see whether the machine has become slower or faster."""
    ran = [(variant, result) for variant, result in results if isinstance(result, Measured)]
    if len(ran) < 2:
        return None
    variant, first = ran[0]
    log.info("once more, to see whether the machine's pace has changed: %s", variant.card.name)
    second = bench.run(variant)
    if isinstance(second, str):
        return None
    before, after = (figures.latency_ms(r.stages_ns)["session"]["p50"] for r in (first, second))
    return {
        "name": variant.card.name,
        "on": variant.on,
        "session_ms": after,
        "ratio": round(after / before, 3) if before else 1.0,
    }

"""`edge bench --models`: comparison of all variants of a family on the same frames.

A variant is one model on one provider (such as CPU or CUDA). Frames are images, with ground truth
if they are rendered. Each variant runs in its own process. Detectors are compared here, models that
choose frontiers in `choices`. `report` prints and saves the figures.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from typing import Any, Union

import numpy as np

from edge.config import Config, DetectorOnnx, load
from edge.errors import UserError
from edge.host import machine
from edge.lab.bench import boxes, choices, frames, report
from edge.lab.bench.frames import BenchFrames
from edge.lab.bench.isolated import run_isolated
from edge.lab.bench.measure import DetectorJob, DetectorMeasurement
from edge.lab.bench.report import Report
from edge.lab.bench.variants import PROVIDERS, Variant, families, providers_here, variants
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.runtime.cards import install_hint, load_detector_card
from edge.perception.runtime.model_file import remembered_sha256
from edge.perception.swap.base import LOAD_TIMEOUT_S

log = logging.getLogger(__name__)

Results = list[tuple[Variant, Union[DetectorMeasurement, str]]]
"""Each variant with its measurement, or with the reason why there is none."""
MEASURE = "edge.lab.bench.measure"  # module that measures in its own process
VERSION = 1  # of the report's format
STAGES = ("pre", "session", "post")  # preprocessing, inference, postprocessing
_FRAME_S = 2.0
"""Longest time that one frame may take, on average."""
_LIMIT = f"{LOAD_TIMEOUT_S:g} s + {_FRAME_S:g} s a frame"  # as text, for error messages


def run(args: argparse.Namespace) -> int:
    """Handle `edge bench --models`: compare, print and save.

    Returns:
        The exit status: 0, or 1 if no variant could run.

    Raises:
        UserError: an option, the configuration or the world cannot be used.
    """
    config = load(args.config)
    family = _family(args.models, config)
    # Some families have detectors, some have choice models, and some have both.
    has_choice_model = family in choices.families()
    if has_choice_model and family not in families():
        return choices.run(family, args, _pictures(args, config))
    todo = variants(family, providers_here(args.providers))
    sizes = [(v.card.input.height, v.card.input.width) for v in todo if v.card.is_here()]
    pictures = _pictures(args, config, sizes)
    found = compare(config, todo, pictures, _settings(config, args.threads))
    # The rows of the choice models; the name of the key belongs to the report's format.
    found["directions"] = choices.compare(family, args, pictures) if has_choice_model else []
    print(report.as_text(found))
    if has_choice_model:
        print("\n" + choices.as_text(family, found["directions"], pictures))
    print(f"saved to {report.save_report(found, args.json)}")
    ran = any(row["state"] == "ran" for row in found["rows"])
    return 0 if ran or choices.any_ran(found["directions"]) else 1


def _pictures(
    args: argparse.Namespace, config: Config, inputs_hw: Sequence[tuple[int, int]] = ()
) -> BenchFrames:
    """Return the frames that the command line asks for; `inputs_hw`: see `frames.from_world`."""
    if args.images is not None:
        return frames.from_folder(args.images, args.frames)
    return frames.from_world(config, args.frames, inputs_hw)


def _family(asked: str, config: Config) -> str:
    """Return the family asked for, or the configured model's family."""
    if asked:
        return asked
    detector = config.perception.detector
    if isinstance(detector, DetectorOnnx):
        return load_detector_card(detector.model).family
    raise UserError(
        f"{config.locate('perception.detector.kind')} is {detector.kind}, which has no model to "
        f"compare; give --models a family (choices: {', '.join(families()) or 'none'})"
    )


def _settings(config: Config, threads: int | None) -> DetectorOnnx:
    """Return the configured detector's settings, which all variants share."""
    detector = config.perception.detector
    settings = detector if isinstance(detector, DetectorOnnx) else DetectorOnnx()
    return settings if threads is None else settings.model_copy(update={"threads": threads})


def measure_variant(
    variant: Variant, job: DetectorJob, limit_s: float
) -> DetectorMeasurement | str:
    """Return the measurement of a variant, or one line of text that says why there is none."""
    if not variant.card.is_here():
        return f"not here: {install_hint(variant.card)}"
    asked = {"model": variant.card.name, "providers": PROVIDERS[variant.provider]}
    job = replace(job, detector=job.detector.model_copy(update=asked))
    return run_isolated(MEASURE, job, limit_s, _LIMIT)


def compare(
    config: Config, todo: Sequence[Variant], pictures: BenchFrames, settings: DetectorOnnx
) -> Report:
    """Run all variants and return their figures, ready for JSON.

    A variant's boxes are compared with those of its FP32 model of the same input size, and with the
    ground truth if that is known.

    Raises:
        UserError: the text encoder is missing, or knows none of the labels in the frames.
    """
    resolve = make_text_encoder(todo[0].card, settings.vocabulary).resolve
    prompts, unknown = frames.prompts_for(pictures.labels, resolve)
    if not prompts:
        raise UserError(
            f"bench --models: the text encoder of {todo[0].card.family} knows none of the objects "
            "in the images; choose another family or other --images"
        )
    # Another family's encoder may not know all background words of the configured model.
    background = tuple(frames.words_for(settings.background, resolve))
    settings = settings.model_copy(update={"background": background})
    tau_det = config.perception.tau_det
    limit_s = LOAD_TIMEOUT_S + _FRAME_S * len(pictures.rgb)
    job = DetectorJob(settings, prompts, pictures.rgb, tau_det)
    results: Results = []
    for number, variant in enumerate(todo, 1):
        name, on = variant.card.name, variant.provider
        log.info("measuring model %d of %d: %s on %s", number, len(todo), name, on)
        results.append((variant, measure_variant(variant, job, limit_s)))
    return {
        "version": VERSION,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "family": todo[0].card.family,
        "config": config.path,
        "machine": machine.describe(),
        "frames": {
            "source": pictures.source,
            "count": len(pictures.rgb),
            "hw": sorted({image.shape[:2] for image in pictures.rgb}),
            # Number of objects that count; None without ground truth.
            "things": None if pictures.truth is None else pictures.counted,
        },
        "prompts": prompts,
        "unknown_labels": unknown if pictures.truth is not None else (),
        "tau_det": tau_det,
        "threads": settings.threads,
        "rows": [_row(*pair, results, pictures, prompts) for pair in results],
    }


def _row(
    variant: Variant,
    result: DetectorMeasurement | str,
    results: Results,
    pictures: BenchFrames,
    prompts: tuple[str, ...],
) -> dict[str, Any]:
    """Return the figures of one variant.

    `results` are those of all variants: one of them is the FP32 model to compare with.
    """
    row = {"name": variant.card.name, "on": variant.provider}
    if isinstance(result, str):
        state = "failed" if variant.card.is_here() else "missing"
        return {**row, "state": state, "why": result}
    truth = None
    if pictures.truth is not None:
        relations = frames.relations_of(pictures.labels, prompts)
        truth = boxes.against_truth(result.found, pictures.truth, relations, prompts)
    return {
        **row,
        "state": "ran",
        "gpu": result.gpu,
        "sha256": remembered_sha256(variant.card.path),
        "latency_ms": latency_ms(result.stages_ns),
        "load_s": round(result.load_s, 2),
        "memory_mb": round(result.memory_mb, 1),
        "gpu_memory_mb": _rounded(result.gpu_memory_mb),
        "others_cores": _rounded(result.others_cores),  # cores that other processes kept busy
        "invalid_boxes": result.invalid_boxes,
        "agreement": _agreement(variant, result, results),
        "truth": truth,
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def latency_ms(stages_ns: np.ndarray) -> dict[str, dict[str, float]]:
    """Return min, p50 and p95 [ms] of each of `STAGES`, and of their sum as `all`.

    `stages_ns` is (n, 3) int64: the times of `STAGES` for each frame.
    """
    columns = np.column_stack([stages_ns, stages_ns.sum(axis=1)]) / 1e6
    return {
        name: {
            "min": round(float(ms.min()), 3),
            "p50": round(float(np.percentile(ms, 50)), 3),
            "p95": round(float(np.percentile(ms, 95)), 3),
        }
        for name, ms in zip((*STAGES, "all"), columns.T, strict=True)
    }


def _agreement(
    variant: Variant, result: DetectorMeasurement, results: Results
) -> dict[str, Any] | None:
    """Compare with FP32 of the same size, on the first provider where it ran; None for itself."""
    for other, reference in results:
        is_fp32 = other.card.precision == "fp32" and other.card.input == variant.card.input
        if is_fp32 and isinstance(reference, DetectorMeasurement):
            is_itself = reference is result
            return None if is_itself else boxes.agreement(reference.found, result.found)
    return None

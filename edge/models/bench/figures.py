"""From raw measurements to the figures of a table: latencies, agreement, recall and precision."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.models.bench.boxes import Found, Tally, Truth, agree, judge

STAGES = ("pre", "session", "post")


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What a worker left of one variant.

    Attributes:
        stages_ns: (n, 3) int64, `STAGES` of each frame.
        found: the boxes of each frame.
        load_s: making it ready, with the first runs.
        memory_mb: what the process grew by.
        gpu_memory_mb: what the GPU's memory in use grew by; NaN where unknown.
        others_cores: how many cores other processes kept busy meanwhile; NaN where unknown.
        invalid_boxes: how many boxes were not finite.
        gpu: its name; empty on the CPU.
    """

    stages_ns: np.ndarray
    found: list[Found]
    load_s: float
    memory_mb: float
    gpu_memory_mb: float
    others_cores: float
    invalid_boxes: int
    gpu: str

    @classmethod
    def read(cls, file: Any) -> Measured:
        """From the arrays that `worker.measure` returns."""
        ends = np.cumsum(file["count"])
        parts = (np.split(file[name], ends[:-1]) for name in ("xyxy_px", "score", "class_id"))
        return cls(
            file["stages_ns"],
            list(itertools.starmap(Found, zip(*parts, strict=True))),
            float(file["load_s"]),
            float(file["memory_mb"]),
            float(file["gpu_memory_mb"]),
            float(file["others_cores"]),
            int(file["invalid_boxes"]),
            str(file["gpu"]),
        )


def latency_ms(stages_ns: np.ndarray) -> dict[str, dict[str, float]]:
    """min, p50 and p95 of each stage and of `all` of them together."""
    columns = {name: stages_ns[:, k] for k, name in enumerate(STAGES)}
    columns["all"] = stages_ns.sum(axis=1)
    return {
        name: {
            "min": round(float(ns.min()) / 1e6, 3),
            "p50": round(float(np.percentile(ns, 50)) / 1e6, 3),
            "p95": round(float(np.percentile(ns, 95)) / 1e6, 3),
        }
        for name, ns in columns.items()
    }


def agreement(reference: list[Found], candidate: list[Found]) -> dict[str, Any]:
    """How a variant's boxes compare with those of its FP32 model, frame by frame."""
    tally = sum(itertools.starmap(agree, zip(reference, candidate, strict=True)), Tally())
    return {**_shares(tally), "score_error": _rounded(tally.score_error), "boxes": tally.wanted}


def against_truth(
    found: list[Found], truth: list[Truth], answers: np.ndarray, prompts: Sequence[str]
) -> dict[str, Any]:
    """Recall and precision against what is there; `by_prompt` has hits, things and boxes.

    Args:
        answers: (labels, prompts); see `frames.answers_of`.
    """
    by_prompt = {
        prompt: sum(
            (
                judge(boxes.xyxy_px[boxes.class_id == k], real, answers[:, k])
                for boxes, real in zip(found, truth, strict=True)
            ),
            Tally(),
        )
        for k, prompt in enumerate(prompts)
    }
    total = sum(by_prompt.values(), Tally())
    return {
        **_shares(total),
        "things": total.wanted,
        "boxes": total.found,
        "by_prompt": {p: [t.hits, t.wanted, t.found] for p, t in by_prompt.items()},
    }


def _shares(tally: Tally) -> dict[str, float | None]:
    return {"recall": _rounded(tally.recall), "precision": _rounded(tally.precision)}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)

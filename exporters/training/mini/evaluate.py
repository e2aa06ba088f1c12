"""Evaluation of a small detector on held-out houses.

    python -m exporters.training.mini.evaluate MODEL.onnx [--text TEXT.onnx]

There are three measurements: average precision at IoU 0.5 per category, for objects of at least 12
px that are half visible; the share of attribute phrases that score higher on the right one of two
objects of a kind in one view; latency.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from onnxruntime import InferenceSession

from edge.config import PerceptionConfig
from edge.lab.bench.boxes import overlaps
from exporters.files import ExportError, exit_on_user_error
from exporters.images import as_input
from exporters.onnx_format import cpu_session
from exporters.training.mini import looks
from exporters.training.mini.houses import HELD_OUT
from exporters.training.mini.views import Frames, make_frames, whole
from exporters.training.results import took_ms

SEEDS = range(HELD_OUT, HELD_OUT + 100)
"""Seeds of the held-out houses."""
PER_HOUSE = 6
"""Images of each house."""
MIN_SIDE_PX, MIN_VISIBLE = 12, 0.5
"""Smaller objects, and objects with a smaller visible share, do not count."""
IOU = 0.5
"""Least overlap of a detection with its object."""
MIN_SCORE = 0.01
"""Detections with lower scores are ignored."""
DEPLOYED: float = PerceptionConfig.model_fields["tau_det"].default
"""The service's default score threshold for a detection."""
TOLD_APART = ("color", "size")
"""Kinds of questions that a model is judged by; the size of a cut-off object is a guess."""


FLOORS = {"ap50": 0.7, "pairs_told_apart": 0.8}
"""Least values of a card's figures on held-out houses."""
MAX_BYTES = 2_900_000
"""Largest size of the INT8 file."""


@dataclass(frozen=True)
class Report:
    """Figures on the test set.

    Attributes:
        ap50: by category.
        things: number of objects that count, by category.
        pairs: (right, asked) by kind of question: "color", "size" (both objects are wholly in view)
            and "cut_off_size" (at least one is not, so its size is a guess).
        phrases: (n, 2) scores (right one, wrong one) of each question of the kinds `TOLD_APART`.
        latency_ms: median and 95th percentile on 2 threads, 8 phrases.
    """

    ap50: dict[str, float]
    things: dict[str, int]
    pairs: dict[str, tuple[int, int]]
    phrases: np.ndarray
    latency_ms: tuple[float, float]

    @property
    def map50(self) -> float:
        return float(np.mean(list(self.ap50.values())))

    def pair_share(self, kind: str | None = None) -> float:
        """Return the share of right answers, to questions of one kind or of `TOLD_APART`."""
        kinds = [kind] if kind else TOLD_APART
        right, asked = np.sum([self.pairs[k] for k in kinds], axis=0)
        return float(right / max(1, asked))

    def summary(self) -> dict[str, float | int]:
        """Return the figures of the card.

        `KIND_questions` is the number of questions, `KIND_pairs` the share of right answers. The
        last two figures count the questions of the kinds `TOLD_APART`.
        """
        right, wrong = (self.phrases.T > DEPLOYED).mean(1) if len(self.phrases) else (0.0, 0.0)
        return {
            "ap50": round(self.map50, 3),
            "categories": len(self.ap50),
            "things": sum(self.things.values()),
            "pairs_told_apart": round(self.pair_share(), 3),
            **{f"{kind}_pairs": round(self.pair_share(kind), 3) for kind in self.pairs},
            **{f"{kind}_questions": asked for kind, (_, asked) in self.pairs.items()},
            f"right_above_{DEPLOYED}": round(float(right), 3),
            f"wrong_below_{DEPLOYED}": round(1.0 - float(wrong), 3),
        }

    def table(self) -> str:
        rows = [f"{v:6.3f}  {self.things[k]:5d}  {k}" for k, v in
                sorted(self.ap50.items(), key=lambda kv: kv[1])]  # fmt: skip
        rows += [f"{name:24s} {value}" for name, value in self.summary().items()]
        rows.append("session ms, median / 95 %: {:.2f} / {:.2f}".format(*self.latency_ms))
        return "\n".join(rows)


def held_out_frames(folder: Path) -> Frames:
    """Return the test set; it is rendered the first time."""
    return make_frames(SEEDS, PER_HOUSE, folder)


def measure(model: Path, text: Path, frames: Frames) -> Report:
    """Run the whole test set."""
    detector, encoder = cpu_session(model, 2), cpu_session(text, 1)
    categories = np.zeros((len(looks.CATEGORIES), 3), np.int64)
    categories[:, 0] = np.arange(1, 1 + len(categories))
    found: dict[int, list[tuple[float, int]]] = defaultdict(list)
    things: dict[int, int] = defaultdict(int)
    pairs = {"color": [0, 0], "size": [0, 0], "cut_off_size": [0, 0]}
    phrases: list[tuple[float, float]] = []
    for index in range(len(frames)):
        objects = frames.of(index)
        questions = _questions(objects)
        tokens = np.concatenate([categories, *(q.phrase[None] for q in questions)])
        rows = encoder.run(None, {"tokens": tokens})[0][None]
        feed = {"images": as_input(frames.rgb[index]), "txt_feats": rows}
        boxes, scores = (out[0] for out in detector.run(None, feed))
        counts = _counts(objects)
        for c in range(len(categories)):
            things[c] += int((counts & (objects["category"] == c + 1)).sum())
            found[c] += _match(boxes, scores[:, c], objects, counts, c + 1)
        for k, question in enumerate(questions):
            score = scores[:, len(categories) + k]
            right, wrong = (
                _score_at(boxes, score, objects["box"][i]) for i in (question.right, question.wrong)
            )
            pairs[question.kind][0] += right > wrong
            pairs[question.kind][1] += 1
            if question.kind in TOLD_APART:
                phrases.append((right, wrong))
    ap = {looks.CATEGORIES[c]: _average_precision(found[c], n) for c, n in things.items() if n}
    return Report(
        ap,
        {looks.CATEGORIES[c]: n for c, n in things.items() if n},
        {k: (v[0], v[1]) for k, v in pairs.items()},
        np.array(phrases).reshape(-1, 2),
        _latency(detector, frames, rows[:, :8]),
    )


@dataclass(frozen=True)
class _Question:
    """A phrase that fits one (`right`) and not the other (`wrong`) of two objects of a kind."""

    kind: str
    phrase: np.ndarray
    right: int
    wrong: int


def _counts(objects: np.ndarray) -> np.ndarray:
    """Return (o,) bool: large and visible enough to be measured."""
    box = objects["box"]
    side = np.minimum(box[:, 2] - box[:, 0], box[:, 3] - box[:, 1])
    return (side >= MIN_SIDE_PX) & (objects["visible"] >= MIN_VISIBLE)


def _questions(objects: np.ndarray) -> list[_Question]:
    """Return all questions about pairs of objects of one category in an image."""
    questions = []
    usable, uncut = np.flatnonzero(_counts(objects)), whole(objects)
    for i in usable:
        for j in usable:
            if i == j or objects["category"][i] != objects["category"][j]:
                continue
            size = "size" if uncut[i] and uncut[j] else "cut_off_size"
            for kind, field, place in (("color", "color", 1), (size, "size", 2)):
                yes, no = objects[field][i], objects[field][j]
                for word in np.flatnonzero((yes[1:] == looks.YES) & (no[1:] == looks.NO)) + 1:
                    phrase = np.zeros(3, np.int64)
                    phrase[0], phrase[place] = objects["category"][i], word
                    questions.append(_Question(kind, phrase, int(i), int(j)))
    return questions


def _score_at(boxes: np.ndarray, scores: np.ndarray, box: np.ndarray) -> float:
    """Return the best score of any anchor whose box matches this one."""
    on = overlaps(boxes, box[None])[0][:, 0] >= IOU
    return float(scores[on].max()) if on.any() else 0.0


def _match(
    boxes: np.ndarray, scores: np.ndarray, objects: np.ndarray, counts: np.ndarray, category: int
) -> list[tuple[float, int]]:
    """Return (score, 1 right / 0 wrong) of each detection.

    Detections on objects that do not count are left out, and so are those on kinds of the category
    or on its broader name.
    """
    keep = np.flatnonzero(scores > MIN_SCORE)
    keep = keep[np.argsort(-scores[keep], kind="stable")][:300]
    kept: list[int] = []
    overlap = overlaps(boxes[keep], boxes[keep])[0]
    for n in range(len(keep)):
        if not kept or overlap[n, kept].max() <= IOU:
            kept.append(n)
    chosen = keep[kept]
    answers = looks.KINDS[objects["category"], category]
    counted = np.flatnonzero((answers == looks.YES) & counts)
    other = np.flatnonzero(((answers == looks.YES) & ~counts) | (answers == looks.UNSURE))
    on_mine = overlaps(boxes[chosen], objects["box"][counted])[0]
    on_other = overlaps(boxes[chosen], objects["box"][other])[0]
    taken = np.zeros(len(counted), bool)
    result = []
    for row, index in enumerate(chosen):
        free = np.where(taken, 0.0, on_mine[row])
        if len(counted) and free.max() >= IOU:
            taken[free.argmax()] = True
            result.append((float(scores[index]), 1))
        elif not (len(other) and on_other[row].max() >= IOU):
            result.append((float(scores[index]), 0))
    return result


def _average_precision(found: list[tuple[float, int]], count: int) -> float:
    """Return the area under the precision envelope over recall (COCO's, without the 101 points)."""
    if not found:
        return 0.0
    right = np.array([hit for _, hit in sorted(found, key=lambda f: -f[0])])
    hits = np.cumsum(right)
    recall, precision = hits / count, hits / np.arange(1, 1 + len(hits))
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(recall, prepend=0.0) * envelope).sum())


def _latency(
    detector: InferenceSession, frames: Frames, rows: np.ndarray, runs: int = 150
) -> tuple[float, float]:
    feeds = [{"images": as_input(rgb), "txt_feats": rows} for rgb in frames.rgb[:runs]]
    took = took_ms(lambda index: detector.run(None, feeds[index % len(feeds)]), runs)
    return took["p50_ms"], took["p95_ms"]


def check_gate(held_out: Mapping[str, float], step: int, steps: int) -> None:
    """Raise ExportError, with all faults, if a model may not replace the shipped one.

    Args:
        held_out: the card's figures on held-out houses.
        step: training steps done.
        steps: training steps of the plan.
    """
    faults = [] if step >= steps else [f"trained only {step} of {steps} steps"]
    faults += [f"{key} {held_out[key]} < {floor}" for key, floor in FLOORS.items()
               if not held_out[key] >= floor]  # fmt: skip
    if held_out["bytes"] > MAX_BYTES:
        faults.append(f"{held_out['bytes']} bytes > {MAX_BYTES}")
    if faults:
        raise ExportError(
            f"model not published: {'; '.join(faults)}; train on with the same command, or give "
            "--no-gate"
        )


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m exporters.training.mini.evaluate",
        description="measure the small detector on images of houses that it was not trained on",
    )
    parser.add_argument("model", type=Path, help="the detector's ONNX file")
    parser.add_argument(
        "--text",
        type=Path,
        help="the text encoder's ONNX file (default: mini-house-text.onnx next to the model)",
    )
    parser.add_argument(
        "--data",
        type=Path,
        help="folder to keep the rendered images in (default: they are deleted)",
    )
    args = parser.parse_args(argv)
    text = args.text or args.model.with_name("mini-house-text.onnx")
    with tempfile.TemporaryDirectory() as scratch:
        frames = held_out_frames(args.data or Path(scratch))
        print(measure(args.model, text, frames).table())


if __name__ == "__main__":
    sys.exit(main())

"""Evaluation of a small detector on held-out houses.

It measures three quantities. First, the average precision at IoU 0.5 of each category, for
objects of at least 12 px that are half visible. Second, questions about two objects of a category
in one image (which one is the red chair?): the share of phrases that score higher on the right one.
Third, the latency.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from onnxruntime import InferenceSession

from edge.config import PerceptionConfig
from edge.lab.bench.boxes import overlaps
from exporters.files import ExportError
from exporters.images import as_input
from exporters.onnx_format import cpu_session
from exporters.parity import select_boxes
from exporters.training.mini import looks
from exporters.training.mini.houses import HELD_OUT
from exporters.training.mini.views import Frames, is_inside_image, make_frames
from exporters.training.results import took_ms

SEEDS = range(HELD_OUT, HELD_OUT + 100)
"""Seeds of the held-out houses."""
PER_HOUSE = 6
"""Images of each house."""
MIN_SIDE_PX = 12
"""Objects with a shorter side do not count."""
MIN_VISIBLE = 0.5
"""Objects with a smaller visible share do not count."""
IOU = 0.5
"""Least overlap of a detection with its object."""
MIN_SCORE = 0.01
"""Detections with lower scores are ignored."""
DEPLOYED: float = PerceptionConfig.model_fields["tau_det"].default
"""The service's default score threshold for a detection."""
TOLD_APART = ("color", "size")
"""Kinds of questions that a model is judged by. Questions about the size of an object that the
image cuts off ("cut_off_size") are not among them: the answer is a guess."""
FLOORS = {"ap50": 0.7, "pairs_told_apart": 0.8}
"""Smallest allowed values of a card's figures on held-out houses."""
TIMED = 150
"""Runs for the latency measurement."""
MAX_BYTES = 2_900_000
"""Largest size of the INT8 file."""


@dataclass(frozen=True)
class Report:
    """Figures of a model on the held-out houses.

    Attributes:
        ap50: average precision at IoU 0.5, by category.
        n_objects: number of objects that count, by category.
        pairs: (number of right answers, number of questions) by kind of question: "color", "size"
            (both objects are entirely in the image) and "cut_off_size" (at least one is not).
        phrases: (n, 2) scores of the phrase on the right object and on the wrong one, for each
            question of the kinds `TOLD_APART`.
        latency_ms: median and 95th percentile on 2 threads, 8 phrases.
    """

    ap50: dict[str, float]
    n_objects: dict[str, int]
    pairs: dict[str, tuple[int, int]]
    phrases: np.ndarray
    latency_ms: tuple[float, float]

    @property
    def map50(self) -> float:
        """Mean of `ap50` over the categories."""
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
        # Shares of scores above the threshold, on the right object and on the wrong one.
        is_above = self.phrases.T > DEPLOYED
        right_above, wrong_above = is_above.mean(1) if len(self.phrases) else (0.0, 0.0)
        return {
            "ap50": round(self.map50, 3),
            "categories": len(self.ap50),
            "things": sum(self.n_objects.values()),
            "pairs_told_apart": round(self.pair_share(), 3),
            **{f"{kind}_pairs": round(self.pair_share(kind), 3) for kind in self.pairs},
            **{f"{kind}_questions": asked for kind, (_, asked) in self.pairs.items()},
            f"right_above_{DEPLOYED}": round(float(right_above), 3),
            f"wrong_below_{DEPLOYED}": round(1.0 - float(wrong_above), 3),
        }

    def table(self) -> str:
        """Return the figures as text: a line for each category, worst first, then the summary."""
        rows = [f"{v:6.3f}  {self.n_objects[k]:5d}  {k}" for k, v in
                sorted(self.ap50.items(), key=lambda kv: kv[1])]  # fmt: skip
        rows += [f"{name:24s} {value}" for name, value in self.summary().items()]
        rows.append("session ms, median / 95 %: {:.2f} / {:.2f}".format(*self.latency_ms))
        return "\n".join(rows)


def held_out_frames(folder: Path) -> Frames:
    """Return the images of the held-out houses; they are rendered the first time."""
    return make_frames(SEEDS, PER_HOUSE, folder)


def measure(model: Path, text: Path, frames: Frames) -> Report:
    """Run the detector on all images."""
    detector, encoder = cpu_session(model, 2), cpu_session(text, 1)
    # Phrases of a category alone, without colour and size; token c + 1 is category c.
    categories = np.zeros((len(looks.CATEGORIES), 3), np.int64)
    categories[:, 0] = np.arange(1, 1 + len(categories))
    # By category: the result of `_match`, and the number of objects that count.
    found: dict[int, list[tuple[float, int]]] = defaultdict(list)
    n_objects: dict[int, int] = defaultdict(int)
    # Kind of question → [right answers, questions].
    pairs = {"color": [0, 0], "size": [0, 0], "cut_off_size": [0, 0]}
    phrases: list[tuple[float, float]] = []  # see `Report.phrases`
    for index in range(len(frames)):
        objects = frames.objects_in(index)
        questions = _questions(objects)
        # The detector's phrases: first all categories, then the questions.
        tokens = np.concatenate([categories, *(q.phrase[None] for q in questions)])
        features = encoder.run(None, {"tokens": tokens})[0][None]
        feed = {"images": as_input(frames.rgb[index]), "txt_feats": features}
        boxes, scores = (out[0] for out in detector.run(None, feed))
        does_count = _does_count(objects)
        for c in range(len(categories)):
            n_objects[c] += int((does_count & (objects["category"] == c + 1)).sum())
            found[c] += _match(boxes, scores[:, c], objects, does_count, c + 1)
        for k, question in enumerate(questions):
            score = scores[:, len(categories) + k]
            right_score, wrong_score = (
                _score_at(boxes, score, objects["box"][i]) for i in (question.right, question.wrong)
            )
            pairs[question.kind][0] += right_score > wrong_score
            pairs[question.kind][1] += 1
            if question.kind in TOLD_APART:
                phrases.append((right_score, wrong_score))
    ap = {looks.CATEGORIES[c]: _average_precision(found[c], n) for c, n in n_objects.items() if n}
    return Report(
        ap,
        {looks.CATEGORIES[c]: n for c, n in n_objects.items() if n},
        {k: (v[0], v[1]) for k, v in pairs.items()},
        np.array(phrases).reshape(-1, 2),
        _latency(detector, frames, features[:, :8]),
    )


@dataclass(frozen=True)
class _Question:
    """A phrase that is true of one of two objects of a category, and not of the other one.

    Attributes:
        kind: key of `Report.pairs`.
        phrase: (3,) int64, see `looks`.
        right: index of the object that it is true of.
    """

    kind: str
    phrase: np.ndarray
    right: int
    wrong: int


def _does_count(objects: np.ndarray) -> np.ndarray:
    """Return (o,) bool: True if an object is large and visible enough to be measured."""
    box = objects["box"]
    side = np.minimum(box[:, 2] - box[:, 0], box[:, 3] - box[:, 1])
    return (side >= MIN_SIDE_PX) & (objects["visible"] >= MIN_VISIBLE)


def _questions(objects: np.ndarray) -> list[_Question]:
    """Return all questions about pairs of objects of one category in an image."""
    questions = []
    usable, uncut = np.flatnonzero(_does_count(objects)), is_inside_image(objects)
    for i in usable:
        for j in usable:
            if i == j or objects["category"][i] != objects["category"][j]:
                continue
            size_kind = "size" if uncut[i] and uncut[j] else "cut_off_size"
            # A phrase is (category, colour, size); `place` is the index of the word.
            for kind, field, place in (("color", "color", 1), (size_kind, "size", 2)):
                # Answers for each word; entry 0 is the answer for no word.
                of_right, of_wrong = objects[field][i], objects[field][j]
                fits = (of_right[1:] == looks.YES) & (of_wrong[1:] == looks.NO)
                for word in np.flatnonzero(fits) + 1:
                    phrase = np.zeros(3, np.int64)
                    phrase[0], phrase[place] = objects["category"][i], word
                    questions.append(_Question(kind, phrase, int(i), int(j)))
    return questions


def _score_at(boxes: np.ndarray, scores: np.ndarray, box: np.ndarray) -> float:
    """Return the best score of the detector's boxes that match this one."""
    on = overlaps(boxes, box[None])[0][:, 0] >= IOU
    return float(scores[on].max()) if on.any() else 0.0


def _match(
    boxes: np.ndarray,
    scores: np.ndarray,
    objects: np.ndarray,
    does_count: np.ndarray,
    category: int,
) -> list[tuple[float, int]]:
    """Match the boxes (a, 4) with the objects (o,) of a category in one image.

    Of overlapping boxes, the one with the highest score for the category is a detection. Detections
    on objects that do not count (see `_does_count`) are left out. So are detections on objects for
    which the category is UNSURE, such as an armchair for the category chair.

    Returns:
        The score of each detection, and 1 if it is right, 0 if it is wrong.
    """
    best = np.argsort(-scores, kind="stable")[:300]
    detected = select_boxes(boxes[best], scores[best, None], MIN_SCORE)
    answers = looks.KINDS[objects["category"], category]
    counted = np.flatnonzero((answers == looks.YES) & does_count)
    ignored = np.flatnonzero(((answers == looks.YES) & ~does_count) | (answers == looks.UNSURE))
    on_counted = overlaps(detected.xyxy_px, objects["box"][counted])[0]
    on_ignored = overlaps(detected.xyxy_px, objects["box"][ignored])[0]
    taken = np.zeros(len(counted), bool)
    result = []
    for row, score in enumerate(detected.score.tolist()):
        free = np.where(taken, 0.0, on_counted[row])
        if len(counted) and free.max() >= IOU:
            taken[free.argmax()] = True
            result.append((score, 1))
        elif not (len(ignored) and on_ignored[row].max() >= IOU):
            result.append((score, 0))
    return result


def _average_precision(found: list[tuple[float, int]], count: int) -> float:
    """Return the area under the precision envelope over recall (COCO's, without the 101 points).

    `found` is from `_match`, and `count` the number of objects.
    """
    if not found:
        return 0.0
    right = np.array([hit for _, hit in sorted(found, key=lambda f: -f[0])])
    hits = np.cumsum(right)
    recall, precision = hits / count, hits / np.arange(1, 1 + len(hits))
    # Highest precision at this recall or a higher one.
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(recall, prepend=0.0) * envelope).sum())


def _latency(
    detector: InferenceSession, frames: Frames, features: np.ndarray
) -> tuple[float, float]:
    """Return median and 95th percentile [ms] of the detector's runs with these text features."""
    feeds = [{"images": as_input(rgb), "txt_feats": features} for rgb in frames.rgb[:TIMED]]
    took = took_ms(lambda index: detector.run(None, feeds[index % len(feeds)]), TIMED)
    return took["p50_ms"], took["p95_ms"]


def check_gate(held_out: Mapping[str, float], step: int, steps: int) -> None:
    """Raise ExportError, with all faults, if a model may not replace the shipped one."""
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

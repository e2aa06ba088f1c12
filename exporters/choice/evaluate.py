"""How well directions are chosen, on houses that training never saw.

Of each view every target is asked that the robot has not seen and that could be reached, where two
marks or more are there and differ: a choice is right that is as good as the best mark, within
`labels.RIGHT_M`. Intervals resample whole houses, since views of one are not independent.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from edge.eval.intervals import Interval, bootstrap
from edge.perception.choice.question import MAX_MARKS
from exporters.choice import labels
from exporters.choice.collect import NEVER, Views
from exporters.images import as_input
from exporters.onnx_format import cpu_session

Logits = tuple[np.ndarray, np.ndarray]
"""(n, t, MAX_MARKS + 1) of the directions and (n, t) of the scene; NaN where it was not asked."""


def asked_at(views: Views) -> np.ndarray:
    """(n, t) bool: targets that count."""
    return labels.asked(views) & (views.seen == NEVER)


def logits_of(model: Path, views: Views, words: np.ndarray) -> Logits:
    """What an ONNX file answers wherever it counts."""
    session, marks, counts = cpu_session(model, 1), labels.marks_of(views), asked_at(views)
    directions = np.full((*counts.shape, MAX_MARKS + 1), np.nan, np.float32)
    scene = np.full(counts.shape, np.nan, np.float32)
    for i in np.flatnonzero(counts.any(axis=1)):
        image = as_input(views.rgb(i))
        for t in np.flatnonzero(counts[i]):
            feed = {"images": image, "txt_feats": words[t : t + 1], "marks": marks[i : i + 1]}
            found, whole = session.run(["directions", "scene"], feed)
            directions[i, t], scene[i, t] = found[0], whole[0, 0]
    return directions, scene


def choosers(views: Views, logits: Logits) -> dict[str, np.ndarray]:
    """Scores of the marks by whoever chooses, (n, t, MAX_MARKS); the highest is chosen."""
    shape = logits[0][..., :MAX_MARKS].shape
    near = np.broadcast_to(-views.path_m[:, None], shape)
    return {
        "model": logits[0][..., :MAX_MARKS],
        "nearest mark": near,
        "cooccurrence": views.lift.transpose(0, 2, 1) - 1e-6 * near,
    }


def top1(views: Views, logits: Logits) -> dict[str, float | int | str]:
    """Shares of right choices, with 95 % intervals over houses."""
    left_m = np.where(labels.shown(views)[:, None], views.left_m.transpose(0, 2, 1), np.inf)
    best_m = left_m.min(axis=2)
    right = left_m <= best_m[..., None] + labels.RIGHT_M
    n_marks = labels.shown(views).sum(axis=1)[:, None]
    n_right = (right & np.isfinite(left_m)).sum(axis=2)
    counts = asked_at(views) & np.isfinite(best_m) & (n_right < n_marks)
    said: dict[str, float | int | str] = {"questions": int(counts.sum())}
    houses = np.broadcast_to(views.house[:, None], counts.shape)[counts]

    def tell(name: str, hits: np.ndarray) -> None:
        mean, low, high = by_house(hits, houses)
        said[f"right_{name}"], said[f"right_{name}_95"] = round(mean, 3), f"{low:.3f}-{high:.3f}"

    chosen: dict[str, np.ndarray] = {}
    for name, score in choosers(views, logits).items():
        score = np.where(labels.shown(views)[:, None], score, -np.inf)
        pick = np.nan_to_num(score, nan=-np.inf).argmax(axis=2)
        chosen[name] = np.take_along_axis(right, pick[..., None], 2)[..., 0][counts].astype(float)
        tell(name.replace(" ", "_"), chosen[name])
    tell("at_random", (n_right / n_marks)[counts])
    for name in ("nearest mark", "cooccurrence"):
        mean, low, high = by_house(chosen["model"] - chosen[name], houses)
        key = name.replace(" ", "_")
        said[f"model_minus_{key}"] = f"{mean:+.3f} ({low:+.3f} to {high:+.3f})"
    return said


def scene_auc(views: Views, logits: Logits) -> float:
    """Area under the ROC curve of the scene's answer."""
    counts = asked_at(views)
    right, score = labels.scene(views)[counts], logits[1][counts]
    if right.all() or not right.any():
        return float("nan")
    order = np.argsort(score, kind="stable")
    rank = np.empty(len(score))
    rank[order] = np.arange(1, 1 + len(score))
    positive = int(right.sum())
    below = rank[right].sum() - positive * (positive + 1) / 2
    return float(below / (positive * (len(right) - positive)))


def by_house(values: np.ndarray, houses: np.ndarray) -> Interval:
    """Mean over questions and its 95 % interval; `houses` are seeds."""
    cluster = np.unique(houses, return_inverse=True)[1]
    return bootstrap(values[None], np.ones((1, len(values))), cluster)[0]


def latency_ms(model: Path, runs: int = 100) -> dict[str, float]:
    """Median and 95th percentile of one view on 2 threads."""
    session, rng = cpu_session(model, 2), np.random.default_rng(0)
    shapes = {value.name: value.shape for value in session.get_inputs()}
    feed = {name: rng.random(shape, np.float32) for name, shape in shapes.items()}
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        session.run(None, feed)
        times.append(1e3 * (time.perf_counter() - start))
    return {
        "p50_ms": round(float(np.median(times)), 2),
        "p95_ms": round(float(np.percentile(times, 95)), 2),
    }

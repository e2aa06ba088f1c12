"""Evaluation of the choice model on held-out houses.

A question is a view and a target. For each view, every reachable target that the robot has not seen
is asked for, if two or more marks exist and differ. A choice is correct if the path from its mark
is at most `labels.CORRECT_WITHIN_M` longer than from the best mark.
Confidence intervals resample entire houses, since views of one house are not independent.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from edge.lab.eval.intervals import Interval, bootstrap
from edge.perception.scoring.choice.question import MAX_MARKS
from exporters.images import as_input
from exporters.onnx_format import cpu_session
from exporters.training.choice import labels
from exporters.training.choice.collect import NEVER, Views
from exporters.training.choice.net import ChoiceNet
from exporters.training.choice.training import Data, answers
from exporters.training.results import auc, took_ms

PARITY_QUESTIONS = 300
"""Number of random questions for the parity."""
Logits = tuple[np.ndarray, np.ndarray]
"""(n, t, MAX_MARKS + 1) of the directions, "elsewhere" last, and (n, t) of the scene.

There are n views and t kinds of object. NaN for pairs that are not asked.
"""


def is_counted(views: Views) -> np.ndarray:
    """Return (n, t) bool: True for a question that counts."""
    return labels.is_asked(views) & (views.seen == NEVER)


def logits_of(net: ChoiceNet, data: Data, views: Views) -> Logits:
    """Return the net's answers from stored features, to all questions that count."""
    counts = is_counted(views)
    directions = np.full((*counts.shape, MAX_MARKS + 1), np.nan, np.float32)
    scene = np.full(counts.shape, np.nan, np.float32)
    for i in np.flatnonzero(counts.any(axis=1)):
        targets = np.flatnonzero(counts[i])
        with torch.no_grad():
            of_marks, of_scene = answers(net, data.batch(np.array([i]), targets[None]))
        directions[i, targets], scene[i, targets] = of_marks[0].numpy(), of_scene[0].numpy()
    return directions, scene


def parity(model: Path, views: Views, words: np.ndarray, logits: Logits) -> float:
    """Return the largest difference between an ONNX file's logits and `logits`, on the images."""
    session, marks, counts = cpu_session(model, 1), labels.marks_of(views), is_counted(views)
    asked = np.argwhere(counts)  # (questions, 2): view and target
    chosen = np.random.default_rng(0).permutation(len(asked))[:PARITY_QUESTIONS]
    worst = 0.0
    for i, t in asked[chosen]:
        feed = {
            "images": as_input(views.rgb(i)), "txt_feats": words[t : t + 1],
            "marks": marks[i : i + 1], "others": views.others[i : i + 1],
        }  # fmt: skip
        of_marks, of_scene = session.run(["directions", "scene"], feed)
        is_option = np.append(labels.is_mark(views)[i], True)  # "elsewhere" always is
        error = np.abs(of_marks[0] - logits[0][i, t])[is_option].max()
        worst = max(worst, float(error), abs(float(of_scene[0, 0] - logits[1][i, t])))
    return worst


def chooser_scores(views: Views, logits: Logits) -> dict[str, np.ndarray]:
    """Return the scores of the marks by several choosers, (n, t, MAX_MARKS) each, by name.

    A chooser takes the mark with the highest score: the model, the nearest mark, and the prior
    (`cooccurrence`).
    """
    shape = logits[0][..., :MAX_MARKS].shape
    nearness = np.broadcast_to(-views.path_m[:, None], shape)
    return {
        "model": logits[0][..., :MAX_MARKS],
        "nearest_mark": nearness,
        "cooccurrence": views.lift.transpose(0, 2, 1) + 1e-6 * nearness,  # which breaks ties
    }


def top1(views: Views, logits: Logits) -> dict[str, float | int | str]:
    """Return the shares of correct choices, with 95 % intervals over houses.

    The entries `in_view_…` count only questions in which no frontier without a mark is better than
    the best mark.
    """
    # (n, t, MAX_MARKS): what is left to drive from each mark to each target.
    left_m = np.where(labels.is_mark(views)[:, None], views.left_m.transpose(0, 2, 1), np.inf)
    best_m = left_m.min(axis=2)
    is_correct = (left_m <= best_m[..., None] + labels.CORRECT_WITHIN_M) & np.isfinite(left_m)
    n_marks, n_correct = labels.is_mark(views).sum(axis=1)[:, None], is_correct.sum(axis=2)
    counts = is_counted(views) & np.isfinite(best_m) & (n_correct < n_marks)
    # Chooser → (n, t), 1 if its choice is correct; for `at_random` the expected value.
    hits = {"at_random": n_correct / n_marks}
    for name, score in chooser_scores(views, logits).items():
        score = np.nan_to_num(np.where(labels.is_mark(views)[:, None], score, -np.inf), nan=-np.inf)
        pick = score.argmax(axis=2)[..., None]
        hits[name] = np.take_along_axis(is_correct, pick, 2)[..., 0].astype(float)
    for name in ("nearest_mark", "cooccurrence"):
        hits[f"model_minus_{name}"] = hits["model"] - hits[name]
    houses = np.broadcast_to(views.house[:, None], counts.shape)
    in_view = counts & (best_m <= views.else_m + labels.CORRECT_WITHIN_M)
    shares: dict[str, float | int | str] = {}
    for prefix, chosen in (("", counts), ("in_view_", in_view)):
        shares[f"{prefix}questions"] = int(chosen.sum())
        for name, hit in hits.items():
            mean, low, high = by_house(hit[chosen], houses[chosen])
            shares[prefix + name] = f"{mean:.3f} ({low:.3f} to {high:.3f})"
    return shares


def scene_auc(views: Views, logits: Logits) -> float:
    """Return the area under the ROC curve of the scene's answer."""
    counts = is_counted(views)
    return auc(logits[1][counts], labels.scene(views)[counts])


def by_house(values: np.ndarray, houses: np.ndarray) -> Interval:
    """Return the mean over questions and its 95 % interval.

    The values are 1 for a correct answer and 0 for a wrong one, or differences. `houses` has the
    seed of each question's house.
    """
    cluster = np.unique(houses, return_inverse=True)[1]
    return bootstrap(values[None], np.ones((1, len(values))), cluster)[0]


def latency_ms(model: Path, runs: int = 100) -> dict[str, float]:
    """Time the model on one view on 2 threads; return median and 95th percentile."""
    session, rng = cpu_session(model, 2), np.random.default_rng(0)
    shapes = {value.name: value.shape for value in session.get_inputs()}
    feed = {name: rng.random(shape, np.float32) for name, shape in shapes.items()}
    return took_ms(lambda _: session.run(None, feed), runs)

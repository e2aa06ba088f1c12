"""Training loop of the choice model: each step has a few views with several targets.

Shapes: v views, t targets of each, m marks.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from exporters.files import ExportError
from exporters.training import checkpoint as checkpoints
from exporters.training.choice import labels
from exporters.training.choice.collect import Views
from exporters.training.choice.features import Features
from exporters.training.choice.net import ChoiceNet
from exporters.training.learning import Learner, LearningPlan

log = logging.getLogger(__name__)

DROP = 0.25
"""Probability that a mark is left out, for more variety in the questions. A frontier whose mark is
left out counts as one without a mark."""
MAX_GRADIENT_NORM = 5.0
"""Longer gradients are shortened to it."""


@dataclass(frozen=True)
class TrainingPlan(LearningPlan):
    """Length and learning rates of a run."""

    steps: int = 1800
    views: int = 24
    targets: int = 8
    rate: float = 1.5e-3
    decay: float = 0.05
    warm_up: int = 100
    average: float = 0.998
    keep_every: int = 100


class Batch(NamedTuple):
    """Inputs of `ChoiceNet`, and the labels.

    Attributes:
        neck16: see `ChoiceNet.read`.
        neck32: see `ChoiceNet.read`.
        evidence: see `ChoiceNet.read`.
        target: see `ChoiceNet.forward`.
        text: see `ChoiceNet.forward`.
        marks: see `ChoiceNet.forward`.
        others: see `ChoiceNet.forward`.
        direction: (v, t, m + 1) see `labels.directions`.
        among: (v, t, m) the labels of the marks alone, as if all frontiers had a mark.
        scene: (v, t) 1 if the best mark is near a shortest path.
    """

    neck16: Tensor
    neck32: Tensor
    evidence: Tensor
    target: Tensor
    text: Tensor
    marks: Tensor
    others: Tensor
    direction: Tensor
    among: Tensor
    scene: Tensor


class Data:
    """Views with their features and labels, from which batches are made.

    Attributes:
        rows: indices of the views with a target to ask for.
    """

    def __init__(
        self,
        views: Views,
        features: Features,
        level_scales: tuple[float, float],
        words: np.ndarray,
    ) -> None:
        self._views, self._features = views, features
        self._level_scales, self._words = level_scales, words
        self._marks, self._asked = labels.marks_of(views), labels.is_asked(views)
        self._scene = labels.scene(views)
        self.rows = np.flatnonzero(self._asked.any(axis=1))

    def batch(self, rows: np.ndarray, targets: np.ndarray, sides: np.ndarray | int = 0) -> Batch:
        """Return views with targets, without augmentation.

        Args:
            rows: (v,) indices of views.
            targets: (v, t) indices of `looks.CATEGORIES`.
            sides: (v,) 1 for mirrored views, 0 for others.
        """
        sides = np.broadcast_to(sides, rows.shape)
        return self._batch(rows, targets, sides, self._marks[rows, :, -1] > 0.0)

    def augmented(self, plan: TrainingPlan, first: int) -> Iterator[Batch]:
        """Yield an augmented batch for each step from `first` on.

        Views and targets are random, half of the views are mirrored, and some marks are left out.
        """
        for step in range(first, plan.steps):
            rng = np.random.default_rng([plan.seed, step])
            rows = rng.choice(self.rows, plan.views)
            # Each target of a view that may be asked for is equally likely.
            chance = self._asked[rows] / self._asked[rows].sum(axis=1, keepdims=True)
            targets = np.stack([rng.choice(len(p), plan.targets, p=p) for p in chance])
            is_mark = self._marks[rows, :, -1] > 0.0
            kept = is_mark & (rng.random(is_mark.shape) >= DROP)
            # At least one mark stays.
            is_mark = np.where(kept.any(axis=1, keepdims=True), kept, is_mark)
            yield self._batch(rows, targets, rng.integers(0, 2, len(rows)), is_mark)

    def _batch(
        self, rows: np.ndarray, targets: np.ndarray, sides: np.ndarray, is_mark: np.ndarray
    ) -> Batch:
        """Return a batch, see `batch`; `is_mark` (v, m) is False for marks that are left out."""
        views, f, each = self._views, self._features, np.arange(len(rows))[:, None]
        neck16, neck32 = (
            torch.from_numpy(x[rows, sides].astype(np.float32) * scale)
            for x, scale in zip((f.neck16, f.neck32), self._level_scales, strict=True)
        )
        evidence = torch.from_numpy(f.evidence[rows, sides].astype(np.float32) / 255.0)
        marks = self._marks[rows] * is_mark[..., None]
        # Mirrored: u and the bearing of a mark change sides.
        marks[..., 0] = np.where(sides[:, None] & is_mark, 1.0 - marks[..., 0], marks[..., 0])
        marks[..., 2] *= np.where(sides, -1.0, 1.0)[:, None]
        # A mark that is left out is a frontier without a mark.
        others = _with_hidden(views.others[rows], self._marks[rows], ~is_mark)
        # (v, t, m): from the marks to the targets. `left` is what remains, not a side.
        left_m = np.take_along_axis(views.left_m[rows], targets[:, None], 2).transpose(0, 2, 1)
        hidden_m = np.where(is_mark[:, None], np.inf, left_m).min(axis=-1)
        else_m = np.minimum(np.take_along_axis(views.else_m[rows], targets, 1), hidden_m)
        left_m = np.where(is_mark[:, None], left_m, np.inf)
        direction = labels.directions(left_m, else_m)
        among = labels.directions(left_m, np.full_like(else_m, np.inf))[..., :-1]
        scene = np.take_along_axis(self._scene[rows], targets, 1).astype(np.float32)
        return Batch(
            neck16, neck32, evidence, evidence.flatten(2)[each, targets],
            torch.from_numpy(self._words[targets]), torch.from_numpy(marks),
            torch.from_numpy(others), torch.from_numpy(direction), torch.from_numpy(among),
            torch.from_numpy(scene),
        )  # fmt: skip


def _with_hidden(others: np.ndarray, marks: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return the figures of the frontiers without a mark, with the marks that were left out.

    Args:
        others: (v, OTHERS_FIELDS) number, least path [m], largest gain [m²].
        marks: (v, m, MARK_FIELDS), see `labels.marks_of`.
        hidden: (v, m) True for a mark that was left out, or does not exist.

    Returns:
        (v, OTHERS_FIELDS) float32.
    """
    hidden = hidden & (marks[..., -1] > 0.0)
    count, least_m, most_m2 = others.T
    least_m = np.where(count > 0.0, least_m, np.inf)
    least_m = np.minimum(least_m, np.where(hidden, marks[..., 4], np.inf).min(axis=1))
    most_m2 = np.maximum(most_m2, np.where(hidden, marks[..., 5], 0.0).max(axis=1))
    count = count + hidden.sum(axis=1)
    least_m = np.where(count > 0.0, least_m, 0.0)
    return np.stack([count, least_m, most_m2], axis=1).astype(np.float32)


def answers(net: ChoiceNet, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return the logits of directions and scene; see `ChoiceNet.forward`."""
    seen = net.read(batch.neck16, batch.neck32, batch.evidence)
    return net(seen, batch.target, batch.text, batch.marks, batch.others)


def losses(net: ChoiceNet, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
    """Return the cross-entropies of directions, of the marks among themselves, and of the scene.

    The second is needed because a view teaches little about its marks if "elsewhere" is far better.
    """
    direction, scene = answers(net, batch)
    of_direction = _cross_entropy(direction, batch.direction)
    of_marks = _cross_entropy(direction[..., :-1], batch.among)
    of_scene = nn.functional.binary_cross_entropy_with_logits(scene, batch.scene)
    return of_direction, of_marks, of_scene


def _cross_entropy(logits: Tensor, label: Tensor) -> Tensor:
    """Return the mean cross-entropy of soft labels."""
    return -(label * logits.log_softmax(-1)).sum(-1).mean()


def train(data: Data, plan: TrainingPlan, kinds: int, checkpoint: Path) -> ChoiceNet:
    """Train, or continue from `checkpoint`; return the averaged weights.

    Raises:
        ExportError: there is nothing to learn from, or `checkpoint` is of another run, or none.
    """
    if not len(data.rows):
        raise ExportError(
            "no image shows a frontier, so there is nothing to learn from; give more --houses"
        )
    run = checkpoints.run_identity(plan, len(data.rows), 1, "cpu")
    torch.manual_seed(plan.seed)
    net = ChoiceNet(kinds)
    learner = Learner(net, plan, plan.steps, checkpoint, run)
    sums = torch.zeros(3)
    for step, batch in enumerate(data.augmented(plan, learner.done), learner.done + 1):
        torch.manual_seed(plan.seed * 1_000_003 + step)  # same dropout if the run continues
        parts = losses(net, batch)
        learner.step(sum(parts), MAX_GRADIENT_NORM)
        sums += torch.stack(parts).detach()
        if step % plan.keep_every == 0 or step == plan.steps:
            shown = (step, plan.steps, *(sums / plan.keep_every).tolist())
            log.info("step %d/%d: losses: direction %.3f, marks %.3f, scene %.3f", *shown)
            sums.zero_()
            learner.keep()
    return learner.averaged

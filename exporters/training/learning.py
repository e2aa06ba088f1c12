"""Training steps, which all our networks share.

A step uses AdamW and a curve of the learning rate. The weights are averaged over the steps, and
checkpoints are written.
"""

from __future__ import annotations

import copy
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from exporters.training import checkpoint as checkpoints

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LearningPlan:
    """Learning rates of a run, and its checkpoints.

    Attributes:
        rate: peak of the learning rate; then the rate falls as half a cosine.
        decay: weight decay; not for biases, norms and tables of embeddings.
        warm_up: steps until the peak.
        average: share of the averaged weights that stays in each step.
        keep_every: steps between two checkpoints.
        seed: seed of weights and data.
    """

    rate: float
    decay: float
    warm_up: int
    average: float
    keep_every: int
    seed: int = 0


class Learner:
    """A model with its optimizer; continues from its checkpoint if there is one.

    Attributes:
        averaged: the model with the exponential mean of its weights.
        done: steps so far.
    """

    def __init__(
        self,
        model: nn.Module,
        pace: LearningPlan,
        steps: int,
        checkpoint: Path,
        run: checkpoints.Run,
        *,
        tables: nn.Module | None = None,
        betas: tuple[float, float] = (0.9, 0.999),
    ) -> None:
        """Set up the optimizer, and load the checkpoint if there is one.

        Args:
            model: network to train.
            pace: learning rates.
            steps: steps of the entire run.
            checkpoint: file to continue from and to write.
            run: identity of the run, see `checkpoints.run_identity`.
            tables: part of the model without weight decay, such as tables of embeddings.
            betas: decay rates of AdamW's running means.

        Raises:
            ExportError: `checkpoint` is of another run, or is no checkpoint.
        """
        self.averaged = copy.deepcopy(model).eval().requires_grad_(False)
        self.done = 0
        self._model, self._pace, self._path, self._run = model, pace, checkpoint, run
        self._optimizer = _adamw(model, tables, pace, betas)
        self._rates = torch.optim.lr_scheduler.LambdaLR(
            self._optimizer, lambda step: rate(step, steps, pace.warm_up)
        )
        self._state = {
            "model": model, "averaged": self.averaged, "optimizer": self._optimizer,
            "rates": self._rates,
        }  # fmt: skip
        self._trained_s = 0.0
        if state := checkpoints.resume(checkpoint, run, run["device"]):
            for name, part in self._state.items():
                part.load_state_dict(state[name])
            self.done, self._trained_s = state["step"], state["seconds"]
            log.info("training continues after step %d of the checkpoint %s", self.done, checkpoint)
        self._started_s = time.monotonic()

    def step(self, loss: Tensor, clip: float, share: Callable[[], None] | None = None) -> None:
        """Learn from a batch."""
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if share is not None:
            share()
        nn.utils.clip_grad_norm_(self._model.parameters(), clip)
        self._optimizer.step()
        self._rates.step()
        self.done += 1
        average(self.averaged, self._model, self._pace.average, self.done)

    def keep(self) -> None:
        """Write the checkpoint."""
        seconds = self._trained_s + time.monotonic() - self._started_s
        checkpoints.save(self._path, self._state, self._run, self.done, seconds)


def rate(step: int, steps: int, warm_up: int) -> float:
    """Return the learning-rate factor: linear warm-up, then half a cosine down to one percent.

    arXiv:1608.03983, eq. 5.
    """
    if step < warm_up:
        return (step + 1) / warm_up
    share = (step - warm_up) / max(1, steps - warm_up)
    return 0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(1.0, share)))


@torch.no_grad()
def average(averaged: nn.Module, model: nn.Module, keep: float, step: int) -> None:
    """Update the exponential mean of weights and norm statistics; faster at first."""
    keep = min(keep, (1.0 + step) / (20.0 + step))
    pairs = zip(averaged.state_dict().values(), model.state_dict().values(), strict=True)
    for mean, value in pairs:
        if mean.dtype.is_floating_point:
            mean.lerp_(value, 1.0 - keep)
        else:
            mean.copy_(value)


def _adamw(
    model: nn.Module, tables: nn.Module | None, pace: LearningPlan, betas: tuple[float, float]
) -> torch.optim.Optimizer:
    """Return the optimizer, without weight decay for vectors and `tables`."""
    without_decay = set() if tables is None else set(tables.parameters())
    decaying = [p for p in model.parameters() if p.ndim > 1 and p not in without_decay]
    rest = [p for p in model.parameters() if p.ndim <= 1 or p in without_decay]
    groups = [
        {"params": decaying, "weight_decay": pace.decay},
        {"params": rest, "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=pace.rate, betas=betas)

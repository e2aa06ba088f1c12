"""Training loop of the translator: composed sentences first, then also human ones."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

import torch
from torch import Tensor, nn

from exporters.training import checkpoint as checkpoints
from exporters.training.learning import Learner, LearningPlan
from exporters.training.translator.compose import Composer, Pair, Phrases
from exporters.training.translator.data import PAD, Batcher, Source, Vocabulary
from exporters.training.translator.net import Size, Translator

log = logging.getLogger(__name__)

MAX_GRADIENT_NORM = 1.0
"""Longer gradients are shortened to it."""
SMOOTHING = 0.05
"""Label smoothing, so that ambiguous sentences keep a low confidence."""


@dataclass(frozen=True, kw_only=True)
class TrainingPlan(LearningPlan):
    """Length and learning rates of a run.

    Attributes:
        human: share of human sentences.
        pairs: sentences in a step, each in both directions.
    """

    steps: int
    human: float
    pairs: int = 64
    decay: float = 0.02
    warm_up: int = 200
    average: float = 0.998
    keep_every: int = 200


# Plans of the two parts of a training: composed sentences first, then also human ones.
COMPOSED = TrainingPlan(steps=6000, rate=2e-3, human=0.0)
PEOPLE = TrainingPlan(steps=1500, rate=6e-4, human=0.15, warm_up=50)


def train(
    phrases: Phrases, human: Sequence[Pair], vocabulary: Vocabulary, plan: TrainingPlan,
    checkpoint: Path, start: Translator | None = None,
) -> Translator:  # fmt: skip
    """Train, or continue from `checkpoint`; return the averaged weights.

    It learns composed and human sentences. It begins with the network `start`, or a random one.

    Raises:
        ExportError: `checkpoint` is of another run, or is no checkpoint.
    """
    torch.manual_seed(plan.seed)
    net = Translator(len(vocabulary.tokens), Size())
    if start is not None:
        weights = start.state_dict()
        rows = weights.pop("table.weight")
        net.load_state_dict(weights, strict=False)
        net.table.weight.data[: len(rows)] = rows  # the new vocabulary only has further tokens
    run = checkpoints.run_identity(plan, len(human), 1, "cpu")
    learner = Learner(net.train(), plan, plan.steps, checkpoint, run, tables=net.table)
    rng = Random(f"{plan.seed} {learner.done}")
    source = Source(Composer(phrases, rng), human, plan.human, rng)
    batcher, sums = Batcher(vocabulary), torch.zeros(2)
    padding = vocabulary.tokens.index(PAD)
    drawn = batcher.batches(source, plan.pairs)
    while learner.done < plan.steps:
        tensors = batcher.tensors(next(drawn), rng)
        with torch.autocast("cpu", torch.bfloat16, enabled=has_bfloat16()):
            parts = [_loss(net, *pair, padding) for pair in tensors]
        learner.step(parts[0] + 0.5 * sum(parts[1:]), MAX_GRADIENT_NORM)
        sums[: len(parts)] += torch.stack(parts).detach()
        if learner.done % plan.keep_every == 0 or learner.done == plan.steps:
            shown = (learner.done, plan.steps, *(sums / plan.keep_every).tolist())
            log.info("step %d/%d: losses: to formulas %.3f, to words %.3f", *shown)
            sums.zero_()
            learner.keep()
    return learner.averaged


def has_bfloat16() -> bool:
    """Return True if the processor multiplies in bfloat16, which halves the time here."""
    capabilities = getattr(torch.cpu, "get_capabilities", dict)  # not in older PyTorch
    return bool(capabilities().get("avx512_bf16", False))


def _loss(net: Translator, source: Tensor, target: Tensor, padding: int) -> Tensor:
    """Return the cross-entropy of each next token of the targets."""
    logits = net(source, target[:, :-1], padding)
    return nn.functional.cross_entropy(
        logits.flatten(0, 1), target[:, 1:].flatten(), ignore_index=padding,
        label_smoothing=SMOOTHING,
    )  # fmt: skip

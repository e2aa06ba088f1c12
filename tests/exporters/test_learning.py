"""Shared parts of training runs: learning curve, averaged weights, resuming from a checkpoint."""

from __future__ import annotations

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra `export`)")

from exporters.files import ExportError  # noqa: E402
from exporters.training.learning import Learner, LearningPlan, average, rate  # noqa: E402
from exporters.training.results import auc  # noqa: E402


def test_the_rate_climbs_and_falls():
    rates = [rate(step, 100, 10) for step in (0, 9, 10, 55, 100, 120)]
    assert rates == pytest.approx([0.1, 1.0, 1.0, 0.505, 0.01, 0.01])


def test_the_average_follows_at_once_at_first_and_slowly_later():
    model, averaged = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
    for step, share in ((0, 1 / 20), (10_000, 0.99)):
        torch.nn.init.zeros_(averaged.weight)
        torch.nn.init.ones_(model.weight)
        average(averaged, model, 0.99, step)
        assert averaged.weight.item() == pytest.approx(1.0 - share)


def learner_of(path, decay: float = 0.0, tables: bool = False) -> tuple[torch.nn.Module, Learner]:
    torch.manual_seed(0)
    model = torch.nn.Sequential(torch.nn.Linear(3, 3), torch.nn.Linear(3, 1))
    run = {"plan": {"decay": decay}, "ranks": 1, "frames": 1, "device": "cpu"}
    spared = model[1] if tables else None
    pace = LearningPlan(rate=1e-2, decay=decay, warm_up=2, average=0.9, keep_every=20)
    return model, Learner(model, pace, 20, path, run, tables=spared)


def steps(model, learner, n: int) -> None:
    for _ in range(n):
        torch.manual_seed(learner.done)
        learner.step(model(torch.randn(4, 3)).square().mean(), 5.0)


def test_a_resumed_run_matches_an_uninterrupted_one(tmp_path):
    model, learner = learner_of(tmp_path / "whole.pt")
    steps(model, learner, 10)
    first, begun = learner_of(tmp_path / "parts.pt")
    steps(first, begun, 4)
    begun.keep()
    with pytest.raises(ExportError, match=r"of another run: decay is 0\.0 there and 0\.5 now"):
        learner_of(tmp_path / "parts.pt", decay=0.5)
    again, rest = learner_of(tmp_path / "parts.pt")
    assert rest.done == 4
    steps(again, rest, 6)
    for one, other in zip(learner.averaged.parameters(), rest.averaged.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)


def test_embedding_tables_have_no_weight_decay(tmp_path):
    model, learner = learner_of(tmp_path / "a.pt", decay=0.5, tables=True)
    before = [p.detach().clone() for p in model.parameters()]
    learner.step(sum(0.0 * p.sum() for p in model.parameters()), 5.0)
    changed = [not torch.equal(p, q) for p, q in zip(model.parameters(), before, strict=True)]
    assert changed == [True, False, False, False]  # only the first layer's matrix


@pytest.mark.parametrize(
    ("score", "right", "area"),
    [
        ([0.1, 0.9], [0, 1], 1.0),
        ([0.9, 0.1], [0, 1], 0.0),
        ([0.5, 0.5, 0.5], [0, 1, 1], 0.5),
        ([0.5], [1], math.nan),
    ],
)
def test_auc(score, right, area):
    assert auc(np.array(score), np.array(right, float)) == pytest.approx(area, nan_ok=True)

"""Ranges and weight rounding, on data whose best answer is known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed (extra `export`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `export`)")

import torch

from exporters.calibration import BINS, Histogram, least_loss_range, silu
from exporters.rounding import channel_scales, gptq

pytestmark = pytest.mark.export


def histogram(values: np.ndarray) -> Histogram:
    low, high = min(0.0, float(values.min())), max(1e-6, float(values.max()))
    return Histogram(low, high, np.histogram(values, BINS, (low, high))[0].astype(float))


def test_range_of_nothing_but_zero_holds_zero():
    low, high = least_loss_range(histogram(np.zeros(10)))
    assert low <= 0 < high


def test_range_keeps_evenly_spread_values():
    low, high = least_loss_range(histogram(np.linspace(-1, 3, 10_000)))
    assert low == pytest.approx(-1, abs=0.05)
    assert high == pytest.approx(3, abs=0.1)


def test_range_into_silu_forgets_what_silu_forgets():
    values = np.concatenate([np.linspace(-3, 3, 10_000), np.full(500, -100.0)])
    low, _ = least_loss_range(histogram(values), silu)
    assert low > -30


def test_gptq_beats_nearest_rounding_on_the_layer_output():
    generator = torch.Generator().manual_seed(0)
    mixing = torch.randn(64, 64, generator=generator)
    inputs = torch.randn(4000, 64, generator=generator) @ mixing  # correlated, as features are
    weight = torch.randn(8, 64, generator=generator)
    scale = channel_scales(weight) * 16  # coarse steps, so that rounding matters
    nearest = (weight / scale).round()
    levels = gptq(weight, inputs.T @ inputs, scale)
    assert torch.equal(levels, levels.round())
    assert levels.abs().max() <= 127

    def loss(candidate: torch.Tensor) -> float:
        return float(((candidate * scale - weight) @ inputs.T).square().mean())

    assert loss(levels) < 0.7 * loss(nearest)

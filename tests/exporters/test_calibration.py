"""Ranges, on data whose best answer is known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("onnx", reason="onnx is not installed (extra `quantize`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from exporters.calibration import BINS, Histogram, least_loss_range, silu

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

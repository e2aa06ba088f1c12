"""INT8 for TensorRT: the quantized graph, and its results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `export`)")
pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

import onnx
from onnx import numpy_helper
from small_net import RECIPE, build, feeds, run

from exporters.calibration import (
    BINS,
    Histogram,
    least_loss_limit,
    least_loss_range,
    silu,
    tensor_session,
)
from exporters.files import ExportError
from exporters.quantize import quantize
from exporters.rounding import round_weights

pytestmark = pytest.mark.export


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("int8")
    fp32, int8 = build(folder / "fp32.onnx"), folder / "int8.onnx"
    quantize(fp32, int8, feeds(8), RECIPE, "int8-trt")
    return fp32, int8


@pytest.fixture(scope="module")
def graph(pair):
    return onnx.load(pair[1]).graph


def test_every_zero_point_is_int8_zero(graph):
    constants = {i.name: numpy_helper.to_array(i) for i in graph.initializer}
    pairs = [n for n in graph.node if n.op_type in ("QuantizeLinear", "DequantizeLinear")]
    assert pairs
    for node in pairs:
        scale, zero = constants[node.input[1]], constants[node.input[2]]
        assert zero.dtype == np.int8
        assert not zero.any()
        assert scale.dtype == np.float16
        assert (scale > 0).all()


def test_only_inputs_of_convolutions_are_quantized(graph):
    made_by = {name: node for node in graph.node for name in node.output}
    constants = {i.name for i in graph.initializer}
    for node in graph.node:
        if node.op_type == "Conv":
            image, weight, bias = node.input
            assert made_by[image].op_type == made_by[weight].op_type == "DequantizeLinear"
            assert made_by[weight].input[0] in constants
            assert bias in constants, "TensorRT takes no quantized bias"
    for node in graph.node:
        if node.op_type == "QuantizeLinear":
            assert made_by[node.input[0]].op_type != "Conv", "it would keep Conv and SiLU apart"


def test_weights_have_a_scale_per_output_channel(graph):
    constants = {i.name: numpy_helper.to_array(i) for i in graph.initializer}
    weights = [n for n in graph.node if n.op_type == "DequantizeLinear" and n.input[0] in constants]
    assert len(weights) == 2
    for node in weights:
        assert constants[node.input[0]].dtype == np.int8
        assert constants[node.input[1]].shape == (8,)
        assert [a.i for a in node.attribute if a.name == "axis"] == [0]


def test_the_result_stays(pair):
    for feed in feeds(3):
        for exact, got in zip(run(pair[0], feed), run(pair[1], feed), strict=True):
            assert got.dtype == np.float32
            assert np.abs(got - exact).mean() < 0.05 * np.abs(exact).mean()


def test_excluded_layers_stay_float(tmp_path):
    fp32, int8 = build(tmp_path / "fp32.onnx"), tmp_path / "int8.onnx"
    quantize(fp32, int8, feeds(), replace(RECIPE, not_symmetric=("^trunk/1/",)), "int8-trt")
    nodes = {node.name: node for node in onnx.load(int8).graph.node}
    assert "DequantizeLinear" in nodes["trunk/0/conv"].input[1]
    assert nodes["trunk/1/conv"].input[1] == "w1"


def test_too_few_images_are_refused(tmp_path):
    fp32 = build(tmp_path / "fp32.onnx")
    with pytest.raises(ExportError, match="3 images"):
        quantize(fp32, tmp_path / "int8.onnx", feeds(3), RECIPE, "int8-trt")
    assert not (tmp_path / "int8.onnx").exists()


def histogram(values: np.ndarray) -> Histogram:
    low, high = min(0.0, float(values.min())), max(1e-6, float(values.max()))
    return Histogram(low, high, np.histogram(values, BINS, (low, high))[0].astype(float))


def test_ranges_keep_even_values_and_cut_outliers():
    """Symmetric ranges cut single outliers; ranges before SiLU cut large negative values."""
    even, far = np.linspace(-1, 3, 10_000), np.full(500, -100.0)
    assert least_loss_limit(histogram(np.zeros(10))) > 0
    assert least_loss_limit(histogram(even)) == pytest.approx(3, abs=0.1)
    assert least_loss_limit(histogram(np.append(np.linspace(-1, 1, 100_000), 8.0))) < 6
    low, high = least_loss_range(histogram(np.zeros(10)))
    assert low <= 0 < high
    assert least_loss_range(histogram(even)) == pytest.approx((-1, 3), abs=0.1)
    assert least_loss_range(histogram(np.concatenate([even, far])), silu)[0] > -30


@pytest.mark.parametrize("corrected", [True, False])
def test_the_bias_correction_compensates_for_clipping(tmp_path, corrected):
    """Images in 0..1 clipped at 0.4: a convolution's output would be too small on average."""
    model, limit, samples = onnx.load(build(tmp_path / "fp32.onnx")), 0.4, feeds(12)
    convs = [node for node in model.graph.node if node.name == "trunk/0/conv"]
    exact = mean_output(model, samples)
    round_weights(model, convs, samples, {"images": limit} if corrected else None)
    for feed in samples:
        feed["images"] = np.minimum(feed["images"], limit)
    error = np.abs(mean_output(model, samples) - exact).max()
    assert (error < 0.02) == corrected


def mean_output(model, samples):
    """Return the mean output of the first convolution, per channel (8,)."""
    session = tensor_session(model, ["c0"])
    return np.mean([session.run(["c0"], feed)[0].mean(axis=(0, 2, 3)) for feed in samples], axis=0)

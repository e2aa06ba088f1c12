"""INT8 for TensorRT: what it demands of a graph, and that the result stays."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed (extra `export`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `export`)")
pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

import onnx
from onnx import numpy_helper
from small_net import RECIPE, build, feeds, run

from exporters.calibration import BINS, Histogram, least_loss_limit
from exporters.files import ExportError
from exporters.quantize import quantize

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


def test_only_what_goes_into_convolutions_is_quantized(graph):
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


@pytest.mark.parametrize(
    ("precision", "count", "says"), [("int4", 8, "int4"), ("int8-trt", 3, "3 images")]
)
def test_what_cannot_be_quantized(tmp_path, precision, count, says):
    fp32 = build(tmp_path / "fp32.onnx")
    with pytest.raises(ExportError, match=says):
        quantize(fp32, tmp_path / "int8.onnx", feeds(count), RECIPE, precision)
    assert not (tmp_path / "int8.onnx").exists()


def test_a_symmetric_range_keeps_even_values_and_cuts_a_lonely_one():
    def limit(values):
        low, high = float(min(0.0, values.min())), float(max(1e-6, values.max()))
        counts = np.histogram(values, BINS, (low, high))[0].astype(float)
        return least_loss_limit(Histogram(low, high, counts))

    assert limit(np.zeros(10)) > 0
    assert limit(np.linspace(-4, 1, 10_000)) == pytest.approx(4, abs=0.1)
    assert limit(np.append(np.linspace(-1, 1, 100_000), 8.0)) < 6

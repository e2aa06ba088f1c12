"""Weights rounded against their inputs: against the same written plainly, and without PyTorch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="onnx is not installed (extra `quantize`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from onnx import helper, numpy_helper

from exporters import rounding

pytestmark = pytest.mark.export

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_TORCH = """
import sys
from pathlib import Path
sys.modules["torch"] = sys.modules["ultralytics"] = None
import exporters.__main__
from exporters.fp16 import write_fp16
from exporters.quantize import quantize
from small_net import RECIPE, build, feeds
folder = Path(sys.argv[1])
fp32 = build(folder / "fp32.onnx")
write_fp16(fp32, folder / "fp16.onnx", feeds(), RECIPE)
for precision in ("int8-cpu", "int8-trt"):
    quantize(fp32, folder / f"{precision}.onnx", feeds(), RECIPE, precision)
"""


def test_derived_models_need_no_torch(tmp_path):
    command = [sys.executable, "-c", WITHOUT_TORCH, str(tmp_path)]
    env = {"PYTHONPATH": f"{ROOT}:{Path(__file__).parent}", "PATH": ""}
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 0, done.stderr
    made = {path.name for path in tmp_path.iterdir()}
    assert made >= {"fp16.onnx", "int8-cpu.onnx", "int8-trt.onnx"}


@pytest.mark.parametrize(
    ("strides", "pads", "kernel"),
    [([1, 1], [0, 0, 0, 0], (1, 1)), ([2, 1], [1, 0, 2, 1], (3, 2)), ([2, 2], [1] * 4, (3, 3))],
)
def test_columns_times_weights_are_the_convolution(strides, pads, kernel):
    random = np.random.default_rng(0)
    x = random.normal(size=(1, 3, 9, 7)).astype(np.float32)
    weight = random.normal(size=(4, 3, *kernel)).astype(np.float32)
    node = helper.make_node("Conv", ["x", "w"], ["y"], pads=pads, strides=strides)
    y = convolve(x[0], weight, strides, pads)
    cells = random.permutation(y[0].size)
    columns = rounding.inputs_of_cells(node, x, kernel, cells)
    np.testing.assert_allclose(columns @ weight.reshape(4, -1).T, y.reshape(4, -1).T[cells], 1e-4)


def convolve(x, weight, strides, pads):
    """(C, H, W) with (rows, C, kh, kw), one output cell after another."""
    x = np.pad(x, ((0, 0), (pads[0], pads[2]), (pads[1], pads[3]))).astype(float)
    (kh, kw), (down, across) = weight.shape[2:], strides
    height, width = (x.shape[1] - kh) // down + 1, (x.shape[2] - kw) // across + 1
    y = np.empty((len(weight), height, width))
    for i, j in np.ndindex(height, width):
        seen = x[:, i * down : i * down + kh, j * across : j * across + kw]
        y[:, i, j] = (weight * seen).sum(axis=(1, 2, 3))
    return y


@pytest.fixture(scope="module")
def layer():
    """Weights (8, d) and inputs (cells, d) that move together; d is more than a block."""
    random = np.random.default_rng(1)
    columns = random.normal(size=(900, 150)) @ random.normal(size=(150, 150)) / 12 + 0.5
    return random.normal(0, 0.1, (8, 150)).astype(np.float32), columns.astype(np.float32)


def test_levels_are_those_of_the_plain_method(layer):
    weight, columns = layer
    moment, scale = columns.T @ columns, rounding.channel_scales(weight)
    given = weight.copy(), moment.copy()
    levels = rounding.gptq(weight, moment, scale)
    assert (levels == np.round(levels)).all()
    assert np.abs(levels).max() <= 127
    plain = plain_gptq(weight.astype(float), moment.astype(float), scale)
    assert (levels != plain).mean() < 0.01  # ties that float32 breaks the other way
    np.testing.assert_array_equal(weight, given[0])
    np.testing.assert_array_equal(moment, given[1])


def plain_gptq(weight, moment, scale):
    """One column after another; the inverse without it by one step of Gauss's elimination."""
    damped = moment + np.eye(len(moment)) * (0.01 * moment.diagonal().mean() + 1e-8)
    inverse, levels = np.linalg.inv(damped), np.zeros_like(weight)
    for k in np.argsort(-moment.diagonal(), kind="stable"):
        levels[:, k] = np.clip(np.round(weight[:, k] / scale[:, 0]), -127, 127)
        error = (weight[:, k] - levels[:, k] * scale[:, 0]) / inverse[k, k]
        weight -= np.outer(error, inverse[k])
        inverse -= np.outer(inverse[:, k], inverse[k]) / inverse[k, k]
    return levels


def test_groups_of_channels_are_rounded_each_by_itself():
    """A convolution with groups is as many convolutions next to each other."""
    random = np.random.default_rng(2)
    weight = random.normal(0, 0.1, (6, 2, 3, 3)).astype(np.float32)
    images = random.normal(0.2, 1.0, (3, 1, 4, 8, 8)).astype(np.float32)

    def rounded(weight, images, groups):
        made = helper.make_node("Conv", ["x", "w", "b"], ["y"], name="conv", group=groups)
        shape = [1, images.shape[2], 8, 8]
        constants = {"w": weight, "b": np.zeros(len(weight), np.float32)}
        graph = helper.make_graph(
            [made], "g", [helper.make_tensor_value_info("x", 1, shape)],
            [helper.make_tensor_value_info("y", 1, None)],
            [numpy_helper.from_array(value, name) for name, value in constants.items()],
        )  # fmt: skip
        opset = helper.make_opsetid("", 17)
        model = helper.make_model(graph, opset_imports=[opset], ir_version=8)
        feeds = [{"x": image} for image in images]
        scales = rounding.round_weights(model, list(model.graph.node), feeds, {"x": 2.0})
        return [scales["w"], *map(numpy_helper.to_array, model.graph.initializer)]

    halves = [rounded(weight[i : i + 3], images[:, :, c : c + 2], 1) for i, c in ((0, 0), (3, 2))]
    for found, *parts in zip(rounded(weight, images, 2), *halves, strict=True):
        np.testing.assert_allclose(found, np.concatenate(parts), atol=1e-6)

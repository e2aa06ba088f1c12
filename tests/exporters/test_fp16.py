"""Float16 models: the nodes, inputs and outputs that stay float32."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `export`)")
pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

import onnx
from onnx import helper
from small_net import RECIPE, build, feeds, run

from exporters.files import ExportError
from exporters.fp16 import overflowing_nodes, write_fp16
from exporters.recipes import Recipe, nodes_like, recipe_of

pytestmark = pytest.mark.export


def elements(path):
    """Element type by tensor name, of everything in the graph."""
    model = onnx.shape_inference.infer_shapes(onnx.load(path))
    graph = model.graph
    types = {v.name: v.type.tensor_type.elem_type for v in (*graph.value_info, *graph.output)}
    return types | {i.name: i.data_type for i in graph.initializer}


@pytest.fixture
def pair(tmp_path):
    fp32, half = build(tmp_path / "fp32.onnx"), tmp_path / "fp16.onnx"
    write_fp16(fp32, half, feeds(), RECIPE)
    return fp32, half


def test_the_result_is_nearly_the_same_and_float32(pair):
    for feed in feeds(3):
        for exact, got in zip(run(pair[0], feed), run(pair[1], feed), strict=True):
            assert got.dtype == np.float32
            np.testing.assert_allclose(got, exact, rtol=0.01, atol=3e-3 * np.abs(exact).max())


def test_convolutions_are_float16_and_the_recipes_nodes_are_not(pair):
    types = elements(pair[1])
    half, single = onnx.TensorProto.FLOAT16, onnx.TensorProto.FLOAT
    assert [types[name] for name in ("w0", "b0", "w1", "c0", "a0")] == [half] * 5
    assert types["big"] == types["boxes"] == types["scores"] == single


def test_float32_nodes_connect_without_casts_through_float16(pair):
    nodes = {node.name: node for node in onnx.load(pair[1]).graph.node}
    assert nodes["head/text"].input[0] == "txt_feats"
    assert nodes["head/mul"].output[0] == "boxes"
    assert sum(node.op_type == "Cast" for node in nodes.values()) == 2  # images, c1


def test_values_too_large_for_float16_stay_float32(tmp_path):
    fp32, half = build(tmp_path / "fp32.onnx", gain=3e4), tmp_path / "fp16.onnx"
    model = onnx.load(fp32)
    large = overflowing_nodes(model, feeds())
    assert {"trunk/0/conv", "trunk/0/mul", "trunk/1/conv"} <= large
    assert "head/matmul" not in large
    write_fp16(fp32, half, feeds(), RECIPE)
    for exact, got in zip(run(fp32, feeds(1)[0]), run(half, feeds(1)[0]), strict=True):
        np.testing.assert_allclose(got, exact, rtol=0.01, atol=1e-4)


def test_a_token_id_beyond_float16_leaves_its_embeddings_float16(tmp_path):
    """Ids are integers, which are not converted: CLIP's end of text is 49407."""
    single, whole = onnx.TensorProto.FLOAT, onnx.TensorProto.INT64
    table = np.random.default_rng(0).normal(size=(20_000, 8)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("Gather", ["table", "tokens"], ["rows"], "embed")],
        "tokens",
        [helper.make_tensor_value_info("tokens", whole, (1, 2))],
        [helper.make_tensor_value_info("rows", single, (1, 2, 8))],
        [onnx.numpy_helper.from_array(table, "table")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    fp32, half = tmp_path / "fp32.onnx", tmp_path / "fp16.onnx"
    onnx.save(model, fp32)
    write_fp16(fp32, half, [{"tokens": np.array([[5, 15_000]])}], Recipe())
    assert elements(half)["table"] == onnx.TensorProto.FLOAT16


def test_a_recipe_must_exist_and_match_a_node(tmp_path):
    model = onnx.load(build(tmp_path / "fp32.onnx"))
    assert nodes_like(model, ()) == []
    with pytest.raises(ExportError, match="no node has a name like /model"):
        nodes_like(model, Recipe(not_int8=("/model",)).not_int8)
    with pytest.raises(
        ExportError,
        match=r"no recipe for 'yolo-world-x' \(choices: "
        r".*yolo-world-s",
    ):
        recipe_of("yolo-world-x")

"""A small network like a detector's, to test how exporters change a graph."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from exporters.recipes import Recipe

RECIPE = Recipe(not_int8=("^head/",), not_fp16=("^head/",))


def build(path: Path, gain: float = 1.0) -> Path:
    """Two convolutions with SiLU, and a head that scores against the text and scales boxes."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    random = np.random.default_rng(0)
    value, node = helper.make_tensor_value_info, helper.make_node
    weights = {
        "w0": random.normal(0, 0.3, (8, 3, 3, 3)) * gain,
        "b0": random.normal(0, 0.1, 8) * gain,
        "w1": random.normal(0, 0.3, (8, 8, 3, 3)) / gain,
        "b1": random.normal(0, 0.1, 8),
        "big": np.full((1, 64, 4), 640.0),
    }
    nodes = [
        node("Conv", ["images", "w0", "b0"], ["c0"], "trunk/0/conv", pads=[1] * 4, strides=[2, 2]),
        node("Sigmoid", ["c0"], ["s0"], "trunk/0/sigmoid"),
        node("Mul", ["c0", "s0"], ["a0"], "trunk/0/mul"),
        node("Conv", ["a0", "w1", "b1"], ["c1"], "trunk/1/conv", pads=[1] * 4, strides=[2, 2]),
        node("Reshape", ["c1", "flat"], ["f"], "head/reshape"),
        node("Transpose", ["f"], ["ft"], "head/transpose", perm=[0, 2, 1]),
        node("Transpose", ["txt_feats"], ["tt"], "head/text", perm=[0, 2, 1]),
        node("MatMul", ["ft", "tt"], ["m"], "head/matmul"),
        node("Sigmoid", ["m"], ["scores"], "head/sigmoid"),
        node("Slice", ["ft", "from", "to", "axis"], ["l"], "head/slice"),
        node("Mul", ["l", "big"], ["boxes"], "head/mul"),
    ]
    integers = {"flat": [1, 8, 64], "from": [0], "to": [4], "axis": [2]}
    graph = helper.make_graph(
        nodes,
        "small",
        [
            value("images", TensorProto.FLOAT, [1, 3, 32, 32]),
            value("txt_feats", TensorProto.FLOAT, [1, "n", 8]),
        ],
        [
            value("boxes", TensorProto.FLOAT, [1, 64, 4]),
            value("scores", TensorProto.FLOAT, [1, 64, "n"]),
        ],
        [
            *(numpy_helper.from_array(a.astype(np.float32), name) for name, a in weights.items()),
            *(numpy_helper.from_array(np.array(v), name) for name, v in integers.items()),
        ],
    )
    opset = [helper.make_opsetid("", 19)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=9), path)
    return path


def feeds(count: int = 6) -> list[dict[str, np.ndarray]]:
    """Random images with three prompts each."""
    random = np.random.default_rng(1)
    return [
        {
            "images": random.random((1, 3, 32, 32), np.float32),
            "txt_feats": random.normal(size=(1, 3, 8)).astype(np.float32),
        }
        for _ in range(count)
    ]


def run(path: Path, feed: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Boxes and scores on the CPU."""
    import onnxruntime

    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return session.run(["boxes", "scores"], feed)

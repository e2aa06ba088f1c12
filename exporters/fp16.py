"""Conversion of a float32 detector to float16; its inputs and outputs stay float32.

Two kinds of nodes stay in float32: those of the family's recipe, and those whose values come near
the end of float16's range on the calibration images. In a brighter room they would overflow.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnxruntime import InferenceSession

from edge.host.files import replace_atomically
from edge.host.progress import with_progress
from exporters.calibration import Feed, float_tensors
from exporters.onnx_format import check_format, cpu_session
from exporters.recipes import Recipe, nodes_like

SAFE_LIMIT = float(np.finfo(np.float16).max) / 8
"""Nodes with larger values on the calibration images stay in float32."""
_SMALL = "small?"  # prefix of the outputs of `_range_session`


def write_fp16(fp32: Path, out: Path, feeds: list[Feed], recipe: Recipe) -> None:
    """Write the float16 model of `fp32` to `out`; see `to_fp16`."""
    model = onnx.load(fp32)
    with replace_atomically(out) as temporary:
        onnx.save(to_fp16(model, kept_nodes(model, feeds, recipe)), temporary)
        check_format(temporary)


def kept_nodes(model: onnx.ModelProto, feeds: list[Feed], recipe: Recipe) -> set[str]:
    """Return the names of the nodes that stay in float32: the recipe's, and those that overflow."""
    return set(nodes_like(model, recipe.not_fp16)) | overflowing_nodes(model, feeds)


def to_fp16(model: onnx.ModelProto, kept: set[str]) -> onnx.ModelProto:
    """Return the model in float16, except for the nodes `kept`, and inputs and outputs.

    Constants are clipped to its range.
    """
    from onnxruntime.transformers.float16 import convert_float_to_float16
    from onnxruntime.transformers.onnx_model import OnnxModel

    converted = convert_float_to_float16(model, keep_io_types=True, node_block_list=sorted(kept))
    drop_round_trips(converted)
    OnnxModel(converted).topological_sort()
    onnx.checker.check_model(converted)
    return converted


def overflowing_nodes(model: onnx.ModelProto, feeds: list[Feed]) -> set[str]:
    """Return the names of nodes that read or write a value beyond ±`SAFE_LIMIT` (or NaN)."""
    names = float_tensors(model)
    session = _range_session(model, names)
    large: set[str] = set()
    for feed in with_progress("pictures: values", feeds):
        for name, value in feed.items():  # integers, such as tokens, are not converted
            if value.dtype == np.float32 and not np.abs(value).max(initial=0.0) <= SAFE_LIMIT:
                large.add(name)
        is_small = session.run([_SMALL + name for name in names], feed) if names else []
        large.update(name for name, small in zip(names, is_small, strict=True) if not small)
    return {
        node.name for node in model.graph.node if large.intersection((*node.input, *node.output))
    }


def _range_session(model: onnx.ModelProto, names: list[str]) -> InferenceSession:
    """Return a session that outputs, for each name, 1 if its values are within ±`SAFE_LIMIT`.

    The session compares the values itself: those of a large transformer together fill 20 GB.
    """
    augmented = onnx.ModelProto()
    augmented.CopyFrom(model)
    graph, node, uint8 = augmented.graph, onnx.helper.make_node, onnx.TensorProto.UINT8
    graph.initializer.append(
        onnx.helper.make_tensor("limit?", onnx.TensorProto.FLOAT, (), [SAFE_LIMIT])
    )
    for name in names:
        magnitude, within, number = (f"{what}?{name}" for what in ("abs", "within", "number"))
        graph.node.extend([
            node("Abs", [name], [magnitude]),
            node("LessOrEqual", [magnitude, "limit?"], [within]),  # False for NaN
            node("Cast", [within], [number], to=uint8),
            node("ReduceMin", [number], [_SMALL + name], keepdims=0),
        ])  # fmt: skip
        graph.output.append(onnx.helper.make_tensor_value_info(_SMALL + name, uint8, ()))
    return cpu_session(augmented.SerializeToString())


def drop_round_trips(model: onnx.ModelProto) -> None:
    """Remove float32 → float16 → float32, which the converter leaves around kept nodes."""
    graph = model.graph
    # Value in float16 → value in float32 from which a cast makes it.
    to_half = {n.output[0]: n.input[0] for n in graph.node if _is_cast(n, onnx.TensorProto.FLOAT16)}
    trips = [n for n in graph.node if _is_cast(n, onnx.TensorProto.FLOAT) and n.input[0] in to_half]
    # Value at the end of a round trip → value at its start.
    replacement = {node.output[0]: to_half[node.input[0]] for node in trips}
    for name in replacement:
        while replacement[name] in replacement:  # several round trips one after another
            replacement[name] = replacement[replacement[name]]
    results = {output.name for output in graph.output}
    # A model output keeps its name: the value before the round trip takes that name.
    renamed = {source: name for name, source in replacement.items() if name in results}
    for node in trips:
        graph.node.remove(node)
    for node in graph.node:
        for names in (node.input, node.output):
            for index, name in enumerate(names):
                name = replacement.get(name, name)
                names[index] = renamed.get(name, name)
    used = {name for node in graph.node for name in node.input} | results
    for node in [n for n in graph.node if not used.intersection(n.output)]:
        graph.node.remove(node)


def _is_cast(node: onnx.NodeProto, to: int) -> bool:
    return node.op_type == "Cast" and any(a.name == "to" and a.i == to for a in node.attribute)

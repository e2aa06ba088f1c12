"""Weight-only quantization to INT8 or INT4: weights get few bits, activations stay float.

A matrix has a scale for each block of `BLOCK` weights (onnxruntime's MatMulNBits, rounding to
nearest). An embedding table has a scale for each row and always 8 bits, because its rows are read
and not summed.
"""

from __future__ import annotations

import logging

import numpy as np
import onnx
from onnx import helper, numpy_helper

from exporters.files import ExportError

BITS = {"int8": 8, "q4": 4}
"""Bits by the precision of a card."""
BLOCK = 32
"""Weights that share a scale."""
INT8_ARITHMETIC = 4
"""MatMulNBits' `accuracy_level`: the CPU multiplies in int8, with inputs rounded block by block. In
float32 it would unpack every weight first. A GPU ignores it."""
MAX_LEVEL = 127
"""Largest magnitude of an int8 level."""


def quantize_weights(model: onnx.ModelProto, precision: str) -> onnx.ModelProto:
    """Return the model with constant matrices in 8 or 4 bits and embedding tables in 8.

    Raises:
        ExportError: nothing in the model to quantize.
    """
    from onnxruntime.quantization.matmul_nbits_quantizer import (
        DefaultWeightOnlyQuantConfig,
        MatMulNBitsQuantizer,
    )

    tables = quantize_tables(model)
    settings = DefaultWeightOnlyQuantConfig(
        block_size=BLOCK, is_symmetric=True, accuracy_level=INT8_ARITHMETIC, bits=BITS[precision]
    )
    quantizer = MatMulNBitsQuantizer(model, algo_config=settings)
    logging.getLogger("onnxruntime.quantization.matmul_nbits_quantizer").setLevel(logging.WARNING)
    quantizer.process()
    quantized = quantizer.model.model
    if not tables and all(node.op_type != "MatMulNBits" for node in quantized.graph.node):
        raise ExportError(
            f"{precision}: the model has no constant matrix that can be quantized; choose another "
            "precision"
        )
    return quantized


def quantize_tables(model: onnx.ModelProto) -> int:
    """Convert every embedding table to int8, in place; return how many there were."""
    graph = model.graph
    constants = {init.name: init for init in graph.initializer}
    uses = [name for node in graph.node for name in node.input]
    found = [
        node for node in graph.node
        if node.op_type == "Gather" and _is_table(constants.get(node.input[0]))
        and _axis(node) == 0 and uses.count(node.input[0]) == 1
    ]  # fmt: skip
    for node in found:
        table = constants[node.input[0]]
        levels, scale = _rows_in_int8(numpy_helper.to_array(table))
        scales = numpy_helper.from_array(scale, f"{table.name}_scale")
        table.CopyFrom(numpy_helper.from_array(levels, table.name))
        graph.initializer.append(scales)
        # In place of the look-up: look up levels and scales, and multiply them.
        name, ids, rows = node.name, node.input[1], node.output[0]
        parts = {part: f"{rows}_{part}" for part in ("levels", "floats", "scales")}
        at = list(graph.node).index(node)
        graph.node.remove(node)
        for offset, made in enumerate((
            helper.make_node("Gather", [table.name, ids], [parts["levels"]], name),
            helper.make_node("Cast", [parts["levels"]], [parts["floats"]], f"{name}_cast",
                             to=onnx.TensorProto.FLOAT),
            helper.make_node("Gather", [scales.name, ids], [parts["scales"]], f"{name}_scales"),
            helper.make_node("Mul", [parts["floats"], parts["scales"]], [rows], f"{name}_scaled"),
        )):  # fmt: skip
            graph.node.insert(at + offset, made)
    return len(found)


def _is_table(tensor: onnx.TensorProto | None) -> bool:
    """Return True for a float tensor of two axes with more elements than a block."""
    return (
        tensor is not None and tensor.data_type == onnx.TensorProto.FLOAT
        and len(tensor.dims) == 2 and int(np.prod(tensor.dims)) > BLOCK
    )  # fmt: skip


def _axis(node: onnx.NodeProto) -> int:
    """Return the axis that a Gather looks up."""
    return next((a.i for a in node.attribute if a.name == "axis"), 0)


def _rows_in_int8(table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quantize (rows, d) float32 to levels (rows, d) int8 and scales (rows, 1) float32."""
    scale = np.maximum(np.abs(table).max(axis=1, keepdims=True), 1e-12) / MAX_LEVEL
    return np.round(table / scale).astype(np.int8), scale.astype(np.float32)

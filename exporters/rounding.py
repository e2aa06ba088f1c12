"""Rounding of weights of convolutions and matrices to int8, so that the output changes least.

Rounding each weight to its nearest step ignores that a layer's inputs are correlated. GPTQ (Frantar
et al. 2022, "Accurate post-training quantization for generative pre-trained transformers") rounds
one input column after another. The later columns compensate the error, weighted by the layer's
inputs on the calibration images.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from numpy.lib.stride_tricks import sliding_window_view
from onnx import numpy_helper

from edge.host.progress import with_progress
from exporters.calibration import Feed, tensor_session

DAMPING = 0.01
"""Share of the mean input power that is added to the diagonal of the moment, for stability where
the calibration images have no input."""
BLOCK = 128
"""Columns that are rounded before the error is spread over all later columns."""
ROWS_PER_IMAGE = 384
"""Output cells of a layer (tokens, for a matrix) that one image contributes."""
MAX_LEVEL = 127
"""Largest magnitude of an int8 weight; its zero point is 0."""
CLIP_SHARES = np.linspace(0.7, 1.0, 13)
"""Ends of the range to try for a channel of a weight, as shares of its largest magnitude."""


def attribute(node: onnx.NodeProto, name: str, default: Any) -> Any:
    """Return an attribute of a node: an integer, or a list of integers."""
    found = (onnx.helper.get_attribute_value(a) for a in node.attribute if a.name == name)
    return next(found, default)


def inputs_of_cells(
    node: onnx.NodeProto, x: np.ndarray, kernel: tuple[int, int], cells: np.ndarray
) -> np.ndarray:
    """Return the inputs that a convolution multiplies with its weights, for some output cells.

    Its input `x` is (1, C, H, W), its kernel (kh, kw). The k cells are numbered row by row.

    Returns:
        (k, C·kh·kw), a row for each cell; C is the number of input channels.
    """
    windows = _windows(node, x, kernel)
    v, u = np.unravel_index(cells, windows.shape[1:3])
    return windows[:, v, u].swapaxes(0, 1).reshape(len(cells), -1)


def _windows(node: onnx.NodeProto, x: np.ndarray, kernel: tuple[int, int]) -> np.ndarray:
    """Return a view (C, output height, output width, kh, kw) of each output cell's input."""
    top, left, bottom, right = attribute(node, "pads", [0, 0, 0, 0])
    step_v, step_u = attribute(node, "strides", [1, 1])
    padded = np.pad(x[0], ((0, 0), (top, bottom), (left, right)))
    return sliding_window_view(padded, kernel, axis=(1, 2))[:, ::step_v, ::step_u]


def _sampled_inputs(
    node: onnx.NodeProto, x: np.ndarray, weight: onnx.TensorProto, random: np.random.Generator
) -> np.ndarray:
    """Return the layer's inputs for at most ROWS_PER_IMAGE of its outputs, (n, d)."""
    if node.op_type == "MatMul":
        tokens = x.reshape(-1, x.shape[-1])
        return tokens[random.permutation(len(tokens))[:ROWS_PER_IMAGE]]
    kernel = tuple(weight.dims[2:])
    height, width = _windows(node, x, kernel).shape[1:3]
    return inputs_of_cells(node, x, kernel, random.permutation(height * width)[:ROWS_PER_IMAGE])


class InputStatistics:
    """Statistics of the inputs of a layer, or of one group of its channels, over all images.

    Args:
        size: d, the number of inputs that one output depends on.
        limit: largest magnitude of the input's symmetric 8-bit range; None if unknown.

    Attributes:
        moment: (d, d) float32, sum of the products of each two inputs.
        mean: (d,) mean of the inputs.
        rounded_mean: (d,) mean of the inputs after rounding to 8 bits; 0 without a limit.
    """

    def __init__(self, size: int, limit: float | None) -> None:
        self.moment = np.zeros((size, size), np.float32)
        self._step = None if limit is None else np.float32(limit / MAX_LEVEL)
        self._count = 0
        self._sum, self._rounded_sum = np.zeros(size), np.zeros(size)

    def add(self, inputs: np.ndarray) -> None:
        """Add the inputs of some outputs of one image, (outputs, d)."""
        self.moment += inputs.T @ inputs
        self._count += len(inputs)
        self._sum += inputs.sum(axis=0)
        if self._step is not None:
            self._rounded_sum += (_round(inputs, self._step) * self._step).sum(axis=0)

    @property
    def mean(self) -> np.ndarray:
        """See the class."""
        return self._sum / self._count

    @property
    def rounded_mean(self) -> np.ndarray:
        """See the class."""
        return self._rounded_sum / self._count


def input_statistics(
    model: onnx.ModelProto,
    layers: list[onnx.NodeProto],
    feeds: list[Feed],
    limits: Mapping[str, float],
) -> dict[str, list[InputStatistics]]:
    """Return the statistics of each layer's input, one for each group of channels, by node name.

    The layers are `Conv` and `MatMul` nodes. `limits` has the largest magnitude of each tensor's
    symmetric 8-bit range, if known.
    """
    weights = {init.name: init for init in model.graph.initializer}
    names = sorted({node.input[0] for node in layers} - {model.graph.input[0].name})
    session = tensor_session(model, names)
    random = np.random.default_rng(0)
    statistics: dict[str, list[InputStatistics]] = {}
    for feed in with_progress("pictures: inputs of layers", feeds):
        made = session.run(names, feed) if names else []  # an empty list means all outputs
        values = {**feed, **dict(zip(names, made, strict=True))}
        for node in layers:
            inputs = _sampled_inputs(node, values[node.input[0]], weights[node.input[1]], random)
            groups = statistics.setdefault(node.name, [])
            if not groups:
                # A depthwise convolution has as many groups as input channels; a matrix has one.
                n = attribute(node, "group", 1)
                size, limit = inputs.shape[1] // n, limits.get(node.input[0])
                groups.extend(InputStatistics(size, limit) for _ in range(n))
            for group, part in zip(groups, np.split(inputs, len(groups), axis=1), strict=True):
                group.add(part)
    return statistics


def channel_scales(weight: np.ndarray) -> np.ndarray:
    """Return the step (rows, 1) of a weight (rows, d) with the least squared clipping error."""
    full = np.maximum(np.abs(weight).max(axis=1, keepdims=True), 1e-8) / MAX_LEVEL
    best = np.full_like(full, np.inf)
    scales = full.copy()
    for share in CLIP_SHARES.astype(np.float32):
        scale = full * share
        error = np.square(_round(weight, scale) * scale - weight).sum(axis=1, keepdims=True)
        # Keep the best scale of each row so far.
        scales = np.where(error < best, scale, scales)
        best = np.minimum(error, best)
    return scales


def _round(values: np.ndarray, scale: np.ndarray | np.floating) -> np.ndarray:
    """Return the values as integer levels of steps `scale`, at most ±MAX_LEVEL."""
    return np.clip(np.round(values / scale), -MAX_LEVEL, MAX_LEVEL)


def gptq(weight: np.ndarray, moment: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return a weight (rows, d) as integer levels, rounded by GPTQ; a row is an output channel.

    `moment` (d, d) is that of `InputStatistics`, and `scale` (rows, 1) the step of each row.
    """
    diagonal = moment.diagonal()
    damping = DAMPING * diagonal.mean() + 1e-8
    # The strongest inputs go first, while many columns are left to compensate their error.
    order = np.argsort(-diagonal, kind="stable")
    weight, factor = weight[:, order], _inverse_factor(moment[np.ix_(order, order)], damping)
    levels = np.zeros_like(weight)
    for start in range(0, weight.shape[1], BLOCK):
        stop = min(start + BLOCK, weight.shape[1])
        errors = np.zeros((len(weight), stop - start), weight.dtype)
        for column in range(start, stop):
            levels[:, column] = _round(weight[:, column], scale[:, 0])
            rest = weight[:, column] - levels[:, column] * scale[:, 0]
            # The error of a column is subtracted from all later columns, weighted by `factor`:
            # at once in this block, and after the block in the others.
            error = rest / factor[column, column]
            weight[:, column:stop] -= np.outer(error, factor[column, column:stop])
            errors[:, column - start] = error
        weight[:, stop:] -= errors @ factor[start:stop, stop:]
    return levels[:, np.argsort(order)]  # the columns in their old order


def _inverse_factor(moment: np.ndarray, damping: float) -> np.ndarray:
    """Return upper triangular U, (d, d), with UᵀU the inverse of moment + damping·1.

    U is the inverse of the upper triangular R with RRᵀ = moment + damping·1. R is Cholesky's factor
    of the matrix with rows and columns in reverse order.
    """
    damped = moment + damping * np.eye(len(moment), dtype=moment.dtype)
    return np.linalg.inv(np.linalg.cholesky(damped[::-1, ::-1])[::-1, ::-1])


def round_weights(
    model: onnx.ModelProto,
    layers: list[onnx.NodeProto],
    feeds: list[Feed],
    limits: Mapping[str, float] | None = None,
) -> dict[str, np.ndarray]:
    """Put rounded weights into `model`, in place; return per-channel scales (rows,) by weight name.

    The layers are `Conv` nodes, and `MatMul` nodes with a constant (d, rows). `limits` has the
    largest magnitude of a tensor's symmetric 8-bit range. If a convolution's input has one, its
    bias compensates the mean error of rounding weights and input (Nagel et al. 2019, "Data-free
    quantization through weight equalization and bias correction", sec. 4.2, with measured means).
    """
    statistics = input_statistics(model, layers, feeds, limits or {})
    by_name = {init.name: init for init in model.graph.initializer}
    scales: dict[str, np.ndarray] = {}
    for node in with_progress("layers: weights", layers):
        initializer, groups = by_name[node.input[1]], statistics[node.name]
        array = numpy_helper.to_array(initializer)
        is_product = node.op_type == "MatMul"  # its output channels are columns
        weight = array.T if is_product else array.reshape(len(array), -1)
        scale = channel_scales(weight)
        of_group = [np.split(rows, len(groups)) for rows in (weight, scale)]
        exact = list(zip(groups, *of_group, strict=True))
        rounded_parts = [gptq(w, g.moment, s) * s for g, w, s in exact]
        rounded = np.concatenate(rounded_parts)
        values = np.ascontiguousarray(rounded.T) if is_product else rounded.reshape(array.shape)
        initializer.CopyFrom(numpy_helper.from_array(values, initializer.name))
        scales[initializer.name] = scale[:, 0]
        if limits and node.input[0] in limits and len(node.input) > 2:
            bias = by_name[node.input[2]]
            shift = [
                w @ g.mean - r @ g.rounded_mean
                for (g, w, _), r in zip(exact, rounded_parts, strict=True)
            ]
            corrected = numpy_helper.to_array(bias) + np.concatenate(shift)
            bias.CopyFrom(numpy_helper.from_array(corrected.astype(np.float32), bias.name))
    return scales

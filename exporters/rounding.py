"""Int8 convolution weights that keep the layer's output, not the weights themselves.

Rounding each weight to its nearest step ignores that a layer's inputs move together. GPTQ
(Frantar et al. 2022, "Accurate post-training quantization for generative pre-trained
transformers") rounds one input column after another and lets the later columns make up for the
error, weighted by what the calibration images feed the layer.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from exporters.calibration import Feed, tensor_session

DAMPING = 0.01
"""Share of the mean input power added to the diagonal, so that unseen directions stay stable."""
BLOCK = 128
ROWS_PER_IMAGE = 384
"""Output cells of a layer that one image contributes."""
MAX_LEVEL = 127
"""Symmetric int8: the scale a weight is stored with has zero point 0."""
CLIP_SHARES = np.linspace(0.7, 1.0, 13)


def attribute(node: onnx.NodeProto, name: str, default: list[int]) -> list[int]:
    """An integer-list attribute of a node."""
    return next((list(a.ints) for a in node.attribute if a.name == name), default)


def input_columns(node: onnx.NodeProto, x: np.ndarray, kernel: tuple[int, int]) -> torch.Tensor:
    """What a convolution multiplies with its weights: (cells, C·kh·kw) of an input (1, C, H, W)."""
    pads = attribute(node, "pads", [0, 0, 0, 0])
    columns = torch.nn.functional.unfold(
        torch.from_numpy(x), kernel, padding=pads[:2], stride=attribute(node, "strides", [1, 1])
    )
    return columns[0].T


class Inputs:
    """What a convolution's input columns (cells, d) are like, summed up over images.

    Attributes:
        moment: their second moment X·Xᵀ, (d, d).
        mean, rounded_mean: of the columns, and of the columns in symmetric 8 bits, (d,).
    """

    def __init__(self, size: int, limit: float | None) -> None:
        self.moment = torch.zeros(size, size)
        self._step = None if limit is None else limit / MAX_LEVEL
        self._count = 0
        self._sum, self._rounded_sum = torch.zeros(size), torch.zeros(size)

    def add(self, columns: torch.Tensor) -> None:
        self.moment.addmm_(columns.T, columns)
        self._count += len(columns)
        self._sum += columns.sum(dim=0)
        if self._step is not None:
            rounded = (columns / self._step).round().clamp(-MAX_LEVEL, MAX_LEVEL) * self._step
            self._rounded_sum += rounded.sum(dim=0)

    @property
    def mean(self) -> torch.Tensor:
        return self._sum / self._count

    @property
    def rounded_mean(self) -> torch.Tensor:
        return self._rounded_sum / self._count


def input_statistics(
    model: onnx.ModelProto,
    convs: list[onnx.NodeProto],
    feeds: list[Feed],
    limits: Mapping[str, float],
    seed: int = 0,
) -> dict[str, Inputs]:
    """Of each convolution, by node name; `limits` are the tensors' 8-bit ranges, where known."""
    weights = {init.name: init for init in model.graph.initializer}
    names = sorted({node.input[0] for node in convs} - {model.graph.input[0].name})
    session = tensor_session(model, names)
    generator = torch.Generator().manual_seed(seed)
    statistics: dict[str, Inputs] = {}
    for feed in feeds:
        made = session.run(names, feed) if names else []  # no name asks for all outputs
        values = {**feed, **dict(zip(names, made, strict=True))}
        for node in convs:
            kernel = tuple(weights[node.input[1]].dims[2:])
            columns = input_columns(node, values[node.input[0]], kernel)
            chosen = torch.randperm(len(columns), generator=generator)[:ROWS_PER_IMAGE]
            if node.name not in statistics:
                limit = limits.get(node.input[0])
                statistics[node.name] = Inputs(columns.shape[1], limit)
            statistics[node.name].add(columns[chosen])
    return statistics


def channel_scales(weight: torch.Tensor) -> torch.Tensor:
    """Per-row step (rows, 1) of a weight (rows, d): the clipping with the least squared error."""
    full = weight.abs().amax(dim=1, keepdim=True).clamp_min(1e-8) / MAX_LEVEL
    best = torch.full_like(full, torch.inf)
    scales = full.clone()
    for share in CLIP_SHARES.tolist():
        scale = full * share
        error = (_round(weight, scale) * scale - weight).square().sum(dim=1, keepdim=True)
        scales = torch.where(error < best, scale, scales)
        best = torch.minimum(error, best)
    return scales


def _round(weight: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    return (weight / scale).round().clamp(-MAX_LEVEL, MAX_LEVEL)


def gptq(weight: torch.Tensor, moment: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    """Integer levels (rows, d) of `weight` (rows, d) on steps `scale` (rows, 1).

    `moment` (d, d) is the second moment of the layer's inputs.
    """
    weight, moment = weight.clone(), moment.clone()
    diagonal = moment.diagonal()
    diagonal += DAMPING * diagonal.mean() + 1e-8
    # The strongest inputs go first, while there are still many columns to make up for them.
    order = diagonal.argsort(descending=True)
    weight, moment = weight[:, order], moment[order][:, order]
    inverse = torch.linalg.cholesky(
        torch.cholesky_inverse(torch.linalg.cholesky(moment)), upper=True
    )
    levels = torch.zeros_like(weight)
    for start in range(0, weight.shape[1], BLOCK):
        stop = min(start + BLOCK, weight.shape[1])
        errors = torch.zeros(len(weight), stop - start)
        for column in range(start, stop):
            levels[:, column] = _round(weight[:, column : column + 1], scale)[:, 0]
            rest = weight[:, column] - levels[:, column] * scale[:, 0]
            error = rest / inverse[column, column]
            weight[:, column:stop] -= torch.outer(error, inverse[column, column:stop])
            errors[:, column - start] = error
        weight[:, stop:] -= errors @ inverse[start:stop, stop:]
    return levels[:, order.argsort()]


def round_weights(
    model: onnx.ModelProto,
    convs: list[onnx.NodeProto],
    feeds: list[Feed],
    limits: Mapping[str, float] | None = None,
) -> dict[str, np.ndarray]:
    """Put rounded weights into `model` (in place); per-channel scales (rows,) by weight name.

    Args:
        limits: by tensor, the largest magnitude of its symmetric 8-bit range. Where a
            convolution's input has one, its bias makes up for what rounding weights and input
            adds to its output on average (Nagel et al. 2019, "Data-free quantization through
            weight equalization and bias correction", sec. 4.2, with the means measured).
    """
    statistics = input_statistics(model, convs, feeds, limits or {})
    by_name = {init.name: init for init in model.graph.initializer}
    scales: dict[str, np.ndarray] = {}
    for node in convs:
        initializer, inputs = by_name[node.input[1]], statistics[node.name]
        array = numpy_helper.to_array(initializer)
        weight = torch.from_numpy(array.reshape(len(array), -1).copy())
        scale = channel_scales(weight)
        rounded = gptq(weight, inputs.moment, scale) * scale
        values = rounded.reshape(array.shape).numpy()
        initializer.CopyFrom(numpy_helper.from_array(values, initializer.name))
        scales[initializer.name] = scale[:, 0].numpy()
        if limits and node.input[0] in limits and len(node.input) > 2:
            bias = by_name[node.input[2]]
            shift = weight @ inputs.mean - rounded @ inputs.rounded_mean
            corrected = numpy_helper.to_array(bias) + shift.numpy()
            bias.CopyFrom(numpy_helper.from_array(corrected.astype(np.float32), bias.name))
    return scales

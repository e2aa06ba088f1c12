"""Activation ranges for static quantization, measured on images.

Plain min–max ranges waste most of the 256 steps on rare values. Here each tensor gets the range
with the least error where the value is used. For example, a convolution's output that goes into
SiLU is judged after SiLU, which loses nearly all values below -6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import onnx
from onnxruntime import InferenceSession

from edge.host.progress import with_progress
from exporters.onnx_format import cpu_session

BINS = 2048
"""Bins of a histogram."""
LEVELS = 255
"""Steps of an 8-bit range."""
MAX_LEVEL = 127
"""Steps of a symmetric 8-bit range on each side of 0."""
SHRINK = np.linspace(0.1, 1.0, 37)
"""Ends of a range to try, as shares of the observed extremes."""

Feed = dict[str, np.ndarray]
"""Inputs of one run of a model, by name."""


@dataclass
class Histogram:
    """Histogram of the values of a tensor.

    Attributes:
        low: lowest value, at most 0, since an 8-bit range must hold 0 exactly.
        high: highest value, at least 0.
        counts: (BINS,) float64 over [low, high].
    """

    low: float
    high: float
    counts: np.ndarray

    @property
    def centres(self) -> np.ndarray:
        """Bin centres, (BINS,)."""
        step = (self.high - self.low) / BINS
        return self.low + step * (np.arange(BINS) + 0.5)


def float_tensors(model: onnx.ModelProto) -> list[str]:
    """Return the names of all intermediate float tensors, in graph order."""
    inferred = onnx.shape_inference.infer_shapes(model)
    known = {info.name: info.type.tensor_type.elem_type for info in inferred.graph.value_info}
    outputs = {output.name for output in model.graph.output}
    made = [name for node in model.graph.node for name in node.output if name not in outputs]
    return [name for name in made if known.get(name) == onnx.TensorProto.FLOAT]


def tensor_session(model: onnx.ModelProto, names: list[str]) -> InferenceSession:
    """Return a session that also outputs the intermediate float tensors `names`."""
    augmented = onnx.ModelProto()
    augmented.CopyFrom(model)
    present = {output.name for output in model.graph.output}
    augmented.graph.output.extend(
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None)
        for name in names
        if name not in present
    )
    return cpu_session(augmented.SerializeToString())


def collect_histograms(
    model: onnx.ModelProto, feeds: list[Feed], names: list[str] | None = None
) -> dict[str, Histogram]:
    """Return histograms of the named tensors (None: all) and of the inputs, over all feeds.

    The model runs twice on each feed, the inputs of one image.
    """
    names = float_tensors(model) if names is None else names
    session = tensor_session(model, names)

    def run_all(what: str) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the values of each tensor, for each feed; `what` names the progress."""
        for feed in with_progress(f"pictures: {what}", feeds):
            yield from feed.items()
            yield from zip(names, session.run(names, feed), strict=True)

    extremes: dict[str, tuple[float, float]] = {}
    for name, values in run_all("extremes"):
        low, high = extremes.get(name, (0.0, 1e-6))  # never an empty range
        extremes[name] = min(low, float(values.min())), max(high, float(values.max()))
    histograms = {name: Histogram(*ends, np.zeros(BINS)) for name, ends in extremes.items()}
    for name, values in run_all("histograms"):
        histogram = histograms[name]
        scale = BINS / (histogram.high - histogram.low)
        index = ((values.ravel() - histogram.low) * scale).astype(np.int32)
        np.minimum(index, BINS - 1, out=index)
        histogram.counts += np.bincount(index, minlength=BINS)
    return histograms


def least_loss_range(
    histogram: Histogram, used_as: Callable[[np.ndarray], np.ndarray] | None = None
) -> tuple[float, float]:
    """Return the 8-bit range that changes `used_as(value)` least, in mean square.

    `used_as` is the function through which the tensor acts, by default the identity.
    """
    used_as = used_as or (lambda x: x)
    x, counts = histogram.centres, histogram.counts
    filled = counts > 0
    x, counts = x[filled], counts[filled]
    exact = used_as(x)
    best = (np.inf, histogram.low, histogram.high)
    lows = histogram.low * SHRINK if histogram.low < 0 else np.zeros(1)
    for low in lows:
        for high in histogram.high * SHRINK:
            step = (high - low) / LEVELS
            zero = np.round(-low / step)  # the level of 0
            level = np.clip(np.round(x / step) + zero, 0, LEVELS)
            loss = float(((used_as((level - zero) * step) - exact) ** 2 * counts).sum())
            if loss < best[0]:
                best = (loss, float(low), float(high))
    return best[1], best[2]


def least_loss_limit(histogram: Histogram) -> float:
    """Return the largest magnitude of the symmetric 8-bit range that changes the values least."""
    x, counts = histogram.centres, histogram.counts
    x, counts = x[counts > 0], counts[counts > 0]
    extreme = max(-histogram.low, histogram.high)
    losses = []
    for limit in extreme * SHRINK:
        step = limit / MAX_LEVEL
        level = np.clip(np.round(x / step), -MAX_LEVEL, MAX_LEVEL)
        losses.append(float(((level * step - x) ** 2 * counts).sum()))
    return float(extreme * SHRINK[int(np.argmin(losses))])


def silu(x: np.ndarray) -> np.ndarray:
    """Return x · sigmoid(x), YOLO's activation."""
    return x / (1.0 + np.exp(-x))

"""Static INT8 quantization of a FP32 detector or image encoder, for onnxruntime or TensorRT.

The file has pairs of quantize and dequantize nodes (QDQ), which the runtime fuses into kernels.
Weights are int8 per output channel. Three measures keep the scores: ranges with the least error
where the value is used (`calibration`), weights rounded against their inputs (`rounding`), and
float for the few nodes in the family's recipe.

`int8-cpu`: activations are uint8 with a zero point, and everything between convolutions is
quantized too. `int8-trt`: activations are int8 around 0, as TensorRT requires, and only inputs of
convolutions are quantized. TensorRT fuses convolution, activation and the next Q into one kernel; a
Q between them would prevent this. Biases and the rest are float16 as in a `fp16` model, because a
strongly typed TensorRT network uses the types in the file.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from edge.host.files import replace_atomically
from edge.host.progress import with_progress
from exporters.calibration import (
    Feed,
    collect_histograms,
    least_loss_limit,
    least_loss_range,
    silu,
)
from exporters.files import ExportError
from exporters.fp16 import kept_nodes, to_fp16, write_fp16
from exporters.images import CENTRED, Border, TextEmbeddings, list_images, load_input
from exporters.onnx_format import check_format
from exporters.recipes import Recipe, nodes_like
from exporters.rounding import round_weights
from exporters.weight_only import quantize_weights

PRECISIONS = ("int8-cpu", "int8-trt")
MIN_IMAGES = 4
"""Least number of images for a calibration."""
MAX_ROUNDING_IMAGES = 40
"""Images that the weights are rounded against; the ranges use all images."""
HELD_OUT_EVERY = 4
"""If one folder is used for both, every fourth image is kept for the parity check."""
FEW_PROMPTS = 4
"""Number of prompts for every second calibration image; the others get all. Missions have few
prompts, benchmarks many."""

PASSES_RANGE_ON = {"Slice", "Reshape", "Transpose", "Resize", "MaxPool", "Unsqueeze", "Expand"}
"""Operators whose output has the range of its input, so that 8-bit values pass unchanged."""


def derive(fp32: Path, out: Path, feeds: list[Feed], recipe: Recipe, precision: str) -> None:
    """Write another precision of a FP32 file to `out`."""
    if precision == "fp16":
        write_fp16(fp32, out, feeds, recipe)
    elif precision in PRECISIONS:
        quantize(fp32, out, feeds, recipe, precision)
    else:
        onnx.save(quantize_weights(onnx.load(fp32), precision), out)
        check_format(out)


def quantize(fp32: Path, out: Path, feeds: list[Feed], recipe: Recipe, precision: str) -> None:
    """Write an INT8 model.

    Raises:
        ExportError: too few inputs.
    """
    if len(feeds) < MIN_IMAGES:
        raise ExportError(
            f"--calibration: got {len(feeds)} images; give at least {MIN_IMAGES} from the robot's "
            "camera (40 or more for good scores)"
        )
    model = onnx.load(fp32)
    for_trt = precision == "int8-trt"
    # Patterns of nodes, then the names of the nodes.
    not_quantized = (*recipe.not_int8, *(recipe.not_symmetric if for_trt else ()))
    excluded = nodes_like(model, not_quantized)
    in_float32 = kept_nodes(model, feeds, recipe) if for_trt else set()
    tensors = None  # names of the tensors whose ranges are measured; None for all
    if recipe.matrices_only:
        layers = constant_products(model)
        excluded += [n.name for n in model.graph.node if n.op_type == "MatMul" and n not in layers]
        tensors = sorted({n.input[0] for n in layers})
    else:
        layers = [n for n in model.graph.node if n.op_type == "Conv"]
    layers = [n for n in layers if n.name not in excluded]
    # TensorRT needs ranges around 0; else there are no limits, and each range has two free ends.
    # Largest magnitude of every activation's symmetric 8-bit range.
    histograms = collect_histograms(model, feeds, tensors) if for_trt else {}
    limits = {name: least_loss_limit(h) for name, h in histograms.items()}
    ranges = {n: (-r, r) for n, r in limits.items()} or activation_ranges(model, feeds, tensors)
    stride = -(-len(feeds) // MAX_ROUNDING_IMAGES)  # rounded up
    scales = round_weights(model, layers, feeds[::stride], limits)
    op_type = layers[0].op_type if for_trt or recipe.matrices_only else None
    with replace_atomically(out) as temporary:
        overrides = _overrides(ranges, scales, 1 if recipe.matrices_only else 0)
        _write_qdq(model, temporary, feeds[0], overrides, excluded, for_trt, op_type)
        if for_trt:
            onnx.save(to_fp16(onnx.load(temporary), in_float32), temporary)
        check_format(temporary)


def constant_products(model: onnx.ModelProto) -> list[onnx.NodeProto]:
    """Return the nodes that multiply by a constant matrix; raise ExportError if there are none."""
    constants = {init.name for init in model.graph.initializer}
    found = [n for n in model.graph.node if n.op_type == "MatMul" and n.input[1] in constants]
    if not found:
        raise ExportError(
            "int8: the model has no constant matrix that can be quantized; choose another precision"
        )
    return found


def input_hw(model: onnx.ModelProto) -> tuple[int, int]:
    """Return height and width in pixels of a model's image input."""
    dims = model.graph.input[0].type.tensor_type.shape.dim
    return dims[2].dim_value, dims[3].dim_value


def calibration_feeds(
    images: list[Path],
    text: TextEmbeddings,
    hw: tuple[int, int],
    border: Border = CENTRED,
) -> list[Feed]:
    """Return one feed per image, alternately with all prompts and with a random few."""
    rng = np.random.default_rng(0)
    feeds = []
    for index, path in enumerate(with_progress("pictures: read", images)):
        rows = np.arange(len(text.names))
        if index % 2 and len(rows) > FEW_PROMPTS:
            rows = rng.choice(rows, FEW_PROMPTS, replace=False)
        feeds.append({"images": load_input(path, hw, border), "txt_feats": text.emb[rows][None]})
    return feeds


def activation_ranges(
    model: onnx.ModelProto, feeds: list[Feed], tensors: list[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Return the 8-bit range of every activation that needs one, by tensor name.

    The arguments are those of `collect_histograms`.
    """
    histograms = collect_histograms(model, feeds, tensors)
    producer = {name: node.op_type for node in model.graph.node for name in node.output}
    consumers: dict[str, set[str]] = {}
    for node in model.graph.node:
        for name in node.input:
            consumers.setdefault(name, set()).add(node.op_type)
    ranges = {}
    for name, histogram in with_progress("tensors: ranges", histograms.items()):
        if producer.get(name) in PASSES_RANGE_ON:
            continue
        if producer.get(name) == "Sigmoid":
            ranges[name] = (0.0, 1.0)
            continue
        # ONNX has no SiLU: x · sigmoid(x) is a Sigmoid and a Mul.
        into_silu = producer.get(name) == "Conv" and consumers.get(name) == {"Sigmoid", "Mul"}
        ranges[name] = least_loss_range(histogram, silu if into_silu else None)
    return ranges


def _overrides(
    ranges: dict[str, tuple[float, float]], scales: dict[str, np.ndarray], axis: int
) -> dict[str, list[dict]]:
    """Return our ranges and weight scales in the form of onnxruntime's quantizer."""
    from onnxruntime.quantization import QuantType

    overrides: dict[str, list[dict]] = {
        name: [{"rmin": np.float32(low), "rmax": np.float32(high)}]
        for name, (low, high) in ranges.items()
    }
    fixed = {"quant_type": QuantType.QInt8, "zero_point": np.int8(0)}
    for name, channels in scales.items():
        overrides[name] = [{**fixed, "scale": np.float32(scale)} for scale in channels]
        overrides[name][0]["axis"] = axis
    return overrides


def _write_qdq(
    model: onnx.ModelProto,
    out: Path,
    feed: Feed,
    overrides: dict,
    excluded: list[str],
    for_trt: bool,
    op_type: str | None,
) -> None:
    """Write the model, with rounded weights, with pairs of quantize and dequantize nodes.

    `feed` is any input of the model; `overrides` are from `_overrides`. `excluded` names nodes that
    are not quantized. Only inputs of nodes of `op_type` are quantized; None: all.
    """
    from onnxruntime.quantization import (
        CalibrationDataReader,
        QuantFormat,
        QuantType,
        quantize_static,
    )

    class OneFeed(CalibrationDataReader):
        """One input for the quantizer's own calibration, whose ranges the overrides replace."""

        def __init__(self) -> None:
            self._feeds = iter([feed])

        def get_next(self) -> Feed | None:
            return next(self._feeds, None)

    options: dict = {"TensorQuantOverrides": overrides}
    if op_type is not None:
        options["OpTypesToExcludeOutputQuantization"] = [op_type]
    if for_trt:
        options |= {"ActivationSymmetric": True, "QuantizeBias": False}
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)  # advice on shape inference that does not apply here
    try:
        quantize_static(
            model,
            out,
            OneFeed(),
            quant_format=QuantFormat.QDQ,
            per_channel=True,
            op_types_to_quantize=None if op_type is None else [op_type],
            activation_type=QuantType.QInt8 if for_trt else QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            nodes_to_exclude=excluded,
            extra_options=options,
        )
    finally:
        root.setLevel(level)


def precisions_to_make(args: Any, choices: Collection[str], network: str) -> list[str]:
    """Return the precisions of `--precision`, after FP32, which the others are made from.

    Raises:
        ExportError: a precision is unknown, or one needs pictures that were not given.
    """
    wanted = ["fp32", *(p for p in args.precision if p != "fp32")]
    if unknown := [p for p in wanted if p not in choices]:
        raise ExportError(
            f"--precision: no precision {unknown[0]!r} for {network} "
            f"(choices: {', '.join(choices)})"
        )
    if wanted != ["fp32"]:
        require_calibration(args.calibration, args.card)
    return wanted


def require_calibration(calibration: Path | None, name: str) -> None:
    """Raise ExportError if no calibration folder was given."""
    if calibration is None:
        raise ExportError(
            f"{name}: --calibration is missing; give a folder of pictures from the robot's "
            "camera, or render some with exporters.render_calibration"
        )


def pictures(calibration: Path | None, validation: Path | None) -> tuple[list[Path], list[Path]]:
    """Return images to calibrate on and images to measure on; empty without a folder.

    One folder for both is split.
    """
    images = [] if calibration is None else list_images(calibration)
    if validation is not None:
        return images, list_images(validation)
    if calibration is None:
        return [], []
    held_out = images[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY]
    if not held_out:
        raise ExportError(
            f"--calibration {calibration}: {len(images)} images are too few to keep one for the "
            f"comparison with the original; give at least {HELD_OUT_EVERY}, or --validation"
        )
    return [path for path in images if path not in set(held_out)], held_out

"""Segmenters in miniature, with the inputs and outputs of those that are published.

The encoder's features are its image, a sixteenth as wide, so that a mask is where the image is
bright, and within the box that the prompt names: a prompt or a mask in the wrong place is seen.
Other features have random weights.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

SIDE, CELLS = 128, 32
"""Side of the encoder's image and of its masks."""


class Layout(NamedTuple):
    """Layout of an export.

    Attributes:
        features: outputs of the encoder and inputs of the decoder, by name (channels, stride).
        prompts: inputs of the decoder besides points.
        masks: outputs of the decoder with masks: name and side, None for the image's own.
        candidates: masks a box.
        card: fields of its card that are not the default.
    """

    image: str
    made: dict[str, tuple[int, int]]
    taken: tuple[str, ...]
    prompts: tuple[str, ...]
    masks: tuple[str, ...]
    candidates: int
    card: dict


LAYOUTS = {
    "mobile-sam": Layout(
        "image", {"image_embedding": (256, 4)}, ("image_embeddings",),
        ("mask_input", "has_mask_input", "orig_im_size"), ("masks", "low_res_masks"), 4,
        {"prompt_px": SIDE},
    ),
    "nano-sam": Layout(
        "image", {"image_embeddings": (256, 4)}, ("image_embeddings",),
        ("mask_input", "has_mask_input"), ("low_res_masks",), 4, {"prompt_px": SIDE},
    ),
    "efficientvit-sam": Layout(
        "input_image", {"image_embeddings": (256, 4)}, ("image_embeddings",), (), ("masks",), 1,
        {"prompt_px": 2 * SIDE},
    ),
    "sam2-tiny": Layout(
        "image",
        {"high_res_feats_0": (32, 4), "high_res_feats_1": (64, 8), "image_embed": (256, 4)},
        ("image_embed", "high_res_feats_0", "high_res_feats_1"),
        ("mask_input", "has_mask_input"), ("masks",), 3, {"prompt_px": SIDE, "fit": "stretch"},
    ),
}  # fmt: skip


def write(folder: Path, cards: Path, name: str, slow: bool = False, **changes) -> dict:
    """Both files of a layout and their card, as it was written.

    Args:
        folder: of the ONNX files.
        cards: folder of the card.
        name: of the card.
        slow: an encoder that has no end with an image that is not black.
        changes: of the card.
    """
    layout = LAYOUTS[name]
    encoder, decoder = folder / f"{name}-encoder.onnx", folder / f"{name}-decoder.onnx"
    _write_encoder(encoder, layout, slow)
    _write_decoder(decoder, layout)
    card = {
        "name": name, "task": "segment", "family": name, "precision": "fp32",
        "encoder": {"file": encoder.name, "sha256": _sha256(encoder)},
        "decoder": {"file": decoder.name, "sha256": _sha256(decoder)},
        "input": {"height": SIDE, "width": SIDE},
        "preprocess": {"color": "rgb", "scale": 1 / 255, "mean": [0.5] * 3, "std": [0.5] * 3},
        "license": "Apache-2.0", "sources": [], "derived_from": None, "parity": None,
        **layout.card, **changes,
    }  # fmt: skip
    (cards / f"{name}.yaml").write_text(yaml.safe_dump(card))
    return card


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _write_encoder(path: Path, layout: Layout, slow: bool) -> None:
    """Each feature: a strided convolution, its first channel the mean of all colours there."""
    from onnx import TensorProto, helper, numpy_helper

    random, nodes, constants, results = np.random.default_rng(0), [], [], []
    pixels = layout.image
    if slow:
        nodes, constants = _endless(pixels)
        pixels = "in_the_end"
    for name, (channels, stride) in layout.made.items():
        weights = random.normal(size=(channels, 3, stride, stride)).astype(np.float32)
        weights[0] = 1.0 / (3 * stride * stride)
        constants.append(numpy_helper.from_array(weights, f"{name}_weights"))
        nodes.append(
            helper.make_node("Conv", [pixels, f"{name}_weights"], [name], strides=[stride, stride])
        )
        shape = [1, channels, SIDE // stride, SIDE // stride]
        results.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
    shape = ["batch" if layout.image == "input_image" else 1, 3, SIDE, SIDE]
    given = [helper.make_tensor_value_info(layout.image, TensorProto.FLOAT, shape)]
    _save(path, nodes, given, results, constants)


def _endless(pixels: str):
    """Return a loop with as many turns as the sum of the pixels above black, times 10^12."""
    from onnx import TensorProto, helper, numpy_helper

    info = helper.make_tensor_value_info
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["goes"]),
         helper.make_node("Identity", ["held"], ["kept"])],
        "turn",
        [info("turn", TensorProto.INT64, []), info("go", TensorProto.BOOL, []),
         info("held", TensorProto.FLOAT, None)],
        [info("goes", TensorProto.BOOL, []), info("kept", TensorProto.FLOAT, None)],
    )  # fmt: skip
    nodes = [
        helper.make_node("ReduceMax", [pixels], ["brightest"], keepdims=0),
        helper.make_node("Add", ["brightest", "one"], ["above"]),
        helper.make_node("Mul", ["above", "many"], ["turns"]),
        helper.make_node("Cast", ["turns"], ["count"], to=TensorProto.INT64),
        helper.make_node("Loop", ["count", "", pixels], ["in_the_end"], body=body),
    ]
    constants = [
        numpy_helper.from_array(np.float32(1.0), "one"),
        numpy_helper.from_array(np.float32(1e12), "many"),
    ]
    return nodes, constants


def _write_decoder(path: Path, layout: Layout) -> None:
    """Write a decoder whose masks are the features' first channel within the box, -1 outside.

    The first mask is the reverse, with lower `iou_predictions`.
    """
    from onnx import TensorProto, helper, numpy_helper

    info, node = helper.make_tensor_value_info, helper.make_node
    px, k = layout.card["prompt_px"], layout.candidates
    middles = ((np.arange(CELLS) + 0.5) * px / CELLS).astype(np.float32)
    sign = np.ones((1, k, 1, 1), np.float32)
    if k > 1:
        sign[0, 0] = -1.0
    arrays = {
        "x": middles.reshape(1, 1, 1, CELLS), "y": middles.reshape(1, 1, CELLS, 1),
        "zero": np.array([0]), "one": np.array([1]), "two": np.array([2]), "axes": np.array([1]),
        "flat": np.array([4]), "outside": np.float32(-1.0), "sign": sign,
        "iou": np.linspace(0.1, 0.9, k, dtype=np.float32).reshape(1, k),
    }  # fmt: skip
    feature = layout.taken[0]
    nodes = [
        node("Slice", [feature, "zero", "one", "axes"], ["bright"]),
        node("Reshape", ["point_coords", "flat"], ["corners"]),
        node("Split", ["corners"], ["x0", "y0", "x1", "y1"], axis=0),
        node("Greater", ["x", "x0"], ["right_of"]),
        node("Less", ["x", "x1"], ["left_of"]),
        node("Greater", ["y", "y0"], ["below"]),
        node("Less", ["y", "y1"], ["above"]),
        node("And", ["right_of", "left_of"], ["across"]),
        node("And", ["below", "above"], ["down"]),
        node("And", ["across", "down"], ["within"]),
        node("Where", ["within", "bright", "outside"], ["one_mask"]),
        node("Mul", ["one_mask", "sign"], ["low"]),
        # An unused input would be dropped from the graph.
        node("ReduceSum", ["point_labels"], ["labels"], keepdims=0),
        node("Sub", ["labels", "labels"], ["nothing"]),
        node("Add", ["iou", "nothing"], ["iou_predictions"]),
    ]
    given = [
        info("point_coords", TensorProto.FLOAT, [1, "points", 2]),
        info("point_labels", TensorProto.FLOAT, [1, "points"]),
        *(info(name, TensorProto.FLOAT, [1, *_shape(layout, name)]) for name in layout.taken),
    ]
    shapes = {
        "mask_input": [1, 1, CELLS, CELLS], "has_mask_input": [1], "orig_im_size": [2],
    }  # fmt: skip
    given += [info(name, TensorProto.FLOAT, shapes[name]) for name in layout.prompts]
    results = [info("iou_predictions", TensorProto.FLOAT, [1, k])]
    for name in layout.masks:
        whole = name == "masks" and len(layout.masks) > 1  # enlarged: not to be taken
        nodes.append(node("Neg" if whole else "Identity", ["low"], [name]))
        results.insert(0, info(name, TensorProto.FLOAT, [1, k, "rows", "columns"]))
    constants = [numpy_helper.from_array(np.asarray(v), key) for key, v in arrays.items()]
    _save(path, nodes, given, results, constants)


def _shape(layout: Layout, name: str) -> list[int]:
    made = layout.made.get(name) or next(iter(layout.made.values()))
    return [made[0], SIDE // made[1], SIDE // made[1]]


def _save(path, nodes, given, results, constants) -> None:
    from onnx import helper

    graph = helper.make_graph(nodes, "tiny", given, results, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(model.SerializeToString())

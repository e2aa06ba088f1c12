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
from onnx_text import onnx_of

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
    """Both files of a layout and their card, as it was written."""
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
    """Each feature: a strided convolution, its first channel the mean of all colours there.

    A slow one first takes as many turns as the brightest pixel above black, times 10^12.
    """
    random, values, made, results = np.random.default_rng(0), {}, [], []
    pixels = layout.image
    if slow:
        made = [
            f"brightest = ReduceMax <keepdims = 0> ({pixels})",
            "above = Add (brightest, one)", "turns = Mul (above, many)",
            f"count = Cast <to = 7> (turns) end = Loop (count, , {pixels}) <body = turn "
            "(int64 k, bool go, float held) => (bool goes, float kept) "
            "{ goes = Identity (go) kept = Identity (held) }>",
        ]  # fmt: skip
        pixels, values = "end", {"one": np.float32(1.0), "many": np.float32(1e12)}
    for name, (channels, stride) in layout.made.items():
        weights = random.normal(size=(channels, 3, stride, stride)).astype(np.float32)
        weights[0] = 1.0 / (3 * stride * stride)
        values[f"{name}_weights"] = weights
        made.append(f"{name} = Conv <strides = [{stride}, {stride}]> ({pixels}, {name}_weights)")
        results.append(f"float[1,{channels},{SIDE // stride},{SIDE // stride}] {name}")
    batch = "batch" if layout.image == "input_image" else 1
    given = f"float[{batch},3,{SIDE},{SIDE}] {layout.image}"
    text = f"g ({given}) => ({', '.join(results)}) {{ {' '.join(made)} }}"
    path.write_bytes(onnx_of(text, **values))


def _write_decoder(path: Path, layout: Layout) -> None:
    """Write a decoder whose masks are the features' first channel within the box, -1 outside.

    The first mask is the reverse, with lower `iou_predictions`.
    """
    px, k = layout.card["prompt_px"], layout.candidates
    middles = ((np.arange(CELLS) + 0.5) * px / CELLS).astype(np.float32)
    sign = np.ones((1, k, 1, 1), np.float32)
    if k > 1:
        sign[0, 0] = -1.0
    shapes = {"mask_input": f"1,1,{CELLS},{CELLS}", "has_mask_input": "1", "orig_im_size": "2"}
    given = ["float[1,points,2] point_coords", "float[1,points] point_labels"]
    given += [f"float[{_shape(layout, name)}] {name}" for name in layout.taken]
    given += [f"float[{shapes[name]}] {name}" for name in layout.prompts]
    masks = [f"float[1,{k},rows,columns] {name}" for name in layout.masks[::-1]]
    made = [
        # The one of two that is enlarged is not to be taken.
        f"{name} = {'Neg' if name == 'masks' and len(masks) > 1 else 'Identity'} (low)"
        for name in layout.masks
    ]
    # An unused input would be dropped from the graph: the labels count as 0.
    text = f"""g ({", ".join(given)}) => ({", ".join(masks)}, float[1,{k}] iou_predictions) {{
      bright = Slice ({layout.taken[0]}, zero, one, axes)
      corners = Reshape (point_coords, flat)
      x0, y0, x1, y1 = Split <axis = 0> (corners)
      right_of = Greater (x, x0) left_of = Less (x, x1) across = And (right_of, left_of)
      below = Greater (y, y0) above = Less (y, y1) down = And (below, above)
      within = And (across, down)
      one_mask = Where (within, bright, outside)
      low = Mul (one_mask, sign)
      labels = ReduceSum <keepdims = 0> (point_labels)
      nothing = Sub (labels, labels)
      iou_predictions = Add (iou, nothing)
      {" ".join(made)}
    }}"""
    iou = np.linspace(0.1, 0.9, k, dtype=np.float32).reshape(1, k)
    path.write_bytes(onnx_of(
        text, x=middles.reshape(1, 1, 1, CELLS), y=middles.reshape(1, 1, CELLS, 1), zero=[0],
        one=[1], axes=[1], flat=[4], outside=np.float32(-1.0), sign=sign, iou=iou,
    ))  # fmt: skip


def _shape(layout: Layout, name: str) -> str:
    channels, stride = layout.made.get(name) or next(iter(layout.made.values()))
    return f"1,{channels},{SIDE // stride},{SIDE // stride}"

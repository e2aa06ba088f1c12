"""Small ONNX models in ONNX's own text, with initializers for the values that a test computes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from onnx import numpy_helper, parser

HEADER = '<ir_version: 8, opset_import: ["": 17]>'


def onnx_of(text: str, **values: ArrayLike) -> bytes:
    """Return the file of a graph; it names the values as if they were inputs."""
    made = parser.parse_model(f"{HEADER} {text}")
    made.graph.initializer.extend(
        numpy_helper.from_array(np.asarray(value), name) for name, value in values.items()
    )
    return made.SerializeToString()


def tiny_detector(
    boxes: np.ndarray,
    logits: np.ndarray,
    hw: tuple[int, int] = (64, 64),
    names: tuple[str, str] = ("images", "txt_feats"),
) -> bytes:
    """Return a detector of these boxes in every image, whose scores are sigmoid(logits · text).

    The image counts as its mean times 0, so that it is an input.
    """
    k, d = logits.shape
    image, text = names
    return onnx_of(
        f"""tiny (float[1,3,{hw[0]},{hw[1]}] {image}, float[1,n,{d}] {text})
        => (float[1,{k},4] boxes, float[1,{k},n] scores) {{
          mean = ReduceMean <keepdims = 0> ({image})
          nothing = Mul (mean, zero)
          boxes = Add (box, nothing)
          turned = Transpose <perm = [0, 2, 1]> ({text})
          raw = MatMul (logits, turned)
          scores = Sigmoid (raw)
        }}""",
        zero=np.float32(0), box=boxes, logits=logits[None],
    )  # fmt: skip

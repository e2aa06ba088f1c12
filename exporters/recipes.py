"""What of a family's network is too delicate for few bits, as patterns of node names."""

from __future__ import annotations

import re
from dataclasses import dataclass

import onnx

from exporters.files import ExportError


@dataclass(frozen=True)
class Recipe:
    """Nodes that keep their type, as patterns of their names.

    Attributes:
        not_int8: nodes that are not quantized.
        not_symmetric: nodes that are not quantized either where 8-bit ranges lie around 0, which
            leaves values of one sign only half the steps.
        not_fp16: nodes that stay in float32 when the others go to float16.
        matrices_only: of a transformer only what is multiplied by constant matrices is quantized,
            and what comes out is float: normalizations, softmax and sums cost little, and their
            values are too uneven for 8 bits.
    """

    not_int8: tuple[str, ...] = ()
    not_symmetric: tuple[str, ...] = ()
    not_fp16: tuple[str, ...] = ()
    matrices_only: bool = False


_YOLO_HEAD = r"^/model\.22/(?!cv\d)"
"""Contrast with the text and box decoding: class scores die in 8 bits, and a coordinate beyond
512 px has only half pixels in float16."""

RECIPES = {
    "yolo-world-s": Recipe(
        not_int8=(
            r"^/model\.[01]/",  # 2 % of the work, and every later layer repeats their error
            r"/attn/(?!proj_conv/)",  # text-guided gates: a sigmoid of a wide sum, half the error
            _YOLO_HEAD,
        ),
        # Their inputs are wide, the latter's for the gates' part of it: the error of what comes out
        # is 4 to 20 times the other convolutions'.
        not_symmetric=(r"^/model\.2/cv1/", r"^/model\.(12|15|18|21)/cv2/"),
        not_fp16=(_YOLO_HEAD,),
    ),
    "mini-house": Recipe(
        not_int8=(
            r"^/trunk/stem/",  # three channels leave an integer kernel half empty: float is faster
            r"^/(?!trunk/|neck/|heads\.)",  # as _YOLO_HEAD
        )
    ),
}
"""By family, as the cards name it."""

TRANSFORMER = Recipe(matrices_only=True)
"""Of every image encoder that is a vision transformer, whatever its family."""


def recipe_of(family: str) -> Recipe:
    """The recipe of a family; raises ExportError that lists those there are."""
    if family not in RECIPES:
        raise ExportError(f"family: unknown {family!r} (choices: {', '.join(sorted(RECIPES))})")
    return RECIPES[family]


def nodes_like(model: onnx.ModelProto, patterns: tuple[str, ...]) -> list[str]:
    """Names of a model's nodes that fit a pattern; raises ExportError if a pattern finds none."""
    names = [node.name for node in model.graph.node]
    for pattern in patterns:
        if not any(re.search(pattern, name) for name in names):
            raise ExportError(
                f"no node is named like {pattern}; export the FP32 model with this project's "
                "exporter, which keeps the module path in node names"
            )
    return [name for name in names if any(re.search(p, name) for p in patterns)]

"""Recipes of quantization: the nodes of each family's network that keep more bits.

Nodes are given as patterns (regular expressions) of their names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import onnx

from exporters.files import ExportError


@dataclass(frozen=True)
class Recipe:
    """Nodes of a network that keep more bits, as patterns of their names.

    Attributes:
        not_symmetric: nodes that are also not quantized if 8-bit ranges are around 0, since values
            of one sign then have only half the steps.
        not_fp16: nodes that stay in float32 when the others become float16.
        matrices_only: quantize only the inputs of products with constant matrices, for a
            transformer. Normalizations, softmax and sums stay float: they cost little, and their
            values vary too much for 8 bits.
    """

    not_int8: tuple[str, ...] = ()
    not_symmetric: tuple[str, ...] = ()
    not_fp16: tuple[str, ...] = ()
    matrices_only: bool = False


_YOLO_HEAD = r"^/model\.22/(?!cv\d)"  # /model.22/Sigmoid, not /model.22/cv2.0/…/Conv
"""The head without its convolutions: text contrast and box decoding. Class scores vanish in 8 bits,
and a coordinate above 512 px has only half-pixel steps in float16."""
_YOLOE_HEAD = r"^/model\.23/(?!cv\d)"  # the same of YOLOE-11, with its network for text embeddings

RECIPES = {
    "yolo-world-s": Recipe(
        not_int8=(
            # /model.0/conv/Conv: 2 % of the work, and their error reaches every later layer.
            r"^/model\.[01]/",
            # /model.12/attn/gl/…, not /model.12/attn/proj_conv/…: text-guided gates, a sigmoid of a
            # wide sum. They make half of the error.
            r"/attn/(?!proj_conv/)",
            _YOLO_HEAD,
        ),
        # Their inputs have a wide range (in the second pattern because of the gates). The error of
        # their output is 4 to 20 times that of other convolutions.
        not_symmetric=(r"^/model\.2/cv1/", r"^/model\.(12|15|18|21)/cv2/"),
        not_fp16=(_YOLO_HEAD,),
    ),
    "yoloe-11s": Recipe(
        not_int8=(r"^/model\.[01]/", r"/attn/(?!qkv/|proj/|pe/)", _YOLOE_HEAD),
        not_fp16=(_YOLOE_HEAD,),
    ),
    "mini-house": Recipe(
        not_int8=(
            r"^/trunk/stem/",  # 3 channels fill an integer kernel badly: float is faster
            r"^/(?!trunk/|neck/|heads\.)",  # all outside trunk, neck and heads; as _YOLO_HEAD
        )
    ),
}
"""Recipes by the family in the cards."""

TRANSFORMER = Recipe(matrices_only=True)
"""Recipe of every image encoder that is a vision transformer."""

OWL = Recipe(
    matrices_only=True,
    not_int8=(r"^/(class|box)_head/",),
    not_fp16=(r"^/(?!vision_model/|box_head/|class_head/dense0/)",),
)
"""Recipe of OWLv2: a vision transformer whose heads are 3 % of the work and whose boxes and scores
need more than 8 bits. The text contrast and the boxes in pixels stay in float32."""


def recipe_of(family: str) -> Recipe:
    """Return the recipe of a family; raise ExportError for an unknown one."""
    if family not in RECIPES:
        raise ExportError(
            f"family: no recipe for {family!r} (choices: {', '.join(sorted(RECIPES))})"
        )
    return RECIPES[family]


def nodes_like(model: onnx.ModelProto, patterns: tuple[str, ...]) -> list[str]:
    """Return the names of nodes that match a pattern; raise ExportError for one without match."""
    names = [node.name for node in model.graph.node]
    for pattern in patterns:
        if not any(re.search(pattern, name) for name in names):
            raise ExportError(
                f"FP32 model: no node has a name like {pattern}; export the model with `edge "
                "models export`, which keeps the module paths as node names"
            )
    return [name for name in names if any(re.search(p, name) for p in patterns)]

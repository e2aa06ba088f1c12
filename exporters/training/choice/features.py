"""Image features of views: the output of the small detector's trunk, the net's only image input.

The trunk is the detector without its box outputs, with the INT8 weights of our quantizer. It is not
trained further. So every image is read once, and the net learns from the INT8 trunk's output.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper
from onnx.utils import Extractor

from edge.host.files import replace_atomically
from exporters.files import sha256_of
from exporters.images import as_input
from exporters.onnx_format import cpu_session
from exporters.training.choice.collect import load_views

GRID_HW = (8, 10)
"""Rows and columns of the feature grid."""
HEADS = tuple(f"/heads.{k}/text/text.2/Conv_output_0_DequantizeLinear_Output" for k in range(3))
"""Names of the detector's tensors with the embeddings of strides 8, 16 and 32."""
NECK = tuple(
    f"/neck/{level}/out/out.2/Relu_output_0_DequantizeLinear_Output" for level in ("low16", "low32")
)
"""Names of the tensors from which the embeddings of strides 16 and 32 are computed."""


@dataclass(frozen=True, slots=True)
class Features:
    """Features of n views; the second axis has the image as it is (0) and mirrored (1).

    A level is the quantized integer of a value: value = scale * level.

    Attributes:
        evidence: (n, 2, c, 8, 10) uint8, 255 times the detector's score of each of
            `looks.CATEGORIES`, the highest in a cell.
        neck16: (n, 2, 96, 8, 10) uint16, sums of the levels of 2x2 cells of stride 16, the first
            of `NECK`.
        neck32: (n, 2, 128, 8, 10) uint8, levels of the cells of stride 32, the second of `NECK`.
    """

    evidence: np.ndarray
    neck16: np.ndarray
    neck32: np.ndarray

    def __len__(self) -> int:
        return len(self.neck32)


class Trunk:
    """The small detector up to its embeddings, as an ONNX model.

    Attributes:
        model: `images` → `HEADS` and `NECK`.
        logit_scale: factor in the detector's scores: sigmoid(scale · embedding · text + bias).
        logit_bias: offset in the detector's scores.
        level_scales: scales of the levels in `Features.neck16` and `neck32`. The first is a quarter
            of the quantizer's, so it turns the sum of four cells into their mean.
        words: (c, 64) float32, unit rows of `looks.CATEGORIES`.
        key: beginning of the detector's hash, which the names of stored features have.
    """

    def __init__(self, detector: Path, text: Path) -> None:
        from exporters.training.mini import looks

        full, self.key = onnx.load(detector), sha256_of(detector)[:8]
        values = {t.name: t for t in full.graph.initializer}

        def number(name: str) -> float:
            """Return a constant of the model."""
            return float(numpy_helper.to_array(values[name]))

        self.model = Extractor(onnx.shape_inference.infer_shapes(full)).extract_model(
            ["images"], [*HEADS, *NECK]
        )
        self.logit_scale, self.logit_bias = float(np.exp(number("scale"))), number("bias")
        # The inputs of a DequantizeLinear node are the levels, their scale, and their zero point.
        makers = {node.output[0]: node for node in full.graph.node}
        scale16, scale32 = (number(makers[name].input[1]) for name in NECK)
        self.level_scales = scale16 / 4.0, scale32
        for name in NECK:
            assert number(makers[name].input[2]) == 0.0, "a ReLU's zero point"
        # Phrases of a category alone, without colour and size; token k + 1 is category k.
        tokens = np.zeros((len(looks.CATEGORIES), 3), np.int64)
        tokens[:, 0] = 1 + np.arange(len(looks.CATEGORIES))
        self.words = cpu_session(text, 1).run(None, {"tokens": tokens})[0]
        self._session = cpu_session(self.model.SerializeToString(), 1)

    def read(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the arrays of `Features` for one image, without the first two axes.

        Args:
            rgb: (h, w, 3) uint8.
        """
        *heads, neck16, neck32 = self._session.run([*HEADS, *NECK], {"images": as_input(rgb)})
        # Logits without the bias; e is (1, 64, h, w), the embeddings of one stride.
        logits = (self.logit_scale * np.einsum("kd,dhw->khw", self.words, e[0]) for e in heads)
        best = np.max([_fold(x, np.max) for x in logits], axis=0) + self.logit_bias
        evidence = np.round(255.0 / (1.0 + np.exp(-best)))
        # From values back to levels: 4 * level_scales[0] is the quantizer's scale.
        levels16 = np.round(_fold(neck16[0], np.sum) / (4.0 * self.level_scales[0]))
        return evidence, levels16, np.round(neck32[0] / self.level_scales[1])


def _fold(x: np.ndarray, reduce: Callable) -> np.ndarray:
    """Reduce (c, h, w) to (c, 8, 10), the feature grid, by a function such as `np.max`."""
    c, h, w = x.shape
    rows, columns = GRID_HW
    return reduce(x.reshape(c, rows, h // rows, columns, w // columns), axis=(2, 4))


def make_features(paths: Sequence[Path], trunk: Trunk) -> Features:
    """Return the features of the views in these files; they are stored next to them."""
    parts = [_read_or_make(path, trunk) for path in paths]
    return Features(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Features))
    )


# Names in the stored file and types of the arrays of `Features`, in the order of its fields.
_STORED = {"evidence": np.uint8, "near": np.uint16, "far": np.uint8}


def _read_or_make(path: Path, trunk: Trunk) -> Features:
    """Return the features of one file of views; compute and store them if they are not stored."""
    stored = path.with_suffix(f".{trunk.key}.npz")
    if not stored.is_file():
        views = load_views([path])
        read = [
            [trunk.read(np.ascontiguousarray(rgb)) for rgb in (image, image[:, ::-1])]
            for image in map(views.rgb, range(len(views)))
        ]
        # `read` is image → (as it is, mirrored) → arrays of `Trunk.read`; k is the array.
        arrays = {
            name: np.array([[features[k] for features in pair] for pair in read], dtype)
            for k, (name, dtype) in enumerate(_STORED.items())
        }
        with replace_atomically(stored) as part, part.open("wb") as file:
            np.savez(file, **arrays)
    with np.load(stored) as data:
        return Features(*(data[name] for name in _STORED))

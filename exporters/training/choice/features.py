"""Image features of views: the output of the small detector's trunk, the net's only image input.

The trunk is the detector's without its boxes, INT8 as our quantizer made it. It is not trained
further. So every image is read once, and the net learns from the INT8 trunk's output.
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
from exporters.images import as_input
from exporters.onnx_format import cpu_session
from exporters.training.choice.collect import load_views

GRID_HW = (8, 10)
"""Rows and columns of the feature grid."""
HEADS = tuple(f"/heads.{k}/text/text.2/Conv_output_0_DequantizeLinear_Output" for k in range(3))
NECK = tuple(
    f"/neck/{level}/out/out.2/Relu_output_0_DequantizeLinear_Output" for level in ("low16", "low32")
)
"""Tensors of the detector, from which the embeddings of strides 16 and 32 are computed. `HEADS` are
the embeddings of strides 8, 16 and 32."""


@dataclass(frozen=True, slots=True)
class Features:
    """Features of n views, as seen and mirrored (the second axis).

    Attributes:
        evidence: (n, 2, c, 8, 10) uint8, 255 times the detector's score of each of
            `looks.CATEGORIES`, the highest in a cell.
        near: (n, 2, 96, 8, 10) uint16, the first of `NECK` as quantized, summed over 2x2 cells.
        far: (n, 2, 128, 8, 10) uint8, the second of `NECK`.
    """

    evidence: np.ndarray
    near: np.ndarray
    far: np.ndarray

    def __len__(self) -> int:
        return len(self.far)


class Trunk:
    """The detector up to its embeddings.

    Attributes:
        model: `images` → `HEADS` and `NECK`.
        scale: factor in the detector's scores: sigmoid(scale · embedding · text + bias).
        bias: offset in the detector's scores.
        scales: factors from `near` and `far` to the values of `NECK` (for `near`, to the mean of
            four).
        words: (c, 64) float32, unit rows of `looks.CATEGORIES`.
    """

    def __init__(self, detector: Path, text: Path) -> None:
        from exporters.training.mini import looks

        whole = onnx.load(detector)
        values = {t.name: t for t in whole.graph.initializer}

        def number(name: str) -> float:
            return float(numpy_helper.to_array(values[name]))

        self.model = Extractor(onnx.shape_inference.infer_shapes(whole)).extract_model(
            ["images"], [*HEADS, *NECK]
        )
        self.scale, self.bias = float(np.exp(number("scale"))), number("bias")
        makers = {node.output[0]: node for node in whole.graph.node}
        near, far = (number(makers[name].input[1]) for name in NECK)
        self.scales = near / 4.0, far
        for name in NECK:
            assert number(makers[name].input[2]) == 0.0, "a ReLU's zero point"
        tokens = np.zeros((len(looks.CATEGORIES), 3), np.int64)
        tokens[:, 0] = 1 + np.arange(len(looks.CATEGORIES))
        self.words = cpu_session(text, 1).run(None, {"tokens": tokens})[0]
        self._session = cpu_session(self.model.SerializeToString(), 1)

    def read(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return one image's `Features`, without the first two axes."""
        *heads, near, far = self._session.run([*HEADS, *NECK], {"images": as_input(rgb)})
        logits = (self.scale * np.einsum("kd,dhw->khw", self.words, e[0]) for e in heads)
        best = np.max([_fold(x, np.max) for x in logits], axis=0) + self.bias
        evidence = np.round(255.0 / (1.0 + np.exp(-best)))
        near = np.round(_fold(near[0], np.sum) / (4.0 * self.scales[0]))
        return evidence, near, np.round(far[0] / self.scales[1])


def _fold(x: np.ndarray, how: Callable) -> np.ndarray:
    """Reduce (c, h, w) to a grid of 8 rows and 10 columns of cells."""
    c, h, w = x.shape
    rows, columns = GRID_HW
    return how(x.reshape(c, rows, h // rows, columns, w // columns), axis=(2, 4))


def make_features(paths: Sequence[Path], trunk: Trunk) -> Features:
    """Return the features of the views in these files; they are stored next to them."""
    parts = [_read_or_make(path, trunk) for path in paths]
    return Features(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Features))
    )


_TYPES = (np.uint8, np.uint16, np.uint8)


def _read_or_make(path: Path, trunk: Trunk) -> Features:
    stored = path.with_suffix(".features.npz")
    if not stored.is_file():
        views = load_views([path])
        read = [
            [trunk.read(np.ascontiguousarray(rgb)) for rgb in (image, image[:, ::-1])]
            for image in map(views.rgb, range(len(views)))
        ]
        arrays = {
            f.name: np.array([[features[k] for features in pair] for pair in read], dtype)
            for k, (f, dtype) in enumerate(zip(fields(Features), _TYPES, strict=True))
        }
        with replace_atomically(stored) as part, part.open("wb") as file:
            np.savez(file, **arrays)
    with np.load(stored) as data:
        return Features(*(data[f.name] for f in fields(Features)))

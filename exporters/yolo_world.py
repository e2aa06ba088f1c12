"""Export of YOLO-World v2 or YOLOE from a checkpoint to one ONNX file with prompts as input.

All detector ONNX files of this project have the same inputs and outputs: `INPUTS`, `OUTPUTS`.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

# By default Ultralytics installs missing packages, sends usage data and writes settings to the home
# folder. An export must not change the host or send data.
os.environ.setdefault("YOLO_AUTOINSTALL", "false")
os.environ.setdefault("YOLO_OFFLINE", "true")
os.environ.setdefault("YOLO_CONFIG_DIR", tempfile.gettempdir())

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from edge.host.files import replace_atomically
from exporters.files import check_sha256
from exporters.images import TextEmbeddings
from exporters.onnx_format import check_format, export_module

INPUTS = ("images", "txt_feats")
"""`images` (1, 3, H, W) float32 RGB 0..1, letterboxed; `txt_feats` (1, n, 512), unit rows."""
OUTPUTS = ("boxes", "scores")
"""`boxes` (1, A, 4) float32 xyxy in input pixels; `scores` (1, A, n) float32 after the sigmoid."""
TEXT_DIM = 512
"""Length of a text embedding."""


class YoloWorldDetector(nn.Module):
    """YOLO-World or YOLOE with text embeddings as an input, and boxes and scores as two outputs.

    Ultralytics' own forward fixes the number of classes in the graph; here it is free.
    """

    def __init__(self, world_model: nn.Module):
        super().__init__()
        # The name `model` keeps ONNX node names at `/model.<layer>/…`, which the quantizer reads.
        self.model = world_model.model
        self.model[-1] = WorldHead(self.model[-1])
        self.save = frozenset(world_model.save)

    def forward(self, images: Tensor, txt_feats: Tensor) -> tuple[Tensor, Tensor]:
        """Run the detector; see `INPUTS` and `OUTPUTS`."""
        x, outputs = images, []
        for layer in self.model[:-1]:
            if layer.f != -1:
                x = outputs[layer.f] if isinstance(layer.f, int) else _gather(layer.f, x, outputs)
            x = layer(x, txt_feats) if type(layer).__name__ == "C2fAttn" else layer(x)
            outputs.append(x if layer.i in self.save else None)
        head = self.model[-1]
        return head(_gather(head.f, x, outputs), txt_feats)


def _gather(sources: list[int], latest: Tensor, outputs: list[Tensor | None]) -> list[Tensor]:
    """Return the outputs of the layers `sources`, by their numbers; -1 is the `latest` layer."""
    return [latest if i == -1 else outputs[i] for i in sources]


class WorldHead(nn.Module):
    """Detection head at strides 8, 16, 32: Ultralytics' WorldDetect layers, fully decoded.

    YOLOE's head also has a network for text embeddings, RepRTA, which its own export folds into the
    last convolution. Here it runs in the graph, so that prompts may change. Masks are left out.
    """

    def __init__(self, head: nn.Module):
        super().__init__()
        self.cv2, self.cv3, self.cv4, self.dfl = head.cv2, head.cv3, head.cv4, head.dfl
        self.reprta = getattr(head, "reprta", nn.Identity())
        self.f, self.i = head.f, head.i
        self.strides_px = [float(stride) for stride in head.stride]

    def forward(self, features: list[Tensor], txt_feats: Tensor) -> tuple[Tensor, Tensor]:
        """Map features (1, C, rows, columns) per level to boxes (1, A, 4) and scores (1, A, n)."""
        text = nn.functional.normalize(self.reprta(txt_feats), dim=-1).transpose(1, 2)
        logits = [self._logits(i, x, text) for i, x in enumerate(features)]
        return self._boxes(features), torch.cat(logits, dim=1).sigmoid()

    def _boxes(self, features: list[Tensor]) -> Tensor:
        """Decode the distribution focal loss of all levels to (1, A, 4) xyxy in input pixels."""
        distances = torch.cat([self.cv2[i](x).flatten(2) for i, x in enumerate(features)], dim=2)
        ltrb = self.dfl(distances).transpose(1, 2)
        centres, strides = _anchors(features, self.strides_px)
        corners = torch.cat((centres - ltrb[..., :2], centres + ltrb[..., 2:]), dim=2)
        return corners * strides

    def _logits(self, level: int, x: Tensor, text: Tensor) -> Tensor:
        """Return logits of one level, (1, cells, n): image features times `text` (1, d, n)."""
        contrast = self.cv4[level]
        embedding = contrast.norm(self.cv3[level](x)).flatten(2).transpose(1, 2)
        # Scale the text: n is far smaller than the number of cells.
        return embedding @ (text * contrast.logit_scale.exp()) + contrast.bias


def _anchors(features: list[Tensor], strides_px: list[float]) -> tuple[Tensor, Tensor]:
    """Return cell centres (1, A, 2) xy in cells, and strides (1, A, 1) in pixels, as constants."""
    centres, strides = [], []
    for x, stride_px in zip(features, strides_px, strict=True):
        rows, columns = int(x.shape[2]), int(x.shape[3])
        xy = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5
        centres.append(xy.reshape(1, -1, 2).astype(np.float32))
        strides.append(np.full((1, rows * columns, 1), stride_px, np.float32))
    return tuple(torch.from_numpy(np.concatenate(part, axis=1)) for part in (centres, strides))


def load_detector(weights: Path, sha256: str) -> YoloWorldDetector:
    """Return the checkpoint in evaluation mode; raise ExportError if its sha256 differs.

    The check comes first, because a .pt file is a pickle, and loading a pickle can run code.
    """
    check_sha256(weights, sha256)
    checkpoint = torch.load(weights, map_location="cpu", weights_only=False)
    detector = YoloWorldDetector(checkpoint["model"].float())
    return detector.eval().requires_grad_(False)


def coco_prompts(weights: Path, sha256: str) -> TextEmbeddings:
    """Return the 80 COCO names with the text embeddings inside the checkpoint."""
    check_sha256(weights, sha256)
    model = torch.load(weights, map_location="cpu", weights_only=False)["model"]
    names = tuple(model.names[index] for index in range(len(model.names)))
    return TextEmbeddings(names, model.txt_feats[0].float().numpy())


def export_onnx(detector: nn.Module, height_px: int, width_px: int, out: Path) -> None:
    """Write the detector as ONNX with a static image size and a free number of prompts."""
    images = torch.zeros(1, 3, height_px, width_px)
    txt_feats = nn.functional.normalize(torch.ones(1, 3, TEXT_DIM), dim=-1)
    inputs, free = (images, txt_feats), {"txt_feats": {1: "n"}, "scores": {1: "anchors", 2: "n"}}
    with replace_atomically(out) as temporary:
        export_module(detector, temporary, dict(zip(INPUTS, inputs, strict=True)), OUTPUTS, free)
        onnx.save(_slimmed(onnx.load(temporary), height_px, width_px), temporary)
        check_format(temporary)


def _slimmed(model: onnx.ModelProto, height_px: int, width_px: int) -> onnx.ModelProto:
    """Fold constants and drop dead nodes, then set the output shapes that tracing left open."""
    import onnxslim

    slim = onnxslim.slim(model)
    anchors = sum((height_px // s) * (width_px // s) for s in (8, 16, 32))
    shapes = {"boxes": (1, anchors, 4), "scores": (1, anchors, "n")}
    for output in slim.graph.output:
        del output.type.tensor_type.shape.dim[:]
        for size in shapes[output.name]:
            dim = output.type.tensor_type.shape.dim.add()
            setattr(dim, "dim_param" if isinstance(size, str) else "dim_value", size)
    onnx.checker.check_model(slim)
    return slim

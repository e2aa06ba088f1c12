"""Export of SegFormer from a Hugging Face folder to ONNX: kinds of ground, with a card.

    edge models export NAME --weights FOLDER --precision fp32 fp16 --calibration PICTURES

For each precision this writes `NAME-PRECISION` of task `ground`. Its output is the scores of
`transformers`, at a quarter of the input's height and width.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from edge.host.files import replace_atomically
from edge.perception.masks.ground import pixels_of
from edge.perception.runtime.card_types import GroundCard
from edge.tasks.sentences.phrases import GROUNDS
from exporters import hugging_face
from exporters.clip import image_preprocess
from exporters.files import ExportError, write_card
from exporters.images import digest_of, read_rgb
from exporters.onnx_format import cpu_session, export_module
from exporters.quantize import derive, pictures, precisions_to_make
from exporters.recipes import TRANSFORMER
from exporters.reports import Report
from exporters.sidecar import write_sidecar

LIMITS = {
    "fp32": {"same_class": 0.999},
    "fp16": {"same_class": 0.99},
    "int8-cpu": {"same_class": 0.9},
}
"""Smallest allowed figures of `PixelReport`, by precision."""


@dataclass(frozen=True)
class PixelReport(Report):
    """Agreement of a file with the original.

    Attributes:
        same_class: share of the scores' pixels that have the same best class.
        max_abs_diff: largest difference of a score.
    """

    pictures: int
    same_class: float
    max_abs_diff: float


class Scores(nn.Module):
    """SegFormer with its scores as the only output, (1, k, h/4, w/4)."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, pixels: Tensor) -> Tensor:
        """Return the scores of an image."""
        return self.model(pixel_values=pixels).logits


def export(args: Any) -> dict[str, PixelReport | None]:
    """Make all files and cards that were asked for; return the parity by card, None if unknown."""
    from transformers import SegformerForSemanticSegmentation

    wanted = precisions_to_make(args, LIMITS, "SegFormer")
    network = Scores(hugging_face.load(SegformerForSemanticSegmentation, args.weights)).eval()
    calibration, validation = pictures(args.calibration, args.validation)
    reports = {}
    for precision in wanted:
        card = make_card(args, precision, network.model.config.id2label)
        out = args.cache / card.file
        print(f"{card.name}: exporting {out}", file=sys.stderr)
        with replace_atomically(out) as temporary:
            if precision == "fp32":
                example = torch.zeros(1, 3, card.input.height, card.input.width)
                export_module(network, temporary, {"pixels": example}, ("scores",), {})
            else:
                feeds = [{"pixels": pixels_of(read_rgb(path), card)} for path in calibration]
                fp32 = args.cache / f"{card.derived_from}.onnx"
                derive(fp32, temporary, feeds, TRANSFORMER, precision)
            report = compare(network, temporary, validation, card) if validation else None
            if report is not None:
                report.accept(card.name, "torch", None if args.no_gate else LIMITS[precision])
        digest = None if precision == "fp32" else digest_of(calibration)
        write_sidecar(out, card.name, None, hugging_face.weights_sha256(args.weights), digest)
        write_card(card.model_dump(mode="json", exclude={"path"}), args.cache)
        reports[card.name] = report
    return reports


def make_card(args: Any, precision: str, labels: dict[int, str]) -> GroundCard:
    """Return the card of one precision.

    Raises:
        ExportError: no class is a kind of ground, or the images cannot be prepared.
    """
    classes = [labels[k] for k in range(len(labels))]
    ground = {
        name: kind for name in classes for kind, listed in GROUNDS.items()
        if name.lower() in listed.split("|")
    }  # fmt: skip
    if not ground:
        choices = "|".join(GROUNDS.values()).replace("|", ", ")
        raise ExportError(
            f"{args.weights / hugging_face.CONFIG}: id2label: no class is a kind of ground "
            f"(choices: {choices})"
        )
    name = f"{args.card}-{precision}"
    return GroundCard.model_validate({
        "name": name, "task": "ground", "family": args.family or args.card, "sources": [],
        "file": f"{name}.onnx", "sha256": None, "parity": None, "precision": precision,
        "license": args.license or hugging_face.license_of(args.weights),
        "derived_from": None if precision == "fp32" else f"{args.card}-fp32",
        **image_preprocess(args.weights), "classes": classes, "ground": ground,
    })  # fmt: skip


def compare(network: nn.Module, file: Path, images: list[Path], card: GroundCard) -> PixelReport:
    """Compare the scores of a file with those of the original on some images."""
    session, same, largest = cpu_session(file), [], 0.0
    for path in images:
        pixels = pixels_of(read_rgb(path), card)
        (found,) = session.run(None, {"pixels": pixels})
        with torch.inference_mode():
            exact = network(torch.from_numpy(pixels)).numpy()
        same.append(float((found.argmax(axis=1) == exact.argmax(axis=1)).mean()))
        largest = max(largest, float(np.abs(found - exact).max()))
    return PixelReport(len(images), float(np.mean(same)), largest)

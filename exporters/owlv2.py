"""Export of OWLv2 from a Hugging Face folder to ONNX: a detector and its text encoder, with cards.

    edge models export NAME --weights FOLDER --precision fp32 fp16 --calibration PICTURES

For each precision this writes `NAME-PRECISION`, a detector with text embeddings as an input, and
`NAME-text-PRECISION`, the encoder of its prompts. Scores are those of `transformers`; the
objectness of a box, which needs no prompt, is left out.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from edge import names
from edge.host.files import replace_atomically, write_atomically
from edge.perception.runtime.card_types import TextCard
from exporters import hugging_face
from exporters.clip import (
    TEXT_PRECISION,
    ClipTextTower,
    embed_torch,
    image_preprocess,
    make_encoder,
    tokens_of,
)
from exporters.encoder_parity import EmbeddingReport
from exporters.files import ExportError, sha256_of, write_card
from exporters.images import PROMPTS, Border, TextEmbeddings, digest_of
from exporters.onnx_format import export_module
from exporters.parity import (
    FP16_LIMITS,
    FP32_LIMITS,
    INT8_LIMITS,
    ParityReport,
    measure,
    torch_model,
)
from exporters.quantize import calibration_feeds, derive, pictures, precisions_to_make
from exporters.recipes import OWL
from exporters.sidecar import write_sidecar
from exporters.yolo_world import INPUTS, OUTPUTS

LIMITS = {"fp32": FP32_LIMITS, "fp16": FP16_LIMITS, "int8-cpu": INT8_LIMITS}
"""Limits of the parity, by the precision of the detector."""
CORNER = Border(128, "corner")
"""Border of an image, as `Owlv2ImageProcessor` makes it."""
SENTENCE = "a photo of a {}"
"""Sentence around a prompt, as in the publisher's examples."""


class Owlv2Detector(nn.Module):
    """OWLv2 with text embeddings as an input, and boxes and scores as outputs (`yolo_world`).

    `mean` and `std` are those of each channel of the images that the `Owlv2ForObjectDetection`
    takes, in 0 to 1.
    """

    def __init__(self, model: nn.Module, mean: list[float], std: list[float]) -> None:
        super().__init__()
        self.model = model
        for name, channels in (("mean", mean), ("std", std)):
            value = torch.tensor(channels).reshape(1, 3, 1, 1)
            self.register_buffer(name, value, persistent=False)
        self.side_px = model.config.vision_config.image_size

    def forward(self, images: Tensor, txt_feats: Tensor) -> tuple[Tensor, Tensor]:
        """Run the detector: one box for each patch of the image."""
        grid, _ = self.model.image_embedder(pixel_values=(images - self.mean) / self.std)
        features = grid.flatten(1, 2)
        logits, _ = self.model.class_predictor(features, txt_feats)
        boxes = self.model.box_predictor(features, grid) * float(self.side_px)
        centre, half = boxes[..., :2], boxes[..., 2:] / 2
        return torch.cat((centre - half, centre + half), dim=2), logits.sigmoid()


def load_detector(folder: Path) -> tuple[Owlv2Detector, ClipTextTower]:
    """Return the detector and its text encoder.

    Raises:
        ExportError: the folder cannot be loaded, or needs other images than the service makes.
    """
    from transformers import Owlv2ForObjectDetection

    model = hugging_face.load(Owlv2ForObjectDetection, folder)
    images = image_preprocess(folder)
    side, how = model.config.vision_config.image_size, images["preprocess"]
    if images["input"] != {"height": side, "width": side} or abs(how["scale"] * 255 - 1) > 1e-3:
        raise ExportError(
            f"{folder}: preprocessor_config.json: size and rescale_factor must be {side} px and "
            "1/255; fetch the folder again"
        )
    tower = ClipTextTower(model.owlv2)
    return Owlv2Detector(model, how["mean"], how["std"]).eval(), tower.eval()


def export(args: Any) -> dict[str, ParityReport | EmbeddingReport | None]:
    """Make all files and cards that were asked for; return the parity by card, None if unknown."""
    wanted = precisions_to_make(args, LIMITS, "OWLv2")
    detector, tower = load_detector(args.weights)
    tokenizer = args.cache / f"{args.card}-tokenizer.json"
    text = hugging_face.tokenizer_text(args.weights, lowercase=True)
    write_atomically(tokenizer, text.encode())
    digest = hugging_face.weights_sha256(args.weights)
    write_sidecar(tokenizer, args.card, None, digest)
    reports: dict[str, ParityReport | EmbeddingReport | None] = {}
    for precision in wanted:
        detect_card, text_card = cards = make_cards(args, precision, detector, tower)
        words, tokens = _prompts(TextCard.model_validate(text_card), args)
        prompts = TextEmbeddings(words, embed_torch(tower, [tokens]))
        texts = [row[None] for row in tokens]
        reports[text_card["name"]] = make_encoder(text_card, tower, texts, texts, digest, args)
        reports[detect_card["name"]] = _make_detector(detect_card, detector, prompts, digest, args)
        for card in cards:
            write_card(card, args.cache)
    return reports


def make_cards(
    args: Any, precision: str, detector: Owlv2Detector, tower: ClipTextTower
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the cards of the detector and of its text encoder, in one precision."""
    text_precision, side = TEXT_PRECISION[precision], detector.side_px
    name, text = f"{args.card}-{precision}", f"{args.card}-text-{text_precision}"
    dim = tower.projection.out_features
    common = {
        "family": args.family or args.card, "sources": [], "sha256": None, "parity": None,
        "license": args.license or hugging_face.license_of(args.weights),
    }  # fmt: skip
    is_fp32 = precision == "fp32"
    tokenizer = f"{args.card}-tokenizer.json"
    return {
        "name": name, "task": "detect", **common, "file": f"{name}.onnx", "precision": precision,
        "derived_from": None if is_fp32 else f"{args.card}-fp32",
        "input": {"height": side, "width": side},
        "preprocess": {
            "color": "rgb", "scale": 1 / 255, "letterbox_pad": CORNER.grey,
            "letterbox_at": CORNER.at,
        },
        "text_dim": dim, "text_encoder": text,
    }, {
        "name": text, "task": "text", **common, "file": f"{text}.onnx",
        "precision": text_precision, "derived_from": None if is_fp32 else f"{args.card}-text-fp32",
        "dim": dim,
        "tokenizer": {
            "kind": "clip", "file": tokenizer, "sha256": sha256_of(args.cache / tokenizer),
            "context": tower.text_model.config.max_position_embeddings, "sentence": SENTENCE,
        },
    }  # fmt: skip


def _prompts(card: TextCard, args: Any) -> tuple[tuple[str, ...], np.ndarray]:
    """Return common targets, and their sentences as tokens (n, context)."""
    words = tuple(names.normalise(word) for word in PROMPTS.split(","))
    tokens = tokens_of(card, args.cache, [card.tokenizer.sentence.format(w) for w in words])
    return words, tokens


def _make_detector(
    card: dict[str, Any],
    detector: Owlv2Detector,
    prompts: TextEmbeddings,
    weights_sha256: str,
    args: Any,
) -> ParityReport | None:
    """Make the file and the sidecar of a detector; None if there are no images to compare on."""
    calibration, validation = pictures(args.calibration, args.validation)
    out, precision, source = args.cache / card["file"], card["precision"], card["derived_from"]
    hw = (detector.side_px, detector.side_px)
    print(f"{card['name']}: exporting {out}", file=sys.stderr)
    report = None
    with replace_atomically(out) as temporary:
        if source is None:
            export_onnx(detector, prompts.emb.shape[1], temporary)
        else:
            feeds = calibration_feeds(calibration, prompts, hw, border=CORNER)
            derive(args.cache / f"{source}.onnx", temporary, feeds, OWL, precision)
        if validation:
            report = measure(torch_model(detector), temporary, validation, prompts, CORNER)
            report.accept(card["name"], "torch", None if args.no_gate else LIMITS[precision])
    parity = report.for_card("torch") if report else None
    digest = None if source is None else digest_of(calibration)
    write_sidecar(out, card["name"], parity, weights_sha256, digest)
    return report


def export_onnx(detector: Owlv2Detector, text_dim: int, out: Path) -> None:
    """Write the detector as ONNX with a static image size and a free number of prompts."""
    side = detector.side_px
    images, txt_feats = torch.zeros(1, 3, side, side), torch.ones(1, 3, text_dim)
    inputs = dict(zip(INPUTS, (images, txt_feats), strict=True))
    export_module(detector, out, inputs, OUTPUTS, {"txt_feats": {1: "n"}, "scores": {2: "n"}})

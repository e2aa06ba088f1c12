"""Export of one model card: checkpoint → FP32 → FP16 or INT8, with a parity check after each step.

    python -m exporters yolo-world-s-256x320-int8-cpu --weights FILE.pt --calibration DIR \\
        --vocabulary FILE.npz --cache DIR

For a folder as Hugging Face publishes it, makes the files and their cards:

    python -m exporters NAME --weights FOLDER --precision fp32 int8-cpu --calibration DIR

For a vision-language model in FP32 that is already here, makes variants and their cards:

    python -m exporters NAME-fp32 --precision q4 --calibration DIR
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from edge.cli.options import Parser
from edge.host import resources
from edge.host.files import replace_atomically
from edge.models.make import TRAINED
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import VOCABULARY_FILE
from edge.perception.runtime.card_types import Card, ChoiceCard, DetectCard, TextCard
from edge.perception.runtime.cards import read_card
from exporters.encoder_parity import EmbeddingReport
from exporters.files import ExportError, exit_on_user_error
from exporters.images import PROMPTS, TextEmbeddings, digest_of, load_text_embeddings
from exporters.parity import (
    FP16_LIMITS,
    FP32_LIMITS,
    INT8_LIMITS,
    ParityReport,
    measure,
    torch_model,
)
from exporters.quantize import (
    calibration_feeds,
    derive,
    input_hw,
    pictures,
    require_calibration,
)
from exporters.recipes import recipe_of
from exporters.sidecar import write_sidecar

FAMILIES = ("yolo-world-s", "yoloe-11s")
"""Families of detectors that are made from a checkpoint."""
MOBILECLIP = "mobileclip-b"
"""Family of text encoders that are made from TorchScript."""
NAME = r"[a-z0-9][a-z0-9.-]*"
"""Pattern of a new card's name."""
FOLDERS = {
    "clip": "exporters.clip", "siglip": "exporters.clip",
    "owlv2": "exporters.owlv2",
    "segformer": "exporters.segformer",
    "idefics3": "exporters.vlm", "smolvlm": "exporters.vlm", "qwen2_vl": "exporters.vlm",
    "qwen3_vl": "exporters.vlm",
}  # fmt: skip
"""Module that exports a Hugging Face folder, by the folder's `model_type`."""


def named_card(name: str, folder: Path) -> Card:
    """Return the card of this name in a folder; raise UserError if it is missing or invalid."""
    path = folder / f"{name}.yaml"
    if not path.is_file():
        choices = ", ".join(sorted(p.stem for p in folder.glob("*.yaml"))) or "none"
        raise ExportError(f"{folder}: no model card {name!r} (choices: {choices})")
    return read_card(path)


def load_card(name: str, folder: Path) -> DetectCard:
    """Return a detector's card; raise UserError if it is invalid, or is not made from weights."""
    path, card = folder / f"{name}.yaml", named_card(name, folder)
    if card.family in TRAINED:
        raise ExportError(
            f"{name}: cannot be exported from weights; train the model with "
            f"`{TRAINED[card.family]}`"
        )
    if not isinstance(card, DetectCard) or card.family not in FAMILIES:
        raise ExportError(
            f"{path}: family: unknown {card.family!r} (choices: {', '.join(FAMILIES)})"
        )
    return card


def export_card(card: DetectCard, args: argparse.Namespace) -> ParityReport | None:
    """Make a card's ONNX file and its sidecar in the cache; None if parity was not measured.

    If the card is derived from FP32, that file is made first, unless it is there.
    """
    if args.weights is None and card.derived_from is None:
        raise ExportError(f"{card.name}: --weights is missing; give the checkpoint (a .pt file)")
    text = _prompts(card, args)
    fp32 = None
    if card.derived_from is not None:
        fp32 = load_card(card.derived_from, args.cards)
        require_calibration(args.calibration, card.name)
        if args.weights is not None:
            _make_file(fp32, None, args, text)
        elif not (args.cache / fp32.file).is_file():
            raise ExportError(
                f"{args.cache / fp32.file}: no such file; give --weights FILE.pt, from which "
                f"{fp32.name} is made first"
            )
    report = _make_file(card, fp32, args, text)
    if args.vocabulary is None and card.text_encoder is None:
        keep_vocabulary(text, args.cache / VOCABULARY_FILE)
    return report


def _export_text(card: TextCard, args: argparse.Namespace) -> EmbeddingReport | None:
    """Make the file of a text encoder in TorchScript."""
    from exporters.mobileclip import export_text

    if args.weights is None:
        raise ExportError(f"{card.name}: --weights is missing; give mobileclip_blt.ts")
    return export_text(card, trusted_sha256(card, args), args)


def _prompts(card: DetectCard, args: argparse.Namespace) -> TextEmbeddings:
    """Return the prompts to calibrate and compare with.

    They are household words, by the detector's own text encoder or of a vocabulary file, or the
    COCO names inside the checkpoint.
    """
    if card.text_encoder is not None:
        words = tuple(PROMPTS.split(","))
        return TextEmbeddings(words, make_text_encoder(card, None).embed(words)[0])
    if args.vocabulary is not None:
        return load_text_embeddings(args.vocabulary)
    if args.weights is None:
        raise ExportError(
            f"{card.name}: --vocabulary is missing; give a file of text embeddings (.npz)"
        )
    from exporters.yolo_world import coco_prompts

    return coco_prompts(args.weights, trusted_sha256(card, args))


def trusted_sha256(card: DetectCard | TextCard, args: argparse.Namespace) -> str:
    """Return the hash that the weights must have: by the card, else by the user (`--sha256`)."""
    if sources := card.weights_sources():
        return sources[0].sha256
    if args.sha256 is None:
        raise ExportError(
            f"{card.name}: its card knows no hash of the weights; give --sha256 HASH, from a place "
            "that you trust, because a checkpoint can run code"
        )
    return args.sha256.lower()


def keep_vocabulary(text: TextEmbeddings, out: Path) -> None:
    """Write a vocabulary file for the service to look prompts up in, if there is none yet."""
    if out.exists():
        return
    with replace_atomically(out) as temporary, temporary.open("wb") as file:
        np.savez(file, names=np.array(text.names), emb=text.emb)
    print(f"{out}: the {len(text.names)} words inside the checkpoint", file=sys.stderr)


def _make_file(
    card: DetectCard, fp32: DetectCard | None, args: argparse.Namespace, text: TextEmbeddings
) -> ParityReport | None:
    """Make a detector's file, from the checkpoint or from the file of the card `fp32`.

    It is compared with what it was made from, on images not used for calibration, if there are any.
    """
    out = args.cache / card.file
    calibration, validation = pictures(args.calibration, args.validation)
    print(f"{card.name}: exporting {out}", file=sys.stderr)
    report, calibration_sha256 = None, None
    with replace_atomically(out) as temporary:  # a file that fails its limits is discarded
        if fp32 is None:
            from exporters.yolo_world import export_onnx, load_detector

            detector = load_detector(args.weights, trusted_sha256(card, args))
            export_onnx(detector, card.input.height, card.input.width, temporary)
            original, name, limits = torch_model(detector), "torch", FP32_LIMITS
        else:
            original, name = args.cache / fp32.file, fp32.name
            print(f"{card.name}: {len(calibration)} images to calibrate on", file=sys.stderr)
            feeds = calibration_feeds(calibration, text, input_hw(onnx.load(original)))
            derive(original, temporary, feeds, recipe_of(card.family), card.precision)
            limits = FP16_LIMITS if card.precision == "fp16" else INT8_LIMITS
            calibration_sha256 = digest_of(calibration)
        if validation:
            report = measure(original, temporary, validation, text)
            report.accept(card.name, name, None if args.no_gate else limits)
    weights = next((source.sha256 for source in card.weights_sources()), None)
    parity = report.for_card(name) if report else None
    write_sidecar(out, card.name, parity, weights, calibration_sha256)
    return report


def export_folder(args: argparse.Namespace) -> None:
    """Make the files and cards of a Hugging Face folder; raises ExportError, see `main`."""
    from exporters.hugging_face import model_type

    if not re.fullmatch(NAME, args.card):
        raise ExportError(
            f"NAME: got {args.card!r:.80}; use only lower-case letters, digits, . and -"
        )
    kind = model_type(args.weights)
    if kind not in FOLDERS:
        choices = ", ".join(FOLDERS)
        raise ExportError(
            f"--weights {args.weights}: config.json: model_type {kind!r:.80} cannot be exported "
            f"(choices: {choices})"
        )
    args.cache.mkdir(parents=True, exist_ok=True)
    module = importlib.import_module(FOLDERS[kind])
    reports = module.export(args)
    print_reports(reports)


def print_reports(reports: dict[str, Any]) -> None:
    """Print reports as one JSON object, by card."""
    print(json.dumps({name: r.figures() if r else None for name, r in reports.items()}))


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    """Parse the command line, and export a folder, a vision-language model or a detector."""
    # fmt: off
    parser = Parser(prog="python -m exporters",
                    description="make the ONNX file of a model card from weights")
    option = parser.add_argument
    option("card", metavar="NAME", help="name of the model card, such as "
           "yolo-world-s-256x320-int8-cpu; with a folder as --weights: name of the new cards")
    option("--weights", type=Path, help="weights to export: a .pt file, or a model folder of "
           "Hugging Face (default: quantize the FP32 file in --cache)")
    option("--sha256", help="hash that a .pt or .ts file must have, if the card names none")
    option("--precision", nargs="+", default=["fp32"], metavar="P", help="for a folder or a "
           "vision-language model: precisions to make (default: fp32)")
    option("--family", help="for a folder: family of the new cards (default: NAME)")
    option("--license", help="for a folder: license of the model (default: that of its README.md)")
    option("--calibration", type=Path,
           help="folder of images to calibrate the quantization with (fp32 needs none)")
    option("--validation", type=Path, help="folder of other images to compare the new model with "
           "its original on (default: every fourth calibration image)")
    option("--vocabulary", type=Path,
           help="file of text embeddings (.npz) (default: the COCO names in --weights)")
    option("--cache", type=Path, default=resources.models_dir(), help="folder for the model files")
    option("--cards", type=Path, default=resources.data_dir("models"),
           help="folder of the model cards")
    option("--no-gate", action="store_true",
           help="keep the model even if its outputs differ too much from the original's")
    # fmt: on
    args = parser.parse_args(argv)
    if args.weights is not None and args.weights.is_dir():
        export_folder(args)
        return
    if isinstance(card_of_name := named_card(args.card, args.cards), ChoiceCard):
        from exporters.vlm_quantize import quantize_card

        print_reports(quantize_card(card_of_name, args))
        return
    if isinstance(card_of_name, TextCard) and card_of_name.family == MOBILECLIP:
        report = _export_text(card_of_name, args)
    else:
        report = export_card(load_card(args.card, args.cards), args)
    if report is not None:
        print(json.dumps(report.figures()))


if __name__ == "__main__":
    sys.exit(main())

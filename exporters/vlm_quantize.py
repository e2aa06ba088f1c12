"""Variants with fewer bits of a vision-language model whose FP32 files are here.

    edge models export NAME-fp32 --quantize --precision q4 int8 --calibration PICTURES

writes the files to `quantized/` in the model's folder, apart from published files, and a card for
each precision. It needs no PyTorch: variants are compared with the FP32 files.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from edge.perception.runtime.card_types import ChoiceCard
from edge.perception.runtime.cards import card_names, load_card, verify_parts
from edge.perception.scoring.vlm.files import open_tokenizer, read_files
from edge.perception.scoring.vlm.pictures import PreparedImage, make_prepare
from edge.perception.scoring.vlm.prompt import find_image_token
from exporters.calibration import Feed
from exporters.files import ExportError, write_card
from exporters.images import digest_of, read_rgb
from exporters.quantize import pictures, quantize, require_calibration
from exporters.recipes import TRANSFORMER
from exporters.vlm_files import (
    FILES,
    ONE_FILE_BYTES,
    VISION,
    bytes_of,
    compare_and_place,
    files_of_card,
    new_files,
    save_network,
)
from exporters.vlm_parity import (
    EncodedImage,
    LetterComparison,
    LetterReport,
    OnnxPipeline,
    Question,
    questions,
)
from exporters.weight_only import quantize_weights

FP32 = "fp32"  # precision of the source
OUT = "quantized"  # folder of the variants
PRECISIONS = {"int8": ("int8", "int8", "int8"), "q4": ("int8", "int8", "q4")}
"""Precisions of vision encoder, token embedding and decoder, by the card's precision.

`int8` is static for the vision encoder and weight-only for the others; `q4` is weight-only.
"""


def quantize_card(card: ChoiceCard, args: Any) -> dict[str, LetterReport]:
    """Make all variants that were asked for; return the parity by card.

    Raises:
        ExportError: the card is no FP32 model with a vision encoder, another card has the name, or
            a parity misses its limits.
        ModelError: a file is missing or damaged.
    """
    # Precision → name of its card: "my-model-fp32" gives "my-model-q4".
    wanted = {p: f"{card.name.removesuffix(f'-{FP32}')}-{p}" for p in args.precision}
    if unknown := [p for p in wanted if p not in PRECISIONS]:
        choices = ", ".join(PRECISIONS)
        raise ExportError(f"--precision: no precision {unknown[0]!r:.60} (choices: {choices})")
    if card.precision != FP32 or card.vision_encoder is None:
        what = f"is {card.precision}" if card.precision != FP32 else "has no vision encoder"
        raise ExportError(f"model {card.name}: {what}; give an FP32 model with a vision encoder")
    for name in wanted.values():
        if name in card_names() and load_card(name).derived_from != card.name:
            raise ExportError(
                f"model {name}: a card has this name already, and is not made from {card.name}; "
                f"get that model with `edge models pull {name}`, or copy the card {card.name} to "
                "another name"
            )
    require_calibration(args.calibration, card.name)
    calibration, validation = pictures(args.calibration, args.validation)
    verify_parts(card)
    original = OnnxReference(card)
    asked = questions(card.path, original.image_token)
    shown = [original.show(read_rgb(path)) for path in validation]
    comparison = LetterComparison(original, shown, asked)
    fp32 = dict(zip(FILES, map(card.path_of, card.networks), strict=True))
    feeds = [original.prepare(read_rgb(path)) for path in calibration]
    others = [part.file for part in card.others if not part.file.startswith("onnx/")]
    made: dict[str, list[Path]] = {}  # by the file's name: several precisions share some
    reports = {}
    with new_files(card.path / OUT) as new:
        for precision, name in wanted.items():
            parts = {
                f"{n}_{p}.onnx": (n, p) for n, p in zip(FILES, PRECISIONS[precision], strict=True)
            }
            for file, (network, bits) in parts.items():
                if file not in made:
                    images = feeds if network == VISION else []
                    made[file] = make_variant(fp32[network], new / file, bits, images)
            reports[name], files = compare_and_place(
                [made[file] for file in parts], card.path / OUT, precision, name, comparison,
                card.name, not args.no_gate, (None, digest_of(calibration)),
            )  # fmt: skip
            made |= zip(parts, files, strict=True)
            card_data = {
                **card.model_dump(mode="json", include={"task", "family", "license", "folder",
                                                        "image_tokens", "max_tokens"}),
                "name": name, "precision": precision, "derived_from": card.name,
                **files_of_card(files, card.path, others),
                "measured": {f"against {card.name}": reports[name].figures()},
            }  # fmt: skip
            write_card(card_data, args.cache)
    return reports


def make_variant(fp32: Path, out: Path, precision: str, images: list[Feed]) -> list[Path]:
    """Write the file of a network in a precision; return it and its weight files.

    `images` are inputs to calibrate a vision encoder on; [] for the other networks.
    """
    print(f"{out.name}: making it", file=sys.stderr)
    model = onnx.load(fp32)
    # A larger model cannot be run to find its ranges: it would have to be one file.
    if images and precision == "int8" and bytes_of(model) < ONE_FILE_BYTES:
        quantize(fp32, out, images, TRANSFORMER, "int8-cpu")
        return [out]
    return save_network(quantize_weights(model, precision), out)


class OnnxReference:
    """The FP32 files of a card, as the reference of `exporters.vlm_parity.LetterComparison`."""

    def __init__(self, card: ChoiceCard) -> None:
        files = read_files(card)
        self._pipeline = OnnxPipeline([card.path_of(part) for part in card.networks])
        self.image_token, text = find_image_token(files, open_tokenizer(files))
        self._prepare = make_prepare(files, text, card.image_tokens)

    def prepare(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        """Return inputs of the vision encoder's ONNX for an image, (h, w, 3) uint8."""
        return self._inputs(self._prepare(rgb))

    def _inputs(self, prepared: PreparedImage) -> dict[str, np.ndarray]:
        """Return those arrays of a prepared image that the vision encoder takes."""
        return {name: prepared.feeds[name] for name in self._pipeline.vision_inputs}

    def show(self, rgb: np.ndarray) -> EncodedImage:
        """Preprocess and encode an image, (h, w, 3) uint8."""
        prepared = self._prepare(rgb)
        feeds = self._inputs(prepared)
        return EncodedImage(feeds, self._pipeline.features(feeds), prepared.grid)

    def logits(self, question: Question, shown: EncodedImage) -> np.ndarray:
        """Return (v,) float32 of the token after the question."""
        return self._pipeline.logits(question, shown.features, shown.grid)

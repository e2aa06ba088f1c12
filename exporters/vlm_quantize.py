"""Variants of a vision-language model that is here in FP32, as it was pulled or exported.

    edge models quantize NAME-fp32 --precision q4 int8 --calibration PICTURES

writes the files to `quantized/` in the model's folder, where no published one lies, and a card for
each precision. It needs no PyTorch: a variant is compared with the FP32 files.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from edge.perception.card_types import ChoiceCard
from edge.perception.cards import card_names, load_card, verify_parts
from edge.perception.vlm.files import TOKENIZER, read_files
from edge.perception.vlm.pictures import make_prepare
from exporters import hugging_face
from exporters.files import ExportError
from exporters.images import digest_of, read_rgb
from exporters.quantize import need_pictures, pictures
from exporters.vlm_files import (
    FILES,
    PRECISIONS,
    Maker,
    files_of_card,
    make_variant,
    write_card,
)
from exporters.vlm_parity import (
    Chain,
    Exam,
    LetterReport,
    Question,
    Shown,
    places_of,
    questions,
)

FP32, OUT = "fp32", "quantized"


def quantize_card(card: ChoiceCard, args: Any) -> dict[str, LetterReport]:
    """Make every variant that was asked for; the parity by card.

    Args:
        args: precision, calibration, validation, cache, no_gate: see `exporters.__main__`.

    Raises:
        ExportError: the card is of no FP32 model with eyes, a card is in the way, or a parity
            misses its limits.
        ModelError: a file is missing or damaged.
    """
    wanted = {p: f"{card.name.removesuffix(f'-{FP32}')}-{p}" for p in args.precision}
    if unknown := [p for p in wanted if p not in PRECISIONS or p == FP32]:
        choices = ", ".join(p for p in PRECISIONS if p != FP32)
        raise ExportError(f"--precision: {unknown[0]!r:.60} (choices: {choices})")
    if card.precision != FP32 or card.vision_encoder is None:
        what = f"is {card.precision}" if card.precision != FP32 else "has no eyes"
        raise ExportError(f"{card.name}: {what}; variants are made of an FP32 model with eyes")
    for name in wanted.values():
        if name in card_names() and load_card(name).derived_from != card.name:
            raise ExportError(
                f"{name}: there is a card of this name, not made of {card.name}: `edge models pull "
                f"{name}` fetches it; for one of your own, copy {card.name}'s under another name"
            )
    need_pictures(args.calibration, card.name)
    calibration, validation = pictures(args.calibration, args.validation)
    verify_parts(card)
    original = FilesOriginal(card)
    asked = questions(card.path, original.image_token)
    exam = Exam(original, [original.show(read_rgb(path)) for path in validation], asked)
    fp32 = dict(zip(FILES, map(card.path_of, card.networks), strict=True))
    (card.path / OUT).mkdir(exist_ok=True)
    maker = Maker(fp32, original, asked[0], calibration, card.path / OUT)
    others = [part.file for part in card.others if not part.file.startswith("onnx/")]
    reports = {}
    for precision, name in wanted.items():
        files, reports[name] = make_variant(
            maker, precision, name, exam, card.name, not args.no_gate,
            (None, digest_of(calibration)),
        )  # fmt: skip
        made = {
            **card.model_dump(mode="json", include={"task", "family", "license", "folder",
                                                    "image_tokens", "max_tokens"}),
            "name": name, "precision": precision, "derived_from": card.name,
            **files_of_card(files, card.path, others),
            "measured": {f"against {card.name}": reports[name].figures()},
        }  # fmt: skip
        write_card(made, args.cache)
    return reports


class FilesOriginal:
    """The FP32 files of a card; see `exporters.vlm_parity.Original`.

    Attributes:
        image_token: stands in a picture's places.
        merge: how many patches a token is high and wide.
    """

    def __init__(self, card: ChoiceCard) -> None:
        files = read_files(card)
        self._chain = Chain([card.path_of(part) for part in card.networks])
        found = files.config.get("image_token_id", files.config.get("image_token_index"))
        text = hugging_face.open_tokenizer(card.path / TOKENIZER).id_to_token(found or 0)
        if not isinstance(found, int) or text is None:
            raise ExportError(f"{card.path}: config.json: image_token_id: {found!r} is no token")
        self.image_token = found
        self.merge = int(files.image.get("merge_size", 1))
        self._prepare = make_prepare(files, text, card.image_tokens)

    def prepare(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        """(h, w, 3) uint8 → inputs of the vision encoder's ONNX."""
        feeds = self._prepare(rgb).feeds
        return {name: feeds[name] for name in self._chain.vision_inputs}

    def show(self, rgb: np.ndarray) -> Shown:
        """A picture, (h, w, 3) uint8, made ready and looked at."""
        feeds = self.prepare(rgb)
        return Shown(feeds, self._chain.features(feeds))

    def logits(self, question: Question, shown: Shown) -> np.ndarray:
        """(v,) float32 of the token behind the question."""
        return self._chain.logits(question, shown.features, shown.grid, self.merge)

    def decoder_feeds(self, question: Question, shown: Shown) -> dict[str, np.ndarray]:
        """Inputs of the decoder's ONNX for the whole question, with nothing before it."""
        ids = question.ids(len(shown.features))
        places = places_of(ids, question.image, shown.grid, self.merge)
        rows = self._chain.rows(ids, question.image, shown.features)
        return self._chain.decoder_feeds(rows, places)

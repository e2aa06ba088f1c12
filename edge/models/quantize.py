"""`edge models quantize`: make a variant from the FP32 file that is here; needs no torch."""

from __future__ import annotations

import argparse

from edge.models.export import exporter, how_to_make, need_modules, with_file
from edge.perception.cards import ModelError, load_card, verify_model
from edge.perception.text import find_vocabulary

_NEEDS = ("onnx", "onnxruntime")


def run(args: argparse.Namespace) -> int:
    """Handle `edge models quantize`; the exit code is the exporter's.

    Raises:
        ModelError: the card is not derived from another, whose file is here and sound, or what
            this needs is not installed.
        PromptError: no vocabulary of text embeddings.
    """
    card = with_file(args.name)
    if card.derived_from is None:
        raise ModelError(
            f"models quantize: {card.name} is not derived from another model; {how_to_make(card)}"
        )
    verify_model(load_card(card.derived_from))
    need_modules("quantize", _NEEDS)
    vocabulary = args.vocabulary or find_vocabulary(None)
    options = {"--calibration": args.calibration, "--vocabulary": vocabulary}
    return exporter("exporters", card.name, options, args.no_gate)

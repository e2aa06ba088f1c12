"""Export of MobileCLIP's text encoder, which encodes YOLOE's prompts, from TorchScript to ONNX.

The tokenizer's file, that of OpenAI's CLIP, must be in the models' folder already.
"""

from __future__ import annotations

from typing import Any

import torch

from edge.perception.runtime.card_types import TextCard
from edge.text import one_line
from exporters.clip import make_encoder, tokens_of
from exporters.encoder_parity import EmbeddingReport
from exporters.files import ExportError, check_sha256
from exporters.images import PROMPTS
from exporters.sidecar import write_sidecar


def export_text(card: TextCard, sha256: str, args: Any) -> EmbeddingReport | None:
    """Make the file of a text card from `args.weights`, a TorchScript file with this hash.

    Raises:
        ExportError: the file is another one or no such encoder, the tokenizer is missing, or the
            parity misses its limits.
    """
    tokens = tokens_of(card, args.cache, PROMPTS.split(","))
    check_sha256(args.weights, sha256)
    write_sidecar(args.cache / card.tokenizer.file, card.name, None, None)
    try:
        script = torch.jit.load(str(args.weights), map_location="cpu").float().eval()
    except RuntimeError as error:
        raise ExportError(
            f"{args.weights}: not a TorchScript file: {one_line(error)}; give mobileclip_blt.ts, "
            "as Ultralytics publishes it"
        ) from None
    for parameter in script.parameters():
        parameter.requires_grad_(False)
    texts = [row[None] for row in tokens]
    return make_encoder(card.model_dump(), script, texts, texts, sha256, args)

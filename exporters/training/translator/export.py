"""Export of the small translator as one ONNX file of INT8 weights.

The file's metadata has the vocabulary.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from edge.host.files import replace_atomically
from edge.mission.language.networks.network import MOST_WORDS, VOCABULARY
from exporters.files import ExportError
from exporters.onnx_format import check_format, cpu_session, trace_module
from exporters.training.translator.data import Vocabulary
from exporters.training.translator.net import Decoder, Encoder, Translator
from exporters.weight_only import quantize_weights

MAX_LOGIT_ERROR = 0.5
"""Largest allowed difference of the INT8 file's logits from the network's."""


class EncoderDecoder(nn.Module):
    """Encoder and decoder in one module, which share the embedding table.

    The output `across` of the encoder goes into the input `across_in` of later calls; see
    `net.Encoder` and `net.Decoder`.
    """

    def __init__(self, net: Translator) -> None:
        super().__init__()
        self.encoder, self.decoder = Encoder(net), Decoder(net)

    def forward(
        self, source: Tensor, target: Tensor, past: Tensor, across_in: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        return self.encoder(source), *self.decoder(target, past, across_in)


def inputs_of(net: Translator, words: int, tokens: int, past: int) -> dict[str, Tensor]:
    """Return random inputs of `EncoderDecoder`, by name."""
    size, rows = net.size, 2  # rows: targets that are decoded at once
    parts, width = 2 * size.decoder_layers, size.width // size.heads
    n_tokens = net.table.num_embeddings
    return {
        "source": torch.randint(1, n_tokens, (1, words)),
        "target": torch.randint(1, n_tokens, (rows, tokens)),
        "past": torch.randn(parts, rows, size.heads, past, width),
        "across_in": torch.randn(parts, 1, size.heads, words, width),
    }


def export(net: Translator, vocabulary: Vocabulary, out: Path) -> float:
    """Write the network as ONNX; return the largest difference of a logit from the network's.

    Raises:
        ExportError: the difference is above `MAX_LOGIT_ERROR`.
    """
    module = EncoderDecoder(net.eval())
    free = {  # axes of any length
        "source": {1: "n"}, "target": {0: "b", 1: "m"}, "past": {1: "b", 3: "p"},
        "across_in": {3: "k"}, "across": {3: "n"}, "logits": {0: "b", 1: "m"},
        "present": {1: "b", 3: "q"},
    }  # fmt: skip
    with replace_atomically(out) as part:
        traced = part.with_suffix(".fp32")
        outputs = ("across", "logits", "present")
        trace_module(module, traced, inputs_of(net, 9, 4, 3), outputs, free)
        model = quantize_weights(onnx.load(traced), "int8")
        traced.unlink()
        entry = model.metadata_props.add()
        entry.key, entry.value = VOCABULARY, json.dumps(vocabulary.tokens)
        model.ir_version = min(model.ir_version, 10)
        onnx.save(model, part)
        check_format(part)
        logit_error = parity(net, part)
        if logit_error > MAX_LOGIT_ERROR:
            raise ExportError(
                f"{out}: not written: logits of the ONNX file differ by {logit_error:.3f} from the "
                f"network's, allowed {MAX_LOGIT_ERROR:g}"
            )
    return logit_error


@torch.no_grad()
def parity(net: Translator, path: Path) -> float:
    """Return the largest difference between the file's logits and the network's."""
    session, module = cpu_session(path, 1), EncoderDecoder(net.eval())
    worst = 0.0
    for words, tokens, past in ((3, 1, 0), (24, 1, 12), (MOST_WORDS - 1, 5, 40)):
        feeds = inputs_of(net, words, tokens, past)
        wanted = module(*feeds.values())
        found = session.run(None, {name: value.numpy() for name, value in feeds.items()})
        worst = max(
            worst, *(float(np.abs(f - w.numpy()).max()) for f, w in zip(found, wanted, strict=True))
        )
    return worst

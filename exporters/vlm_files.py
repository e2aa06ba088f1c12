"""The three files of a vision-language model in fewer bits, and its card.

Made of the FP32 files, wherever those are from: this needs no PyTorch.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml

from edge.host.files import replace_atomically, write_atomically
from exporters.fp16 import kept_nodes, to_fp16
from exporters.images import read_rgb
from exporters.onnx_format import check_format
from exporters.quantize import quantize
from exporters.recipes import TRANSFORMER, Recipe, nodes_like
from exporters.reports import check_limits
from exporters.sidecar import write_sidecar
from exporters.vlm_parity import Chain, Exam, LetterReport, Original, Question
from exporters.weight_only import quantize_weights

VISION, EMBEDDING, DECODER = FILES = ("vision_encoder", "embed_tokens", "decoder_model_merged")
PRECISIONS = {
    "fp32": ("fp32", "fp32", "fp32"),
    "fp16": ("fp16", "fp16", "fp16"),
    "int8": ("int8", "int8", "int8"),
    "q4": ("int8", "int8", "q4"),
    "q4f16": ("fp16", "fp16", "q4f16"),
}
"""By a card's precision: those of its files. `int8` is static of the vision encoder, and of weights
alone of the others; `q4` of weights."""
LIMITS = {
    "fp32": {"cosine": 0.9999, "rank_agreement": 0.99},
    "fp16": {"cosine": 0.999, "rank_agreement": 0.97},
    "int8": {"cosine": 0.9, "rank_agreement": 0.9},
    "q4": {"cosine": 0.9, "rank_agreement": 0.8},
    "q4f16": {"cosine": 0.999, "rank_agreement": 0.8},
}
CACHED = ("past_key_values.", "present.")
RECIPES = {
    VISION: Recipe(not_fp16=(r"^/places/",)),
    EMBEDDING: Recipe(),
    DECODER: Recipe(not_fp16=(r"^/rotary_emb/", r"layernorm/", r"^/norm/")),
}
"""What stays in float32: the angle of place 1000 has no fraction left in float16, and the square of
a decoder's hidden value soon is no number."""
ONE_FILE_BYTES = 2_000_000_000
"""What is more is kept in a file beside: protocol buffers end at 2 GiB."""
HALF_PICTURES = 8
"""On so many it is seen which of the decoder's values are too large for float16."""


class Maker:
    """Makes files of those in FP32, each once: several precisions of a model share some."""

    def __init__(
        self,
        traces: dict[str, Path],
        original: Original,
        asked: Question,
        calibration: list[Path],
        folder: Path,
    ) -> None:
        """
        Args:
            traces: FP32 of the three, by name.
            asked: what the decoder is watched at, to see which values are too large for float16.
            folder: for what is made.
        """
        self._traces, self._folder = traces, folder
        self._made: dict[tuple[str, str], list[Path]] = {}
        few = [original.show(read_rgb(path)) for path in calibration[:HALF_PICTURES]]
        self._feeds = {
            VISION: [original.prepare(read_rgb(path)) for path in calibration],
            EMBEDDING: [{"input_ids": asked.ids(1)}],
            DECODER: [original.decoder_feeds(asked, shown) for shown in few],
        }

    def make(self, name: str, precision: str) -> list[Path]:
        """The file of a network in a precision, and those that it keeps weights in."""
        if (name, precision) not in self._made:
            suffix = "" if precision == "fp32" else f"_{precision}"
            out = self._folder / f"{name}{suffix}.onnx"
            print(f"{out.name}: making it", file=sys.stderr)
            self._made[name, precision] = self._make(name, precision, out)
        return self._made[name, precision]

    def _make(self, name: str, precision: str, out: Path) -> list[Path]:
        trace, feeds = self._traces[name], self._feeds[name]
        model = onnx.load(trace)
        whole = bytes_of(model) < ONE_FILE_BYTES
        if name == VISION and precision == "int8" and whole:
            with replace_atomically(out) as temporary:
                quantize(trace, temporary, feeds, TRANSFORMER, "int8-cpu")
                check_format(temporary)
            return [out]
        if precision in ("fp16", "q4f16"):
            model = to_fp16(model, _kept(model, feeds if whole else [], name), half_ends=CACHED)
            if precision == "q4f16":
                model = quantize_weights(model, "q4")
        elif precision != "fp32":
            model = quantize_weights(model, precision)
        return save_network(model, out)


def _kept(model: onnx.ModelProto, feeds: list[dict[str, np.ndarray]], name: str) -> set[str]:
    """Nodes that stay in float32; by their values only where there are feeds to see them on."""
    recipe = RECIPES[name]
    return kept_nodes(model, feeds, recipe) if feeds else set(nodes_like(model, recipe.not_fp16))


def bytes_of(model: onnx.ModelProto) -> int:
    """What its weights take."""
    return sum(len(tensor.raw_data) for tensor in model.graph.initializer)


def save_network(model: onnx.ModelProto, out: Path) -> list[Path]:
    """Write a model, its weights in `FILE.onnx_data` beside it where one file does not hold them.

    Returns:
        The files: the model first.
    """
    if bytes_of(model) < ONE_FILE_BYTES:
        with replace_atomically(out) as temporary:
            onnx.save(model, temporary)
            check_format(temporary)
        return [out]
    data = out.with_name(f"{out.name}_data")
    data.unlink(missing_ok=True)  # onnx would append to it
    onnx.save(
        model, out, save_as_external_data=True, all_tensors_to_one_file=True, location=data.name
    )
    return [out, data]


def make_variant(
    maker: Maker,
    precision: str,
    name: str,
    exam: Exam,
    against: str,
    gate: bool,
    digests: tuple[str | None, str | None],
) -> tuple[list[list[Path]], LetterReport]:
    """The files of a card in a precision, each with what lies beside it, and their parity.

    Args:
        against: what the exam's answers are of.
        digests: of the weights and of the pictures calibrated on, as far as there are any.

    Raises:
        ExportError: the parity misses its limits, and `gate`.
    """
    files = [maker.make(*part) for part in zip(FILES, PRECISIONS[precision], strict=True)]
    report = exam.sit(Chain([network for network, *_ in files]))
    print(f"{name} against {against}:\n{report.table()}", file=sys.stderr)
    if gate:
        check_limits(report, LIMITS[precision], name)
    for path in itertools.chain(*files):
        write_sidecar(path, name, report.figures(), *digests)
    return files, report


def files_of_card(paths: list[list[Path]], folder: Path, others: list[str]) -> dict[str, Any]:
    """The part of a card of task `choice` that names its files.

    Args:
        paths: what `make_variant` returns.
        folder: of the model.
        others: what says how to feed the networks.
    """
    told = [[path.relative_to(folder).as_posix() for path in files] for files in paths]
    keys = ("vision_encoder", "embed_tokens", "decoder")
    parts = {key: {"file": files[0]} for key, files in zip(keys, told, strict=True)}
    beside = [file for files in told for file in files[1:]]
    return {**parts, "others": [{"file": file} for file in (*others, *beside)]}


def write_card(card: dict[str, Any], folder: Path) -> None:
    """Write it as `NAME.yaml`."""
    text = yaml.safe_dump(card, sort_keys=False, width=110)
    write_atomically(folder / f"{card['name']}.yaml", text.encode())

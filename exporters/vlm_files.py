"""The three files of a vision-language model: how they are saved, judged and named by a card."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import onnx
import yaml

from edge.host.files import replace_atomically, write_atomically
from exporters.onnx_format import check_format
from exporters.reports import check_limits
from exporters.sidecar import write_sidecar
from exporters.vlm_parity import Chain, Exam, LetterReport

VISION, EMBEDDING, DECODER = FILES = ("vision_encoder", "embed_tokens", "decoder_model_merged")
CACHED = ("past_key_values.", "present.")
LIMITS = {
    "fp32": {"cosine": 0.9999, "rank_agreement": 0.99},
    "fp16": {"cosine": 0.999, "rank_agreement": 0.97},
    "int8": {"cosine": 0.9, "rank_agreement": 0.9},
    "q4": {"cosine": 0.9, "rank_agreement": 0.8},
    "q4f16": {"cosine": 0.999, "rank_agreement": 0.8},
}
ONE_FILE_BYTES = 2_000_000_000
"""What is more is kept in a file beside: protocol buffers end at 2 GiB."""


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


def judge(
    files: list[list[Path]],
    precision: str,
    name: str,
    exam: Exam,
    against: str,
    gate: bool,
    digests: tuple[str | None, str | None],
) -> LetterReport:
    """Compare three files with what they are made of, and write a sidecar for each.

    Args:
        files: of each network its file, and those that it keeps weights in.
        against: what the exam's answers are of.
        digests: of the weights and of the pictures calibrated on, as far as there are any.

    Raises:
        ExportError: the parity misses its limits, and `gate`.
    """
    report = exam.sit(Chain([network for network, *_ in files]))
    print(f"{name} against {against}:\n{report.table()}", file=sys.stderr)
    if gate:
        check_limits(report, LIMITS[precision], name)
    for path in itertools.chain(*files):
        write_sidecar(path, name, report.figures(), *digests)
    return report


def files_of_card(paths: list[list[Path]], folder: Path, others: list[str]) -> dict[str, Any]:
    """The part of a card of task `choice` that names its files.

    Args:
        paths: of each network its file, and those that it keeps weights in.
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

"""The three ONNX files of a vision-language model: how they are saved, checked and named in a card.

`exporters.vlm` makes them in FP32, `exporters.vlm_quantize` in other precisions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import onnx

from exporters.onnx_format import check_format
from exporters.sidecar import write_sidecar
from exporters.vlm_parity import LetterComparison, LetterReport, OnnxPipeline

VISION, EMBEDDING, DECODER = FILES = ("vision_encoder", "embed_tokens", "decoder_model_merged")
LIMITS = {
    "fp32": {"cosine": 0.9999, "rank_agreement": 0.99},
    "int8": {"cosine": 0.9, "rank_agreement": 0.9},
    "q4": {"cosine": 0.9, "rank_agreement": 0.8},
}
"""Smallest allowed figures of `LetterReport`, by precision."""
ONE_FILE_BYTES = 2_000_000_000
"""Larger weights go into a separate file: protocol buffers end at 2 GiB."""


def bytes_of(model: onnx.ModelProto) -> int:
    """Return the size of a model's weights in bytes."""
    return sum(len(tensor.raw_data) for tensor in model.graph.initializer)


def save_network(model: onnx.ModelProto, out: Path) -> list[Path]:
    """Write a model; its weights go into `FILE.onnx_data` if one file cannot hold them.

    Returns:
        The files: the model first.
    """
    if bytes_of(model) < ONE_FILE_BYTES:
        onnx.save(model, out)
        check_format(out)
        return [out]
    data = out.with_name(f"{out.name}_data")
    onnx.save(
        model, out, save_as_external_data=True, all_tensors_to_one_file=True, location=data.name
    )
    return [out, data]


@contextmanager
def new_files(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder for new files of `folder`, on the same disk."""
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".new-", dir=folder) as temporary:
        yield Path(temporary)


def compare_and_place(
    files: list[list[Path]],
    folder: Path,
    precision: str,
    name: str,
    comparison: LetterComparison,
    against: str,
    gate: bool,
    digests: tuple[str | None, str | None],
) -> tuple[LetterReport, list[list[Path]]]:
    """Compare new files with the model that they were made from; put them and sidecars in `folder`.

    Each network has its file, then its weight files. The model answers questions with letters; the
    files' answers are compared with its own. `precision` selects the limits, and `against` names
    the reference. The digests are those of the weights and of the calibration images, if known.

    Returns:
        The report, and the files in their places.

    Raises:
        ExportError: the parity misses its limits, and `gate` is True.
    """
    report = comparison.compare(OnnxPipeline([network for network, *_ in files]))
    report.accept(name, against, LIMITS[precision] if gate else None)
    placed = [[path.replace(folder / path.name) for path in one] for one in files]
    for path in itertools.chain(*placed):
        write_sidecar(path, name, report.figures(), *digests)
    return report, placed


def files_of_card(paths: list[list[Path]], folder: Path, others: list[str]) -> dict[str, Any]:
    """Return the part of a card of task `choice` that names its files."""
    relative = [[path.relative_to(folder).as_posix() for path in files] for files in paths]
    keys = ("vision_encoder", "embed_tokens", "decoder")
    parts = {key: {"file": files[0]} for key, files in zip(keys, relative, strict=True)}
    weight_files = [file for files in relative for file in files[1:]]
    return {**parts, "others": [{"file": file} for file in (*others, *weight_files)]}

"""`edge models export`: make a model file, in a process of its own."""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
from pathlib import Path

from edge.host import resources
from edge.host.children import python_module
from edge.host.files import read_regular, write_atomically
from edge.models.local import pulled_weights
from edge.perception.embedding.text import MAX_VOCABULARY_BYTES, VOCABULARY_FILE, find_vocabulary
from edge.perception.runtime.card_types import ChoiceCard, DetectCard, SegmentCard, SimilarityCard
from edge.perception.runtime.cards import (
    FileCard,
    ModelError,
    card_path,
    how_to_get,
    load_card,
    verify_model,
    verify_parts,
)

TRAINED = {
    "mini-house": "python -m exporters.training.mini --out RUN",
}
"""Families that are not made from weights, and the commands that train them."""
_QUANTIZE_NEEDS = ("onnx", "onnxruntime")
_CHOICE_NEEDS, _CHOICE_PRECISION = ("PIL", "tokenizers"), "q4"
_EXPORT_NEEDS = ("torch", "torchvision", "ultralytics", "onnxslim", *_QUANTIZE_NEEDS)
_FOLDER_NEEDS = ("torch", "transformers", "tokenizers", "onnxscript", *_QUANTIZE_NEEDS)
_WITHOUT_DEPENDENCIES = ("torchvision", "ultralytics")
"""Packages that no extra brings, since theirs collide with ours; see `pyproject.toml`."""


def export(args: argparse.Namespace) -> int:
    """Handle `edge models export`; the exit code is the exporter's.

    Of a card, or of a model's folder as Hugging Face publishes it, whose cards are made too. A
    vocabulary that was given is kept beside the models, where `edge run` looks for it.

    Raises:
        ModelError: nothing to export from, what an export needs is not installed, or the
            vocabulary cannot be kept.
    """
    if args.weights is not None and args.weights.is_dir():
        need_modules("transformers", _FOLDER_NEEDS)
        return _run_exporters(args.name, args, weights=args.weights)
    card = with_file(args.name)
    if card.family in TRAINED:
        raise ModelError(f"models export: {card.name} is trained: {how_to_make(card)}")
    weights = args.weights or pulled_weights(card)
    if weights is None:
        pull = f"run `edge models pull {card.name}`, or " if card.weights_sources() else ""
        raise ModelError(
            f"models export: no weights of {card.name} here; {pull}name them with --weights FILE.pt"
        )
    need_modules("export", _EXPORT_NEEDS)
    code = _run_exporters(
        card.name, args, weights=weights, vocabulary=args.vocabulary, cards=_folder_of(card)
    )
    if code == 0 and args.vocabulary is not None:
        keep_vocabulary(args.vocabulary)
    return code


def quantize(args: argparse.Namespace) -> int:
    """Handle `edge models export --quantize`, without torch; the exit code is the exporter's.

    Of a card that is derived from another; or of a vision-language model's FP32, whose variants
    get cards.

    Raises:
        ModelError: the card is not derived from another, what it is made of is not here and sound,
            or what this needs is not installed.
        PromptError: no vocabulary of text embeddings.
    """
    if isinstance(named := load_card(args.name), ChoiceCard):
        verify_parts(named)
        need_modules("quantize", _QUANTIZE_NEEDS)
        need_modules("choice", _CHOICE_NEEDS)
        args.precision = args.precision or [_CHOICE_PRECISION]
        return _run_exporters(named.name, args, cards=_folder_of(named))
    if args.precision:
        raise ModelError(f"models export: {args.name}: its card names its precision already")
    card = with_file(args.name)
    if card.derived_from is None:
        raise ModelError(
            f"models export --quantize: {card.name} is not derived from another model; "
            f"{how_to_make(card)}"
        )
    if not isinstance(card, DetectCard):
        raise ModelError(
            f"models export --quantize: {card.name} is no detector; make it from its model's "
            f"folder: `edge models export NAME --weights FOLDER --precision {card.precision}`"
        )
    verify_model(load_card(card.derived_from))
    need_modules("quantize", _QUANTIZE_NEEDS)
    vocabulary = args.vocabulary or find_vocabulary(None)
    return _run_exporters(card.name, args, vocabulary=vocabulary, cards=_folder_of(card))


def with_file(name: str) -> FileCard:
    """The card of a model that has a file; raises ModelError for one that has none."""
    card = load_card(name)
    if isinstance(card, SimilarityCard):
        parts = [n for n in (card.image_encoder, card.text_encoder, card.detector) if n]
        raise ModelError(f"model {name!r}: has no file of its own, it uses {' and '.join(parts)}")
    if isinstance(card, ChoiceCard):
        raise ModelError(
            f"model {name!r}: has several files; its card is for those in {card.folder}"
        )
    if isinstance(card, SegmentCard):
        parts = [part.file for part in card.files]
        raise ModelError(f"model {name!r}: has two files, {' and '.join(parts)}, made elsewhere")
    if card.server is not None:
        raise ModelError(f"model {name!r}: has no file here, {how_to_get(card)}")
    return card


def how_to_make(card: FileCard) -> str:
    """What makes a model's file, as a part of a sentence: a command, where there is one."""
    if card.task == "segment":
        return "the exporter of its own project makes it"
    return f"`{TRAINED.get(card.family, f'edge models export {card.name}')}` makes it"


def need_modules(action: str, modules: tuple[str, ...]) -> None:
    """Raise ModelError unless the exporters and these modules can be imported.

    Args:
        action: the extra of the same name brings them, but for a runtime, of which there are two.
    """
    missing = [m for m in ("exporters", *modules) if importlib.util.find_spec(m) is None]
    if missing:
        extras = f"cpu,{action}" if "onnxruntime" in missing else action
        alone = [m for m in missing if m in _WITHOUT_DEPENDENCIES]
        then = f", then pip install --no-deps {' '.join(alone)}" if alone else ""
        raise ModelError(
            f"models export: {', '.join(missing)} not installed here: pip install "
            f"'edge-vln[{extras}]'{then}"
        )


def _folder_of(card: FileCard | ChoiceCard) -> Path:
    return card_path(card.name).parent


def _run_exporters(name: str, args: argparse.Namespace, **files: Path | None) -> int:
    """Run `python -m exporters`, which writes to the models' cache; its exit code.

    Args:
        files: weights, vocabulary, and the folder of the cards, as far as there are any.
    """
    options = {
        "weights": files.get("weights"),
        "calibration": args.calibration,
        "vocabulary": files.get("vocabulary"),
        "cache": resources.models_dir(),
        "cards": files.get("cards"),
        "family": args.family,
        "license": args.license,
    }
    given = [(f"--{key}", str(value)) for key, value in options.items() if value is not None]
    precision = ["--precision", *args.precision] if args.precision else []
    gate = ["--no-gate"] if args.no_gate else []
    command = [*python_module("exporters"), name, *sum(given, ()), *precision, *gate]
    return subprocess.run(command, check=False).returncode


def keep_vocabulary(source: Path) -> Path:
    """Copy a vocabulary file into the models' cache, whole or not at all; where it lies then.

    Raises:
        ModelError: it cannot be read or written.
    """
    path = resources.models_dir() / VOCABULARY_FILE
    try:
        content = read_regular(source, MAX_VOCABULARY_BYTES)
        write_atomically(path, content)
    except OSError as error:
        raise ModelError(
            f"{source}: cannot be kept as {path} ({error.strerror}); set $EDGE_VOCABULARY to it"
        ) from None
    return path

"""`edge models export`: exports or quantizes a model file, in a separate process."""

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
from edge.perception.runtime.card_types import (
    RUNNING,
    ChoiceCard,
    DetectCard,
    SegmentCard,
    SimilarityCard,
)
from edge.perception.runtime.cards import (
    FileCard,
    ModelError,
    card_names,
    card_path,
    install_hint,
    load_card,
    verify_model,
    verify_parts,
)

TRAINED = {"mini-house": "python -m exporters.training.mini --out RUN"}
"""Family of models that are not exported from weights → command that trains them."""
FROM_FOLDER = {
    "owlv2-base": "google/owlv2-base-patch16-ensemble",
    "segformer-b0": "nvidia/segformer-b0-finetuned-cityscapes-1024-1024",
}
"""Family that is exported from a folder → the folder's name on Hugging Face.

All cards of the family are made at once, so the export takes the family's name."""
# Modules that the exporters need, by kind of export.
_QUANTIZE_NEEDS = ("onnx", "onnxruntime")
_CHOICE_NEEDS = ("PIL", "tokenizers")
_EXPORT_NEEDS = ("torch", "torchvision", "ultralytics", "onnxslim", *_QUANTIZE_NEEDS)
_FOLDER_NEEDS = ("torch", "transformers", "tokenizers", "onnxscript", *_QUANTIZE_NEEDS)
_CHOICE_PRECISION = "q4"  # default precision of a vision-language model
_WITHOUT_DEPENDENCIES = ("torchvision", "ultralytics")
"""Packages to install without dependencies, which conflict with ours; see `pyproject.toml`."""


def export(args: argparse.Namespace) -> int:
    """Handle `edge models export` without `--quantize`; return the exit code of the exporter.

    The source is the weights of a card's model, or a model folder of Hugging Face, for which cards
    are made, too. A given vocabulary is copied to the folder of the models, where `edge run` finds
    it.

    Raises:
        ModelError: there are no weights, a package is not installed, or the vocabulary cannot be
            copied.
    """
    if args.weights is not None and args.weights.is_dir():
        require_modules("transformers", _FOLDER_NEEDS)
        return _run_exporters(args.name, args, weights=args.weights)
    if args.weights is not None and not args.weights.exists() and args.name not in card_names():
        raise ModelError(f"models export: --weights {args.weights}: no such folder")
    card = load_single_file_card(args.name)
    if card.family in TRAINED:
        raise ModelError(
            f"models export: {card.name} is trained, not exported: {how_to_make(card)}"
        )
    if card.family in FROM_FOLDER:
        raise ModelError(f"models export: {card.name}: {how_to_make(card)}")
    weights = args.weights or pulled_weights(card)
    if weights is None:
        pull = f"run `edge models pull {card.name}`, or " if card.weights_sources() else ""
        raise ModelError(
            f"models export: no weights of {card.name} here; {pull}name their file with --weights "
            "FILE.pt"
        )
    require_modules("export", _EXPORT_NEEDS)
    code = _run_exporters(
        card.name, args, weights=weights, vocabulary=args.vocabulary, cards=_folder_of(card)
    )
    if code == 0 and args.vocabulary is not None:
        store_vocabulary(args.vocabulary)
    return code


def quantize(args: argparse.Namespace) -> int:
    """Handle `edge models export --quantize`, and return the exit code of the exporter.

    The source is the card of a derived model, or of the FP32 files of a vision-language model,
    whose variants get cards. torch is not needed.

    Raises:
        ModelError: the model is not derived from another one, the source file is missing or
            damaged, or a package is not installed.
        PromptError: there is no vocabulary of text embeddings.
    """
    if isinstance(named := load_card(args.name), ChoiceCard):
        verify_parts(named)
        require_modules("quantize", _QUANTIZE_NEEDS)
        require_modules("choice", _CHOICE_NEEDS)
        args.precision = args.precision or [_CHOICE_PRECISION]
        return _run_exporters(named.name, args, cards=_folder_of(named))
    if args.precision:
        raise ModelError(
            f"models export: {args.name}: its card sets the precision; leave out --precision"
        )
    card = load_single_file_card(args.name)
    if card.derived_from is None:
        raise ModelError(
            f"models export --quantize: {card.name} is not derived from another model; "
            f"{how_to_make(card)}"
        )
    if not isinstance(card, DetectCard):
        raise ModelError(
            f"models export --quantize: {card.name} is not a detector; export it from its model "
            f"folder: `edge models export NAME --weights FOLDER --precision {card.precision}`"
        )
    verify_model(load_card(card.derived_from))
    require_modules("quantize", _QUANTIZE_NEEDS)
    vocabulary = args.vocabulary
    if vocabulary is None and card.text_encoder is None:
        vocabulary = find_vocabulary(None)
    return _run_exporters(card.name, args, vocabulary=vocabulary, cards=_folder_of(card))


def load_single_file_card(name: str) -> FileCard:
    """Return the card of a model with one local file; raise ModelError for other models."""
    card = load_card(name)
    if isinstance(card, SimilarityCard):
        running = "the one of perception.detector.model" if card.detector == RUNNING else None
        named = (card.image_encoder, card.text_encoder, running or card.detector)
        parts = [name for name in named if name]
        raise ModelError(
            f"model {name!r}: has no file of its own; name one that it uses: {' or '.join(parts)}"
        )
    if isinstance(card, ChoiceCard):
        raise ModelError(
            f"model {name!r}: has several files, in {card.folder}; name a model of one file"
        )
    if isinstance(card, SegmentCard):
        parts = [part.file for part in card.files]
        raise ModelError(
            f"model {name!r}: has two files, {' and '.join(parts)}; name a model of one file"
        )
    if card.server is not None:
        raise ModelError(f"model {name!r}: has no file here: {install_hint(card)}")
    return card


def how_to_make(card: FileCard) -> str:
    """Return how to make a model's file, as a clause for messages."""
    if published := FROM_FOLDER.get(card.family):
        return (
            f"`edge models export {card.family} --weights FOLDER` makes it, from a folder of "
            f"{published}"
        )
    if card.task in ("segment", "ground"):
        return "the exporter of its project makes it"
    return f"`{TRAINED.get(card.family, f'edge models export {card.name}')}` makes it"


def require_modules(action: str, modules: tuple[str, ...]) -> None:
    """Raise ModelError if the exporters or these modules cannot be imported."""
    missing = [m for m in ("exporters", *modules) if importlib.util.find_spec(m) is None]
    if missing:
        extras = f"cpu,{action}" if "onnxruntime" in missing else action
        separate = [m for m in missing if m in _WITHOUT_DEPENDENCIES]
        then = f", then pip install --no-deps {' '.join(separate)}" if separate else ""
        raise ModelError(
            f"models export: {', '.join(missing)} not installed here: pip install "
            f"'edge-vln[{extras}]'{then}"
        )


def _folder_of(card: FileCard | ChoiceCard) -> Path:
    """Return the folder of a card's own file."""
    return card_path(card.name).parent


def _run_exporters(name: str, args: argparse.Namespace, **files: Path | None) -> int:
    """Run `python -m exporters`, which writes to the folder of the models; return its exit code."""
    options = {
        "weights": files.get("weights"),
        "calibration": args.calibration,
        "vocabulary": files.get("vocabulary"),
        "cache": resources.models_dir(),
        "cards": files.get("cards"),
        "family": args.family,
        "license": args.license,
        "sha256": args.sha256,
    }
    # Pairs of option and value, joined to one list of arguments below.
    given = [(f"--{key}", str(value)) for key, value in options.items() if value is not None]
    precision = ["--precision", *args.precision] if args.precision else []
    gate = ["--no-gate"] if args.no_gate else []
    command = [*python_module("exporters"), name, *sum(given, ()), *precision, *gate]
    return subprocess.run(command, check=False).returncode


def store_vocabulary(source: Path) -> Path:
    """Copy a vocabulary file atomically to the folder of the models, and return its path.

    Raises:
        ModelError: the file cannot be read or written.
    """
    path = resources.models_dir() / VOCABULARY_FILE
    try:
        content = read_regular(source, MAX_VOCABULARY_BYTES)
        write_atomically(path, content)
    except OSError as error:
        raise ModelError(
            f"{source}: cannot be copied to {path} ({error.strerror}); set $EDGE_VOCABULARY to "
            f"{source}"
        ) from None
    return path

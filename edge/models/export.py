"""`edge models export`: make a model file from weights, in a process of its own."""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
from pathlib import Path

from edge.host import resources
from edge.host.children import python_module
from edge.host.files import read_regular, write_atomically
from edge.models.places import pulled_weights
from edge.perception.cards import FileCard, ModelError, card_path, load_card
from edge.perception.text import MAX_VOCABULARY_BYTES, VOCABULARY_FILE

_TRAINED = {
    "mini-house": "python -m exporters.train_mini --out RUN && python -m exporters.mini.export RUN",
}
"""Families that are not made from weights, and the commands that train them."""
_NEEDS = ("torch", "torchvision", "ultralytics", "onnx", "onnxruntime", "onnxslim")
_WITHOUT_DEPENDENCIES = ("torchvision", "ultralytics")
"""Packages that no extra brings, since theirs collide with ours; see `pyproject.toml`."""


def run(args: argparse.Namespace) -> int:
    """Handle `edge models export`; the exit code is the exporter's.

    A vocabulary that was given is kept beside the models, where `edge run` looks for it.

    Raises:
        ModelError: nothing to export from, what an export needs is not installed, or the
            vocabulary cannot be kept.
    """
    card = with_file(args.name)
    if card.family in _TRAINED:
        raise ModelError(f"models export: {card.name} is trained: {how_to_make(card)}")
    weights = args.weights or pulled_weights(card)
    if weights is None:
        pull = f"run `edge models pull {card.name}`, or " if card.weights_sources() else ""
        raise ModelError(
            f"models export: no weights of {card.name} here; {pull}name them with --weights FILE.pt"
        )
    need_modules("export", _NEEDS)
    options = {"--calibration": args.calibration, "--vocabulary": args.vocabulary}
    code = exporter("exporters", card.name, {"--weights": weights, **options}, args.no_gate)
    if code == 0 and args.vocabulary is not None:
        keep_vocabulary(args.vocabulary)
    return code


def with_file(name: str) -> FileCard:
    """The card of a model that has a file; raises ModelError for one that has none."""
    card = load_card(name)
    if card.task == "similarity":
        parts = [n for n in (card.image_encoder, card.text_encoder, card.detector) if n]
        raise ModelError(f"model {name!r}: has no file of its own, it uses {' and '.join(parts)}")
    return card


def how_to_make(card: FileCard) -> str:
    """The command that makes a model's file, as a part of a sentence."""
    return f"`{_TRAINED.get(card.family, f'edge models export {card.name}')}` makes it"


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
            f"models {action}: {', '.join(missing)} not installed here: pip install "
            f"'edge-vln[{extras}]'{then}"
        )


def exporter(module: str, name: str, options: dict[str, Path | None], no_gate: bool) -> int:
    """Run `python -m MODULE NAME --option …`, which writes to the models' cache; its exit code.

    Args:
        no_gate: keep a model though its parity misses the limits.
    """
    options = {**options, "--cache": resources.models_dir(), "--cards": card_path(name).parent}
    given = [part for key, path in options.items() if path is not None for part in (key, str(path))]
    command = [*python_module(module), name, *given, *(["--no-gate"] if no_gate else [])]
    return subprocess.run(command, check=False).returncode


def keep_vocabulary(source: Path) -> Path:
    """Copy a vocabulary file into the models' cache, whole or not at all; where it lies then.

    Raises:
        ModelError: it cannot be read or written.
    """
    path = resources.models_dir() / VOCABULARY_FILE
    try:
        content = read_regular(source, MAX_VOCABULARY_BYTES)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    except OSError as error:
        raise ModelError(
            f"{source}: cannot be kept as {path} ({error.strerror}); set $EDGE_VOCABULARY to it"
        ) from None
    return path

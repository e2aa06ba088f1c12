"""`edge models export`: make a model file from weights, in a process of its own."""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
from pathlib import Path

from edge import resources
from edge.children import python_module
from edge.perception.cards import FileCard, ModelError, load_card
from edge.perception.text import VOCABULARY_FILE
from edge.store.places import pulled_weights

_NEEDS = ("torch", "ultralytics", "onnx", "onnxruntime", "onnxslim")


def run(args: argparse.Namespace) -> int:
    """Handle `edge models export`; the exit code is the exporter's.

    A vocabulary that was given is kept beside the models, where `edge run` looks for it.

    Raises:
        ModelError: nothing to export from, or what an export needs is not installed.
    """
    card = with_file(args.name)
    weights = args.weights or pulled_weights(card)
    if weights is None:
        pull = f"run `edge models pull {card.name}`, or " if card.weights_sources() else ""
        raise ModelError(
            f"models export: no weights of {card.name} here; {pull}name them with --weights FILE.pt"
        )
    need_modules("export", _NEEDS)
    options = {"--calibration": args.calibration, "--vocabulary": args.vocabulary}
    code = exporter("exporters", card.name, {"--weights": weights, **options})
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


def need_modules(action: str, modules: tuple[str, ...]) -> None:
    """Raise ModelError unless the exporters and these modules can be imported.

    Args:
        action: the extra of the same name brings them, but for a runtime, of which there are two.
    """
    missing = [m for m in ("exporters", *modules) if importlib.util.find_spec(m) is None]
    if missing:
        extras = f"cpu,{action}" if "onnxruntime" in missing else action
        raise ModelError(
            f"models {action}: {', '.join(missing)} not installed here: pip install "
            f"'edge-vln[{extras}]'"
        )


def exporter(module: str, name: str, options: dict[str, Path | None]) -> int:
    """Run `python -m MODULE NAME --option …`, which writes to the models' cache; its exit code."""
    given = [part for key, path in options.items() if path is not None for part in (key, str(path))]
    cache = str(resources.models_dir())
    command = [*python_module(module), name, *given, "--cache", cache]
    return subprocess.run(command, check=False).returncode


def keep_vocabulary(source: Path) -> Path:
    """Copy a vocabulary file into the models' cache, whole or not at all; where it lies then."""
    path = resources.models_dir() / VOCABULARY_FILE
    if not (path.exists() and path.samefile(source)):
        path.parent.mkdir(parents=True, exist_ok=True)
        half = path.with_name(f"{path.name}.{os.getpid()}.part")
        shutil.copyfile(source, half)
        half.replace(path)
    return path

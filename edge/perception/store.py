"""`edge models`: what models there are, whether they are sound, and how they are made."""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from edge import resources
from edge.perception.cards import (
    Card,
    ModelError,
    all_cards,
    load_card,
    made_parity,
    verify_model,
)
from edge.perception.onnx_detector import OUTPUTS, check_interface, open_session
from edge.perception.text import VOCABULARY_FILE

_HEADINGS = ("name", "input", "precision", "licence", "file", "parity against the step before")
_EXPORT_NEEDS = ("torch", "ultralytics", "onnx")


def run(args: argparse.Namespace) -> int:
    """Handle `edge models …`; the exit code."""
    try:
        if args.action == "list":
            print(list_models())
            return 0
        if args.action == "check":
            return check_models(args.name)
        return export_model(args.name, args.weights, args.calibration, args.vocabulary)
    except ModelError as error:
        print(error, file=sys.stderr)
        return 1


def list_models() -> str:
    """A table of all cards, ready to print."""
    rows = [_HEADINGS, *(_row(card) for card in all_cards())]
    if len(rows) == 1:
        return "no model cards"
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEADINGS))]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def _row(card: Card) -> tuple[str, ...]:
    p = card.parity or made_parity(card)
    parity = "-"
    if p is not None:
        parity = (
            f"{p.reference}: recall {p.recall:.3f}, precision {p.precision:.3f}, "
            f"score error {p.score_error:.2f} ({p.images} images)"
        )
    size = f"{card.path.stat().st_size / 1e6:.0f} MB" if card.path.is_file() else "missing"
    shape = f"{card.input.height}x{card.input.width}"
    return (card.name, shape, card.precision, card.license, size, parity)


def check_models(name: str | None) -> int:
    """Check one model, or all whose file is there; prints a line each."""
    if name is not None:
        print(check_model(load_card(name)))
        return 0
    present = [card for card in all_cards() if card.path.is_file()]
    if not present:
        print("no model files here: run `edge models list` for what there is", file=sys.stderr)
        return 1
    failed = 0
    for card in present:
        try:
            print(check_model(card))
        except ModelError as error:
            print(error, file=sys.stderr)
            failed += 1
    return 1 if failed else 0


def check_model(card: Card) -> str:
    """Hash, loading, names and shapes, and one inference on noise.

    Returns:
        One line that says what was found.

    Raises:
        ModelError: with what is wrong and what to do.
    """
    path = verify_model(card)
    session = open_session(path, ["CPUExecutionProvider"], threads=2)
    check_interface(session, card)
    random = np.random.default_rng(0)
    shape = (1, 3, card.input.height, card.input.width)
    text = random.normal(size=(1, 2, card.text_dim)).astype(np.float32)
    text /= np.linalg.norm(text, axis=2, keepdims=True)
    feed = {"images": random.random(shape, dtype=np.float32), "txt_feats": text}
    boxes, scores = session.run(list(OUTPUTS), feed)
    a = boxes.shape[1]
    if boxes.shape != (1, a, 4) or scores.shape != (1, a, 2):
        raise ModelError(
            f"{path}: boxes {boxes.shape}, scores {scores.shape}; must be (1, a, 4) and (1, a, 2): "
            "export it again"
        )
    if not (np.isfinite(boxes).all() and np.isfinite(scores).all()):
        raise ModelError(f"{path}: returns values that are not finite: export it again")
    if scores.min() < 0.0 or scores.max() > 1.0:
        raise ModelError(f"{path}: scores must lie in 0..1 (after the sigmoid): export it again")
    return f"{card.name}: ok (hash, interface, {a} boxes, finite)"


def export_model(
    name: str, weights: Path, calibration: Path | None, vocabulary: Path | None
) -> int:
    """Run `python -m exporters` in a process of its own; its exit code.

    A vocabulary that was given is kept beside the models, where `edge run` looks for it.
    """
    load_card(name)
    missing = [m for m in _EXPORT_NEEDS if importlib.util.find_spec(m) is None]
    if missing:
        raise ModelError(
            f"models export: {', '.join(missing)} not installed here: pip install edge-vln[export]"
        )
    if importlib.util.find_spec("exporters") is None:
        raise ModelError(
            "models export: package `exporters` not found: pip install edge-vln[export]"
        )
    command = [sys.executable, "-m", "exporters", name, "--weights", str(weights)]
    for option, path in (("--calibration", calibration), ("--vocabulary", vocabulary)):
        if path is not None:
            command += [option, str(path)]
    command += ["--cache", str(resources.models_dir())]
    code = subprocess.run(command, check=False).returncode
    if code == 0 and vocabulary is not None:
        keep_vocabulary(vocabulary)
    return code


def keep_vocabulary(source: Path) -> Path:
    """Copy a vocabulary file into the models' cache, whole or not at all; where it lies then."""
    path = resources.models_dir() / VOCABULARY_FILE
    if not (path.exists() and path.samefile(source)):
        path.parent.mkdir(parents=True, exist_ok=True)
        half = path.with_name(f"{path.name}.{os.getpid()}.part")
        shutil.copyfile(source, half)
        half.replace(path)
    return path

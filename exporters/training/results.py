"""Training commands: their common options, figures for cards, and files in `models/`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from edge.cli.options import Parser
from edge.host.files import replace_atomically

MODELS = Path(__file__).parents[2] / "models"
"""Folder of the project's own models."""


def training_parser(name: str, text: str, out: str) -> Parser:
    """Return the parser of a training command, with the options that all have."""
    parser = Parser(prog=f"python -m exporters.training.{name}", description=text)
    option = parser.add_argument
    option("--out", type=Path, required=True, help=f"folder for {out} (required)")
    option("--models", type=Path, default=MODELS, help="folder for the model's files and its cards")
    option("--seed", type=int, default=0, help="seed of the training and of its data")
    return parser


def auc(score: np.ndarray, right: np.ndarray) -> float:
    """Return the area under the ROC curve: P(a right one scores above a wrong one).

    Ties count half. NaN if all are right, or none is. `right` is 1 for right, 0 for wrong.
    """
    _, order, counts = np.unique(score, return_inverse=True, return_counts=True)
    rank = (np.cumsum(counts) - 0.5 * (counts - 1))[order]  # from 1; equal scores share the mean
    n = int((right > 0).sum())
    if n in (0, len(right)):
        return float("nan")
    return float((rank[right > 0].sum() - 0.5 * n * (n + 1)) / (n * (len(right) - n)))


def took_ms(run: Callable[[int], object], runs: int) -> dict[str, float]:
    """Time `run(0)`, `run(1)`, …; return median and 95th percentile."""
    times = []
    for index in range(runs):
        start = time.perf_counter()
        run(index)
        times.append(1e3 * (time.perf_counter() - start))
    return {f"p{q}_ms": round(float(np.percentile(times, q)), 2) for q in (50, 95)}


def publish(files: Mapping[str, Path], cards: list[dict[str, Any]], out: Path, note: str) -> None:
    """Put ONNX files and their cards into `out`, files before cards; on an error, put nothing."""
    contents = {name: path.read_bytes() for name, path in files.items()}
    for card in cards:
        body = yaml.safe_dump(card, sort_keys=False, width=100)
        contents[f"{card['name']}.yaml"] = f"# {note}\n{body}".encode()
    # All are written to temporary files, which get their names when the block ends without an
    # error, in reverse order: so the files come before the cards.
    with ExitStack() as stack:
        for name, content in reversed(contents.items()):
            stack.enter_context(replace_atomically(out / name)).write_bytes(content)

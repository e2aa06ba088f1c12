"""What `edge models bench` does, from its options to the exit code."""

from __future__ import annotations

import argparse

from edge.config import Config, DetectorOnnx, load
from edge.errors import UserError
from edge.models.bench import frames, table
from edge.models.bench.compare import compare
from edge.models.bench.variants import families, providers_here, variants
from edge.models.bench.writing import keep, update_cards
from edge.perception.cards import load_detector_card


def run(args: argparse.Namespace) -> int:
    """Compare, print, keep; 1 when nothing could run.

    Raises:
        UserError: an option, the configuration or the world cannot be used.
    """
    config = load(args.config)
    todo = variants(_family(args.family, config), providers_here(args.providers))
    if args.images is not None:
        pictures = frames.from_folder(args.images, args.frames)
    else:
        sizes = [(v.card.input.height, v.card.input.width) for v in todo if v.card.is_here()]
        pictures = frames.from_world(config, args.frames, sizes)
    report = compare(config, todo, pictures, _settings(config, args.threads))
    print(table.as_text(report))
    print(f"kept in {keep(report, args.json)}")
    if args.update_cards:
        for path in update_cards(report):
            print(f"written to {path}")
    return 0 if any(row["state"] == "ran" for row in report["rows"]) else 1


def _family(asked: str | None, config: Config) -> str:
    """The family that was asked for, else that of the configured model."""
    if asked is not None:
        return asked
    detector = config.perception.detector
    if isinstance(detector, DetectorOnnx):
        return load_detector_card(detector.model).family
    choices = ", ".join(families()) or "none"
    raise UserError(
        f"{config.path}: perception.detector.kind is {detector.kind}: name a family "
        f"(choices: {choices})"
    )


def _settings(config: Config, threads: int | None) -> DetectorOnnx:
    """The configured detector's settings, which all variants share."""
    detector = config.perception.detector
    settings = detector if isinstance(detector, DetectorOnnx) else DetectorOnnx()
    return settings if threads is None else settings.model_copy(update={"threads": threads})

"""The cards that an export makes files for, and their parity written back."""

from __future__ import annotations

from pathlib import Path

import yaml

from edge.perception.card_types import DetectCard
from edge.perception.cards import read_card
from edge.perception.model_file import ModelError
from exporters.files import ExportError, replace_atomically

MADE_BY = {
    "mini-house": "python -m exporters.train_mini --out RUN && python -m exporters.mini.export RUN"
}
"""Commands that make a whole family from nothing, cards and all."""


def load_card(name: str, folder: Path) -> DetectCard:
    """Read a detector's card by name.

    Raises:
        ExportError: there is none (the choices are listed), it is not valid, or it is made
            otherwise.
    """
    path = folder / f"{name}.yaml"
    if not path.is_file():
        choices = ", ".join(sorted(p.stem for p in folder.glob("*.yaml"))) or "none"
        raise ExportError(f"{folder}: no card {name!r} (choices: {choices})")
    try:
        card = read_card(path)
    except ModelError as error:
        raise ExportError(str(error)) from None
    if card.family in MADE_BY:
        raise ExportError(f"{name}: made with `{MADE_BY[card.family]}`, not from weights")
    if not isinstance(card, DetectCard):
        raise ExportError(f"{path}: task: {card.task!r}; only detectors are exported")
    return card


def weights_hashes(card: DetectCard) -> list[str]:
    """Digests of the checkpoints that it may be made from."""
    return [source.sha256 for source in card.weights_sources()]


def update_parity(path: Path, parity: dict) -> None:
    """Replace the card's measured parity, atomically; the other keys keep their order."""
    card = yaml.safe_load(path.read_text(encoding="utf-8"))
    card["parity"] = parity
    with replace_atomically(path) as temporary:
        temporary.write_text(yaml.safe_dump(card, sort_keys=False, width=110), encoding="utf-8")

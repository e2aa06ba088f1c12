"""`edge models list`: prints the model cards as a table or as JSON."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from pathlib import Path

from edge.perception.runtime.card_types import ChoiceCard, EmbeddingParity, FileCard
from edge.perception.runtime.cards import Card, ModelError, all_cards, load_card, made_parity
from edge.text import bounded_repr, format_table, one_line, redact

PERMISSIVE = {
    "0bsd", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "cc0-1.0", "isc", "mit", "mit-0",
    "unlicense", "zlib",
}  # fmt: skip
"""Licences (SPDX, in lower case) that ask for no more than a notice."""
_HEADINGS = ("name", "task", "input", "precision", "licence", "file", "parity")


def run(args: argparse.Namespace) -> int:
    """Handle `edge models list`.

    Raises:
        ModelError: no such card, or no card has the licence.
    """
    cards = all_cards() if args.name is None else [load_card(args.name)]
    if args.licence is not None:
        wanted = PERMISSIVE if args.licence == "permissive" else {args.licence.lower()}
        known = sorted({card.license for card in all_cards()})
        if wanted.isdisjoint(licence.lower() for licence in known):
            raise ModelError(
                f"--licence: no card has {bounded_repr(args.licence)} (choices: "
                f"{', '.join(map(one_line, ('permissive', *known)))})"
            )
        cards = [card for card in cards if card.license.lower() in wanted]
    print(as_json(cards) if args.json else as_table(cards))
    return 0


def as_json(cards: Iterable[Card]) -> str:
    """Return the cards as JSON, each with the `path` of its first file.

    `path` is null if the card has no file, or a file is missing.
    """
    rows = []
    for card in cards:
        path = _first_path(card)
        rows.append({**card.model_dump(), "path": None if path is None else str(path)})
    return json.dumps(redact(rows), indent=2)


def as_table(cards: Iterable[Card]) -> str:
    """Return a table of the cards."""
    rows = [_HEADINGS, *map(_row, cards)]
    if len(rows) == 1:
        return "no model cards"
    return format_table(rows)


def _first_path(card: Card):  # type: ignore[no-untyped-def]
    """Return the path of a card's first file; None if there is no file, or one is missing."""
    here = [file.path for file in card.files if file.is_here()]
    return here[0] if here and len(here) == len(card.files) else None


def _row(card: Card) -> tuple[str, ...]:
    """Return the cells of a card's row; see `_HEADINGS`."""
    size = getattr(card, "input", None)
    shape = f"{size.height}x{size.width}" if size else "-"
    precision = getattr(card, "precision", "-")
    cells = (
        card.name,
        card.task,
        shape,
        precision,
        card.license,
        _describe_file(card),
        _describe_parity(card),
    )
    return tuple(map(one_line, cells))


def _describe_file(card: Card) -> str:
    """Return the size of a card's files, the server that runs it, or `missing`."""
    if not card.files:
        return "-"
    if served := [file.server.url for file in card.files if file.server is not None]:
        return f"on {redact(served[0])}"
    if _first_path(card) is None:
        return "missing"
    size = sum(path.stat().st_size for file in card.files for path in _paths(file))
    return f"{size / 1e6:.0f} MB" if size >= 10e6 else f"{size / 1e6:.1f} MB"


def _paths(file: FileCard | ChoiceCard) -> list[Path]:
    """Return the paths of all files of a file card."""
    if isinstance(file, ChoiceCard):
        return [file.path_of(part) for part in file.parts]
    return [file.path]


def _describe_parity(card: Card) -> str:
    """Return how the model compares with its reference, from the card, else from the export."""
    # The parity of the card, else that of its first file that has one.
    p = card.parity or next((p for file in card.files if (p := made_parity(file))), None)
    if p is None:
        return "-"
    if isinstance(p, EmbeddingParity):
        order = "" if p.rank_agreement is None else f", order {p.rank_agreement:.3f}"
        return f"cosine {p.cosine:.3f}{order} of {p.reference} ({p.inputs} inputs)"
    error = "" if p.score_error is None else f", score error {p.score_error:.2f}"
    return (
        f"recall {p.recall:.3f}, precision {p.precision:.3f}{error} "
        f"of {p.reference} ({p.images} images)"
    )

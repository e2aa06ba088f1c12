"""Model cards as the exporter reads and writes them.

`edge.perception.cards` validates the same files for the service; this keeps torch's environment
free of the service's dependencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from exporters.files import ExportError, replace_atomically

MADE_BY = {
    "mini-house": "python -m exporters.train_mini --out RUN && python -m exporters.mini.export RUN"
}
"""Commands that make a whole family from nothing, cards and all."""


@dataclass(frozen=True)
class ExportCard:
    """What an export needs from a card.

    Attributes:
        path: the card file.
        name, family, precision: as in the card.
        file: file name of the ONNX in the model cache.
        derived_from: name of the card that it is quantized from, None for FP32.
        hw: input height and width in pixels.
        weights_sha256: digests of the checkpoints that it may be made from; the card's other
            sources give the ONNX file itself.
    """

    path: Path
    name: str
    family: str
    precision: str
    file: str
    derived_from: str | None
    hw: tuple[int, int]
    weights_sha256: tuple[str, ...]


def cards_folder() -> Path:
    """`models/` beside this package in a clone, or the package data of an installed wheel."""
    root = Path(__file__).resolve().parent.parent
    folders = [root / "models", root / "edge" / "_data" / "models"]
    for folder in folders:
        if any(folder.glob("*.yaml")):
            return folder
    raise ExportError(f"{folders[0]}: no model cards; reinstall edge-vln or name --cards FOLDER")


def load_card(name: str, folder: Path) -> ExportCard:
    """Read one card by name; raises ExportError that lists the choices."""
    path = folder / f"{name}.yaml"
    if not path.is_file():
        choices = ", ".join(sorted(p.stem for p in folder.glob("*.yaml"))) or "none"
        raise ExportError(f"{folder}: no card {name!r} (choices: {choices})")
    try:
        card = yaml.safe_load(path.read_text(encoding="utf-8"))
        if card.get("family") in MADE_BY:
            raise ExportError(f"{name}: made with `{MADE_BY[card['family']]}`, not from weights")
        return ExportCard(
            path=path,
            name=card["name"],
            family=card["family"],
            precision=card["precision"],
            file=card["file"],
            derived_from=card["derived_from"],
            hw=(card["input"]["height"], card["input"]["width"]),
            weights_sha256=tuple(
                source["sha256"] for source in card["sources"] if source["sha256"] != card["sha256"]
            ),
        )
    except (OSError, yaml.YAMLError, AttributeError, KeyError, TypeError) as error:
        raise ExportError(f"{path}: not a model card ({error!r}); see the others there") from None


def update_parity(path: Path, parity: dict) -> None:
    """Replace the card's measured parity, atomically; the other keys keep their order."""
    card = yaml.safe_load(path.read_text(encoding="utf-8"))
    card["parity"] = parity
    with replace_atomically(path) as temporary:
        temporary.write_text(yaml.safe_dump(card, sort_keys=False, width=110), encoding="utf-8")

"""The tables of parity in docs/models.md, of models with random weights.

    python tests/exporters/parity_tables.py [FAMILY ...] [--keep FOLDER]

Folders of small models are exported in every precision (extra `transformers`) and compared with
what `transformers` makes of them, on views of generated houses: calibrated in some, measured in
others. `clip-vit-b-32` is CLIP at its published size.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import tiny_folders

from edge.config import parse
from edge.lab.bench.frames import from_world
from edge.text import aligned
from exporters import clip, vlm, vlm_files

TOWERS = {
    "clip": tiny_folders.write_clip,
    "siglip": tiny_folders.write_siglip,
    "clip-vit-b-32": partial(tiny_folders.write_clip, size=tiny_folders.VIT_B_32),
}
LANGUAGE = {
    "idefics3": partial(tiny_folders.write_vlm, kind="idefics3"),
    "qwen2-vl": partial(tiny_folders.write_vlm, kind="qwen2_vl"),
}
HOUSES = {"calibration": range(4), "validation": range(4, 7)}
"""Seeds, none of which episodes are judged on."""
VIEWS = 6
"""Of each house."""


def main() -> None:
    parser = argparse.ArgumentParser(description="the tables of parity in docs/models.md")
    every = (*TOWERS, *LANGUAGE)
    parser.add_argument("families", nargs="*", metavar="FAMILY", help=f"of {', '.join(every)}")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep what is made there")
    args = parser.parse_args()
    if unknown := [name for name in args.families if name not in every]:
        parser.error(f"FAMILY: {unknown[0]!r} (choices: {', '.join(every)})")
    with TemporaryDirectory(prefix="edge-parity-") as temporary:
        root = args.keep or Path(temporary)
        for part, seeds in HOUSES.items():
            write_views(root / part, seeds)
        rows = [row for name in args.families or every for row in compared(name, root)]
    titles = ("model", "inputs", "cosine", "order", "largest change of p", "same letter")
    print(aligned([titles, *rows], left=1))


def write_views(folder: Path, seeds: range) -> None:
    """Pictures of generated houses from random free places."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        world = {"world": {"kind": "generated", "seed": seed}}
        config = parse({"perception": {"detector": {"kind": "sim"}}, "sim": world})
        for k, rgb in enumerate(from_world(config, VIEWS, []).rgb):
            cv2.imwrite(str(folder / f"{seed}-{k}.png"), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


def compared(name: str, root: Path) -> list[tuple[str, ...]]:
    """Export a family in all of its precisions; a row of figures for each file or model."""
    module: Any = clip if name in TOWERS else vlm
    write = {**TOWERS, **LANGUAGE}[name]
    precisions = clip.TEXT_PRECISION if name in TOWERS else vlm_files.PRECISIONS
    asked = argparse.Namespace(
        card=name, weights=write(root / "folders" / name), precision=list(precisions),
        calibration=root / "calibration", validation=root / "validation", cache=root / "cards",
        family=None, license=None, no_gate=True,
    )  # fmt: skip
    asked.cache.mkdir(exist_ok=True)
    return [row_of(card, report) for card, report in module.export(asked).items()]


def row_of(card: str, report: Any) -> tuple[str, ...]:
    inputs = getattr(report, "inputs", None) or report.questions
    more = [getattr(report, key, None) for key in ("share_error", "same_letter")]
    figures = (report.cosine, report.rank_agreement, *more)
    return (card, str(inputs), *("-" if value is None else f"{value:.5f}" for value in figures))


if __name__ == "__main__":
    sys.exit(main())

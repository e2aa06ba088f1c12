"""Vocabulary of CLIP ViT-B/32 text embeddings, made from Detic's published files, without CLIP.

    git clone --depth 1 https://github.com/facebookresearch/Detic
    python -m exporters.vocabulary Detic --out clip_vitb32_vocab.npz

Detic (Apache-2.0) has the embedding of "a NAME" for every category of LVIS, Objects365 and
OpenImages next to its code: 1608 words in all.
"""

from __future__ import annotations

import argparse
import ast
import csv
import json
import sys
from pathlib import Path

import numpy as np

from edge.host.files import open_regular, read_regular, replace_atomically
from exporters.files import ExportError, exit_on_user_error

DIM = 512
"""Length of an embedding."""
_METADATA = Path("datasets/metadata")  # folder in the clone
# Errors of the readers below if a file is missing or has another content.
_UNREADABLE = (OSError, EOFError, ValueError, SyntaxError, KeyError, IndexError, TypeError)


def lvis_names(text: str) -> list[str]:
    """Return the names of a JSON list of categories, by id."""
    return [item["name"] for item in sorted(json.loads(text), key=lambda item: item["id"])]


def objects365_names(text: str) -> list[str]:
    """Return the names of a table: number, name, name with corrected spelling."""
    return [row[2] for row in csv.reader(text.splitlines()) if row]


def openimages_names(text: str) -> list[str]:
    """Return the names of Python code that assigns a list of categories; the code is not run."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "categories":
            return [item["name"] for item in ast.literal_eval(node.value)]
    raise KeyError("categories")


TABLES = (
    (_METADATA / "lvis_v1_train_cat_info.json", lvis_names, "lvis_v1_clip_a+cname.npy"),
    (_METADATA / "Objects365_names_fix.csv", objects365_names, "o365_clip_a+cnamefix.npy"),
    (Path("detic/data/datasets/oid.py"), openimages_names, "oid_clip_a+cname.npy"),
)
"""File of names, its reader, file of embeddings. If two files have a word, the first one counts."""


def read_tables(detic: Path) -> dict[str, np.ndarray]:
    """Return the embedding, (512,) float16, of each word.

    Raises:
        ExportError: a file is missing or invalid.
    """
    found: dict[str, np.ndarray] = {}
    for file, names_in, embeddings in TABLES:
        path = detic / file
        try:
            names = names_in(read_regular(path).decode("utf-8"))
            path = detic / _METADATA / embeddings
            with open_regular(path) as content:
                rows = np.load(content, allow_pickle=False)
        except _UNREADABLE as error:
            reason = getattr(error, "strerror", None) or repr(error)
            raise ExportError(
                f"{path}: cannot be read ({reason:.100}); give the folder of a clone of "
                "https://github.com/facebookresearch/Detic"
            ) from None
        if rows.shape != (len(names), DIM):
            raise ExportError(
                f"{path}: shape {rows.shape}, expected ({len(names)}, {DIM}) as in {file.name}; "
                "clone Detic again"
            )
        for name, row in zip(names, rows.astype(np.float16), strict=True):
            found.setdefault(name.replace("_", " ").lower(), row)
    return found


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m exporters.vocabulary", description="make a vocabulary from Detic's tables"
    )
    parser.add_argument(
        "detic", type=Path, help="folder with a clone of https://github.com/facebookresearch/Detic"
    )
    parser.add_argument("--out", type=Path, required=True, help="file to write (.npz; required)")
    args = parser.parse_args(argv)
    words = read_tables(args.detic)
    with replace_atomically(args.out) as made, made.open("wb") as file:
        np.savez(file, names=np.array(list(words)), emb=np.stack(list(words.values())))
    print(f"{args.out}: {len(words)} words")


if __name__ == "__main__":
    sys.exit(main())

"""`edge models list`: a row for each card, aligned, or JSON."""

from __future__ import annotations

import json
import os

import pytest

from edge.cli.main import main
from edge.host import resources

SHARED = {"family": "f", "license": "MIT", "sources": [], "derived_from": None, "parity": None}
TEXT = {
    **SHARED, "name": "words", "task": "text", "file": "words.onnx", "sha256": None, "dim": 8,
    "precision": "fp32", "tokenizer": {"kind": "attributes"},
    "measured": {"held-out": {"ap50": 0.9, "seed": 1, "made by": "train"}},
}  # fmt: skip
SCORER = {"name": "scorer", "family": "f", "task": "similarity", "license": "MIT", "detector": "d"}


def test_no_cards(put_card, capsys):
    assert main(["models", "list"]) == 0
    assert main(["models", "list", "--json"]) == 0
    assert capsys.readouterr().out.splitlines() == ["no model cards", "[]"]


def test_rows_are_aligned(put_card, capsys):
    put_card(TEXT)
    put_card(SCORER)
    assert main(["models", "list"]) == 0
    head, scorer, words = capsys.readouterr().out.splitlines()
    for heading, cells in {
        "task": ("similarity", "text"), "precision": ("-", "fp32"), "file": ("-", "missing"),
    }.items():  # fmt: skip
        at = head.index(heading)
        assert (scorer[at:].split()[0], words[at:].split()[0]) == cells
    (resources.models_dir() / "words.onnx").write_bytes(b"x" * 2_900_000)
    assert main(["models", "list", "words"]) == 0
    _, words = capsys.readouterr().out.splitlines()
    assert "2.9 MB" in words


def test_an_encoders_parity_is_that_of_its_embeddings(put_card, capsys):
    parity = {"reference": "torch", "inputs": 41, "cosine": 0.9987, "rank_agreement": 0.97}
    put_card({**TEXT, "parity": parity})
    assert main(["models", "list"]) == 0
    assert "cosine 0.999, order 0.970 of torch (41 inputs)" in capsys.readouterr().out
    put_card({**TEXT, "parity": {**parity, "rank_agreement": None}})
    assert main(["models", "list"]) == 0
    assert "cosine 0.999 of torch" in capsys.readouterr().out


def test_json_has_the_card_data_and_file_paths(put_card, capsys):
    put_card(TEXT)
    put_card(SCORER)
    path = resources.models_dir() / "words.onnx"
    path.write_bytes(b"x")
    assert main(["models", "list", "--json"]) == 0
    scorer, words = json.loads(capsys.readouterr().out)
    assert (scorer["detector"], scorer["path"]) == ("d", None)
    assert words["path"] == str(path)
    assert words["measured"]["held-out"] == {"ap50": 0.9, "seed": 1, "made by": "train"}


def test_models_are_chosen_by_licence(put_card, capsys):
    for name, licence in {"a": "apache-2.0", "b": "AGPL-3.0", "c": "MIT", "d": "unknown"}.items():
        put_card({**TEXT, "name": name, "license": licence})

    def listed(*words):
        assert main(["models", "list", "--json", *words]) == 0
        return [card["name"] for card in json.loads(capsys.readouterr().out)]

    assert listed("--licence", "permissive") == ["a", "c"]
    assert listed("--licence", "agpl-3.0") == ["b"]
    assert listed("b", "--licence", "permissive") == []
    assert main(["models", "list", "--licence", "gpl"]) == os.EX_UNAVAILABLE
    error = "--licence: no card has 'gpl' (choices: permissive, AGPL-3.0, MIT, apache-2.0, unknown)"
    assert capsys.readouterr().err.strip() == error
    with pytest.raises(SystemExit):
        main(["models", "list", "--check", "--licence", "permissive"])
    assert "--licence: not allowed with --check" in capsys.readouterr().err

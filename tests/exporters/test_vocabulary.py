"""A vocabulary from Detic's tables, on a clone of three small ones."""

from __future__ import annotations

import json

import numpy as np
import pytest

from edge.perception.embedding.text import TextEmbeddings
from exporters.vocabulary import DIM, TABLES, main

LVIS = [{"id": 2, "name": "sofa_(red)"}, {"id": 1, "name": "Trash_can"}]
OBJECTS365 = "1,Sofa,Sofa\n2,Bakset,Basket\n"
OPENIMAGES = """raise SystemExit("run")
categories = [{'id': 1, 'name': 'Sofa'}, {'id': 2, 'name': 'Door'}]
"""
WORDS = ["trash can", "sofa (red)", "sofa", "basket", "door"]


@pytest.fixture
def detic(tmp_path):
    """Return a clone of Detic; row k of table t points along axis 10 t + k."""
    for t, (names, text) in enumerate(
        zip((table[0] for table in TABLES), (json.dumps(LVIS), OBJECTS365, OPENIMAGES), strict=True)
    ):
        for file in (names, TABLES[t][2]):
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / names).write_text(text)
        rows = 3 * np.eye(DIM, dtype=np.float16)[10 * t : 10 * t + 2]
        np.save(tmp_path / "datasets/metadata" / TABLES[t][2], rows)
    return tmp_path


def test_a_folder_without_the_tables_is_an_error(tmp_path, capsys):
    assert main([str(tmp_path), "--out", str(tmp_path / "v.npz")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "lvis_v1_train_cat_info.json: cannot be read (No such file" in line
    assert list(tmp_path.iterdir()) == []


def test_every_word_has_its_row_and_the_first_table_wins(detic, tmp_path):
    assert main([str(detic), "--out", str(tmp_path / "v.npz")]) == 0
    vocabulary = TextEmbeddings(str(tmp_path / "v.npz"))
    assert list(np.load(tmp_path / "v.npz")["names"]) == WORDS
    assert vocabulary.embed(WORDS)[0].argmax(axis=1).tolist() == [0, 1, 10, 11, 21]


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        (TABLES[0][0], b"[{}]", "KeyError('id')"),
        (TABLES[1][0], b"1,Sofa\n", "IndexError"),
        (TABLES[1][0], b"1,Sofa,Sofa\n", "shape (2, 512), expected (1, 512) as in"),
        (TABLES[2][0], b"categories = [open('x')]", "ValueError"),
        (TABLES[2][0], b"categories = (", "SyntaxError"),
        (TABLES[2][0], b"", "KeyError('categories')"),
        (TABLES[0][0].with_name(TABLES[0][2]), b"no table", "Error"),
    ],
)
def test_a_damaged_table_is_an_error_of_one_line(detic, tmp_path, capsys, file, content, message):
    (detic / file).write_bytes(content)
    assert main([str(detic), "--out", str(tmp_path / "v.npz")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert file.name in line
    assert message in line
    assert not (tmp_path / "v.npz").exists()

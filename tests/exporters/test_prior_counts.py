"""Counting which objects share a room, and the table that comes with the package."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from edge.lab.sim.procthor import read_houses
from edge.perception.prior import table
from exporters.training.prior.__main__ import main
from exporters.training.prior.counts import count, inside

HOUSES = Path(__file__).parents[3] / "shared/worlds/procthor_train.jsonl.gz"
SQUARE = [[0, 0], [2, 0], [2, 2], [0, 2]]
L_SHAPE = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 4], [0, 4]]


def house(objects: list[tuple[str, float, float]], rooms=(SQUARE,)) -> dict:
    return {
        "rooms": [{"polygon": room} for room in rooms],
        "objects": [{"category": name, "center": [x, y, 0.5]} for name, x, y in objects],
    }


@pytest.mark.parametrize(
    ("houses", "expected"),
    [
        ([], {"rooms": 0, "things": [], "rooms_with_both": []}),
        ([house([])], {"rooms": 1, "things": [], "rooms_with_both": []}),
        (
            [house([("bed", 1, 1), ("bed", 1.5, 1), ("vase", 9, 9)])] * 5,
            {"rooms": 5, "things": ["bed"], "rooms_with_both": [[5]]},
        ),
        (
            [house([("tv", 1, 1), ("bed", 1.5, 1)])] * 5 + [house([("couch", 1, 1)])] * 5,
            {
                "rooms": 10,
                "things": ["bed", "sofa", "television"],
                "rooms_with_both": [[5], [0, 5], [5, 0, 5]],
            },
        ),
        ([house([("bed", 1, 1)])] * 4, {"rooms": 4, "things": [], "rooms_with_both": []}),
    ],
)
def test_count(houses, expected):
    assert count(houses) == expected


@pytest.mark.parametrize(
    ("polygon", "x", "y", "within"),
    [
        ([], 0.0, 0.0, False),
        (SQUARE, 1, 1, True),
        (SQUARE, 3, 1, False),
        (L_SHAPE, 3, 0.5, True),
        (L_SHAPE, 0.5, 3, True),
        (L_SHAPE, 3, 3, False),
    ],
)
def test_inside(polygon, x, y, within):
    assert inside(polygon, x, y) == within


def test_the_table_is_the_count_of_the_training_houses():
    if not HOUSES.exists():
        pytest.skip("needs the ProcTHOR houses of the shared folder")
    data = json.loads(table.FILE.read_text())
    counted = count(read_houses(HOUSES))
    assert counted == {key: data[key] for key in counted}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "No such file"),
        (b"no gzip", "ot a gzipped file"),
        (gzip.compress(b"{", mtime=0), "line 1: not JSON"),
        (gzip.compress(b'{"rooms": 3}', mtime=0), "not a file of ProcTHOR houses"),
        (gzip.compress(b"{}" * 100, mtime=0)[:-9], "end-of-stream"),
    ],
)
def test_main_names_the_file_and_the_fault(tmp_path, capsys, content, words):
    file = tmp_path / "houses.jsonl.gz"
    if content is not None:
        file.write_bytes(content)
    assert main([str(file), "--out", str(tmp_path / "table.json")]) == 1
    error = capsys.readouterr().err
    assert str(file) in error
    assert words in error
    assert error.count("\n") == 1

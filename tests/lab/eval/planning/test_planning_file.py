"""Tasks as files: they are read back as written, and faults are reported in one line."""

from __future__ import annotations

import json

import pytest

from edge.errors import FileError
from edge.lab.eval.planning.file import TaskFileError, read_tasks, write_tasks
from edge.lab.eval.planning.templates import generate

GOOD = {
    "id": 0,
    "template": "own",
    "objects": ["bed"],
    "sentence": "Reach a bed.",
    "formula": "F bed",
}


def test_round_trip(tmp_path):
    path, tasks = tmp_path / "tasks.jsonl", generate(60)
    write_tasks(path, tasks)
    assert read_tasks(path) == tasks
    assert set(json.loads(path.read_text().splitlines()[0])) == set(GOOD)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("\n \n", ": the file has no tasks"),
        (b"\xff\xfe", "not UTF-8"),
        ("{", "line 1: not JSON"),
        ("3", "line 1: not a JSON object; each line must be one task with the fields id, template"),
        (json.dumps(GOOD) + "\n{}", "line 2: id: expected int, got None"),
        (
            json.dumps(GOOD) + "\n" + json.dumps(GOOD),
            "line 2: id: 0 is also the id of an earlier line",
        ),
        ({**GOOD, "id": -1}, "id: expected 0 to 2**63 - 1, got -1"),
        ({**GOOD, "formula": "F (bed"}, "formula, column"),
        ({**GOOD, "formula": "F bed & G !bed"}, "contradicts itself"),
        ({**GOOD, "objects": [3]}, "objects: expected the objects of the formula: bed"),
        (
            {
                **GOOD,
                "formula": " & ".join(f"F thing{c}" for c in "abcdefg"),
                "objects": [f"thing{c}" for c in "abcdefg"],
            },
            "at most 12 are allowed",
        ),
        ({**GOOD, "formula": "F " + "x" * 10, "objects": ["", "x"]}, "line 1: '' is no name"),
    ],
)
def test_bad_files(tmp_path, content, message):
    path = tmp_path / "tasks.jsonl"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(TaskFileError) as caught:
        read_tasks(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_unwritable_files(tmp_path):
    with pytest.raises(TaskFileError, match="cannot be read: No such file"):
        read_tasks(tmp_path / "none")
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot be written: "):
        write_tasks(tmp_path / "file" / "tasks.jsonl", generate(1))

"""Requests of `edge mission` to a running service, and the display of its answers."""

from __future__ import annotations

import argparse

import pytest

from edge.cli.mission import add_arguments, as_text


@pytest.mark.parametrize(
    ("answer", "lines"),
    [
        ({}, ["done"]),
        ({"phase": "failed", "reason": "cancelled"}, ["phase:       failed; cancelled"]),
        ({"state": 0}, ["state:       0"]),
        ({"phase": "searching", "robot": {"problems": ["no usable observations: no odom", "b"]}},
         ["phase:       searching", "not ready:   no usable observations: no odom; b"]),
        ({"task": {"phase": "looking", "missing": ["van", "gate"], "writer": "rules",
                   "steps": [{"said": "go there", "state": "driven"},
                             {"said": "stop at the gate", "state": "looked for"}]}},
         ["task:        looking", "steps:       driven: go there; looked for: stop at the gate",
          "written by:  rules", "missing:     van, gate"]),
        (
            {
                "task": {
                    "phase": "driving", "writer": "model m", "answers": 3, "understood": "",
                    "rounds": [{"error": "no"}, {"error": ""}], "trajectory": [[0, 0, 0]],
                    "length_m": 7.25, "driven_m": 3.0, "refinements": 3, "notes": ["a", "b"],
                }
            },
            [
                "task:        driving",
                "written by:  model m",
                "answers:     3",
                "trajectory:  3.0 of 7.2 m driven, refined again 2 times because the map changed",
                "notes:       a; b",
            ],
        ),
        ({"formula": "F bed"}, ["formula:     F bed"]),
        ({"formula": "true", "task": {"answers": 1, "rounds": [{"error": "x is\nno name"}]}},
         ["answers:     1, the newest: x is no name"]),
    ],
)  # fmt: skip
def test_answers_are_printed_as_lines(answer, lines):
    assert as_text(answer).splitlines() == lines


@pytest.fixture
def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    assert add_arguments(parser).add_parser("explain") is not None
    return parser


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (["new", "demo", "words"], {"do": "new", "formula": False, "timeout": None}),
        (["new", "demo", "F a", "--formula", "--json"], {"formula": True, "json": True}),
        (["new", "demo", "words", "--reading", "2"], {"formula": False, "reading": 2}),
        (["status", "demo"], {"do": "status", "timeout": None, "fleet": False}),
        (["pause", "demo", "--timeout", "0.5"], {"do": "pause", "timeout": 0.5}),
        (["resume", "demo"], {"do": "resume"}),
        (["cancel", "demo"], {"do": "cancel", "robots": []}),
        (["pause", "demo", "a", "b", "--fleet"], {"robots": ["a", "b"], "fleet": True}),
    ],
)
def test_a_command_line(parser, line, expected):
    assert {**vars(parser.parse_args(line)), **expected} == vars(parser.parse_args(line))


@pytest.mark.parametrize(
    "line",
    [
        [], ["new", "demo"], ["pause"], ["stop", "demo"],
        ["status", "demo", "--timeout", "0"], ["status", "demo", "--timeout", "nan"],
        ["status", "demo", "--timeout", "soon"], ["status", "demo", "--timeout", "inf"],
    ],
)  # fmt: skip
def test_no_command_line(parser, line, capsys):
    with pytest.raises(SystemExit, match="2"):
        parser.parse_args(line)
    assert "usage:" in capsys.readouterr().err

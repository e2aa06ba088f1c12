"""`edge eval translate --everyday`: judging everyday sentences."""

from __future__ import annotations

import json

import pytest

from edge.cli.parsers import make_parser
from edge.config import TranslatorGrammar
from edge.errors import FileError, UserError
from edge.lab.eval import translate
from edge.lab.eval.everyday import everyday_cases, everyday_counts, score_everyday

GO = {"said": "go to the dock", "expect": "mission", "formula": 'F("dock")'}


@pytest.mark.parametrize(
    ("case", "outcome"),
    [
        (GO, "right"),
        ({**GO, "formula": 'F("shelf")'}, "wrong"),
        ({**GO, "expect": "refuse"}, "wrong"),
        ({**GO, "expect": "ask", "also": ["mission"]}, "right"),
        ({**GO, "said": "go to the dock and wait there two minutes", "minutes": 2}, "right"),
        ({**GO, "said": "go to the dock and wait there two minutes", "minutes": 3}, "wrong"),
        ({**GO, "said": "frobnicate"}, "asked or refused"),
        ({**GO, "said": "frobnicate", "expect": "refuse"}, "right"),
        ({**GO, "said": "do not go near the stove"}, "asked or refused"),
        ({"said": "patrol the dock and the shelf for an hour", "expect": "mission", "minutes": 60,
          "formula": 'G(F("dock")) & G(F("shelf"))'}, "right"),
        ({"said": "before you go to the dock, visit the shelf", "expect": "mission",
          "formula": 'F("shelf" & F("dock"))'}, "right"),
        ({"said": "where is the mug?", "expect": "question", "about": "mug"}, "right"),
        ({"said": "where is the mug?", "expect": "question", "about": "cup"}, "wrong"),
        ({"said": "which rooms do you know", "expect": "question", "about": "rooms"}, "right"),
        ({"said": "forget the dock", "expect": "learn", "meaning": "forget it", "about": "dock"},
         "right"),
        ({"said": "forget the dock", "expect": "learn", "meaning": "remember", "about": "dock"},
         "wrong"),
        ({"said": "do not go in the office", "expect": "learn", "about": "office",
          "meaning": "standing rule: keep out of the office"}, "right"),
        ({"said": "do not go in the office", "expect": "learn", "about": "office",
          "meaning": "lift the keep-out rule for the office"}, "wrong"),
        ({"said": "wait ten seconds", "expect": "control", "meaning": "wait", "seconds": 10},
         "right"),
        ({"said": "stop", "expect": "control", "meaning": "go on"}, "wrong"),
        ({"said": "never mind", "expect": "control", "meaning": "go on"}, "wrong"),
    ],
)  # fmt: skip
def test_a_sentence_is_judged(case, outcome):
    assert score_everyday(case, TranslatorGrammar()).outcome == outcome


def test_the_table_and_the_failures_are_written(tmp_path, capsys):
    table, failures, out = (tmp_path / name for name in ("in.jsonl", "failures", "out.json"))
    table.write_text("")
    assert everyday_cases(table) == []
    assert everyday_counts([]) == {"all": {"right": 0, "asked or refused": 0, "wrong": 0}}
    table.write_text(f"{json.dumps(GO)}\n\n{json.dumps({**GO, 'said': 'frobnicate'})}\n")
    arguments = ["eval", "translate", "--everyday", table, "--backend", "grammar",
                 "--failures", failures, "--out", out]  # fmt: skip
    assert translate.run(make_parser().parse_args(map(str, arguments))) == 0
    assert capsys.readouterr().out.splitlines()[2].split() == ["all", "2", "1", "1", "0"]
    counts = {"right": 1, "asked or refused": 1, "wrong": 0}
    assert json.loads(out.read_text())["grammar"]["all"] == counts
    assert json.loads(failures.read_text())["said"] == "frobnicate"


def test_a_missing_file_is_a_file_error(tmp_path):
    with pytest.raises(FileError, match=r"in\.jsonl: cannot be read: No such file"):
        everyday_cases(tmp_path / "in.jsonl")


@pytest.mark.parametrize("line", ["{", "[]", '{"said": 1, "expect": "ask"}', '{"said": "a"}'])
def test_a_damaged_file_is_refused(tmp_path, line):
    table = tmp_path / "in.jsonl"
    table.write_text(line)
    with pytest.raises(UserError, match=r"line 1: not a sentence: .*; see docs/language\.md"):
        everyday_cases(table)

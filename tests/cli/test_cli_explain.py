"""Whatever text is given as a mission, it is understood or refused in one safe, short line."""

from __future__ import annotations

import argparse
import contextlib
import io

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from edge.cli import explain
from edge.config import MissionConfig
from edge.errors import UserError
from edge.mission.spec import prepare
from edge.text import MAX_CHARS

LONGEST = 1200  # of a refusal with the parts of a contradiction and the remedy

ODD = ["\0", "\x1b[2J", "\x9b", "\u202e", "\ud800", "\n", "\u2028", "\u00a0", "_", "€", "椅子", '"']
ODD += ["a" * 201, "\\", "(", ")", "…", "²"]
FORMULA = ["F", "G", "X", "WX", "U", "W", "R", "M", "!", "&", "|", "->", "<->", "true", "false"]
FORMULA += ["_", "tv", "bed", "F tv", '"arm chair"', '"..."', '"-"', '"€ near tv"', '"€ 1s"']
WORDS = [
    "go", "to", "the", "a", "tv", "bed", "chairs", "kitchen", "near", "it", "them", "then", "and",
    "or", ",", ".", ";", "not", "don't", "avoid", "visit", "twice", "3", "times", "one", "of",
    "either", "before", "after", "until", "any", "order", "exactly", "once", "&", "first", "only",
    "everything", "both",
]  # fmt: skip
WORDS += ['"..."', '"-"', '"the €"', '"€ near tv"', '"tv\0"']


def rows_of(*choices: list[str]) -> st.SearchStrategy[str]:
    """Texts made of words of these lists."""
    words = st.sampled_from([word for choice in choices for word in choice])
    return st.lists(words, max_size=14).map(" ".join)


texts = st.one_of(
    st.text(max_size=60), rows_of(FORMULA), rows_of(FORMULA, ODD), rows_of(WORDS),
    rows_of(WORDS, ODD),
)  # fmt: skip


def explained(text: str, formula: bool, reading: int | None = None) -> list[str]:
    """Return the output of `edge mission explain`."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        args = argparse.Namespace(text=text, formula=formula, reading=reading, config="demo")
        args.draw = None
        assert explain.run(args) == 0
    return out.getvalue().removesuffix("\n").split("\n")


def assert_safe(error: UserError) -> None:
    assert str(error).isprintable()
    assert len(str(error)) <= LONGEST


def assert_refused(text: str, formula: bool, says: str) -> None:
    with pytest.raises(UserError) as caught:
        explained(text, formula)
    assert_safe(caught.value)
    assert says in str(caught.value)


def test_a_path_is_shown_by_its_steps():
    lines = explained("turn left, then stop 2 m before the sofa", formula=False)
    assert lines[:2] == [
        "path:        turn left, then stop 2 m before the sofa",
        "by:          rules",
    ]
    args = argparse.Namespace(text="turn left", formula=False, reading=None, config="demo")
    args.draw = "automaton.svg"
    with pytest.raises(UserError, match="--draw: a path in words has no automaton"):
        explain.run(args)


def test_all_readings_are_listed_and_one_is_chosen():
    said = "the sofa must be visited before the bed"
    first, *listed, last = explained(said, formula=False)
    assert first == f"ambiguous:   it can be read in {len(listed)} ways"
    assert "Reach the sofa, then the bed." in listed[-1]
    assert last.endswith("mission.instruction gets (1), which fulfils all the others")
    lines = explained(said, formula=False, reading=len(listed))
    assert lines[0] == "understood:  Reach the sofa, then the bed."
    assert lines[1 : 2 + len(listed)] == [f"reading:     {len(listed)} of {len(listed)}", *listed]
    with pytest.raises(UserError, match="there is no reading 9"):
        explained(said, formula=False, reading=9)


@given(texts, st.booleans())
@example('"\x08', False)
def test_any_text_is_explained_or_refused_in_one_line(text, formula):
    try:
        lines = explained(text, formula)
    except UserError as error:
        assert_safe(error)
    else:
        names = [line.partition(":")[0] for line in lines if not line.startswith(" ")]
        asked = names[0] in ("ambiguous", "not sure") and names[-1] == "choose"
        assert asked or names[:4] == ["understood", "formula", "by", "targets"]
        assert all(map(str.isprintable, lines))


@given(texts)
def test_any_text_is_a_target_or_refused_by_the_configuration(text):
    try:
        mission = MissionConfig(target=text)
    except ValidationError as error:
        (fault,) = error.errors()
        assert fault["loc"] == ("target",)
    else:
        try:
            assert prepare(mission).targets == (text,)
        except UserError as error:  # its singular may be no name
            assert_safe(error)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "column 1: expected a proposition"),
        ('F "\x1b[31mtv"', "'[31mtv' is no name: character 1 (U+001B) does not print"),
        ('F "' + "b" * 150_000 + '"', "is no name: it has more than 200 characters"),
        ("(" * 190_000, "found the end"),
        ("F a" + " " * 200_000, "at most 200000 are read"),
        (" & ".join(f"F n{i}" for i in range(4000)), "4000 targets, at most 16"),
        ("G !(" + " | ".join(f"{'b' * 190}{i}" for i in range(16)) + ")", "doing nothing"),
        ("F a & G !a & " + " & ".join(f"G !{'b' * 190}{i}" for i in range(9)), "contradiction"),
    ],
    ids=lambda value: value[:20],
)
def test_an_invalid_formula_is_refused_in_one_short_line(text, says):
    assert_refused(text, formula=True, says=says)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("go to the \x1b[31mtv", "character 7: did not understand 'the [31mtv'"),
        ("\0" * 100, "'U+0000 U+0000 U+0000 U+0000 U+0000 U+0000 U+0000 U+0000'"),
        ('go to "tv\u202e"', "no name: character 3 (U+202E) does not print"),
        ('go to "..."', "no name: it needs a letter or a digit"),
        ("go to the " + "blah " * 900, "did not understand 'blah blah blah"),
        ("x" * 9999, "not a known object"),
        ("(" * 9000, "more than 1000 words"),
        ("go to the tv " * 1000, "at most 10000 characters"),
    ],
    ids=lambda value: value[:20],
)
def test_an_invalid_instruction_is_refused_in_one_short_line(text, says):
    assert_refused(text, formula=False, says=says)


@pytest.mark.parametrize(
    "text", ["!" * 500 + "F a", "F a & " * 100 + "F a"], ids=lambda value: value[:20]
)
def test_a_long_formula_is_cut_to_one_line(text):
    lines = explained(text, formula=True)
    shown = lines[1].removeprefix("formula:     ")
    assert len(shown) <= MAX_CHARS
    assert all(len(line) <= LONGEST for line in lines)


def test_words_that_the_detector_lacks_are_reported(tmp_path, capsys):
    np.savez(tmp_path / "words.npz", names=["chair", "houseplant"], emb=np.eye(2, 512))
    detector = f"kind: onnx, vocabulary: {tmp_path / 'words.npz'}"
    (tmp_path / "robot.yaml").write_text(f"perception: {{detector: {{{detector}}}}}\n")
    args = argparse.Namespace(
        text="F chair & F zebra & F bush", formula=True, reading=None, draw=None,
        config=str(tmp_path / "robot.yaml"),
    )  # fmt: skip
    assert explain.run(args) == 0
    warnings = [row for row in capsys.readouterr().out.split("\n") if row.startswith("warning")]
    assert len(warnings) == 2
    assert "cannot look for it: prompt 'zebra': not in the vocabulary words.npz" in warnings[0]
    assert warnings[1] == "warning:     bush: searched as houseplant"

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.text import MAX_CHARS, one_line


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("", ""),
        (" \n\t ", ""),
        ("no way to the goal", "no way to the goal"),
        ("stuck\r\n12:00:00.000 info mission: reached", "stuck 12:00:00.000 info mission: reached"),
        ("\x1b]0;owned\x07 \x00\x7f\x9b31m", "]0;owned 31m"),
        ("right\u202eleft\u2028next\u200b", "right left next"),
        ("lone \ud800 surrogate", "lone surrogate"),
        ("Küche 台所 🛋", "Küche 台所 🛋"),
        (ValueError("bad\nnews"), "bad news"),
        ("x" * 201, "x" * 199 + "…"),
        ("x" * 200, "x" * 200),
    ],
)
def test_one_line(said, shown):
    assert one_line(said) == shown


@given(st.text(max_size=500), st.integers(1, 300))
def test_it_is_printable_short_and_says_no_more_the_second_time(text, limit):
    line = one_line(text, limit)
    assert line.isprintable()
    assert len(line) <= limit
    assert one_line(line, limit) == line


def test_a_novel_is_cut_before_it_is_looked_through():
    assert one_line("\n" * 10_000_000 + "end") == ""
    assert len(one_line("word " * 10_000_000)) == MAX_CHARS

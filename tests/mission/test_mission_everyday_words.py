"""Regular expressions for everyday phrases and names."""

from __future__ import annotations

import re

import pytest

from edge.mission.language.words.everyday_words import NAME, phrase_of


@pytest.mark.parametrize(
    ("kind", "text", "longest"),
    [
        ("find", "", None),
        ("find", "searching", "search"),
        ("find", "Search for the mug", "Search for"),
        ("relation", "in front the sofa", "in"),
        ("relation", "in front of the sofa", "in front of"),
        ("relation", "inside", "inside"),
        ("go to", "drive quickly back into the hall", "drive quickly back into"),
        ("go to", "drive quickly the hall", None),
    ],
)
def test_the_longest_phrase_of_a_kind_matches(kind, text, longest):
    found = re.match(phrase_of(kind), text, re.I)
    assert (found and found[0]) == longest


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("", None),
        ("in", None),
        ("the red mug in the hall", "the red mug"),
        ("cup of tea on", "cup of tea"),
        ("a cup of", "a cup"),
        ("trash can can", "trash can"),
        ("one2 two three four five six", "one2 two three four five"),
        ("two  spaces", "two"),
    ],
)
def test_a_name_has_at_most_five_words(text, name):
    found = re.match(NAME, text, re.I)
    assert (found and found[0]) == name


def test_phrases_share_their_endings():
    """One alternative for each phrase is 184,000 characters, which take 0.3 s to compile."""
    assert len(phrase_of("go to")) < 10_000

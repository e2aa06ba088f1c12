"""Names lifted out of instructions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.mission.language.grammar.prefix_notation import MOST_NAMES, NAMES
from edge.mission.language.networks.delexicalisation import delexicalise_text
from edge.mission.language.words.tokens import TranslationError

LIFTED = [
    ("", "", ()),
    ("Go to the sofa.", "go to <0> .", ("sofa",)),
    ("go to a bed; then the couch", "go to <0> . then <1>", ("bed", "sofa")),
    ("the sofa, the bed and the sofa", "<0> , <1> and <0>", ("sofa", "bed")),
    ("find the small red box", "find <0>", ("small red box",)),
    ("go to the first floor, then landmark 1", "go to <0> , then <1>",
     ("first floor", "landmark one")),
    ("landmark 2 on floor 3", "<0>", ("landmark two on floor three",)),
    ("first go to the door", "first go to <0>", ("door",)),
    ("the chair next to the bed", "<0>", ("chair next to bed",)),
    ('reach "blorf" twice', "reach <0> twice", ("blorf",)),
    ("go to mom's bed", "go to <0>", ("mom's bed",)),
    ("visit a then b", "visit <0> then <1>", ("a", "b")),
    ("visit a at most twice", "visit <0> at most twice", ("a",)),
    ("a cannot be visited", "<0> can not be visited", ("a",)),
    ("find the trash can and the exit", "find <0> and <1>", ("trash can", "exit")),
    ("visit a a b", "visit <0> <0> <1>", ("a", "b")),
    ("go to the bed for a minute", "go to <0> for a minute", ("bed",)),
    ("don't enter the hall", "do not enter <0>", ("hall",)),
    ("don t go to the bed, isn t it", "do not go to <0> , is not it", ("bed",)),
    ("check the watch, then check the check", "check <0> , then check the check", ("watch",)),
    ("the robot goes to the bed", "the robot goes to <0>", ("bed",)),
    ("nothing known", "nothing known", ()),
]  # fmt: skip


@pytest.mark.parametrize(("said", "words", "names"), LIFTED)
def test_lifts(said: str, words: str, names: tuple[str, ...]) -> None:
    lifted = delexicalise_text(said)
    assert (" ".join(lifted.words), lifted.names) == (words, names)
    assert len(lifted.starts) == len(lifted.words)
    for word, start in zip(lifted.words, lifted.starts, strict=True):
        if word.isalpha() and word not in ("do", "not"):
            assert said[start:].lower().startswith(word)


REFUSED = [
    ("go to the sofa \x1b[2J", "this character is not allowed"),
    ('go to ""', "no name"),
    ("go " * 251, "more than 250 words"),
    ("x" * 10_001, "at most 10000 characters"),
    (" ".join("bcdefghjk"), f"at most {MOST_NAMES} objects"),
]


@pytest.mark.parametrize(("said", "hint"), REFUSED)
def test_refuses(said: str, hint: str) -> None:
    with pytest.raises(TranslationError, match=hint) as refused:
        delexicalise_text(said)
    assert len(str(refused.value)) < 200


@given(st.text(max_size=120) | st.binary(max_size=120).map(lambda b: b.decode("latin-1")))
def test_any_text_is_lifted_or_refused(text: str) -> None:
    try:
        lifted = delexicalise_text(text)
    except TranslationError:
        return
    assert {w for w in lifted.words if w in NAMES} == set(NAMES[: len(lifted.names)])

"""The small translator: when it is believed, when it asks, when it refuses."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.equivalence import distinguishing_trace
from edge.mission.language.grammar.prefix_notation import NAMES, REFUSED
from edge.mission.language.networks import model as small
from edge.mission.language.networks.model import NeuralTranslator
from edge.mission.language.networks.network import FormulaHypothesis, TranslationNetwork
from edge.mission.language.words.tokens import TranslationError
from edge.mission.logic.ltl import parse

KNOWN = ("go", "to", "then", "not", "visit", "please", ",", ".")


class Stub:
    """A network that writes given text."""

    words = KNOWN

    def __init__(self, *written: tuple[str, float, float]) -> None:
        self._written = written

    def knows(self, word: str) -> bool:
        return word in KNOWN or word in NAMES

    def formulas(self, words: Sequence[str], names: int) -> list[FormulaHypothesis]:
        return [FormulaHypothesis(tuple(text.split()), math.log(p)) for text, p, _ in self._written]

    def back_translation_log_p(
        self, tokens: Sequence[str], sentences: Sequence[Sequence[str]]
    ) -> list[float]:
        """Every word is accounted for: the shorter sentence is the less likely."""
        log_p = {tuple(text.split()): each for text, _, each in self._written}
        whole = max(map(len, sentences))
        return [log_p[tuple(tokens)] * (2 * whole - len(words)) for words in sentences]


SURE = ("F & <0> F <1>", 0.98, -1.0)
OTHER = "& F <0> F <1>"
SAID = "go to the sofa, then to the bed"
BELIEVED = [
    (SAID, [SURE], True, ["F (sofa & F bed)"]),
    (SAID, [SURE, (OTHER, 0.02, -2.0)], True, ["F (sofa & F bed)"]),
    (SAID, [SURE, (OTHER, 0.02, -1.1)], True, ["F (sofa & F bed)"]),  # a worse text
    (SAID, [SURE, (OTHER, 0.02, -0.1)], False, ["F (sofa & F bed)"]),  # a better text
    (SAID, [("F & <0> F <1>", 0.7, -1.0), (OTHER, 0.3, -1.5)], False,
     ["F (sofa & F bed)", "F sofa & F bed"]),
    (SAID, [("F & <0> F <1>", 0.98, -4.0)], False, ["F (sofa & F bed)"]),  # words unaccounted for
    (SAID, [("F <0>", 0.98, -1.0)], False, None),  # an object is left out
    (SAID, [("& F <0> G ! <1>", 0.98, -4.0)], False, ["F sofa & G !bed"]),
    (SAID, [("W ! <0> <1>", 0.98, -4.0)], False, None),  # it asks for nothing
    (SAID, [("F & <0> F <1>", 0.7, -1.0), (OTHER, 0.16, -1.5), (REFUSED, 0.14, 0.0)], False,
     None),  # hardly among them
    (SAID, [("& F <0> F <1>", 0.6, -1.0), ("& F <1> F <0>", 0.4, -1.0)], True,
     ["F sofa & F bed"]),  # one language, written twice
    (SAID, [SURE, (REFUSED, 0.02, 0.0)], True, ["F (sofa & F bed)"]),
    (SAID, [("& F <0> G ! <0>", 0.9, -1.0), ("F & <0> F <1>", 0.1, -1.0)], False, None),
    ("vist the sofa then the bed", [SURE], False, ["F (sofa & F bed)"]),  # a slip
    ("go to the soffa, then to the bed", [SURE], False, ["F (sofa & F bed)"]),
    ("wobble to the sofa, then to the bed", [SURE], False, ["F (sofa & F bed)"]),  # not known
]  # fmt: skip


@pytest.mark.parametrize(("said", "written", "sure", "texts"), BELIEVED)
def test_likely_readings_are_offered_with_their_confidence(
    said: str, written: list[tuple[str, float, float]], sure: bool, texts: list[str] | None
) -> None:
    if texts is None:  # nothing to offer that is likely to be right
        with pytest.raises(TranslationError, match="could not be translated to a mission"):
            NeuralTranslator(Stub(*written)).read(said)
        return
    guess = NeuralTranslator(Stub(*written)).read(said)
    assert guess.confident is sure
    assert list(guess.formulas) == [parse(text) for text in texts]


DOUBTS = [
    ("go to the soffa, then to the bed", ("soffa: sofa?",)),
    ("vist the sofa then the bed", ("vist: visit?",)),
    ("go to soffa then to the bed", ("soffa: sofa?",)),
    ("zzz to the sofa then the bed", ("zzz: not known?",)),
    ("go to base, then to the sofa, then to the bed", ("base: not known?",)),  # no basket
]


@pytest.mark.parametrize(("said", "doubts"), DOUBTS)
def test_slips_are_reported(said: str, doubts: tuple[str, ...]) -> None:
    assert NeuralTranslator(Stub(SURE)).read(said).doubts == doubts


REFUSALS = [
    ("", "no known object in it"),
    ("go there", "no known object in it"),
    ("Geh zum Sofa und dann zum Bett", "English only"),
    ("wibble wobble wubble wabble the sofa then the bed", "did not understand 'wabble the sofa"),
    ("go " * 95 + "to the bed", "too long for one sentence"),
    ("go to the bed \x00", "not allowed in an instruction"),
    ("guard the sofa, then go to the bed", "character 1: did not understand 'guard': unknown verb"),
    ("go to the sofa by bus", "did not understand 'bus': say where to go, without the means"),
    ("go to the sofa by the bed", "is one object at the other, or on the way to it"),
    ("look around the sofa, then go to the bed", "'around' can mean inside it or past it"),
]


@pytest.mark.parametrize(("said", "hint"), REFUSALS)
def test_refusals(said: str, hint: str) -> None:
    with pytest.raises(TranslationError, match=hint) as refused:
        NeuralTranslator(Stub(SURE)).read(said)
    assert len(str(refused.value)) < 250


@pytest.mark.parametrize("written", [[], [(REFUSED, 0.6, 0.0), ("F <0>", 0.4, -1.0)]])
def test_text_without_a_formula(written: list[tuple[str, float, float]]) -> None:
    with pytest.raises(TranslationError, match="could not be translated to a mission"):
        NeuralTranslator(Stub(*written)).read(SAID)


@cache
def shipped() -> NeuralTranslator:
    return NeuralTranslator(TranslationNetwork("mini-translator"))


READ = [
    ("steer clear of the bed on your path to the hall", "F hall & G !bed"),
    ("find a route to the hall that does not pass the kitchen", "F hall & G !kitchen"),
    ("don't set foot in the hall until you have been to the kitchen", "!hall W kitchen"),
    ("go to landmark 1 by way of the second floor", 'F ("second floor" & F "landmark one")'),
]


@pytest.mark.parametrize(("said", "text"), READ)
def test_the_shipped_model_reads_common_instructions(said: str, text: str) -> None:
    guess = shipped().read(said)
    assert guess.confident
    assert distinguishing_trace(guess.formulas[0], parse(text)) is None


NOT_READ = [
    "turn left at the sofa",
    "go to the sofa in five minutes",
    "bring me the cup from the table",
    "if the door is open, go to the bed",
    "stay near the sofa until I come back",
    "go to the sofa and the bed, but avoid the former",
]


@pytest.mark.parametrize("said", NOT_READ)
def test_the_shipped_model_is_unsure_of_unsupported_orders(said: str) -> None:
    with contextlib.suppress(TranslationError):
        assert not shipped().read(said).confident


CHANGED = [
    ("go to the sofa and never enter the hall", "never"),
    ("go to the sofa without passing the hall", "without"),
    ("do not go to the bed before you have been to the hall", "not"),
    ("visit the sofa exactly twice", "twice"),
    ("go to the sofa, but only after you have been to the hall", "only"),
]


@pytest.mark.parametrize(("said", "word"), CHANGED)
def test_a_meaningful_word_changes_the_reading(said: str, word: str) -> None:
    whole = shipped().read(said).formulas[0]
    try:
        less = shipped().read(" ".join(w for w in said.split() if w.strip(",") != word))
    except TranslationError:
        return
    assert not less.confident or distinguishing_trace(whole, less.formulas[0]) is not None


LEFT_OVER = [  # the rest has a clear meaning; the refusal names a word of it
    ("go to all sofas, but do not go to the table", "all"),
    ("go to the sofa, but do not go to the table every time", "every time"),
    ("visit the sofa and the bed, avoid the table if you can", "if"),
    ("go under the sofa, but do not go to the table", "under"),
    ("go twice to the sofa via the hall", "twice"),
    ("use only the path to get to the shed", "only"),
    ("never go out of the yard, go to the gate", "out"),
    ("stop before you reach the bed", "stop"),
]


@pytest.mark.parametrize(("said", "word"), LEFT_OVER)
def test_a_word_that_is_left_over_is_refused_by_name(said: str, word: str) -> None:
    with pytest.raises(TranslationError) as refused:
        shipped().read(said)
    assert word in refused.value.part


def test_no_inserted_negation_is_skipped() -> None:
    passed = []
    for said, _ in READ[:1]:
        meant, words = shipped().read(said).formulas[0], said.split()
        for at in range(len(words) + 1):
            for word in ("not", "never", "without", "except"):
                changed = " ".join((*words[:at], word, *words[at:]))
                with contextlib.suppress(TranslationError):
                    guess = shipped().read(changed)
                    if guess.confident and distinguishing_trace(guess.formulas[0], meant) is None:
                        passed.append(changed)
    assert not passed


@given(
    st.lists(
        st.sampled_from([*"abc", "the sofa", "go", "not", "until", "twice", ".", "zz", "or"])
        | st.text(max_size=6),
        max_size=12,
    ).map(" ".join)
)
def test_any_text_is_read_or_refused(said: str) -> None:
    try:
        guess = shipped().read(said)
    except TranslationError:
        return
    assert 1 <= len(guess.formulas) <= small.MOST_OFFERED

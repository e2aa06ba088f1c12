"""Sentences composed for the small translator."""

from __future__ import annotations

from random import Random

from edge.mission.language.grammar.prefix_notation import (
    NAMES,
    OPERATORS,
    REFUSED,
    arity,
    formula_of,
)
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import propositions
from exporters.training.translator.compose import Composer, delexicalised, load

PHRASES = load()
OBJECTS = ("sofa", "bed", "oven", "chair", "desk", "lamp", "door", "window")


def test_every_phrase_can_be_filled_in() -> None:
    """No slot is missing, nothing is left of the notation, and every name has its object."""
    composer = Composer(PHRASES, Random(0))
    for family in PHRASES.families:
        assert all(token in OPERATORS or token in "abcde" for token in family.tokens)
        compile_formula(
            formula_of(delexicalised(_said(family.letters), family.tokens).tokens, OBJECTS)
        )
        for template in family.templates:
            words = composer.filled(template)
            assert not set("{}()|") & set(words), template
            named = {word[1] for word in words.split() if word.startswith("$")}
            assert set(family.letters) <= named, template
    for template in PHRASES.refused:
        assert not set("{}()|") & set(composer.filled(template)), template


def _said(letters: list[str]) -> str:
    return " ".join(f"${letter}" for letter in letters)


def test_names_are_numbered_in_order_of_mention() -> None:
    pair = delexicalised("don't go to $b before $a", ["W", "!", "b", "a"])
    assert pair.words == ("do", "not", "go", "to", "<0>", "before", "<1>")
    assert pair.tokens == ("W", "!", "<0>", "<1>")


def test_formulas_name_only_objects_of_their_sentence() -> None:
    composer = Composer(PHRASES, Random(1))
    pairs = [composer.pair() for _ in range(500)]
    assert pairs == [c.pair() for c in [Composer(PHRASES, Random(1))] for _ in range(500)]
    for words, tokens in pairs:
        named = [word for word in dict.fromkeys(words) if word in NAMES]
        assert named == list(NAMES[: len(named)])
        if tokens != (REFUSED,):
            assert set(propositions(formula_of(tokens, NAMES))) <= set(named)
            assert all(arity(t) or t in NAMES for t in tokens)
    assert 0.05 < sum(tokens == (REFUSED,) for _, tokens in pairs) / 500 < 0.25

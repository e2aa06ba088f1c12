from __future__ import annotations

import json
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge import names
from edge.perception.embedding.attributes import (
    ALIKE,
    OPPOSITES,
    SYNONYMS,
    Phrase,
    Vocabulary,
    contrasting,
    nearest,
    parse,
)
from edge.perception.embedding.text import PromptError

WORDS = Vocabulary(
    ("chair", "table", "coffee table", "sofa", "trash can", "table lamp", "washing machine"),
    ("red", "blue", "white", "gray"),
    ("tall", "short", "wide", "narrow", "large", "small"),
)


@pytest.mark.parametrize("prompt", ["", "  ", "the ", "?!", "€ near a chair"])
def test_an_empty_prompt_is_an_error(prompt):
    with pytest.raises(PromptError, match="prompt"):
        parse(prompt, WORDS)


@pytest.mark.parametrize(
    ("prompt", "phrase"),
    [
        ("chair", Phrase("chair")),
        ("Chairs", Phrase("chair")),
        ("tall white trash bin", Phrase("trash can", "white", "tall")),
        ("big grey couch", Phrase("sofa", "gray", "large")),
        ("low table", Phrase("coffee table")),
        ("dining table", Phrase("table")),
        ("navy blue chair", Phrase("chair", "blue")),
        ("a chair that is red", Phrase("chair", None, None, ("that is red",))),
        ("tall, white trash can", Phrase("trash can", "white", "tall")),
        ("low white table", Phrase("table", "white", "short")),
        ("big sized red chair", Phrase("chair", "red", "large", ("sized",))),
        ("SofaC_01", Phrase("sofa")),
    ],
)
def test_a_phrase_is_read(prompt, phrase):
    assert parse(prompt, WORDS) == phrase


@pytest.mark.parametrize("prompt", ["elephant", "white", "dish washer", "wine glass", "lamb"])
def test_an_unknown_noun_is_refused_with_the_nearest_category(prompt):
    with pytest.raises(PromptError, match=r"only the built-in world's 7 categories \(nearest: \w+"):
        parse(prompt, WORDS)


@pytest.mark.parametrize(
    ("prompt", "message"),
    [
        ("red and blue chair", "two colours, red and blue"),
        ("white red chair", "two colours"),
        ("tall low-cut chair", "tall and short"),
        ("big little table", "large and small"),
        ("slim wide sofa", "wide and narrow"),
        ("not red chair", "'not' is not understood; say what the object is like"),
        ("a non-red chair", "'non' is not understood"),
    ],
)
def test_a_contradictory_phrase_is_refused(prompt, message):
    with pytest.raises(PromptError, match=message):
        parse(prompt, WORDS)


@given(
    st.sampled_from([None, *WORDS.sizes]),
    st.sampled_from([None, *WORDS.colors]),
    st.sampled_from(WORDS.categories),
    st.data(),
)
def test_phrases_are_read_in_any_order_with_any_alias(size, color, category, data):
    phrase = Phrase(category, color, size)
    assert parse(str(phrase), WORDS) == phrase
    noun = data.draw(st.sampled_from(names.names_of(category)))
    adjectives = data.draw(
        st.permutations(
            [data.draw(st.sampled_from((w, *SYNONYMS.get(w, ())))) for w in (size, color) if w]
        )
    )
    said = parse(" ".join(["the", *adjectives, noun]), WORDS)
    if said.category == category:  # "low" before "table" is a coffee table
        assert said == phrase
    else:
        assert (adjectives[-1:], category) == (["low"], "table")


@given(
    st.sampled_from([None, *WORDS.sizes]),
    st.sampled_from([None, *WORDS.colors]),
    st.sampled_from(WORDS.categories),
)
def test_contrasts_differ_in_one_attribute_of_the_phrase(size, color, category):
    phrase = Phrase(category, color, size)
    others = [parse(text, WORDS) for text in contrasting(phrase, WORDS)]
    assert bool(others) == bool(size or color)
    for other in others:
        assert other.category == category
        assert (other.color != color) + (other.size != size) == 1
        assert (other.color is None) == (color is None)
        assert (other.size is None) == (size is None)
    assert all(other.size not in ALIKE.get(size, ()) for other in others)


def test_synonyms_are_in_one_place_and_opposites_are_never_alike():
    words = [word for others in SYNONYMS.values() for word in others]
    assert len(words) == len(set(words))
    assert not set(words) & set(SYNONYMS)
    for (a, b), (c, d) in product(OPPOSITES, OPPOSITES):
        assert b not in ALIKE[a]
        assert (c in ALIKE[a]) == (a in ALIKE[c])
        assert (d in ALIKE[b]) == (b in ALIKE[d])


def test_a_vocabulary_survives_json():
    assert Vocabulary.from_json(WORDS.to_json()) == WORDS


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"categories": [], "colors": []}',
     json.dumps({"categories": [1], "colors": [], "sizes": []}),
     json.dumps({"categories": "chair", "colors": [], "sizes": []})],
)  # fmt: skip
def test_an_invalid_vocabulary_is_refused(text):
    with pytest.raises(ValueError, match=r"Expecting|not an object|not a list"):
        Vocabulary.from_json(text)


def test_the_nearest_words_include_aliases():
    assert nearest("setee", WORDS)[0] == "sofa"
    assert nearest("bim", WORDS)[0] == "trash can"
    assert 0 < len(nearest("xyzzy", WORDS)) <= 5

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge import names
from edge.errors import UserError


@pytest.mark.parametrize(
    ("word", "why"),
    [
        ("", "'' is no name: it needs a letter or a digit"),
        ("_", "'_' is no name: it needs a letter or a digit"),
        ("-", "it needs a letter or a digit"),
        ("the €", "it needs a letter or a digit"),
        ("tv\0", "'tv' is no name: character 3 (U+0000) does not print"),
        ("tv\n12:00 info", "'tv 12:00 info' is no name: character 3 (U+000A) does not print"),
        ("\udc80tv", "'tv' is no name: character 1 (U+DC80) does not print"),
        ("b" * 201, f"'{'b' * 59}…' is no name: it has more than 200 characters"),
    ],
)
def test_an_invalid_name_is_refused_with_the_reason(word, why):
    assert not names.is_name(word)
    assert not names.is_known(word)
    with pytest.raises(names.NotANameError) as caught:
        names.canonical(word)
    assert str(caught.value).endswith(why)
    assert isinstance(caught.value, UserError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("tv", "television"),
        ("TV", "television"),
        ("TV set", "television"),
        ("Television", "television"),
        ("trash bins", "trash can"),
        ("the garbage can", "trash can"),
        ("couches", "sofa"),
        ("settee", "sofa"),
        ("reading desk", "desk"),
        ("potted plants", "houseplant"),
        ("shelves", "shelf"),
        ("cell_phone", "cell phone"),
        ("glass", "glass"),
        ("bus", "bus"),
        ("widgets", "widget"),
        ("arm chair", "armchair"),
        ("tvstand", "tv stand"),
        ("Room 12", "room 12"),
        ("room twelve", "room 12"),
        ("aisle twenty-one", "aisle 21"),
        ("landmark 2", "landmark two"),
        ("Bay-3", "bay three"),
        ("room 12A", "room 12a"),
        ("room 007", "room 007"),
        ("floor 2", "second floor"),
        ("12th floor", "floor 12"),
        ("twelfth floor", "floor 12"),
    ],
)
def test_synonyms_share_one_canonical_name(word, expected):
    assert names.canonical(word) == expected


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("Trash", "trash can"),
        ("Trash_01_001", "trash can"),
        ("SofaC", "sofa"),
        ("ChairA", "chair"),
        ("ChairD_01_003", "chair"),
        ("Bed", "bed"),
        ("ReadingDesk", "desk"),
        ("TV", "television"),
        ("TV_02_001", "television"),
        ("TVCabinet", "cabinet"),
        ("Refrigerator", "refrigerator"),
        ("NightStand", "nightstand"),
        ("PortraitB", "painting"),
        ("CoffeeTable", "coffee table"),
        ("KitchenTable", "dining table"),
        ("AirconditionerA", "air conditioner"),
    ],
)
def test_model_names_of_simulated_houses(model, expected):
    assert names.canonical(model) == expected


def test_every_alias_is_unique_and_normalised():
    everything = [n for name, others in names.ALIASES.items() for n in (name, *others)]
    assert len(everything) == len(set(everything))
    assert all(names.normalise(n) == n for n in everything)


pieces = st.sampled_from(["the", "a", "SofaC", "01", "€", "123s", "near", ".", "dishes", "tv", "<"])
odd = st.one_of(st.text(max_size=40), st.lists(pieces, max_size=6).map(" ".join))


@given(odd)
def test_any_text_is_a_lower_case_name_or_refused(word):
    try:
        name = names.canonical(word)
    except names.NotANameError:
        return
    assert name == name.lower()
    assert name.isprintable()
    assert any(map(str.isalnum, name))
    assert names.canonical(name) == name


@given(odd)
def test_parts_of_a_name_are_valid_names(word):
    try:
        parts = [names.head_phrase(word), *names.head_nouns(word), *names.names_of(word)]
    except names.NotANameError:
        return
    assert all(map(names.is_name, parts))


def test_every_alias_leads_to_its_canonical_name():
    for name, others in names.ALIASES.items():
        for other in (name, *others, name.upper(), f"the {name}"):
            assert names.canonical(other) == name, other


@pytest.mark.parametrize(
    ("phrase", "expected"),
    [
        ("sofa", ["sofa"]),
        ("tall white trash bin", ["tall white trash bin", "white trash bin", "trash bin", "bin"]),
        ("the chair next to the red table", ["chair"]),
        ("bed with blue sheets", ["bed"]),
    ],
)
def test_head_nouns(phrase, expected):
    assert list(names.head_nouns(phrase)) == expected


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [("tv", "television set", True), ("bin", "Trash", True), ("sofa", "bed", False)],
)
def test_same(a, b, expected):
    assert names.same_name(a, b) is expected


def test_the_singular_of_a_plural_is_the_name():
    for name in {*names.ALIASES, *names.HYPERNYMS, "bus", "paper knife"} - {"chest of drawers"}:
        assert names.singular(names.plural(name)) == name


def test_a_kind_has_one_broader_word():
    assert names.hypernym("nothing known") is None
    kinds = [kind for kinds in names.HYPERNYMS.values() for kind in kinds]
    assert len(kinds) == len(set(kinds))
    for broader, of_it in names.HYPERNYMS.items():
        assert {names.hypernym(f"the {kind}") for kind in of_it} == {broader}


def test_broader_and_near_words_are_canonical():
    for table in (names.BROADER, names.NEAR):
        for name, others in table.items():
            for word in (name, *others):
                assert names.canonical(word) == word
    for name, others in names.NEAR.items():
        assert not any(names.may_be_same_object(name, other) for other in others)


@pytest.mark.parametrize(
    ("a", "b", "akin", "near"),
    [
        ("couch", "sofa", True, True),
        ("armchair", "chair", True, True),
        ("orchid", "houseplant", True, True),
        ("wardrobe", "cabinet", False, True),
        ("desk", "dining table", False, False),
        ("bed", "sofa", False, False),
    ],
)
def test_names_of_one_object(a, b, akin, near):
    assert names.may_be_same_object(a, b) == names.may_be_same_object(b, a) == akin
    assert names.look_alike(a, b) == names.look_alike(b, a) == near


def test_non_targets_leave_out_targets_and_their_kinds():
    assert names.non_targets((), ("chair",)) == ()
    words = ("couch", "sofa", "armchair", "lamp", "dining chairs")
    assert names.non_targets(words, ("chair",)) == ("sofa", "table lamp")
    assert names.non_targets(words, ("armchair",)) == ("sofa", "table lamp", "chair")

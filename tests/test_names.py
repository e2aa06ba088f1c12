from __future__ import annotations

import gzip
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge import names


@pytest.mark.parametrize("word", ["", "  ", "the", "_", "a "])
def test_nothing_is_not_a_name(word):
    if word.strip() in ("the", "a"):
        assert names.canonical(word) == word.strip()  # an article alone is all there is
    else:
        with pytest.raises(ValueError, match="not a name"):
            names.canonical(word)


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
    ],
)
def test_one_word_for_one_thing(word, expected):
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


def test_every_alias_stands_once_and_is_normalised():
    everything = [n for name, others in names.ALIASES.items() for n in (name, *others)]
    assert len(everything) == len(set(everything))
    assert all(names.normalise(n) == n for n in everything)


@given(st.text(max_size=40))
def test_any_text_is_a_lower_case_name_or_refused(word):
    try:
        name = names.canonical(word)
    except ValueError:
        return
    assert name
    assert name == name.lower()


def test_every_name_and_alias_leads_to_its_canonical_name_and_stays_there():
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
    assert names.same(a, b) is expected


def test_names_of_starts_with_the_word_itself():
    assert names.names_of("bin")[0] == "bin"
    assert "trash can" in names.names_of("bin")
    assert names.names_of("gizmo") == ("gizmo",)


def test_procthor_categories_are_known(shared_dir):
    """Furniture that robots are sent to; small things keep their own names."""
    file = shared_dir / "worlds" / "procthor_val.jsonl.gz"
    if not file.exists():
        pytest.skip(f"not there: {file.name}")
    with gzip.open(file, "rt") as lines:
        seen = {o["category"] for line in lines for o in json.loads(line)["objects"]}
    furniture = {"sofa", "television", "garbage can", "fridge", "house plant", "arm chair",
                 "counter top", "desk lamp", "side table", "dresser", "bed", "desk"}  # fmt: skip
    assert furniture - {"side table"} <= {c for c in seen if names.is_known(c)} | (furniture - seen)

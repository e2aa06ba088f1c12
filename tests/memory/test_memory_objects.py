"""Answers of the object map to "where is it"."""

from __future__ import annotations

import pytest

from edge.geometry import SE2
from edge.memory import known_objects, where_is
from edge.perception.tracking.sightings import TrackedObjects

POSE = SE2(0.0, 0.0, 0.0)
NOW_NS = 100_000_000_000


def seen(*rows: tuple[str, float, int, int]) -> TrackedObjects:
    """Rows of name, x, hits and age in seconds; confidence falls from row to row."""
    s = TrackedObjects(8)
    s.n = len(rows)
    for i, (name, x_m, hits, age_s) in enumerate(rows):
        if name not in s.words:
            s.words.append(name)
        s.word[i], s.id[i], s.hits[i] = s.words.index(name), i + 1, hits
        s.xyz_m[i] = x_m, 0.0, 0.5
        s.confidence[i] = 0.9 - 0.1 * i
        s.last_seen_ns[i] = NOW_NS - age_s * 1_000_000_000
    return s


def test_nothing_is_known_at_first():
    assert known_objects(TrackedObjects(4), NOW_NS, 1) == []
    assert where_is("mug", [], POSE, True) == "no mug has been seen"
    assert where_is("mug", [], None, False) == (
        "no mug has been seen: the detector is not looking for it"
    )


SEEN = seen(
    ("mug", 1.0, 5, 0), ("chair", 2.0, 5, 60), ("armchair", 3.0, 5, 300), ("mug", 4.0, 1, 0)
)


@pytest.mark.parametrize(
    ("name", "ids"),
    [
        ("", [1, 2, 3]),
        ("mug", [1]),
        ("cup", [1]),
        ("bed", []),
        ("chair", [2, 3]),
        ("armchair", [3]),
    ],
)
def test_objects_are_found_by_name_and_kind_if_they_were_seen_often_enough(name, ids):
    assert [one.id for one in known_objects(SEEN, NOW_NS, 2, name)] == ids


def test_an_armchair_comes_after_the_chairs():
    armchair_first = seen(("armchair", 1.0, 5, 0), ("chair", 2.0, 5, 0), ("chair", 3.0, 5, 0))
    ids = {
        name: [one.id for one in known_objects(armchair_first, NOW_NS, 2, name)]
        for name in ("chair", "armchair", "")
    }
    assert ids == {"chair": [2, 3, 1], "armchair": [1], "": [1, 2, 3]}


@pytest.mark.parametrize(("most", "ids"), [(0, []), (1, [1]), (9, [1, 2, 3])])
def test_of_many_objects_the_most_confident_are_returned(most, ids):
    assert [one.id for one in known_objects(SEEN, NOW_NS, 2, most=most)] == ids


def test_the_answer_says_where_when_and_how_sure():
    found = known_objects(SEEN, NOW_NS, 2, "chair")
    assert where_is("chair", found, POSE, True) == (
        "chair: at (2.0, 0.0), 2.0 m away, seen 60 s ago, confidence 0.80; "
        "at (3.0, 0.0), 3.0 m away, seen 5 min ago, confidence 0.70"
    )
    assert found[0].to_json() == {
        "id": 2, "name": "chair", "xyz": [2.0, 0.0, 0.5], "confidence": 0.8, "hits": 5,
        "age_s": 60.0,
    }  # fmt: skip


def test_a_long_answer_is_cut():
    found = known_objects(seen(*[("mug", x, 5, 0) for x in range(8)]), NOW_NS, 1, "mug")
    assert where_is("mug", found, None, True).endswith("; 3 more")

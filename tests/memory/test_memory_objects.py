"""Answers of the object map to "where is it"."""

from __future__ import annotations

import pytest

from edge.geometry import SE2
from edge.memory import describe_location, describe_similar, known_objects
from edge.perception.tracking.tracked_objects import TrackedObjects

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
    assert describe_location("mug", [], POSE, True) == "no mug has been seen"
    assert describe_location("mug", [], None, False) == (
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
def test_objects_are_found_by_name_and_kind(name, ids):
    assert [one.id for one in known_objects(SEEN, NOW_NS, 2, name)] == ids


def test_an_armchair_is_listed_after_the_chairs():
    armchair_first = seen(("armchair", 1.0, 5, 0), ("chair", 2.0, 5, 0), ("chair", 3.0, 5, 0))
    ids = {
        name: [one.id for one in known_objects(armchair_first, NOW_NS, 2, name)]
        for name in ("chair", "armchair", "")
    }
    assert ids == {"chair": [2, 3, 1], "armchair": [1], "": [1, 2, 3]}


@pytest.mark.parametrize(("most", "ids"), [(0, []), (1, [1]), (9, [1, 2, 3])])
def test_the_most_confident_objects_are_returned(most, ids):
    assert [one.id for one in known_objects(SEEN, NOW_NS, 2, most=most)] == ids


def test_the_answer_gives_place_age_and_confidence():
    found = known_objects(SEEN, NOW_NS, 2, "chair")
    assert describe_location("chair", found, POSE, True) == (
        "chair: at (2.0, 0.0), 2.0 m away, seen 60 s ago, confidence 0.80; "
        "at (3.0, 0.0), 3.0 m away, seen 5 min ago, confidence 0.70"
    )
    assert found[0].to_json() == {
        "id": 2, "name": "chair", "xyz": [2.0, 0.0, 0.5], "confidence": 0.8, "hits": 5,
        "age_s": 60.0, "known_s": 100.0, "came_from": None, "room": "",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("filters", "ids"),
    [
        ({"since_s": 60.0}, [1, 2]),
        ({"most": 2}, [1, 2]),
        ({"is_in": lambda x_m, y_m: x_m > 2.5}, [3]),
        ({"is_in": lambda x_m, y_m: False}, []),
        ({"is_in": lambda x_m, y_m: x_m > 2.5, "since_s": 1.0}, []),
    ],
)
def test_objects_are_filtered_by_time_number_and_room(filters, ids):
    def room_of(x_m, y_m):
        return "kitchen" if x_m > 2.5 else ""

    found = known_objects(SEEN, NOW_NS, 2, room_of=room_of, **filters)
    assert [one.id for one in found] == ids
    assert all(one.room == ("kitchen" if one.id == 3 else "") for one in found)


def test_a_moved_object_reports_its_old_place():
    moved = seen(("mug", 1.0, 5, 0))
    moved.moves[0], moved.came_from_m[0] = 1, (4.0, 2.0)
    found = known_objects(moved, NOW_NS, 2, "mug")
    assert describe_location("mug", found, None, True) == (
        "mug: at (1.0, 0.0), seen now, confidence 0.90, probably moved from (4.0, 2.0)"
    )
    assert found[0].to_json()["came_from"] == [4.0, 2.0]


def test_similar_objects_are_marked_as_similar():
    similar = {"mug": known_objects(SEEN, NOW_NS, 2, "mug")}
    assert describe_similar("goblet", {}, None, True) == "no goblet has been seen"
    assert describe_similar("goblet", similar, None, True) == (
        "no goblet has been seen; a mug (similar) at (1.0, 0.0), seen now, confidence 0.90"
    )


def test_a_long_answer_is_cut():
    found = known_objects(seen(*[("mug", x, 5, 0) for x in range(8)]), NOW_NS, 1, "mug")
    assert describe_location("mug", found, None, True).endswith("; 3 more")

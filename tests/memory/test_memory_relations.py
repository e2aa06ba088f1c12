"""Objects that a relation describes, and the instances that they mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.memory import DescribedObject, DescribedTargets, RelationError, parse_description
from edge.names import NotANameError
from edge.types import Instance


def in_no_room(name: str, x_m: float, y_m: float) -> bool:
    return False


def on_floor(point_m: np.ndarray, other_m: np.ndarray) -> bool:
    return True


@pytest.mark.parametrize(
    "name", ["chair", "red chair", "second floor", "first aid kit", "room 12", "chest of drawers"]
)
def test_a_plain_name_has_no_relation(name):
    assert parse_description(name) is None


@pytest.mark.parametrize(
    ("text", "obj"),
    [
        ("the chair next to the desk", DescribedObject("chair", "next to", "desk")),
        ("chair by the window", DescribedObject("chair", "next to", "window")),
        ("chair closest to the window", DescribedObject("chair", "nearest to", "window")),
        ("mug on the table", DescribedObject("mug", "on", "table")),
        ("box under the bed", DescribedObject("box", "under", "bed")),
        ("cup in the sink", DescribedObject("cup", "in", "sink")),
        ("mug in the kitchen", DescribedObject("mug", room="kitchen")),
        ("mug in room 3", DescribedObject("mug", room="room three")),
        ("mug in Anna's crypt", DescribedObject("mug", room="anna's crypt")),
        ("mug on the desk in the crypt", DescribedObject("mug", "on", "desk", "crypt")),
        ("mug in the lounge", DescribedObject("mug", room="lounge")),
        ("mug in the studio", DescribedObject("mug", room="studio")),
        ("mug in the fridge", DescribedObject("mug", "in", "fridge")),
        ("mug in the top drawer", DescribedObject("mug", "in", "top drawer")),
        ("mugs in my toy box", DescribedObject("mugs", "in", "toy box")),
        ("mug in the drawer in the studio", DescribedObject("mug", "in", "drawer", "studio")),
        ("mug in room twelve", DescribedObject("mug", room="room 12")),
        ("second door", DescribedObject("door", nth=2)),
        ("2nd red chair in the kitchen", None),
        ("red chair in the living room", DescribedObject("red chair", room="living room")),
        (
            "third chair next to the desk in the kitchen",
            DescribedObject("chair", "next to", "desk", "kitchen", 3),
        ),
    ],
)
def test_a_description_has_noun_relation_anchor_room_and_number(text, obj):
    found = parse_description(text)
    assert found == (obj or DescribedObject("2nd red chair", room="kitchen"))
    assert found.prompts == tuple(filter(None, (found.noun, found.anchor)))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("chair behind the sofa", "cannot check 'behind'"),
        ("chair to the left of the sofa", "cannot check 'left of'"),
        ("chair next to the desk near the bed", "a second relation"),
    ],
)
def test_a_relation_that_cannot_be_checked_is_refused(text, why):
    with pytest.raises(RelationError, match=why):
        parse_description(text)


def obj(id, label, x_m, y_m=0.0, z_m=0.5):
    points_m = np.array([(x_m - 0.2, y_m, z_m), (x_m + 0.2, y_m, z_m)], np.float32)
    center_m = points_m.mean(axis=0)
    return Instance(
        id, label, center_m, points_m, score=0.9, hits=5, first_seen_ns=0, last_seen_ns=0
    )


MAP = (
    obj(1, "desk", 0.0), obj(2, "chair", 1.0), obj(3, "chair", 4.0),
    obj(4, "chair", 1.5), obj(5, "window", 9.0), obj(6, "mug", 0.1, z_m=0.9),
    obj(7, "mug", 4.1, z_m=0.9), obj(8, "box", 0.0, z_m=0.1),
)  # fmt: skip


def resolve(text, known=MAP, last=False, targets=None):
    targets = targets or DescribedTargets(in_no_room, on_floor)
    found = targets.resolve(text, lambda name: [one for one in known if one.label == name], last)
    return None if found is None else [one.id for one in found]


@pytest.mark.parametrize(
    ("text", "ids"),
    [
        ("chair", None),
        ("chair next to the desk", [2, 4]),
        ("second chair next to the desk", [4]),
        ("third chair next to the desk", []),
        ("second chair", [3]),
        ("chair nearest to the desk", [2]),
        ("chair nearest to the window", []),
        ("sofa next to the desk", []),
        ("chair next to the sofa", []),
        ("mug on the desk", [6]),
        ("box under the desk", [8]),
        ("mug under the desk", []),
    ],
)
def test_a_description_means_these_instances(text, ids):
    assert resolve(text, known=()) == (None if ids is None else [])
    assert resolve(text) == ids


def test_the_nearest_object_may_be_far_after_the_search():
    assert resolve("chair nearest to the window") == []
    assert resolve("chair nearest to the window", last=True) == [3]


def test_a_room_needs_the_map_of_rooms():
    assert resolve("chair in the kitchen") == []
    targets = DescribedTargets(lambda name, x_m, y_m: name == "kitchen" and x_m > 3, on_floor)
    assert resolve("chair in the kitchen", targets=targets) == [3]
    assert resolve("chair in the office", targets=targets) == []


def test_the_choice_is_explained():
    targets = DescribedTargets(in_no_room, on_floor)

    def of(name):
        return [one for one in MAP if one.label == name]

    assert targets.reason_for("chair", MAP[1], of) == ""
    assert targets.reason_for("chair next to the desk", MAP[1], of) == "0.6 m from desk 1"
    assert targets.reason_for("chair next to the desk", MAP[2], of) == ""
    why = targets.reason_for("second chair next to the desk", MAP[3], of)
    assert why == "number 2 in the order of seeing, 1.1 m from desk 1"


@pytest.mark.parametrize(
    ("gap_m", "length_m", "has_floor", "is_another"),
    [
        (0.3, 1.0, True, False),
        (0.5, 1.0, True, True),
        (0.5, 1.0, False, False),
        (0.5, 0.4, False, True),  # as two mugs on a table
        (0.9, 2.0, False, True),
    ],
)
def test_another_one_of_several_is_no_part_of_the_reached_one(
    gap_m, length_m, has_floor, is_another
):
    reached, other = obj(1, "sofa", 0.0), obj(2, "sofa", 0.0)
    reached.points_m[:, 0] = -length_m, 0.0
    other.points_m[:, 0] = gap_m, gap_m + 0.1
    reached.state = "reached"
    targets = DescribedTargets(in_no_room, lambda point_m, other_m: has_floor)
    assert resolve("sofa 2 of 2", (reached, other), targets=targets) == [2] * is_another


def test_two_objects_of_one_image_are_no_parts_of_one():
    reached, other = obj(1, "chair", 0.0), obj(2, "chair", 0.2)
    reached.state = "reached"
    assert resolve("chair 2 of 2", (reached, other)) == []
    other.apart = frozenset((1,))
    assert resolve("chair 2 of 2", (reached, other)) == [2]


@given(st.text(max_size=30))
def test_any_text_is_described_plain_or_refused(text):
    try:
        found = parse_description(text)
    except (NotANameError, RelationError):
        return
    assert found is None or (found.noun and (found.anchor or found.room or found.nth))

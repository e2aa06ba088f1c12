"""Rooms: shapes with lasting ids, kinds by objects, names by people."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.mapping.regions import CELL_M, NO_REGIONS, OPEN, WALL, RegionMap, border_lengths
from edge.memory import (
    NO_SURVEY,
    RoomMemory,
    RoomName,
    RoomSurvey,
    Site,
    Zone,
    kind_of_room,
    survey_rooms,
)
from edge.perception.prior.table import load
from edge.perception.prior.words import PriorWordIndex
from edge.perception.tracking.tracked_objects import TrackedObjects

TABLE = load()
WORDS = PriorWordIndex(TABLE)
Box = tuple[int, int, int, int]
LEFT, RIGHT = (0, 0, 30, 40), (31, 0, 70, 40)
UNNAMED = Site()


def cut(*boxes: Box, origin: tuple[int, int] = (0, 0)) -> RegionMap:
    """Regions from boxes (x0, y0, x1, y1) in cells of `map`; the window starts at `origin`."""
    cells, label = np.full((60, 90), WALL, np.uint8), np.zeros((60, 90), np.int16)
    for number, (x0, y0, x1, y1) in enumerate(boxes, start=1):
        at = np.s_[y0 - origin[1] : y1 - origin[1], x0 - origin[0] : x1 - origin[0]]
        cells[at], label[at] = OPEN, number
    grid = Grid(cells, (origin[0] * CELL_M, origin[1] * CELL_M), CELL_M)
    n = len(boxes)
    return RegionMap(grid, cells == WALL, label, n, border_lengths(label, n))


def surveyed(*cuts: RegionMap, before: RoomSurvey = NO_SURVEY) -> RoomSurvey:
    for one in cuts:
        before = survey_rooms(one, before)
    return before


def ids_at(survey: RoomSurvey, *places_m: tuple[float, float]) -> list[int]:
    return [survey.depth_at(*place)[0] for place in places_m]


def seen(*objects: tuple[str, float, float]) -> TrackedObjects:
    s = TrackedObjects(32)
    for i, (word, x_m, y_m) in enumerate(objects):
        if word not in s.words:
            s.words.append(word)
        s.xyz_m[i], s.word[i], s.confidence[i] = (x_m, y_m, 0.5), s.words.index(word), 0.5
    s.n = s.generation = len(objects)
    return s


def memory(
    *cuts: RegionMap, objects: TrackedObjects | None = None, site: Site = UNNAMED
) -> RoomMemory:
    rooms = RoomMemory(TABLE, WORDS)
    rooms.set_site(site)
    rooms.on_survey(surveyed(*cuts))
    rooms.update(objects or seen(), 0)
    return rooms


BATH = seen(("toilet", 1.0, 1.0), ("toilet paper", 1.0, 1.5), ("bed", 5.0, 2.0))


def test_nothing_is_known_at_first():
    rooms = memory()
    assert rooms.rooms == ()
    assert rooms.room_at(0.0, 0.0) is None
    assert rooms.entered_room(0.0, 0.0) == 0
    assert rooms.find("kitchen") == []
    assert rooms.kind_ratio("kitchen", np.zeros((2, 2), np.float32)).tolist() == [1, 1]
    assert survey_rooms(NO_REGIONS, NO_SURVEY).shapes == ()


def test_a_room_has_an_outline_an_area_and_standing_places():
    (shape,) = surveyed(cut(LEFT)).shapes
    assert shape.id == 1
    assert shape.area_m2 == pytest.approx(12.0)
    x_m, y_m = shape.polygon_m.T
    assert (x_m.min(), x_m.max()) == pytest.approx((0.05, 2.95))
    assert (y_m.min(), y_m.max()) == pytest.approx((0.05, 3.95))
    assert shape.xy_m == pytest.approx((1.5, 2.0), abs=0.6)
    assert len(shape.points_m) > 10
    assert (shape.points_m > 0.5).all()
    assert (shape.points_m < (2.5, 3.5)).all()


def test_rooms_know_their_doors():
    left, right = surveyed(cut(LEFT, (30, 15, 70, 24))).shapes
    (door,) = left.doors
    assert (door.room, right.doors[0].room) == (right.id, left.id)
    assert door.xy_m == pytest.approx((3.0, 1.95), abs=0.1)
    assert door.width_m == pytest.approx(0.9)


def test_a_small_area_is_not_a_room():
    assert surveyed(cut((0, 0, 12, 12))).shapes == ()
    assert surveyed(cut((0, 0, 1, 400))).shapes == ()


@pytest.mark.parametrize(
    ("then", "left", "right"),
    [
        ((LEFT, RIGHT), 1, 2),  # as it was
        ((RIGHT, LEFT), 1, 2),  # another order
        (((0, 0, 30, 50), (31, 0, 85, 50)), 1, 2),  # more of both is known
        (((0, 0, 70, 40),), 2, 2),  # merged: the larger remains
        ((LEFT, (31, 0, 70, 15), (31, 16, 70, 40)), 1, 2),  # split: the larger part
        ((LEFT,), 1, 0),  # gone
    ],
)
def test_ids_last(then, left, right):
    survey = surveyed(cut(LEFT, RIGHT), cut(*then))
    assert ids_at(survey, (1.5, 2.0), (5.0, 3.0)) == [left, right]


def test_a_room_that_was_merged_gets_its_id_again():
    together, apart = cut((0, 0, 70, 40)), cut(LEFT, RIGHT)
    survey = surveyed(apart, together, together, apart)
    assert ids_at(survey, (1.5, 2.0), (5.0, 3.0)) == [1, 2]
    assert survey.next_id == 3


@given(dx=st.integers(-20, 0), dy=st.integers(-15, 0))
def test_ids_do_not_depend_on_the_window(dx, dy):
    survey = surveyed(cut(LEFT, RIGHT), cut(RIGHT, LEFT, origin=(dx, dy)))
    assert ids_at(survey, (1.5, 2.0), (5.0, 3.0)) == [1, 2]


def test_a_room_has_its_kind_from_the_objects_in_it():
    rooms = memory(cut(LEFT, RIGHT), objects=BATH)
    left, right = rooms.rooms
    assert left.kinds == ("bathroom",)
    assert left.title == "bathroom"
    assert left.reason == "toilet and toilet paper seen"
    assert max(right.chance, key=right.chance.get) == "bedroom"
    assert rooms.find("the washroom") == [left]
    assert rooms.find("room 2") == [right]
    assert rooms.find("room two") == [right]
    assert rooms.room_at(1.0, 1.0) is left
    here, there = rooms.kind_ratio("bathroom", np.array([(1, 1), (5, 2)], np.float32))
    assert there < 1 < here


OPEN_PLAN = seen(
    ("refrigerator", 0.5, 1.0), ("countertop", 0.5, 2.0), ("sofa", 5.5, 3.0), ("tv stand", 6.5, 1.0)
)


def test_an_empty_room_has_no_evidence_of_its_kind():
    rooms = memory(cut(LEFT))
    xy_m, weights = rooms.evidence(rooms.rooms[0], "kitchen")
    assert (xy_m.shape, weights.shape) == ((0, 2), (0,))
    assert not rooms.votes(rooms.rooms[0], "kitchen").any()


@pytest.mark.parametrize(("kind", "x_m"), [("kitchen", (0, 2)), ("living room", (5, 7))])
def test_evidence_for_a_room_kind_lies_at_its_objects(kind, x_m):
    (room,) = (rooms := memory(cut((0, 0, 70, 40)), objects=OPEN_PLAN)).rooms
    assert room.kinds == ("kitchen", "living room")
    votes = rooms.votes(room, kind)
    assert votes.shape == (len(room.points_m),)
    assert x_m[0] < room.points_m[votes.argmax(), 0] < x_m[1]
    assert votes.max() > 0.0
    xy_m, weights = rooms.evidence(room, kind)
    assert ((x_m[0] < xy_m[:, 0]) & (xy_m[:, 0] < x_m[1])).tolist() == (weights > 0.0).tolist()


@pytest.mark.parametrize(
    ("kind", "corners_m", "closed"),
    [
        ("keep_out", ((-1, -1), (4, -1), (4, 5), (-1, 5)), True),
        ("keep_out", ((-1, -1), (4, -1), (4, 2), (-1, 2)), False),
        ("stay_inside", ((-1, -1), (4, -1), (4, 5), (-1, 5)), False),
        ("stay_inside", ((4, -1), (9, -1), (9, 5), (4, 5)), True),
    ],
)
def test_a_room_is_closed_if_zones_cover_it(kind, corners_m, closed):
    (room,) = memory(cut(LEFT)).rooms
    assert room.closed_by(UNNAMED) == ""
    assert room.closed_by(Site((Zone("yard", kind, corners_m),))) == ("yard" if closed else "")


def test_a_name_by_a_person_is_certain():
    site = Site((RoomName("office", (5.0, 2.0)), RoomName("lounge", (1.5, 2.0))))
    rooms = memory(cut(LEFT, RIGHT), objects=BATH, site=site)
    left, right = rooms.rooms
    assert (right.name, right.kinds, right.chance["office"]) == ("office", ("office",), 1.0)
    assert (left.title, left.kinds, left.chance["bathroom"]) == ("lounge", ("living room",), 0.0)
    assert rooms.find("living room") == rooms.find("lounge") == [left]
    assert rooms.find("bathroom") == []
    rooms.set_site(Site())
    rooms.update(BATH, 0)
    assert rooms.find("bathroom")[0].id == left.id


@pytest.mark.parametrize(
    ("at_m", "titles", "kinds"),
    [
        ((2.4, 3.4), ["kitchen", "living room"], ("kitchen", "living room")),
        ((1.2, 1.2), ["living room"], ("living room",)),
    ],
    ids=["an open-plan room", "another name for one place"],
)
def test_an_open_plan_room_has_several_names(at_m, titles, kinds):
    site = Site((RoomName("kitchen", (1.0, 1.0)), RoomName("living room", at_m)))
    rooms = memory(cut(LEFT), site=site)
    (room,) = rooms.rooms
    assert (room.title, room.kinds) == ("living room", kinds)
    for name in ("kitchen", "living room"):
        assert rooms.find(name) == ([room] if name in titles else [])
        assert rooms.is_in(name, 1.0, 1.0) == (name in titles)


def test_a_robot_is_inside_away_from_the_border():
    rooms = memory(cut(LEFT, RIGHT))
    assert rooms.entered_room(1.5, 2.0) == 1
    assert rooms.entered_room(0.3, 2.0) == rooms.entered_room(-5.0, 2.0) == 0
    rooms.on_pose(1.5, 2.0)
    rooms.update(seen(), 0)
    assert [room.is_visited for room in rooms.rooms] == [True, False]


def test_room_ids_survive_a_restart_but_not_a_new_frame():
    rooms, again = memory(cut(LEFT, RIGHT)), RoomMemory(TABLE, WORDS)
    rooms.on_pose(5.0, 2.0)
    again.load_state_dict(rooms.state_dict())
    again.on_survey(survey_rooms(cut(RIGHT, LEFT), again.survey))
    again.update(seen(), 0)
    assert [(room.id, room.is_visited) for room in again.rooms] == [(1, False), (2, True)]
    assert ids_at(again.survey, (1.5, 2.0), (5.0, 3.0)) == [1, 2]
    again.on_pose_jump()
    again.update(seen(), 0)
    assert again.rooms == ()
    assert [s.id for s in survey_rooms(cut(LEFT), again.survey).shapes] == [3]
    again.load_state_dict({})  # an older checkpoint
    with pytest.raises(ValueError, match="'next_id' is missing"):
        again.load_state_dict({"id": np.zeros(0, np.int64)} | _without("next_id", rooms))


def _without(name: str, rooms: RoomMemory) -> dict[str, np.ndarray]:
    return {key: array for key, array in rooms.state_dict().items() if key != name}


@pytest.mark.parametrize(
    ("word", "kind"),
    [
        ("kitchen", "kitchen"), ("The Lounge", "living room"), ("sitting room", "living room"),
        ("study", "office"), ("corridor", "hallway"), ("toilet", None), ("mug", None), ("", None),
    ],
)  # fmt: skip
def test_words_for_rooms(word, kind):
    assert kind_of_room(word) == kind

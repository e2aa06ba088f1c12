"""Rooms in the running service, in a simulated house: goals at them, bans, names and answers."""

from __future__ import annotations

import json
import re

import pytest
from small_house import HOUSE, driven

from edge.bus.verbs import Request, read_request
from edge.errors import UserError
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.behaviours.room_targets import is_closed
from edge.loop.requests.handlers import handle_mission
from edge.loop.requests.memory_requests import MEMORY_VERBS, handle_memory
from edge.loop.requests.site_requests import SITE_VERBS, handle_site
from edge.memory import RoomName, Site, Zone
from edge.mission.spec import prepare
from edge.types import GoalStatus

LIVING, KITCHEN = (1.6, 1.4), (8.5, 2.0)
KITCHEN_X_M, KITCHEN_Y_M = (6.0, 11.0), (0.0, 4.0)  # of the built-in house


def ask(loop: ClosedLoop, verbs=SITE_VERBS, handle=handle_site, **request) -> dict:
    do, fields = read_request(json.dumps(request).encode(), verbs)
    return handle(loop.service, Request(do, fields), 0)


def is_in_kitchen(loop: ClosedLoop) -> bool:
    pose = loop.drive.motion.pose
    (x0, x1), (y0, y1) = KITCHEN_X_M, KITCHEN_Y_M
    return x0 < pose.x_m < x1 and y0 < pose.y_m < y1


@pytest.fixture(scope="module")
def in_kitchen() -> ClosedLoop:
    return driven("go to the kitchen")


def test_no_room_is_known_before_the_first_tick():
    loop = driven("go to the kitchen", seconds=0.0)
    assert ask(loop, MEMORY_VERBS, handle_memory, do="rooms") == {"text": "0 rooms", "rooms": []}
    with pytest.raises(UserError, match="pose is not known yet"):
        ask(loop, do="set", kind="room", name="office")
    with pytest.raises(
        UserError, match=r"no room called 'kitchen', expected exactly one \(known: none\)"
    ):
        ask(loop, do="set", kind="keep_out", room="kitchen")


def test_the_robot_finds_the_kitchen_and_drives_inside(in_kitchen):
    loop = in_kitchen
    assert loop.service.status.phase == "reached", loop.notes.events
    assert is_in_kitchen(loop)
    assert loop.service.status.reason.startswith("inside the kitchen, room 2: refrigerator and")
    assert loop.service.map.rooms.entered_room(*loop.drive.motion.pose.matrix()[:2, 3]) == 2


def test_rooms_are_listed_named_and_closed(in_kitchen):
    loop = in_kitchen
    answer = ask(loop, MEMORY_VERBS, handle_memory, do="rooms")
    kinds = {room["id"]: room["kinds"] for room in answer["rooms"]}
    assert (kinds[1], kinds[2]) == (["living room"], ["kitchen"])
    assert [door["room"] for door in answer["rooms"][0]["doors"]] == [2]
    found = ask(loop, MEMORY_VERBS, handle_memory, do="find", name="refrigerator")
    assert found["text"].startswith("refrigerator: in the kitchen, at (")
    named = ask(loop, do="set", kind="room", name="The Canteen")
    assert named["text"].startswith("room: canteen is the room around (")
    loop.step()
    assert loop.service.map.rooms.room(2).title == "canteen"
    assert ask(loop, do="set", kind="keep_out", room="canteen")["text"].startswith(
        "zone: keep out of canteen zone ("
    )
    loop.step()
    assert loop.service.map.grid.zones.contains(*KITCHEN)
    assert not loop.service.map.grid.zones.contains(*LIVING)
    for name in ("canteen zone", "canteen"):
        ask(loop, do="remove", name=name)
    loop.step()
    assert loop.service.map.rooms.room(2).title == "kitchen"
    assert not loop.service.map.grid.zones.contains(*KITCHEN)


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"kind": "room"}, "do: set needs a name"),
        ({"kind": "garden", "name": "a"}, "kind: expected place or room, got 'garden'"),
        ({"kind": "room", "room": "kitchen"}, "do: set needs a name"),
        ({"kind": "keep_out", "room": ""}, "room: expected text"),
    ],
)
def test_requests_that_are_refused(request_, message):
    with pytest.raises(ValueError, match=message):
        read_request(json.dumps({"do": "set", **request_}).encode(), SITE_VERBS)


def test_a_name_by_a_person_is_a_goal():
    loop = driven("go to the canteen", RoomName("canteen", KITCHEN))
    assert loop.service.status.phase == "reached", loop.notes.events
    assert is_in_kitchen(loop)
    assert "inside the canteen, room 2" in loop.service.status.reason


def test_a_forbidden_room_is_closed_until_the_mission_ends(in_kitchen):
    service, mission = in_kitchen.service, in_kitchen.config.mission
    for instruction in ("go to the bed, but never enter the living room", "go to the sofa"):
        service.begin(prepare(mission, instruction), in_kitchen.drive.motion.stamp_ns)
        in_kitchen.step()
        forbidden = "never" in instruction
        assert service.map.grid.zones.contains(*LIVING) == forbidden
        assert not service.map.grid.zones.contains(*KITCHEN)
    service.begin(prepare(mission, "never enter room 1 and find the bed"), 0)
    in_kitchen.step()
    assert service.map.grid.zones.contains(*LIVING)
    service.control.fail("enough", 0)
    in_kitchen.step()
    assert not service.map.grid.zones.contains(*LIVING)


CLOSED = Zone("annexe", "keep_out", ((6.0, -1.0), (12.0, -1.0), (12.0, 5.0), (6.0, 5.0)))


def test_a_mission_to_a_closed_room_is_refused(in_kitchen):
    service, mission = in_kitchen.service, in_kitchen.config.mission
    service.change_site(Site((CLOSED,)), 0)

    def begin(instruction: str) -> None:
        brief = prepare(mission, instruction, site=service.site.known)
        handle_mission(service, Request("new", prepared=brief), in_kitchen.drive.motion.stamp_ns)

    why = "mission: {} is closed by the zone 'annexe'; remove the zone or name another room"
    for name, room in (("kitchen", "the kitchen"), ("room two", "room 2")):
        with pytest.raises(UserError, match=why.format(name)):
            begin(f"go to {room}")
    begin("go to the sofa, but never enter the kitchen")
    begin("go to the living room")
    service.change_site(Site(), 0)
    begin("go to the kitchen")
    service.control.fail("enough", 0)
    service.change_site(Site((CLOSED,)), 0)
    with pytest.raises(UserError, match=why.format("kitchen")):
        handle_mission(service, Request("again"), in_kitchen.drive.motion.stamp_ns)
    service.change_site(Site(), 0)


def test_a_mission_to_an_undiscovered_closed_room_fails():
    loop = driven("go to the canteen", CLOSED, RoomName("canteen", KITCHEN))
    assert loop.service.status.phase == "failed", loop.notes.events
    assert loop.service.status.reason == "a zone closes the canteen, room 2"
    assert not is_in_kitchen(loop)


@pytest.mark.parametrize(
    ("x_m", "closed", "closed_to_a_kitchen"),
    [
        ((20.0, 21.0), False, False),  # elsewhere
        ((6.0, 6.6), False, False),  # a part without the refrigerator
        ((8.8, 12.0), False, True),  # the part with the refrigerator
        ((6.0, 12.0), True, True),
    ],
)
def test_a_zone_over_the_refrigerator_closes_the_kitchen(
    in_kitchen, x_m, closed, closed_to_a_kitchen
):
    service, (low, high) = in_kitchen.service, x_m
    zone = Zone("zone", "keep_out", ((low, -1.0), (high, -1.0), (high, 5.0), (low, 5.0)))
    (kitchen,) = service.map.rooms.find("kitchen")
    service.change_site(Site((zone,)), 0)
    found = is_closed(kitchen, service.map), is_closed(kitchen, service.map, "kitchen")
    service.change_site(Site(), 0)
    assert found == (closed, closed_to_a_kitchen)
    assert not is_closed(kitchen, service.map, "kitchen")


def test_an_empty_room_is_not_taken_for_a_kitchen(tmp_path, monkeypatch):
    monkeypatch.setitem(HOUSE, "objects", HOUSE["objects"][:1])  # the sofa: the other room is empty
    loop = driven("go to the kitchen", seconds=120.0, folder=tmp_path)
    assert loop.service.status.phase == "failed", loop.notes.events
    assert "found no kitchen" in loop.service.status.reason


def test_the_next_room_is_an_unvisited_one():
    loop = driven("go to the next room", seconds=60.0)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert is_in_kitchen(loop)


@pytest.mark.parametrize(
    ("instruction", "phase", "reason"),
    [
        # The bed may cut the bedroom into two rooms.
        ("visit all rooms", "reached", r"was in [23] rooms: living room,.* bedroom; found: "),
        ("visit every bedroom", "reached", "was in 1 bedroom: bedroom; found: "),
        (
            "visit all rooms except the bedroom",
            "reached",
            "was in 1 room: living room; did not get into: bedroom; found: ",
        ),
        ("visit every bathroom", "failed", "explored all reachable space, found no bathroom"),
    ],
)
def test_a_tour_ends_when_each_room_was_visited(tmp_path, instruction, phase, reason):
    loop = driven(instruction, folder=tmp_path)
    status = loop.service.status
    assert status.phase == phase, loop.notes.events
    assert re.match(reason, status.reason), status.reason
    if "except" in instruction:
        entered = {room.title for room in loop.service.map.rooms.rooms if room.is_visited}
        assert entered == {"living room"}


def test_a_patrol_of_the_house_visits_each_room_in_each_round(tmp_path):
    loop = driven("patrol the house twice", seconds=300.0, folder=tmp_path)
    assert loop.service.status.phase == "reached", loop.notes.events
    tours = [text for text in loop.notes.events if text.startswith("reached: every room (was in ")]
    assert len(tours) == 2, loop.notes.events


def test_a_tour_without_a_certain_room_visits_the_most_likely_one(tmp_path, monkeypatch):
    objects = [HOUSE["objects"][0], {"category": "sink", "at": [7.5, 2.0]}]
    monkeypatch.setitem(HOUSE, "objects", objects)
    status = driven("visit every bathroom", folder=tmp_path).service.status
    assert status.phase == "reached", status.reason
    assert re.match(r"was in 1 bathroom: room \d \(probably one\); found: ", status.reason)


def test_a_tour_leaves_out_a_room_that_the_robot_cannot_get_into(tmp_path, monkeypatch):
    loop = driven("visit all rooms", seconds=0.0, folder=tmp_path)
    accept = loop.controller.on_goal

    def refuse_bedroom(stamp_ns: int, goal: SE2) -> list[GoalStatus]:
        if goal.x_m > 4.0:
            return [GoalStatus(stamp_ns, "failed", "the door is closed")]
        return accept(stamp_ns, goal)

    monkeypatch.setattr(loop.controller, "on_goal", refuse_bedroom)
    status = loop.run(200.0).service.status
    assert status.phase == "reached", loop.notes.events
    assert status.reason.startswith("was in 1 room: living room; did not get into: "), status.reason

"""Sentences to a running service other than missions: questions, facts to learn, control."""

from __future__ import annotations

import json
import re
from functools import partial

import numpy as np
import pytest
from simulated import simulated

from edge import names
from edge.bus.verbs import Request, read_request
from edge.errors import UserError
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.requests.handlers import handle_mission, mission_verbs
from edge.memory import Place, RoomName, Site
from edge.memory.rooms import SAME_SPOT_M
from edge.mission.destinations import PlaceTarget
from edge.mission.language.intents import MemoryQuestion, NoMissionError
from edge.tasks.mission_spec import prepare_mission


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    mission = {"instruction": "find the bed", "translator": {"kind": "grammar"}}
    config = simulated({"loop": {"lockstep": True}, "sim": {"lockstep": True}, "mission": mission})
    return ClosedLoop(config, colour=False).run(6.0)


def say(loop: ClosedLoop, said: str) -> dict:
    """Send an instruction as `edge mission new` does."""
    prepare = partial(prepare_mission, loop.config, site=loop.service.site.known)
    verbs = mission_verbs(prepare, in_words=True)
    do, fields = read_request(json.dumps({"do": "new", "instruction": said}).encode(), verbs)
    prepared = verbs[do].prepare
    request = Request(do, fields, prepared=prepared and prepared(fields))
    return handle_mission(loop.service, request, 0)


def test_a_question_is_answered_and_the_mission_stays(loop):
    before = loop.service.mission
    assert say(loop, "Where is the unicorn?")["text"].startswith("no unicorn has been seen")
    assert say(loop, "What did you see?")["text"].startswith("seen: ")
    assert say(loop, "Which places do you know?")["text"] == "places: start"
    assert ", at (" in say(loop, "Where are you?")["text"]
    assert say(loop, "Which rooms do you know?")["text"].startswith("rooms: ")
    seen = say(loop, "What have you seen?")["text"].removeprefix("seen: ").split(", ")[0]
    name = seen.rpartition(" × ")[2]
    assert say(loop, f"Is there a {name}?")["text"].startswith(f"yes, {name}: ")
    many = say(loop, f"How many {names.plural(name)} are there?")["text"]
    assert re.match(rf"\d+ {name}\w* seen; {name}: ", many), many
    many = say(loop, f"How many {names.plural(name)} are next to the unicorn?")["text"]
    assert many.startswith(f"{name}: ")
    assert say(loop, "How many unicorns are there?")["text"].startswith("no unicorn has been seen")
    assert say(loop, "What is near the unicorn?")["text"].startswith("no unicorn has been seen")
    assert say(loop, "What can you do?")["text"].startswith("say for example: 'find my keys'")
    assert say(loop, "What are you doing?")["text"].startswith("find the bed: ")
    assert loop.service.mission is before


def test_objects_within_range_of_a_named_one_are_near(loop, monkeypatch):
    seen = [
        {"id": 1, "name": "desk", "xyz": [0.0, 0.0, 0.5], "room": "office"},
        {"id": 2, "name": "mug", "xyz": [0.5, 0.0, 0.8], "room": "office"},
        {"id": 3, "name": "mug", "xyz": [3.0, 0.0, 0.8], "room": "office"},
        {"id": 4, "name": "bed", "xyz": [0.0, 0.5, 0.3], "room": "bedroom"},
        {"id": 5, "name": "lamp", "xyz": [0.0, 1.0, 0.8], "room": ""},
    ]

    def handle(service, request, now_ns):
        name = request.fields.get("name")
        found = [one for one in seen if name in (None, one["name"])]
        return {"objects": found or seen[:1], "text": f"no {name} has been seen; a desk has"}

    monkeypatch.setattr("edge.loop.requests.intent_requests.handle_memory", handle)
    assert say(loop, "What is next to the desk?")["text"] == "within 1.5 m of the desk: mug, lamp"
    assert say(loop, "What is on the bed?")["text"] == "within 1.5 m of the bed: lamp"
    assert say(loop, "What is on the sofa?")["text"] == "no sofa has been seen; a desk has"


def test_a_place_is_learned_and_forgotten(loop):
    assert say(loop, "Remember this as the um dock.")["text"].startswith("place: dock is (")
    assert say(loop, "Which places do you know?")["text"] == "places: dock, start"
    assert say(loop, "Forget the dock, we moved it.")["text"] == "removed: dock"
    with pytest.raises(UserError, match="no place or zone 'dock'"):
        say(loop, "Forget the dock.")
    with pytest.raises(UserError, match="kitchen: no zone has this name"):
        say(loop, "You may go into the kitchen again.")


def test_a_room_is_named_closed_and_opened(loop):
    assert say(loop, "This is the ballroom.")["text"].startswith(
        "room: ballroom is the room around"
    )
    loop.step()
    assert say(loop, "Where are you?")["text"].startswith("in the ballroom, at (")
    service = loop.service
    points_m = service.map.rooms.find("ballroom")[0].points_m
    away_m = np.hypot(points_m[:, 0] - service.pose.x_m, points_m[:, 1] - service.pose.y_m)
    site = service.site.site.with_item(RoomName("bar", tuple(points_m[away_m.argmax()].tolist())))
    service.change_site(site, 0)
    assert away_m.max() > SAME_SPOT_M
    again = say(loop, "This is the lounge.")["text"]
    assert again.endswith("; it is also called bar: remove a name that is wrong")
    say(loop, "Forget the lounge.")
    say(loop, "Forget the bar.")
    assert say(loop, "Stay out of the ballroom, please.")["text"].startswith("zone: keep out of")
    assert say(loop, "You may go into the ballroom again.")["text"] == "removed: ballroom zone"
    assert "stay inside" in say(loop, "Stay in this room.")["text"]
    assert say(loop, "You can leave this room again.")["text"].startswith("removed: ")
    with pytest.raises(UserError, match="no room called garage is known"):
        say(loop, "What did you see in the garage?")
    say(loop, "Forget the ballroom.")


def test_the_last_mission_starts_once_more():
    config = simulated({"loop": {"lockstep": True}, "sim": {"lockstep": True}})
    loop = ClosedLoop(config, colour=False)
    service, spec = loop.service, loop.service.mission.spec
    with pytest.raises(UserError, match=r"cannot start it again: .*; it still runs, so cancel it"):
        say(loop, "Do that again.")
    say(loop, "Cancel that.")
    assert say(loop, "Do that again.")["phase"] == "searching"
    assert service.mission.spec.automaton is spec.automaton


def test_places_of_the_last_mission_may_have_moved():
    config = simulated({"loop": {"lockstep": True}, "sim": {"lockstep": True}})
    loop = ClosedLoop(config, colour=False, site=Site((Place("dock", SE2(2.0, 1.0, 0.0)),)))
    say(loop, "Go to the dock, then to the bed, and come back.")
    say(loop, "Cancel that.")
    loop.service.change_site(Site((Place("dock", SE2(1.0, 2.0, 0.0)),)), 0)
    say(loop, "Once more, please.")
    assert loop.service.mission.destinations["dock"] == PlaceTarget(SE2(1.0, 2.0, 0.0))
    say(loop, "Cancel that.")
    loop.service.change_site(Site(), 0)
    with pytest.raises(UserError, match=r"cannot start it again: no place dock is known now$"):
        say(loop, "Once more, please.")


def test_nothing_starts_once_more_before_the_first_mission():
    config = simulated({"loop": {"lockstep": True}, "sim": {"lockstep": True}})
    loop = ClosedLoop(config, colour=False)
    loop.service.mission.ended = "idle"
    with pytest.raises(UserError, match=r"cannot start it again: no mission was given yet$"):
        say(loop, "again")


def test_a_spoken_stop_is_as_urgent_as_the_verb():
    verbs = mission_verbs(lambda **texts: texts, in_words=True)

    def read(said: str) -> str:
        return read_request(json.dumps({"do": "new", "instruction": said}).encode(), verbs)[0]

    said = ("Stop, please!", "go on", "cancel that", "stop at the bed")
    assert [read(one) for one in said] == ["pause", "resume", "cancel", "new"]
    assert verbs["pause"].stops_robot
    plain = mission_verbs(lambda **texts: texts)
    assert read_request(b'{"do": "new", "instruction": "stop"}', plain)[0] == "new"


def test_a_question_is_handed_to_the_loop():
    def prepare(**texts: str) -> None:
        raise NoMissionError(MemoryQuestion("self"))

    assert mission_verbs(prepare)["new"].prepare(
        {"instruction": "where are you"}
    ) == MemoryQuestion("self")


def test_a_timed_wait_is_a_pause_that_ends(loop):
    service = loop.service
    assert say(loop, "Wait here for two minutes, please.")["paused"]
    service.control.end_pause(119 * 10**9)
    assert service.mission.paused
    service.control.end_pause(120 * 10**9)
    assert not service.mission.paused
    say(loop, "Wait ten seconds.")
    service.control.cancel("by the test", 0)
    events = len(loop.notes.events)
    service.control.end_pause(11 * 10**9)
    assert loop.notes.events[events:] == []
    service.begin(service.mission.spec, 0)
    say(loop, "Wait ten seconds.")
    say(loop, "Stop!")
    service.control.end_pause(11 * 10**9)
    assert service.mission.paused
    assert not say(loop, "You can go on now.")["paused"]

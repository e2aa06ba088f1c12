"""Destinations: the meaning of a proposition's text, and their JSON."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Place, Site
from edge.mission.destinations import (
    CheckTarget,
    EveryObjectTarget,
    EveryRoomTarget,
    ExploreTarget,
    FailureTarget,
    PlaceTarget,
    WaitTarget,
    destination_of,
    destinations_json,
    destinations_of_json,
    with_caller,
)

DOCK = SE2(1.0, 2.0, 0.5)
SITE = Site((Place("dock", DOCK), Place("wait 5 s", DOCK)))


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("bed", None),
        ("waiting room", None),
        ("the Dock", PlaceTarget(DOCK)),
        ("start", PlaceTarget()),
        ("here", PlaceTarget()),
        ("wait", WaitTarget()),
        ("wait 30 s", WaitTarget(30.0)),
        ("Wait_30_s", WaitTarget(30.0)),
        ("wait for two minutes", WaitTarget(120.0)),
        ("wait 1.5 min", WaitTarget(90.0)),
        ("wait 5 s", PlaceTarget(DOCK)),
        ("wait until 09:00", WaitTarget(until="09:00")),
        ("Wait_until_23:59", WaitTarget(until="23:59")),
        ("explored", ExploreTarget()),
        ("explored living room", ExploreTarget("living room")),
        ("explored for 10 min", ExploreTarget("", 600.0)),
        ("explored kitchen for one hour", ExploreTarget("kitchen", 3600.0)),
        ("every room", EveryRoomTarget()),
        ("every living room", EveryRoomTarget("living room")),
        ("every chair", EveryObjectTarget("chair")),
        ("every chair next to the desk", EveryObjectTarget("chair next to the desk")),
        ("every chair in the kitchen", EveryObjectTarget("chair in the kitchen", "kitchen")),
        ("check stove", CheckTarget("stove")),
        ("check the red mug", CheckTarget("red mug")),
        ("check the kettle in the kitchen", CheckTarget("kettle", "kitchen")),
        ("check keys in the drawer", CheckTarget("keys in the drawer")),
    ],
)
def test_the_text_decides(text, meant):
    assert destination_of(text, SITE) == meant


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wait 0 s", "^0 s: expected a time above 0 s"),
        ("wait 25 hours", "up to 24 h"),
        ("wait until 24:00", "^wait until 24:00: expected a time of day from 00:00 to 23:59"),
        ("wait until 9:00", 'as in "wait until 09:00"'),
        ("explored for some min", "^some min: expected a time"),
        ("explored map", "map: no room has this name, .*; give a room this name first"),
        ("every chair 2 of 3", "say 'every' or a number, not both"),
        ("every pantry", "pantry: no room has this name"),
        ("check mug in pantry", "pantry: no room has this name"),
        ("caller", "caller: the request does not say where the caller is; send from_pose"),
    ],
)
def test_an_impossible_destination_is_refused(text, message):
    with pytest.raises(UserError, match=message):
        destination_of(text, SITE)


@pytest.mark.parametrize("wait", [{"until": "9:00"}, {"until": "09:00", "seconds": 5.0}])
def test_json_has_one_end_of_a_wait(wait):
    with pytest.raises(ValueError, match=r"until|not both"):
        destinations_of_json({"a": {"kind": "wait", **wait}})


def test_the_caller_is_at_the_requested_pose():
    assert destination_of("caller", with_caller(SITE, DOCK)) == PlaceTarget(DOCK)
    assert with_caller(SITE, None) is SITE


numbers = st.floats(-1000, 1000)
seconds = st.none() | st.floats(0.001, 86400)
destinations = st.one_of(
    st.builds(PlaceTarget, st.none() | st.builds(SE2, numbers, numbers, numbers)),
    st.builds(ExploreTarget, st.text(max_size=20), seconds),
    st.builds(WaitTarget, seconds),
    st.builds(WaitTarget, st.none(), st.sampled_from(["00:00", "09:30", "23:59"])),
    st.builds(CheckTarget, st.text(max_size=20)),
    st.builds(EveryRoomTarget, st.text(max_size=20)),
    st.builds(EveryObjectTarget, st.text(max_size=20), st.text(max_size=20)),
    st.builds(FailureTarget, st.text(max_size=20)),
)


@given(st.dictionaries(st.text(max_size=20), destinations, max_size=4))
def test_json_gives_the_same_destinations(given):
    assert destinations_of_json(json.loads(json.dumps(destinations_json(given)))) == given

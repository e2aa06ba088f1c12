"""Tours of rooms, with stand-ins for map and goals."""

from __future__ import annotations

from types import SimpleNamespace

from edge.geometry import SE2
from edge.loop.behaviours.tours import EveryRoomPursuit
from edge.mission.destinations import EveryRoomTarget


def test_surveys_of_one_room_do_not_count_for_the_next():
    """The robot is at a goal in the next bedroom as soon as it has explored the one before."""
    rooms = [SimpleNamespace(id=i, is_named=False, xy_m=(0.0, 0.0)) for i in (1, 2)]
    here = rooms[0]
    known = SimpleNamespace(entered_room=lambda x_m, y_m: here.id, survey=None)
    goals = SimpleNamespace(
        goal=SimpleNamespace(kind="place"),
        arrived=True,
        chooser=SimpleNamespace(begin_target=lambda target: None),
    )
    mission, context = SimpleNamespace(target="every bedroom"), SimpleNamespace(pose=SE2(0, 0, 0))
    tour = EveryRoomPursuit(
        EveryRoomTarget("bedroom"), mission, SimpleNamespace(rooms=known), goals
    )
    tour._visit.explored_id = here.id
    agree = []
    for survey in "abc":
        known.survey = survey
        agree.append(tour._is_inside(here, context))
    assert agree == [False, False, True]
    tour.end(0)
    here = rooms[1]
    assert not tour._is_inside(here, context)

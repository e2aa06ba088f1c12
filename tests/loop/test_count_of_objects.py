"""Result of a search for all objects of a name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edge.geometry import SE2
from edge.loop.behaviours.tours import TriedPlaces, end_with_count
from edge.types import Goal, Instance


def at(x_m, state):
    centre_m = np.array([[x_m, 0.0, 0.5]], np.float32)
    return Instance(1, "shelf", centre_m[0], centre_m, 0.5, 9, 0, 0, state)


@pytest.mark.parametrize(
    ("reached", "missed", "parts", "result"),
    [
        ([], 0, 0, "found no shelf"),
        ([-1.0], 0, 0, "found no shelf"),  # it is in another room
        ([], 2, 0, "found no shelf (did not get to 2 more)"),
        ([1.0], 0, 0, "found 1 shelf: in the hall at (1.0, 0.0)"),
        ([1.0, 2.0], 1, 1, "found 2 shelves (did not get to 1 more; 1 more may be parts of these): "
         "in the hall at (1.0, 0.0), in the hall at (2.0, 0.0)"),
    ],
)  # fmt: skip
def test_the_result_has_number_places_and_gaps(reached, missed, parts, result):
    visited = [at(x_m, "reached") for x_m in reached]
    others = [at(9.0, "confirmed")] * (missed + parts)
    found = {"shelf": visited + others, "every shelf": others[:missed]}
    tracker = SimpleNamespace(of=lambda label, **_: found[label])
    rooms = SimpleNamespace(room_phrase=lambda x_m, y_m: "in the hall")
    ended = []
    mission = SimpleNamespace(
        on_reached=lambda text, now_ns, answer: ended.append((text, now_ns, answer)),
    )
    end_with_count(
        mission,
        SimpleNamespace(tracker=tracker, rooms=rooms),
        "every shelf",
        lambda found: [one for one in found if one.center_m[0] > 0.0],
        7,
    )
    assert ended == [(result, 7, result)]


@pytest.mark.parametrize(
    ("seen_from_m", "state", "again_at_m", "is_left"),
    [
        (2.0, "tentative", 5.0, False),
        (2.0, "tentative", 5.5, False),
        (2.0, "tentative", 7.0, True),  # at another place
        (2.0, "confirmed", 5.0, True),
        (9.0, "tentative", 5.0, True),  # the robot turned back far from it
    ],
)
def test_a_place_that_was_tried_in_vain_is_left_out(seen_from_m, state, again_at_m, is_left):
    known = {1: at(5.0, state)}
    perception = SimpleNamespace(confirm_range_m=3.0)
    tried = TriedPlaces(
        SimpleNamespace(
            tracker=SimpleNamespace(get=known.get), config=SimpleNamespace(perception=perception)
        )
    )
    assert tried.without([]) == []
    tried.note(None, SE2(0.0, 0.0, 0.0))
    goal = Goal(1, SE2(4.2, 0.0, 0.0), "instance", 1, (5.0, 0.0), 0.5, "shelf")
    tried.note(goal, SE2(0.0, 0.0, 0.0))
    tried.note(replace(goal, stamp_ns=2), SE2(5.0 - seen_from_m, 0.0, 0.0))
    assert tried.without([at(5.0, "tentative")])  # it still drives there
    tried.note(None, SE2(5.0 - seen_from_m, 0.0, 0.0))
    again = [at(again_at_m, "tentative")]
    assert tried.without(again) == again * is_left
    assert tried.without([at(5.0, "reached")])

"""Result of a search for all objects of a name."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from edge.loop.behaviours.tours import end_with_count


def at(x_m, state):
    return SimpleNamespace(center_m=np.array([x_m, 0.0, 0.5]), state=state)


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

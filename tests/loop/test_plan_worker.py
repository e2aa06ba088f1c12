"""Background work for a task."""

from __future__ import annotations

from dataclasses import replace

import pytest
from task_scenes import STREET, Thing, street

from edge.loop.behaviours.plan_worker import SAME_OBJECT_M, _find_again


@pytest.mark.parametrize(
    ("things", "asked", "found"),
    [
        ((), (1, "van"), None),
        (STREET, (2, "car"), 2),
        (STREET, (9, "bench"), None),
        ((Thing("van", 2.0, 0.0), Thing("car", 3.0, 0.0), Thing("car", 9.0, 0.0)), (9, "car"), 2),
        ((Thing("car", SAME_OBJECT_M + 0.1, 0.0),), (9, "car"), None),
    ],
    ids=["nothing", "by its number", "no such thing", "by its label", "too far off"],
)
def test_a_thing_that_got_another_number_is_found_again(things, asked, found):
    scene = street(*things)
    for i, one in scene.objects.items():
        scene.objects[i] = replace(one, points_m=one.position_m[None])
    thing = _find_again(asked, scene)
    assert (None if thing is None else thing.id) == found

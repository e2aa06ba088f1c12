"""Background work for a task."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated
from task_scenes import STREET, Thing, street

from edge.loop.behaviours import plan_worker
from edge.loop.behaviours.plan_worker import SAME_OBJECT_M, PlanResult, _find_again, run_request
from edge.tasks.refine import refine
from edge.tasks.scene.objects import ObjectMap
from edge.tasks.scene.scene import Region
from edge.tasks.scene.value_map import PathMargins
from edge.trajectory.pursuit import MotionLimits


@pytest.mark.parametrize(
    ("objects", "asked", "found"),
    [
        ((), (1, "van"), None),
        (STREET, (2, "car"), 2),
        (STREET, (9, "bench"), None),
        ((Thing("van", 2.0, 0.0), Thing("car", 3.0, 0.0), Thing("car", 9.0, 0.0)), (9, "car"), 2),
        ((Thing("car", SAME_OBJECT_M + 0.1, 0.0),), (9, "car"), None),
    ],
    ids=["nothing", "by its number", "no such object", "by its label", "too far off"],
)
def test_an_object_with_a_new_id_is_found_again(objects, asked, found):
    scene = street(*objects)
    for i, one in scene.objects.items():
        scene.objects[i] = replace(one, points_m=one.position_m[None])
    obj = _find_again(asked, scene)
    assert (None if obj is None else obj.id) == found


def test_a_nearer_approach_keeps_off_the_ground_to_avoid(monkeypatch):
    scene = street(Thing("van", 5.0, 0.0))
    monkeypatch.setattr(plan_worker, "_scene", lambda request: scene)
    shown = []
    monkeypatch.setattr(
        plan_worker, "_write_up_to", lambda n, request, scene: shown.append(scene) or PlanResult()
    )
    for instruction in ("go to the van", "go to the van, avoid the lawn"):
        request = plan_worker.PlanRequest(
            simulated({}), instruction, 0, (1,), 1, None, None, (), ObjectMap(), None, None,
            before=PlanResult(), nearer_to=(1, "van"),
        )  # fmt: skip
        run_request(request)
    closed = [int((one.occupancy.cells >= 50).sum()) for one in shown]
    assert len(closed) == 2
    assert closed[1] > closed[0]


@pytest.mark.parametrize(
    ("chosen", "drivable"), [({"lawn"}, {2}), ({"road", "lawn"}, {1, 2}), ({"path"}, {1, 2})]
)
def test_a_path_keeps_its_kinds_of_ground_under_new_ids(chosen, drivable, monkeypatch):
    """If no ground of these kinds is left, it may use all."""
    scene, limits = street(), MotionLimits(1.0, 1.0, 1.0, 1.0)
    driven = refine(scene, [np.array([[2.0, 0.0]])], {7}, PathMargins(0.3), limits)
    now = replace(scene, regions={k: Region(k, s, 9.0) for k, s in ((1, "road"), (2, "lawn"))})
    monkeypatch.setattr(plan_worker, "_scene", lambda request: now)
    asked = []
    monkeypatch.setattr(plan_worker, "refine_again", lambda scene, before, *_: asked.append(before))
    request = plan_worker.PlanRequest(
        simulated({}), "go straight for 2 metres", 0, (1,), 1, None, None, (), ObjectMap(), None,
        None, before=PlanResult(refined=driven, grounds=frozenset(chosen)),
    )  # fmt: skip
    run_request(request)
    assert [before.drivable for before in asked] == [drivable]


@pytest.mark.parametrize(
    ("instruction", "hopeless"),
    [("go to the purple van", False), ("go to the van on the left", True)],
)
def test_an_object_of_another_colour_may_be_seen_yet(instruction, hopeless, monkeypatch):
    monkeypatch.setattr(plan_worker, "_scene", lambda request: street(Thing("van", 5.0, -1.0)))
    monkeypatch.setattr(plan_worker, "_frame_detector", lambda request: None)  # without an image
    request = plan_worker.PlanRequest(
        simulated({}), instruction, 0, (1,), 1, None, None, (), ObjectMap(), None, None,
    )  # fmt: skip
    result = run_request(request)
    assert (result.refined, result.hopeless) == (None, hopeless)
    assert "did not understand" in result.error

"""Missions for objects that a relation describes."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import simulated
from small_house import HOUSE, driven

from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.behaviours.search import SearchBehaviour
from edge.loop.goals.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.mission.spec import prepare
from edge.types import Instance


def obj(id, label, x_m):
    points_m = np.array([(x_m - 0.2, 0.0, 0.5), (x_m + 0.2, 0.0, 0.5)], np.float32)
    return Instance(id, label, points_m.mean(axis=0), points_m, 0.9, 5, 0, 0)


@pytest.mark.parametrize(
    ("target", "prompts", "ids"),
    [
        ("chair", ("chair",), [2, 3, 4]),
        ("chair next to desk", ("chair", "desk"), [2, 3]),
        ("second chair", ("chair",), [3]),
        ("check chair next to desk", ("chair", "desk"), [2, 3]),
        ("chair next to sofa", ("chair", "sofa"), []),
    ],
)
def test_only_objects_that_fit_the_relation_are_candidates(target, prompts, ids):
    config = simulated()
    spec = prepare(config.mission, formula=f'F "{target}"')
    assert spec.prompts == prompts
    assert spec.prompt_for(target) == prompts[0]
    here, mission = SemanticMap(config, spec.prompts), MissionRun(spec, config.mission)
    goals = GoalTracker(config, here.pool, here.tracker, lambda goal: None, lambda text, ns: None)
    behaviour = SearchBehaviour(mission, config, here, goals, None)
    assert list(behaviour.target_objects()) == []
    for one in (obj(1, "desk", 5.0), *(obj(i, "chair", 2.0 * i) for i in (2, 3, 4))):
        here.tracker.add(one)
    assert [one.id for one in behaviour.target_objects()] == ids
    here.close()


def test_a_reached_object_is_no_candidate_for_the_next_of_several():
    config = simulated()
    spec = prepare(config.mission, "find two chairs")
    assert spec.prompts == ("chair",)
    here, mission = SemanticMap(config, spec.prompts), MissionRun(spec, config.mission)
    goals = GoalTracker(config, here.pool, here.tracker, lambda goal: None, lambda text, ns: None)
    behaviour = SearchBehaviour(mission, config, here, goals, None)
    # 2 is a part of 1 that the tracker holds for another chair.
    for i, x_m in enumerate((2.0, 2.7, 5.0), start=1):
        here.tracker.add(obj(i, "chair", x_m))
    assert [one.id for one in behaviour.target_objects()] == [1, 2, 3]
    here.tracker.mark_reached(1)
    assert [one.id for one in behaviour.target_objects()] == [3]
    here.close()


@pytest.mark.parametrize(
    ("said", "phase", "reason"),
    [
        ("find two sofas", "reached", "sofa 1 of 2, then sofa 2 of 2"),
        ("find three sofas", "failed", "explored all reachable space"),
    ],
)
def test_several_of_a_kind_are_different_objects(said, phase, reason, tmp_path, monkeypatch):
    other = {"category": "sofa", "at": [6.8, 0.7]}
    monkeypatch.setitem(HOUSE, "objects", [*HOUSE["objects"], other])
    loop = driven(said, folder=tmp_path, seconds=300.0)
    status = loop.service.status
    assert status.phase == phase, (status, loop.notes.events)
    assert status.reason.startswith(reason), status
    reached = [one for one in loop.service.map.tracker.all if one.state == "reached"]
    sofas = [one for one in loop.world.objects if one.label == "sofa"]
    assert len(reached) == len(sofas) == 2
    for sofa in sofas:
        at_m = [sofa.distance_m(*one.center_m[:2].tolist()) for one in reached]
        assert min(at_m) < 0.5 < max(at_m)


def test_the_vase_on_the_cabinet_is_found_with_a_report():
    """It takes some seconds, since the robot drives through the house."""
    data = {
        "mission": {"instruction": 'go to the "vase on the cabinet"'},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},
    }
    loop = ClosedLoop(simulated(data), colour=False).run(600)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.distance_m("vase") <= 1.0
    (chosen,) = [text for text in loop.notes.events if "chosen" in text]
    assert chosen.startswith("vase on the cabinet: vase ")
    assert " m from cabinet " in chosen

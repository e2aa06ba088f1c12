"""Missions for things that a relation describes."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import simulated

from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.behaviours.search import SearchBehaviour
from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.mission.spec import prepare
from edge.types import Instance


def thing(id, label, x_m):
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
    assert list(behaviour.gather()) == []
    for one in (thing(1, "desk", 5.0), *(thing(i, "chair", 2.0 * i) for i in (2, 3, 4))):
        here.tracker.add(one)
    assert [one.id for one in behaviour.gather()] == ids
    here.close()


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

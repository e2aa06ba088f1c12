"""Missions with several targets, in closed loop with a simulated robot in the built-in house."""

from __future__ import annotations

import json

import numpy as np
import pytest
from simulated import simulated

from edge.bus.verbs import Request
from edge.config import Config
from edge.errors import UserError
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.requests.handlers import handle_mission
from edge.loop.status import status_message
from edge.mission.spec import prepare
from edge.perception.embedding.text import PromptError

CHOICE = "F ((chair | sofa) & F television) & !bed W television"


def config(formula: str, **sections: dict) -> Config:
    mission = {"instruction": formula, "translator": {"kind": "ltl"}, **sections.pop("mission", {})}
    base = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True, "step_s": 0.2},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},
        "mission": mission,
    }
    return simulated({**base, **sections})


def taken(loop: ClosedLoop, kind: str) -> list[str]:
    return [step.label for step in loop.service.mission.log if step.kind == kind]


@pytest.mark.parametrize(("weights", "seed"), [("constant", 0), ("distance", 1), ("constant", 2)])
def test_a_choice_a_sequence_and_a_prohibition(weights, seed):
    perception = {"detector": {"kind": "sim", "seed": seed}}
    mission = {"planner": {"kind": "vitl", "weights": weights}}
    loop = ClosedLoop(config(CHOICE, mission=mission, perception=perception), colour=False).run(300)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    reached = taken(loop, "reached")
    assert reached[-1] == "television"
    assert reached[0] in ("chair", "sofa")
    assert len(reached) == 2
    assert loop.distance_m("television") <= 1.0
    assert loop.drive.motion.collisions == 0
    assert (loop.service.mission.sets.knowledge.distance_m is not None) == (weights == "distance")
    loop.service.close()


def ask(loop: ClosedLoop, do: str, spec=None, overtaken: int = 0, **fields: object) -> dict:
    request = Request(do, fields, prepared=spec, cancelled=overtaken)
    return handle_mission(loop.service, request, loop.drive.motion.stamp_ns)


def refusal(loop: ClosedLoop, do: str, spec=None, **fields: object) -> str:
    with pytest.raises(UserError) as caught:
        ask(loop, do, spec, **fields)
    return str(caught.value)


def test_an_idle_robot_stands_and_tests_its_controller():
    loop = ClosedLoop(config("F bed"), colour=False)
    service = loop.service
    service.mission.set_idle()
    service.goals.client.driving = True  # to something that a service before this one sent
    loop.run(8)
    answer = ask(loop, "status")
    assert (answer["phase"], answer["reason"]) == ("idle", "waiting for a mission")
    assert (answer["id"], answer["past"], service.status.done) == ("", [], False)
    assert answer["robot"]["controller"] == "answers"
    assert loop.drive.motion.path_m < 0.05
    assert refusal(loop, "pause") == "no mission is running: no mission was given yet"
    ask(loop, "new", prepare(loop.config.mission, formula="F bed"), if_free=True)
    assert service.status.phase == "searching"


def test_a_mission_keeps_its_given_id():
    loop = ClosedLoop(config("F television"), colour=False).run(3)
    bed, sofa = (prepare(loop.config.mission, formula=f"F {x}") for x in ("bed", "sofa"))
    assert refusal(loop, "new", bed, id="1", if_free=True).startswith("not free: the last mission ")
    assert ask(loop, "new", bed, id="1")["id"] == "1"
    begun = loop.service.mission
    assert ask(loop, "new", bed, id="1", if_free=True)["id"] == "1"
    assert loop.service.mission is begun, "given twice, begun once"
    assert refusal(loop, "cancel", id="2").startswith("no mission 2 is running: ")
    assert ask(loop, "cancel", id="1", why="another is\nat it")["reason"] == "another is at it"
    ask(loop, "new", sofa, id="2")
    answer = ask(loop, "new", bed)
    assert answer["past"] == [
        {"id": "1", "phase": "failed", "reason": "another is at it"},
        {"id": "2", "phase": "failed", "reason": "replaced"},
    ]
    over = "mission 2 is already over on this robot: give the new mission another id"
    assert refusal(loop, "new", sofa, id="2") == over
    assert json.dumps(answer)


def test_a_new_mission_replaces_the_old_and_keeps_the_map():
    loop = ClosedLoop(config("F television"), colour=False).run(10)
    generation = loop.service.map.grid.travel_cost.generation
    spec = prepare(loop.config.mission, formula="F bed")
    answer = ask(loop, "new", spec)
    assert (answer["formula"], answer["target"]) == ("F bed", "bed")
    loop.step()
    assert loop.service.map.grid.travel_cost.generation >= generation
    loop.run(200)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.distance_m("bed") <= 1.0


def test_a_mission_the_detector_refuses_keeps_the_old_one(monkeypatch):
    loop = ClosedLoop(config("F bed"), colour=False).run(3)

    def refuse(prompts):
        raise PromptError("prompt 'qwerty': not in the vocabulary")

    monkeypatch.setattr(loop.service.perception.worker.detector, "set_prompts", refuse)
    before = loop.service.mission
    assert (
        refusal(loop, "new", prepare(loop.config.mission, formula="F qwerty"))
        == "prompt 'qwerty': not in the vocabulary"
    )
    assert loop.service.mission is before


def test_a_pose_jump_clears_known_distances():
    mission = {"planner": {"kind": "vitl", "weights": "distance"}}
    loop = ClosedLoop(config(CHOICE, mission=mission), colour=False)
    while loop.service.mission.sets.knowledge.distance_m is None:
        loop.step()
    loop.service.on_pose_jump(loop.drive.motion.stamp_ns)
    assert loop.service.mission.sets.knowledge.distance_m is None
    assert loop.service._travel_costs._worker.poll() is None
    loop.service.close()


def test_pause_stops_the_robot_and_resume_continues():
    loop = ClosedLoop(config("F bed"), colour=False).run(6)
    assert ask(loop, "pause")["phase"] == "paused"
    for _ in range(15):
        loop.step()
    at, elapsed_s = loop.drive.motion.pose, loop.service.status.elapsed_s
    for _ in range(20):
        loop.step()
    assert loop.drive.motion.pose.distance_to(at.x_m, at.y_m) < 0.02
    assert loop.service.status.elapsed_s == elapsed_s
    assert ask(loop, "resume")["phase"] != "paused"
    loop.run(200)
    assert loop.service.status.phase == "reached", loop.notes.events


def test_a_flood_of_equal_requests_is_reported_once():
    loop = ClosedLoop(config("F television"), colour=False).run(2)
    for do in ("resume", *["pause"] * 5, *["resume"] * 5):
        ask(loop, do)
    loop.step()
    assert [e for e in loop.notes.events if "mission: p" in e or "mission: resumed" in e] == [
        "mission: paused", "mission: resumed",
    ]  # fmt: skip


def test_a_goal_from_before_a_pause_is_not_sent_again():
    """The one to stand is newer, so a controller would take the old one for replaced."""
    loop = ClosedLoop(config("F bed"), colour=False).run(1)
    for _ in range(8):
        ask(loop, "pause")
        for _ in range(3):
            loop.step()
        ask(loop, "resume")
        for _ in range(5):
            loop.step()
    stamps = [goal.stamp_ns for goal in loop.notes.goals]
    assert stamps == sorted(set(stamps))
    assert not any("replaced" in answer.reason for answer in loop.notes.goal_statuses)


def test_cancel_ends_a_mission_and_leaves_nothing_to_pause():
    loop = ClosedLoop(config("F bed"), colour=False).run(3)
    answer = ask(loop, "cancel")
    assert (answer["phase"], "overtaken" in answer) == ("failed", False)
    loop.step()
    assert loop.service.status.reason == "cancelled"
    assert "no mission" in refusal(loop, "pause")
    assert ask(loop, "status")["phase"] == "failed"


@pytest.mark.parametrize("do", ["pause", "cancel"])
def test_a_stop_reports_the_missions_that_it_prevented(do):
    loop = ClosedLoop(config("F bed"), colour=False)
    ask(loop, "cancel")
    assert "no mission is running" in refusal(loop, do)
    answer = ask(loop, do, overtaken=2)
    assert (answer["phase"], answer["paused"], answer["overtaken"]) == ("failed", False, 2)
    loop.service.close()


def test_a_goal_next_to_a_forbidden_object_is_warned_of():
    """The demo house has no such place, so the forbidden object is put next to the goal."""
    loop = ClosedLoop(config("F television & (!lamp W television)"), colour=False)
    while not any(step.kind == "target" for step in loop.service.mission.log):
        loop.step()
    while loop.service.goals.goal is None:
        loop.step()
    goal = loop.service.goals.goal
    lamp = _thing_at(99, "lamp", goal.pose.x_m + 0.4, goal.pose.y_m)
    loop.service.map.tracker.add(lamp)
    loop.service.goals.chooser.abandon()
    loop.step()
    assert loop.service.goals.goal.candidate_id == goal.candidate_id
    step = loop.service.mission.log[-1]
    assert (step.kind, step.label) == ("warning", "lamp")
    assert "m from lamp, which must not be reached now" in step.text


def _thing_at(instance_id: int, label: str, x_m: float, y_m: float):

    from edge.types import Instance

    point = np.array([[x_m, y_m, 0.5]], np.float32)
    return Instance(instance_id, label, point[0], point, 0.9, 9, 0, 0)


def test_the_status_has_formula_state_plan_sets_and_reason():
    loop = ClosedLoop(config(CHOICE), colour=False).run(3)
    sent = status_message(loop.service.result())["mission"]
    assert sent["formula"] == CHOICE
    assert sent["states"] >= 4
    assert sent["plan"][-1] == "television"
    assert sent["forbidden"] == ["bed"]
    assert sent["why"]
    assert set(sent) >= {"state", "detected", "reached", "failed", "english", "options", "trace"}

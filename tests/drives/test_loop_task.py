"""A task in the service, in closed loop with a simulated robot in the built-in house."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import groupby
from types import SimpleNamespace

import numpy as np
import pytest
from chat_server import ChatServer, saying, serving
from simulated import simulated

from edge.bus.verbs import Request
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.behaviours import driven_trajectory, plan_worker
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.monitoring.metrics import SERVICE_METRICS
from edge.loop.requests.handlers import handle_mission, mission_verbs
from edge.loop.service import Service
from edge.loop.status import status_message
from edge.memory import Site, Zone
from edge.policies import make_policy
from edge.tasks.mission_spec import prepare_mission
from edge.tasks.sentences.object_phrases import AmbiguousObjectError
from edge.types import GoalStatus, Instance

STRAIGHT = "go straight for 2 metres"
TO_THE_OVEN = "go to the oven"
OVENS = (TO_THE_OVEN, "go past the left of the oven", "stop in front of the oven")
START = (7.0, 3.0, 3.1)  # in the kitchen, with the oven behind the robot
NEXT_ROOM = (8.4, 6.1, 1.6)  # from where the oven is found within half a minute


def closed(task: str | None = STRAIGHT, **sections: dict) -> ClosedLoop:
    start = START if task in OVENS else NEXT_ROOM if task and "oven" in task else None
    sim = {"lockstep": True, "step_s": 0.2, "start": start}
    camera = {"width_px": 160, "height_px": 128}  # sees enough
    base = {"loop": {"lockstep": True}, "sim": sim, "sensors": {"camera": camera}}
    return ClosedLoop(simulated({**base, **sections}), task=task, colour=False)


def ask(loop: ClosedLoop, do: str, **fields: object) -> dict:
    fields = mission_verbs(prepare_mission)[do].read(fields) if do == "new" else fields
    spec = prepare_mission(loop.config, **fields) if do == "new" else None
    return handle_mission(
        loop.service, Request(do, fields, prepared=spec), loop.drive.motion.stamp_ns
    )


def until(loop: ClosedLoop, phase: str, seconds: float = 120.0) -> ClosedLoop:
    while loop.service.behaviour.task_status().phase != phase:
        assert loop.seconds < seconds, loop.notes.events
        loop.step()
    return loop


@pytest.fixture(scope="module")
def at_the_oven() -> ClosedLoop:
    return closed(TO_THE_OVEN).run(200)


def test_a_task_finds_its_object_then_drives_the_trajectory(at_the_oven):
    loop = closed(TO_THE_OVEN)
    loop.step()
    facts = loop.service.result().task()
    assert (facts.phase, facts.missing, facts.refined) == ("looking", ("oven",), None)
    loop = at_the_oven
    mission = loop.service.mission
    assert loop.service.status.phase == "reached", loop.notes.events
    assert mission.sets.reached == ()
    kinds = [step.kind for step in mission.log]
    assert kinds[:4] == ["start", "target", "seen", "trajectory"]
    assert kinds[-1] == "end"
    assert loop.distance_m("oven") <= 1.0
    assert json.dumps(status_message(loop.service.result()))


@pytest.mark.parametrize("task", OVENS[:2])
def test_an_unconfirmed_destination_is_rejected_and_the_search_continues(task, monkeypatch):
    loop = closed(task)
    tracker = loop.service.map.tracker
    monkeypatch.setattr(Instance, "is_confirmed", False)
    until(loop, "verifying")
    assert states(loop)[0] == "under way"
    (oven,) = tracker.of("oven")
    until(loop, "looking").step()
    assert oven.state == "rejected"
    assert (loop.service.status.done, states(loop)[0]) == (False, "looked for")
    assert any(
        f"oven {oven.id} was not confirmed from near by, rejected: exploring" in event
        for event in loop.notes.events
    )


def test_a_destination_too_far_to_verify_is_accepted():
    loop = closed(TO_THE_OVEN, perception={"confirm_range_m": 0.2}).run(200)
    assert not loop.service.map.tracker.of("oven", only_confirmed=True)
    assert any("too far to verify, accepted" in event for event in loop.notes.events)
    assert loop.service.status.phase == "reached", loop.notes.events


def ambiguous(loop: ClosedLoop, monkeypatch, states: tuple[str, ...]) -> None:
    """Return True if the rules choose among all ovens while one of them is in such a state."""
    tracker = loop.service.map.tracker

    def write(instruction, *args, **more):
        found = tracker.of("oven")
        if any(one.state in states for one in found):
            ids = tuple(one.id for one in found)
            raise AmbiguousObjectError("it may be any of these", "the oven", 7, ids)
        return real(instruction, *args, **more)

    real = plan_worker.write_trajectory
    monkeypatch.setattr(plan_worker, "write_trajectory", write)


def test_an_ambiguous_tentative_object_is_looked_at_from_nearby(monkeypatch):
    loop = closed(TO_THE_OVEN)
    ambiguous(loop, monkeypatch, ("tentative",))
    loop.run(200)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert any("it may be any of these: exploring further" in e for e in loop.notes.events)
    assert [goal.kind for goal in loop.notes.goals].count("instance") >= 1
    assert loop.service.mission.sets.reached == ()


def test_a_task_ambiguous_between_known_objects_fails(monkeypatch):
    loop = closed(TO_THE_OVEN)
    ambiguous(loop, monkeypatch, ("tentative", "confirmed"))
    loop.run(200)
    status = loop.service.status
    assert (status.phase, status.reason) == ("failed", "it may be any of these")
    assert [one.state for one in loop.service.map.tracker.of("oven")] == ["confirmed"]
    assert "trajectory" not in {goal.kind for goal in loop.notes.goals}


def first_plan(task: str, monkeypatch) -> tuple[plan_worker.PlanRequest, plan_worker.PlanResult]:
    """Return the first request for a trajectory that can be driven from `START`, and its result."""
    plans, real = [], plan_worker.run_request

    def run(request):
        result = real(request)
        if isinstance(request, plan_worker.PlanRequest):
            plans.append((request, result))
        return result

    monkeypatch.setattr(plan_worker, "run_request", run)
    until(closed(task, sim={"lockstep": True, "step_s": 0.2, "start": START}), "driving")
    return plans[-1]


def test_an_object_to_avoid_is_still_avoided_after_refinement(monkeypatch):
    _, near = first_plan(TO_THE_OVEN, monkeypatch)
    request, away = first_plan(f"{TO_THE_OVEN}, avoiding the sink", monkeypatch)
    (sink,) = (one for one in request.instances if one.label == "sink")
    refined = plan_worker.run_request(replace(request, before=near, index=0))
    gaps_m = [
        np.hypot(*(plan.refined.poses[:, :2] - sink.center_m[:2]).T).min()
        for plan in (near, away, refined)
    ]
    assert gaps_m[0] < 1.3
    assert min(gaps_m[1:]) > 1.7


def states(loop: ClosedLoop) -> list[str]:
    return [step.state for step in loop.service.result().task().steps]


def task_steps(loop: ClosedLoop) -> dict[str, int]:
    """As a scrape counts them."""
    (metric,) = (metric for metric in SERVICE_METRICS if metric.name == "edge_task_steps")
    return metric.read(SimpleNamespace(service=loop.service))


def test_the_first_steps_are_driven_before_later_targets_are_seen():
    loop = until(closed(f"{STRAIGHT}, then {TO_THE_OVEN}"), "driving")
    facts = loop.service.result().task()
    assert (facts.missing, states(loop)) == (("oven",), ["under way", "looked for"])
    start = loop.drive.motion.pose
    until(loop, "looking")
    at = loop.drive.motion.pose
    assert start.distance_to(at.x_m, at.y_m) == pytest.approx(2.0, abs=0.3)
    assert states(loop) == ["driven", "looked for"]
    counted = {state: n for state, n in task_steps(loop).items() if n}
    assert counted == {"driven": 1, "looked for": 1}
    loop.run(300)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert states(loop) == ["driven", "driven"]
    assert loop.distance_m("oven") <= 1.0
    assert loop.drive.motion.collisions == 0
    kinds = [kind for kind, _ in groupby(goal.kind for goal in loop.notes.goals)]
    assert (kinds[0], kinds[-1]) == ("trajectory", "trajectory")
    assert len(kinds) > 2, "it was searched for in between"


def test_a_finished_step_counts_as_driven_during_the_next():
    loop = until(closed("go straight for 1 metre, then straight for 1 metre"), "driving")
    seen = [states(loop)]
    while not loop.service.status.done:
        loop.step()
        seen.append(states(loop))
    assert [states for states, _ in groupby(seen)] == [
        ["under way", "under way"], ["driven", "under way"], ["driven", "driven"],
    ]  # fmt: skip
    assert loop.service.result().task().refinements == 1, "of one trajectory"


def test_a_task_fails_with_the_name_of_the_missing_object():
    task = f"{STRAIGHT}, then go to the surfboard"
    loop = closed(task, mission={"search_limit_s": 5.0}).run(30)
    status = loop.service.status
    assert (status.phase, status.reason) == ("failed", "no surfboard within 5 s")
    assert loop.service.result().task().phase == "failed"
    assert states(loop) == ["driven", "not driven"]


def test_a_task_is_requested_and_replaced_like_a_mission():
    loop = closed(None).run(0.2)
    answer = ask(loop, "new", task=STRAIGHT, id="7")
    assert (answer["instruction"], answer["id"]) == (STRAIGHT, "7")
    until(loop, "driving").step()
    assert ask(loop, "new", task=STRAIGHT, id="7")["phase"] == "approaching"
    ask(loop, "new", formula="F bed")
    assert loop.service.result().task() is None
    loop.step()
    assert loop.service.goals.goal is None or loop.service.goals.goal.kind != "trajectory"


def test_pause_stops_a_task_and_resume_continues_it():
    loop = until(closed(), "driving")
    for _ in range(5):
        loop.step()
    ask(loop, "pause")
    for _ in range(10):
        loop.step()
    at = loop.drive.motion.pose
    for _ in range(5):
        loop.step()
    assert loop.drive.motion.pose.distance_to(at.x_m, at.y_m) < 0.02
    ask(loop, "resume")
    loop.run(60)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.service.result().task().refinements == 1


def test_a_pose_jump_voids_the_trajectory_and_another_is_written():
    loop = until(closed(TO_THE_OVEN), "driving")
    before = loop.service.result().task().refined
    loop.service.on_pose_jump(loop.drive.motion.stamp_ns)
    facts = loop.service.result().task()
    assert (facts.phase, facts.refined) == ("looking", None)
    loop.run(300)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.service.result().task().refined is not before


def test_the_robot_drives_around_an_obstacle_on_the_trajectory():
    loop = until(closed("go straight for 3 metres"), "driving")
    pose, now_ns = loop.drive.motion.pose, loop.drive.motion.stamp_ns
    loop.service.map.grid.bumps.close(pose, pose.ahead(1.5), 0.2, now_ns)
    loop.run(60)
    facts = loop.service.result().task()
    assert loop.service.status.phase == "reached", loop.notes.events
    assert facts.refinements >= 2
    assert any("obstacle on the path" in event for event in loop.notes.events)


MAT = Zone("mat", "keep_out", ((3.6, 2.1), (4.2, 2.1), (4.2, 2.7), (3.6, 2.7)))
"""A zone between the sofa and a robot that starts at (5, 1)."""


@pytest.mark.parametrize("is_late", [False, True])
def test_a_task_drives_around_a_zone(is_late):
    sim = {"lockstep": True, "step_s": 0.2, "start": (5.0, 1.0, 2.2)}
    loop, in_zone = closed("go to the sofa", sim=sim), 0
    service = loop.service
    if is_late:
        until(loop, "driving").step()
    service.change_site(Site((MAT,)), loop.drive.motion.stamp_ns)
    while not service.status.done and loop.seconds < 60.0:
        loop.step()
        pose = loop.drive.motion.pose
        in_zone += service.map.grid.zones.contains(pose.x_m, pose.y_m)
    assert service.status.phase == "reached", loop.notes.events
    assert (in_zone, loop.drive.motion.collisions) == (0, 0)
    assert loop.distance_m("sofa") <= 1.0
    assert service.result().task().refinements <= 3


def test_a_task_fails_if_no_trajectory_removes_the_obstacle(monkeypatch):
    monkeypatch.setattr(driven_trajectory, "blocked_ahead_m", lambda *_: 1.0)
    loop = closed().run(10.0)
    status = loop.service.status
    assert (status.phase, status.reason) == ("failed", "obstacle on the path 1.0 m ahead")
    assert "writing a new trajectory from here" in " ".join(loop.notes.events)
    assert len(loop.notes.events) < 30


def by_model(server: ChatServer, **planner: object) -> ClosedLoop:
    planner = {"kind": "model", "url": server.url, **planner}
    return closed("Drive a little way.", tasks={"planner": planner})


def test_a_failed_goal_out_of_a_zone_is_no_failure_of_the_trajectory():
    loop = until(closed(), "driving")
    service, pose = loop.service, loop.drive.motion.pose
    corners = [(pose.x_m + a, pose.y_m + b) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    rug = Zone("rug", "keep_out", tuple(corners))
    service.change_site(Site((rug,)), loop.drive.motion.stamp_ns)
    for _ in range(3):
        loop.step()
        goal = service.goals.goal
        assert goal.kind == "zone_exit"
        service.on_goal_status(GoalStatus(goal.stamp_ns, "failed", "by the test"))
    assert not any("by the test" in event for event in loop.notes.events)


def test_a_model_writes_once_the_robot_has_turned_round():
    script = (
        "```python\nr = robot()['position']\ngive_trajectory([line(r, (r[0] + 1.0, r[1]))])\n```"
    )
    with serving(saying("no code", script)) as server:
        loop = by_model(server).run(60)
    facts = loop.service.result().task()
    assert loop.service.status.phase == "reached", loop.notes.events
    assert [bool(said.error) for said in facts.rounds] == [True, False]
    assert "Drive a little way." in facts.prompt
    assert facts.writer == f"default at {server.url}"
    assert [g.kind for g in loop.notes.goals[:3]] == ["trajectory"] * 3
    assert any(event.startswith("answer 1 of the model: ") for event in loop.notes.events)


def test_a_restarted_task_continues_with_the_first_undriven_step(tmp_path):
    task = f"{STRAIGHT}, then {TO_THE_OVEN}"
    loop = until(until(closed(task), "driving"), "looking")
    config = loop.config
    loop.service.checkpoint = ServiceCheckpoint(config, tmp_path / "c", task)
    loop.step()
    loop.service.checkpoint.close()
    again = ServiceCheckpoint(config, tmp_path / "c", None)
    spec = again.saved_spec()
    assert (spec.targets, spec.translation.instruction) == (("oven",), task)
    loop.service = Service(
        config, spec, loop.worker, make_policy(config.policy, config.path), [loop.notes], again
    )
    assert loop.service.mission.meter.elapsed_s > 1.0
    assert states(loop) == ["driven", "looked for"]
    sent = len(loop.notes.goals)
    loop.run(300)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.distance_m("oven") <= 1.0
    assert loop.notes.goals[sent].kind != "trajectory", "the first step is not driven again"
    again.close()

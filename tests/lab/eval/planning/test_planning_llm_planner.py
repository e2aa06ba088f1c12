"""The LLM-planner: the paper's prompt, answers read defensively, kinds of failures."""

from __future__ import annotations

import contextlib

import pytest
from chat_server import completion, send, serving
from small_house import small_house

from edge.host.ports import free_port
from edge.lab.eval.arms import make_arms
from edge.lab.eval.drive import in_process, run_episode
from edge.lab.eval.episodes import make_episode, sensing_settings
from edge.lab.eval.planning.delexicalised import compiled
from edge.lab.eval.planning.llm_planner import LlmPlanner, parse_answer
from edge.mission.logic.ltl import parse
from edge.mission.planning.planner import MissionKnowledge

MISSION = "Reach a bed and a couch in any order."
AUTOMATON = compiled(parse("F bed & F sofa"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("TARGET: bed", "bed"),
        ("target : the Potted Plant.", "houseplant"),
        ("Sure!\nTARGET: plant (it was seen)\nDONE", "houseplant"),
        ("<think>TARGET: couch? No, wa", None),
        ('"DONE".', None),
        ("TARGET:", None),
        ("TARGET: ", None),
        ("TARGET: DONE", None),
        ("\x00\ud800", None),
    ],
)
def test_answers(text, expected):
    assert parse_answer(text, ("bed", "houseplant", "sofa")) == expected


@contextlib.contextmanager
def planning(*rules: tuple[str, str]):
    """Return a planner and its server, which answers by the text of the question."""

    def behave(handler):
        (question,) = (m["content"] for m in server.requests[-1][2]["messages"])
        send(handler, completion(next(text for words, text in rules if words in question)))

    with serving(behave) as server:
        yield LlmPlanner(AUTOMATON, MISSION, server.url), server


@pytest.mark.parametrize(
    ("said", "knowledge", "target", "reason"),
    [
        ("TARGET: couch", MissionKnowledge(), "sofa", "chosen by the language model"),
        ("DONE", MissionKnowledge(), None, "names no target"),
        ("TARGET: piano", MissionKnowledge(), None, "names no target"),
        (
            "TARGET: bed",
            MissionKnowledge(failed=frozenset({"bed"})),
            None,
            "asks for bed, which failed",
        ),
    ],
)
def test_the_target_named_by_the_model_becomes_the_plan(said, knowledge, target, reason):
    with planning(("", said)) as (planner, server):
        plan = planner.plan(0, knowledge)
        assert planner.plan(0, knowledge) == plan
        assert len(server.requests) == 1  # the same question is asked once
    assert (plan.target, plan.feasible) == (target, target is not None)
    assert reason in plan.reason


def test_prompt_is_the_papers():
    with planning(("", "TARGET: bed")) as (planner, server):
        known = {"detected": frozenset({"television"}), "reached": frozenset({"houseplant"})}
        planner.plan(0, MissionKnowledge(**known, failed=frozenset({"sofa"})))
        (message,) = server.requests[0][2]["messages"]
    assert message["content"].splitlines() == [
        "Role: You are a navigation planner. Determine the next target object for an agent to "
        "satisfy the task as fast as possible.",
        f"Task: {MISSION}",
        "Rules: Follow the temporal ordering implied by the task. Revisiting objects is allowed. "
        'Output exactly: TARGET: <object> or "DONE".',
        "Current State:",
        "• Observed (known location, not yet reached): {tv}",
        "• Reached (in order): [potted plant]",
        "• Failed (unreachable): {couch}",
    ]


def test_no_progress_is_rejected_and_a_fulfilled_mission_asks_nothing():
    with planning(("", "TARGET: bed")) as (planner, server):
        bed = AUTOMATON.step(0, "bed")
        assert (
            "leads no further"
            in planner.plan(bed, MissionKnowledge(reached=frozenset({"bed"}))).reason
        )
        assert planner.plan(AUTOMATON.step(bed, "sofa"), MissionKnowledge()).feasible
        assert len(server.requests) == 1


@pytest.mark.parametrize(
    ("rules", "success", "reason"),
    [
        ([("[couch]", "TARGET: bed"), ("", "TARGET: couch")], True, "sofa, then bed"),
        ([("[bed]", "TARGET: couch"), ("", "TARGET: bed")], True, "bed, then sofa"),
        ([("[bed]", "DONE"), ("", "TARGET: bed")], False, "names no target"),
    ],
)
def test_a_column_of_missions_may_be_planned_by_a_model(tmp_path, rules, success, reason):
    config = small_house(tmp_path, mission={"time_limit_s": 90.0})
    with planning(*rules) as (_, server):
        planner = {
            "kind": "edge.lab.eval.planning.llm_planner:LlmPlanner",
            "options": {"url": server.url},
        }
        (arm,) = make_arms(config, {"llm": {"mission": {"planner": planner}}})
        start = (1.0, 2.0, 0.0)
        world = config.sim.world.model_dump(mode="json")
        episode = make_episode(
            world, "small", start, 5.0, sensing_settings(config), instruction=MISSION
        )
        outcome = run_episode(arm, episode, in_process)
    assert (outcome.success, reason in outcome.reason) == (success, True), outcome.reason


def test_an_unreachable_server_counts_as_a_crash(tmp_path):
    config = small_house(tmp_path)
    options = {"url": f"http://127.0.0.1:{free_port()}/v1"}
    planner = {"kind": "edge.lab.eval.planning.llm_planner:LlmPlanner", "options": options}
    (arm,) = make_arms(config, {"llm": {"mission": {"planner": planner}}})
    world = config.sim.world.model_dump(mode="json")
    episode = make_episode(world, "small", (1.0, 2.0, 0.0), 5.0, {}, instruction=MISSION)
    outcome = run_episode(arm, episode, in_process)
    assert outcome.failure == "crashed"
    assert options["url"] in outcome.reason

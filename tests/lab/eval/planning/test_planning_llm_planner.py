"""The LLM-planner: the paper's prompt, answers read defensively, kinds of failures."""

from __future__ import annotations

import contextlib
import re
import threading

import pytest
from chat_server import completion, send, serving
from small_house import small_house

from edge.chat import ChatError, TokenLimitError
from edge.host.ports import free_port
from edge.lab.eval.arms import make_arms
from edge.lab.eval.drive import in_process, run_episode
from edge.lab.eval.episodes import make_episode, sensing_settings
from edge.lab.eval.planning.delexicalised import compiled, delexicalise
from edge.lab.eval.planning.executor import (
    COMPLETE,
    DONE,
    GAVE_UP,
    INVALID,
    NO_ANSWER,
    VIOLATED,
    PlannerInput,
    PlanningProblem,
)
from edge.lab.eval.planning.llm_planner import (
    MAX_QUESTIONS,
    LlmPlanner,
    llm_chooser,
    merged,
    parse_answer,
    prompt,
    run_llm,
)
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.sweep import NOT_RUN, Settings, run_tasks
from edge.lab.eval.planning.templates import SPOKEN, BenchmarkTask, generate
from edge.mission.logic.ltl import parse, propositions
from edge.mission.planning.planner import MissionKnowledge

FORMULA = parse("F (bed & F houseplant) & G !sofa")
SENTENCE = "Reach a bed and then a potted plant. Never reach a couch."
TASK = BenchmarkTask(7, "own", propositions(FORMULA), SENTENCE, FORMULA)
SETTINGS = Settings(("vitl",), (1.0,))


class Model:
    """Answers like a chat client, by a function of the question."""

    def __init__(self, answer) -> None:
        self.answer, self.asked, self.options = answer, [], {}
        self._lock = threading.Lock()

    def ask(self, messages, **options):
        assert [m["role"] for m in messages] == ["user"]
        with self._lock:
            self.asked.append(messages[0]["content"])
            self.options = options
        return self.answer(messages[0]["content"])


def answers_in_turn(*answers):
    todo = list(answers)
    return lambda question: todo.pop(0)


def run_one(answer):
    model = Model(answer)
    results, failure = run_llm([TASK], [0], SETTINGS, model)
    assert failure is None
    return int(results.outcome.item()), model


def test_prompt_is_the_papers():
    # World: bed, houseplant, sofa, then chair, toilet, television.
    text = prompt(TASK, PlannerInput(0, seen=0b110011, reached=0b1, order=(0, 0)))
    assert text.splitlines() == [
        "Role: You are a navigation planner. Determine the next target object for an agent to "
        "satisfy the task as fast as possible.",
        f"Task: {SENTENCE}",
        "Rules: Follow the temporal ordering implied by the task. Revisiting objects is allowed. "
        'Output exactly: TARGET: <object> or "DONE".',
        "Current State:",
        "• Observed (known location, not yet reached): {potted plant, toilet, tv}",
        "• Reached (in order): [bed, bed]",
        "• Failed (unreachable): {}",
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("TARGET: bed", 0),
        ("target : the Potted Plant.", 1),
        ("Sure!\nTARGET: plant (it was seen)\nDONE", 1),
        ("<think>TARGET: couch? No, wa", INVALID),
        ('"DONE".', DONE),
        ("TARGET:", INVALID),
        ("TARGET: ", INVALID),
        ("TARGET: DONE", INVALID),
        ("\x00\ud800", INVALID),
    ],
)
def test_answers(text, expected):
    assert parse_answer(text, ("bed", "houseplant", "sofa")) == expected


@pytest.mark.parametrize(
    ("answers", "outcome"),
    [
        (("TARGET: bed", "TARGET: potted plant"), COMPLETE),
        (("TARGET: bed", "DONE"), GAVE_UP),  # the paper's case 2
        (("TARGET: couch",), VIOLATED),  # the paper's case 1
        (("TARGET: bed", "what?"), NO_ANSWER),
        # An object that the task does not name is a detour, not a failure.
        (("TARGET: tv", "TARGET: bed", "TARGET: plant"), COMPLETE),
    ],
)
def test_outcomes(answers, outcome):
    assert run_one(answers_in_turn(*answers))[0] == outcome


def test_rambling_is_the_models_failure_and_going_in_circles_ends():
    def rambling(*words):
        def ramble(question):
            raise TokenLimitError("too long", words[question.count("[bed")])

        return ramble

    assert run_one(rambling("The task is to"))[0] == NO_ANSWER
    assert run_one(rambling("TARGET: bed\nWhy? Be", "TARGET: potted plant. Be"))[0] == COMPLETE
    outcome, model = run_one(lambda question: "TARGET: bed")
    assert outcome == NO_ANSWER
    assert len(model.asked) == MAX_QUESTIONS


def test_same_question_is_asked_once():
    asked = []
    choose = llm_chooser(TASK, lambda q: asked.append(q) or "TARGET: bed")
    for draw in (0.1, 0.9):
        assert choose(PlannerInput(0, draw=draw)) == 0
    assert len(asked) == 1


def perfect(tasks):
    """Answer as the optimal planner does, from the prompt's text alone."""
    by_sentence = {task.sentence: task for task in tasks}

    def answer(question):
        task = by_sentence[re.search(r"Task: (.*)", question)[1]]
        lifted = delexicalise(task.formula)
        problem = PlanningProblem.of(lifted.automaton, lifted.others)
        spoken = [SPOKEN.get(name, name) for name in task.objects]
        order = re.search(r"order\): \[(.*)\]", question)[1].split(", ")
        reached = [spoken.index(word) for word in order if word]
        observed = re.search(r"reached\): \{(.*)\}", question)[1].split(", ")
        state, seen = 0, sum(1 << spoken.index(word) for word in observed if word in spoken)
        for i in reached:
            state, seen = problem.moves[state, i], seen | 1 << i
        target = PLANNERS["optimal"].make(problem)(1.0)(PlannerInput(state, seen))
        return f"TARGET: {spoken[target]}"

    return answer


def test_a_perfect_model_is_as_good_as_the_optimum():
    tasks = generate(30)
    settings = Settings(("optimal",), (1.0,))
    rows, told = [3, 11, 29], []
    offline = run_tasks(tasks, settings)
    own, failure = run_llm(
        tasks, rows, settings, Model(perfect(tasks)), jobs=3, progress=told.append
    )
    assert failure is None
    assert told == [1, 2, 3]
    both = merged(offline, own)
    assert both.planners == ("optimal", "llm")
    assert both.complete[1, 0, rows].all()
    assert (both.explorations[1, 0, rows] == both.explorations[0, 0, rows]).all()
    assert (both.outcome[1] == NOT_RUN).sum() == 27


def test_a_failing_server_ends_the_runs_without_a_verdict():
    questions = []

    def answer(question):
        questions.append(question)
        if len(questions) > 2:
            raise ChatError("http://x: no answer")
        return "TARGET: bed"

    tasks = [TASK, *generate(5)]
    results, failure = run_llm(tasks, range(6), SETTINGS, Model(answer))
    assert str(failure) == "http://x: no answer"
    assert (results.outcome == NOT_RUN).all()
    assert len(questions) == 3


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("a bug")])
def test_results_before_an_error_are_kept(error):
    def progress(done):
        if done == 2:
            raise error

    tasks = generate(6)
    results, failure = run_llm(tasks, range(6), SETTINGS, Model(perfect(tasks)), progress=progress)
    assert failure is error
    assert (results.outcome == COMPLETE).sum() == 2
    assert (results.outcome == NOT_RUN).sum() == 4


# -- in the loop ----------------------------------------------------------------------------------

MISSION = "Reach a bed and a couch in any order."
AUTOMATON = compiled(parse("F bed & F sofa"))


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

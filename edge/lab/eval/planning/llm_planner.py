"""The LLM-planner of ViTL V-C: a language model that is asked for every next target."""

from __future__ import annotations

import math
import os
import re
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

import numpy as np

from edge import names
from edge.chat import ChatClient, ChatError, TokenLimitError
from edge.lab.eval.planning.delexicalised import delexicalise, world_of
from edge.lab.eval.planning.executor import (
    DONE,
    INVALID,
    ChooseTarget,
    EpisodeResult,
    PlannerInput,
    PlanningProblem,
    draws_of,
    run_episode,
)
from edge.lab.eval.planning.report import LLM
from edge.lab.eval.planning.sweep import Settings, SweepResults, empty_results
from edge.lab.eval.planning.templates import SPOKEN, BenchmarkTask
from edge.mission.logic.automaton import Automaton
from edge.mission.planning.plan import ACCEPTED, DEAD
from edge.mission.planning.planner import MissionKnowledge, TargetPlan

MAX_QUESTIONS = 50
"""Most different questions in a run; after that the answer is `INVALID`.

A run that sees all six objects and reaches twice as many as any task needs takes fewer than 30.
"""

OPTIONS = {"temperature": 0, "max_tokens": 512}  # of each request to the model

# The paper's prompt box, word for word.
PROMPT = """\
Role: You are a navigation planner. Determine the next target object for an agent to satisfy \
the task as fast as possible.
Task: {task}
Rules: Follow the temporal ordering implied by the task. Revisiting objects is allowed. \
Output exactly: TARGET: <object> or "DONE".
Current State:
• Observed (known location, not yet reached): {{{observed}}}
• Reached (in order): [{reached}]
• Failed (unreachable): {{{failed}}}"""

# "TARGET: <potted plant>", "target: **bed**": group 1 is the object, up to a punctuation mark.
_TARGET = re.compile(r"TARGET\s*:\s*[^\w\n]*([^\n.,;:()<>\"'*`]+)", re.IGNORECASE)
_DONE = re.compile(r"\bDONE\b", re.IGNORECASE)
# Reasoning before the answer, perhaps cut off.
_THOUGHT = re.compile(r"<think>.*?(</think>|$)", re.DOTALL)


def prompt(task: BenchmarkTask, known: PlannerInput) -> str:
    """Return the question for the model. No object of the benchmark fails, so that set is empty."""
    spoken = [SPOKEN.get(name, name) for name in world_of(task.objects)]
    observed = known.seen & ~known.reached  # bit masks, by object
    return PROMPT.format(
        task=task.sentence,
        observed=", ".join(word for i, word in enumerate(spoken) if observed >> i & 1),
        reached=", ".join(spoken[i] for i in known.order),
        failed="",
    )


def parse_answer(text: str, objects: Sequence[str]) -> int:
    """Return an answer as index into `objects` (canonical names), `DONE`, or `INVALID`.

    >>> parse_answer("TARGET: <potted plant>", ["bed", "houseplant"])
    1
    """
    text = _THOUGHT.sub("", text)
    target = _TARGET.search(text)
    if target is None:
        return DONE if _DONE.search(text) else INVALID
    try:
        return list(objects).index(names.canonical(target[1]))
    except ValueError:
        return INVALID


class LlmPlanner:
    """The LLM-planner in the service: a plugin for `mission.planner.kind`.

    It asks the model again if an object was seen, reached or failed, and the tick waits for the
    answer. It is for evaluations in lockstep. It obeys the model even if that breaks the mission.
    The mission fails if the model names no target that leads on, or says DONE too early.

    Args:
        url, model, api_key_env, time_limit_s: see `mission.translator.kind: llm`.

    Raises:
        ChatError: the URL or the key cannot be used; from `plan`, no usable answer.
    """

    def __init__(
        self,
        automaton: Automaton,
        instruction: str,
        url: str,
        model: str = "default",
        api_key_env: str = "OPENAI_API_KEY",
        time_limit_s: float = 30.0,
    ) -> None:
        self._automaton, self._instruction = automaton, instruction
        self._client = ChatClient(url, model, os.environ.get(api_key_env), time_limit_s)
        self._reached: list[str] = []
        self._answers: dict[str, str | None] = {}

    def plan(
        self, state: int, knowledge: MissionKnowledge, current: str | None = None
    ) -> TargetPlan:
        """Return the model's next target. See `Planner.plan`; costs are steps."""
        automaton = self._automaton
        if automaton.accepting[state]:
            return ACCEPTED
        if automaton.steps_left[state] < 0:
            return DEAD
        self._reached += sorted(knowledge.reached - set(self._reached))
        target = self._ask_model(knowledge)
        if target is None:
            return _no_plan("the language model names no target")
        if target in knowledge.failed:
            return _no_plan(f"the language model asks for {target}, which failed")
        if automaton.step(state, target) == state:
            return _no_plan(f"the language model asks for {target}, which leads no further")
        reason = "chosen by the language model"
        return TargetPlan(target, (target,), 1.0, True, (), reason, ((target, 1.0),))

    def _ask_model(self, knowledge: MissionKnowledge) -> str | None:
        """Return the proposition that the model names; None if it names none."""
        question = PROMPT.format(
            task=self._instruction,
            observed=_spoken(sorted(knowledge.detected)),
            reached=_spoken(self._reached),
            failed=_spoken(sorted(knowledge.failed)),
        )
        if question not in self._answers:
            try:
                answer = self._client.ask([{"role": "user", "content": question}], **OPTIONS)
            except TokenLimitError as error:
                answer = error.answer
            index = parse_answer(answer, self._automaton.propositions)
            self._answers[question] = (
                None if index in (DONE, INVALID) else self._automaton.propositions[index]
            )
        return self._answers[question]


def _spoken(objects: Sequence[str]) -> str:
    """Join objects by the paper's words for them."""
    return ", ".join(SPOKEN.get(name, name) for name in objects)


def _no_plan(reason: str) -> TargetPlan:
    return TargetPlan(None, (), math.inf, False, (), reason, ())


def llm_chooser(task: BenchmarkTask, ask: Callable[[str], str]) -> ChooseTarget:
    """Return a planner that asks the model. It asks the same question only once a run.

    A failed attempt that shows nothing new does not change the question. So this is the paper's
    "re-queried whenever the environment state changes".
    """
    objects = world_of(task.objects)
    answers: dict[str, int] = {}

    def choose(known: PlannerInput) -> int:
        question = prompt(task, known)
        if question not in answers:
            if len(answers) == MAX_QUESTIONS:
                return INVALID
            try:
                answers[question] = parse_answer(ask(question), objects)
            except TokenLimitError as error:  # too long, but it may have named its target
                answers[question] = parse_answer(error.answer, objects)
        return answers[question]

    return choose


def run_llm(
    tasks: Sequence[BenchmarkTask],
    rows: Sequence[int],
    settings: Settings,
    client: ChatClient,
    jobs: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[SweepResults, BaseException | None]:
    """Run the LLM-planner on some of the tasks, with the random numbers of the other planners.

    Args:
        tasks: all tasks.
        rows: indices of the tasks to run.
        settings: the settings; each of their p_obs, the probability that an exploration finds its
            target, is run.
        client: asks the model.
        jobs: number of questions at the same time.
        progress: called with the number of episodes done so far.

    Returns:
        Results for all tasks, most of them not run, and the error that ended the runs early. No
        error is raised, not even Ctrl-C, so that the caller can report the results first. If the
        server fails, which is not the planner's fault, the episode counts as not run.
    """
    settings = settings._replace(planners=(LLM,))
    results = empty_results(tasks, settings)
    stop = threading.Event()

    def run(row: int, j: int, e: int) -> EpisodeResult | None:
        """Run episode `e` of a task at the j-th p_obs; None if it was stopped."""
        task, p_obs = tasks[row], settings.p_obs[j]
        delexicalised = delexicalise(task.formula)

        def ask(question: str) -> str:
            return client.ask([{"role": "user", "content": question}], **OPTIONS)

        choose = llm_chooser(task, ask)
        draws = draws_of(settings.seed, task.id, p_obs, e)
        problem = PlanningProblem.of(delexicalised.automaton, delexicalised.others)
        try:
            episode = run_episode(
                problem, p_obs, lambda s: DONE if stop.is_set() else choose(s), draws
            )
        except ChatError:
            stop.set()  # before the pool's next episode asks the failed server again
            raise
        return None if stop.is_set() else episode

    failure: BaseException | None = None
    pool = ThreadPoolExecutor(jobs)
    try:
        futures = {
            pool.submit(run, row, j, e): (row, j, e)
            for row in rows
            for j in range(len(settings.p_obs))
            for e in range(settings.episodes)
        }
        for done, future in enumerate(as_completed(futures), start=1):
            row, j, e = futures[future]
            episode = future.result()
            if episode is not None:
                at = (0, j, row, e)  # (planner, p_obs, task, episode)
                results.outcome[at], results.explorations[at], results.steps[at] = episode
            progress(done)
    except BaseException as error:
        failure = error
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)  # a pending question may take a minute
    return results, failure


def merged(a: SweepResults, b: SweepResults) -> SweepResults:
    """Return the results of the planners of both, on the same tasks and p_obs."""
    return SweepResults(
        a.planners + b.planners,
        a.p_obs,
        np.concatenate([a.outcome, b.outcome]),
        np.concatenate([a.explorations, b.explorations]),
        np.concatenate([a.steps, b.steps]),
        a.bound,
    )

"""The LLM-planner of ViTL V-C: a language model that is asked for the next target."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence

from edge import names
from edge.chat import ChatClient, TokenLimitError
from edge.lab.eval.planning.templates import SPOKEN
from edge.mission.logic.automaton import Automaton
from edge.mission.planning.plan import ACCEPTED, DEAD
from edge.mission.planning.planner import MissionKnowledge, TargetPlan

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
# Reasoning before the answer, perhaps cut off.
_THOUGHT = re.compile(r"<think>.*?(</think>|$)", re.DOTALL)


def parse_answer(text: str, objects: Sequence[str]) -> str | None:
    """Return the object (a canonical name) that an answer names; None for "DONE" and all else.

    >>> parse_answer("TARGET: <potted plant>", ["bed", "houseplant"])
    'houseplant'
    """
    target = _TARGET.search(_THOUGHT.sub("", text))
    try:
        name = None if target is None else names.canonical(target[1])
    except names.NotANameError:
        return None
    return name if name in objects else None


class LlmPlanner:
    """The LLM-planner in the service: a plugin for `mission.planner.kind`.

    It asks the model again if an object was seen, reached or failed, and the tick waits for the
    answer. It is for evaluations in lockstep. It obeys the model even if that breaks the mission.
    The mission fails if the model names no target that leads on, or says DONE too early.

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
            except TokenLimitError as error:  # too long, but it may have named its target
                answer = error.answer
            self._answers[question] = parse_answer(answer, self._automaton.propositions)
        return self._answers[question]


def _spoken(objects: Sequence[str]) -> str:
    """Join objects by the paper's words for them."""
    return ", ".join(SPOKEN.get(name, name) for name in objects)


def _no_plan(reason: str) -> TargetPlan:
    return TargetPlan(None, (), math.inf, False, (), reason, ())

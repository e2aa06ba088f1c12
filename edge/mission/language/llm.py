"""Translator backend `llm`: a language model writes the formula, and nothing it says is trusted.

One question per instruction, and a second one when the answer is no formula, or speaks of an
object that the instruction does not name. ViTL (IV-A1) translates with an LLM in the same way;
the prompt here is our own.
"""

from __future__ import annotations

import logging
import re
import time
from typing import Any

from edge import names
from edge.chat import CutOffError, client_of
from edge.config import TranslatorLlm
from edge.errors import UserError
from edge.mission.language.english import describe
from edge.mission.language.formula_grammar import gbnf
from edge.mission.language.grounding import objects_in
from edge.mission.ltl import Formula, FormulaError, parse, postorder, propositions
from edge.mission.translate import Translation, TranslationError, validated
from edge.text import one_line

log = logging.getLogger("edge.mission")

MAX_TOKENS = 256  # six objects in three branches with two conditions take about 120
MAX_FORMULA_CHARACTERS = 4000
SHOWN_TO_MODEL = 500  # characters of a wrong answer
SHOWN_TO_USER = 80

SYSTEM = """\
Translate the instruction to a home robot into one formula of linear temporal logic. Answer with \
the formula only.
At every step the robot reaches one object. The name of an object is a proposition: it is true in \
the step in which the robot reaches that object. Every action on an object (go to, find, clean, \
turn on) just means to reach it. Use the names of the instruction, in double quotes if they have \
several words.
F a: reach a.
F (a & F b): reach a, and then b.
F a & F b: reach a and b, in any order.
F (a | b): reach a or b.
!a W b: do not reach a until b is reached.
G !a: never reach a.
F (a & X F a): reach a twice."""

EXAMPLES = (
    ("Go to the oven.", "F oven"),
    ("Find a towel and then a mirror, or find a clock.", "F (towel & F mirror) | F clock"),
    (
        "Wipe the coffee table and the desk, but do not go to the desk before the lamp.",
        'F "coffee table" & F desk & (!desk W lamp)',
    ),
    (
        "First look at the piano or the vase, then at the bench. Never go near the stove.",
        "F ((piano | vase) & F bench) & G !stove",
    ),
)


class LlmTranslator:
    """A `Translator` that asks the server of its configuration.

    Raises:
        ChatError: the server's URL or the API key cannot be used.
    """

    def __init__(self, config: TranslatorLlm) -> None:
        self._config = config
        self._client = client_of(config)

    def translate(self, instruction: str) -> Translation:
        """The instruction's formula, its propositions canonical names that the instruction names.

        Raises:
            TranslationError: the instruction names no object, or no answer was a usable formula.
            ChatError: the server failed, or gave no answer within `time_limit_s` (for both
                attempts together).
        """
        begin_s, url = time.monotonic(), self._client.url
        objects = objects_in(instruction)
        if not objects:
            raise TranslationError(f"no object to reach is named in {one_line(instruction, 100)!r}")
        messages = conversation(instruction)
        options = {"temperature": 0, **constraint(self._config.constrain, objects)}
        for attempts in (1, 2):
            left_s = self._config.time_limit_s - (time.monotonic() - begin_s)
            try:
                answer = self._client.ask(messages, left_s=left_s, **options)
                formula = read(answer, objects)
            except CutOffError as error:
                answer, fault = error.answer, "the formula does not come to an end"
            except (FormulaError, _UnusableError) as error:
                fault = str(error)
            else:
                _report_left_out(formula, objects)
                seconds = time.monotonic() - begin_s
                return Translation(
                    instruction, formula, describe(formula), "llm", seconds, attempts
                )
            messages += repair(answer, fault)
        shown = one_line(bare(answer), SHOWN_TO_USER)
        raise TranslationError(
            f"no translation: {url} answered {shown!r}: {one_line(fault)}; "
            "say it in other words, or use a larger model"
        )


class _UnusableError(UserError):
    """A formula that must not be carried out; the message is for the model, and for the user."""


def make(config: TranslatorLlm) -> LlmTranslator:
    """The translator that a configuration describes.

    Raises:
        ChatError: the server's URL or the API key cannot be used.
    """
    return LlmTranslator(config)


def conversation(instruction: str) -> list[dict[str, str]]:
    """The messages that ask for an instruction's formula."""
    messages = [{"role": "system", "content": SYSTEM}]
    for sentence, formula in EXAMPLES:
        messages.append({"role": "user", "content": sentence})
        messages.append({"role": "assistant", "content": formula})
    return [*messages, {"role": "user", "content": instruction}]


def repair(answer: str, fault: str) -> list[dict[str, str]]:
    """The messages that ask for a better formula."""
    wanted = f"This is wrong: {fault}. Answer with the corrected formula only."
    return [
        {"role": "assistant", "content": answer[:SHOWN_TO_MODEL] or "..."},
        {"role": "user", "content": wanted},
    ]


def constraint(kind: str, objects: tuple[str, ...]) -> dict[str, Any]:
    """The fields of a request that keep its answer to formulas about `objects`.

    Without a grammar no limit of tokens is asked for: hosted models name that field differently,
    and spend tokens on thinking; the limits of time and size hold all the same.

    Args:
        kind: "gbnf" (llama.cpp), "guided_grammar" (vLLM, 0.11 or newer) or "none".
    """
    if kind == "none":
        return {}
    grammar = gbnf(objects)
    # vLLM took this as the field `guided_grammar` until 0.12, and has ignored that one since.
    field = {"grammar": grammar} if kind == "gbnf" else {"structured_outputs": {"grammar": grammar}}
    return {"max_tokens": MAX_TOKENS, **field}


def read(answer: str, objects: tuple[str, ...]) -> Formula:
    """The formula in a model's answer, its propositions replaced by their canonical names.

    Args:
        objects: what the instruction names; anything else is refused, as a robot must not set
            out for what a model made up.

    Raises:
        FormulaError: the answer is no formula.
        UserError: it is too long, or speaks of other things than the objects, or of none.
    """
    text = bare(answer)
    if len(text) > MAX_FORMULA_CHARACTERS:
        raise _UnusableError(f"the answer has {len(text)} characters; it must be one short formula")
    formula = renamed(parse(text))
    allowed = {names.canonical(phrase) for phrase in objects}
    strange = [name for name in propositions(formula) if name not in allowed]
    if strange:
        raise _UnusableError(
            f"the instruction names no {strange[0]!r}; it names {', '.join(objects[:20])}"
        )
    if not propositions(formula):
        raise _UnusableError("the formula speaks of no object")
    return validated(formula)


def bare(answer: str) -> str:
    """An answer without the wrapping that models like: thoughts, a code fence, a heading.

    >>> bare("```ltl\\nLTL: F chair\\n```")
    'F chair'
    """
    text = re.sub(r"\A\s*<think>.*?</think>", "", answer, flags=re.DOTALL).strip()
    if fenced := re.fullmatch(r"```\w*\n(.*?)\n?```", text, flags=re.DOTALL):
        text = fenced[1].strip()
    text = re.sub(r"\A(?:LTL|Formula|Answer|Output)(?: formula)?\s*[:=]\s*", "", text, flags=re.I)
    return text.strip("`").strip()


def renamed(formula: Formula) -> Formula:
    """The formula with every proposition replaced by its canonical name (`edge.names`).

    Raises:
        UserError: a proposition is no name at all.
    """
    done: dict[int, Formula] = {}
    for node in postorder(formula):
        name = _canonical(node.name) if node.op == "ap" else ""
        done[id(node)] = Formula(node.op, tuple(done[id(arg)] for arg in node.args), name)
    return done[id(formula)]


def _canonical(name: str) -> str:
    try:
        return names.canonical(name)
    except names.NotANameError as error:
        raise _UnusableError(str(error)) from None


def _report_left_out(formula: Formula, objects: tuple[str, ...]) -> None:
    """Say which known things of the instruction the formula leaves out: perhaps a prohibition."""
    known = dict.fromkeys(names.canonical(phrase) for phrase in objects if names.is_known(phrase))
    left_out = [name for name in known if name not in propositions(formula)]
    if left_out:
        log.warning("the formula leaves out %s; check what it says", ", ".join(left_out))

"""Translator `llm`: a language model writes the formula, and every answer is checked.

One request per instruction; a second one if the answer is no formula, or has an object that the
instruction does not name. ViTL (IV-A1) also translates with an LLM; this prompt is our own.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

from edge import names
from edge.chat import TokenLimitError, make_chat_client
from edge.config import TranslatorLlm
from edge.errors import UserError
from edge.mission.language.words import lexicon
from edge.mission.language.words.tokens import TranslationError
from edge.mission.logic.ltl import Formula, FormulaError, ap, parse, propositions, renamed, to_text
from edge.text import one_line

MOST_NAMES = 100  # names that the grammar lists; with more, it allows any quoted name
MOST_NESTING = 8  # depth of parentheses; a sequence of n objects needs n - 1
MOST_OPERANDS = 12  # operands of one & or |
SPARE = 3  # an object may occur several times: nesting and operands may exceed the number of names

# Operators in the grammar; they can express the others.
UNARY = ("!", "F ", "G ", "X ")
BINARY = (" W ", " U ")
# GBNF of a quoted name of up to 40 characters.
ANY_NAME = r'"\"" [^"\\\x00-\x1f] [^"\\\x00-\x1f]{0,39} "\""'


def gbnf(phrases: Sequence[str]) -> str:
    """Return the grammar of the formulas over `phrases`, in GBNF, the notation of llama.cpp.

    The number of phrases limits nesting and operands, so a model that repeats itself comes to an
    end. With more than `MOST_NAMES` phrases, every quoted name is allowed.

    >>> print(gbnf(["tv", "potted plant"]).splitlines()[1])
    name ::= "tv" | "\\"potted plant\\""
    """
    texts = dict.fromkeys(to_text(ap(phrase)) for phrase in phrases)
    name = ANY_NAME if len(texts) > MOST_NAMES else " | ".join(map(_literal, texts))
    nesting = min(len(texts) + SPARE, MOST_NESTING)
    operands = min(len(texts) + SPARE, MOST_OPERANDS)
    rules = {
        "root": f"first{nesting} (and{nesting} | or{nesting})?",
        "name": name,
        "unary": " | ".join(map(_literal, UNARY)),
        "binary": " | ".join(map(_literal, BINARY)),
    }
    for n in range(nesting + 1):
        rules |= _level(n, operands)
    return "\n".join(f"{rule} ::= {body}" for rule, body in rules.items()) + "\n"


def _level(n: int, operands: int) -> dict[str, str]:
    """Return the rules of formulas with at most `n` nested parentheses and `operands` per & or |.

    `first` may begin a conjunction, `timed` is any later part, and `signed` is one with operators
    before a name or before parentheses. `both` and `either` are parentheses around & and |.

    One pair of parentheses has only one kind of &, | or ->, so precedence does not matter. One step
    reaches one object, so `a & b` contradicts itself, and small models tend to continue it without
    end. Only the first part of a conjunction may be a bare name, and no part may be a conjunction.
    """
    times = f"{{1,{operands - 1}}}"
    rules = {
        f"first{n}": f"name | timed{n}",
        f"and{n}": f'(" & " timed{n}){times}',
        f"or{n}": f'(" | " first{n}){times} | " -> " timed{n}',
        f"timed{n}": f"signed{n} (binary first{n})?",
        f"signed{n}": "unary{1,3} name",
    }
    if n > 0:
        rules[f"both{n}"] = f'"(" first{n - 1} and{n - 1} ")"'
        rules[f"either{n}"] = f'"(" (first{n - 1} or{n - 1} | timed{n - 1}) ")"'
        rules[f"first{n}"] = f"name | timed{n} | both{n}"
        rules[f"signed{n}"] = f"unary{{1,3}} (name | both{n} | either{n}) | either{n}"
    return rules


def _literal(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


LONGEST_NAME = 5  # words in one name of the alias table
LONGEST_UNKNOWN = 3  # words in a name that the alias table does not have

ARTICLES = frozenset({"a", "an", "the", "some", "any", "my", "our"})
# Words that are no part of an object's name, unless the alias table has the name.
STOP_WORDS = frozenset(word for phrase in lexicon.TABLE for word in phrase) | ARTICLES
STOP_WORDS |= {"for", "from", "than", "how", "which", "who", "what", "s", "t", "doesn", "didn"}


def objects_in(instruction: str) -> tuple[str, ...]:
    """Return the phrases of an instruction that may name an object, in lower case, each once.

    The longest names of the alias table are found first; a name inside a longer one ("table" in
    "coffee table") is not returned. The remaining words between them and `STOP_WORDS` may be
    qualities of the name ("red chair"), or an unknown name.

    >>> objects_in("Go to the coffee table, then decorate the red potted plant.")
    ('coffee table', 'decorate', 'potted plant', 'red potted plant')
    >>> objects_in("Do not do that!")
    ()
    """
    found: list[str] = []
    for part in re.split(r"[^\w\s'’&\-]+", instruction.lower()):
        for named, run in groupby(_names_and_words(part), key=_may_name):
            if named:
                found += _phrases(list(run))
    return tuple(dict.fromkeys(found))


def _names_and_words(part: str) -> Iterator[str]:
    """Yield the known names in a part of an instruction (the longest ones), and other words."""
    words = re.findall(r"[^\W_]+|&", part)
    at = 0
    while at < len(words):
        length = 1
        if words[at] not in ARTICLES:  # `names` would include the article
            lengths = range(min(LONGEST_NAME, len(words) - at), 1, -1)
            known = (n for n in lengths if names.is_known(" ".join(words[at : at + n])))
            length = next(known, 1)
        yield " ".join(words[at : at + length])
        at += length


def _may_name(item: str) -> bool:
    return item not in STOP_WORDS or names.is_known(item)


def _phrases(run: list[str]) -> Iterator[str]:
    """Yield the possible names in a run of known names and unknown words."""
    before: list[str] = []
    for item in run:
        if names.is_known(item):
            yield item
            if 0 < len(before) <= LONGEST_UNKNOWN:
                yield " ".join((*before, item))
            before = []
        else:
            before.append(item)
    for first in range(len(before)):
        for end in range(first + 1, min(first + LONGEST_UNKNOWN, len(before)) + 1):
            yield " ".join(before[first:end])


log = logging.getLogger(__name__)

MAX_TOKENS = 256  # six objects in three branches with two conditions need about 120
MAX_FORMULA_CHARACTERS = 4000  # of an answer that is parsed
SHOWN_TO_MODEL = 500  # characters of a wrong answer
SHOWN_TO_USER = 80  # characters of a wrong answer

# The system prompt, and examples of instructions with their formulas.
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
    """Translator that asks the configured language model.

    Raises:
        ChatError: the server's URL or the API key cannot be used.
    """

    def __init__(self, config: TranslatorLlm, must_live: bool = False) -> None:
        self._config = config
        self._client = make_chat_client(config, must_live)

    def read(self, instruction: str) -> Formula:
        """Return the instruction's formula, with canonical names from the instruction only.

        Raises:
            TranslationError: the instruction names no object, or no answer was a usable formula.
            ChatError: the server failed, or gave no answer within `time_limit_s` (both requests
                together).
        """
        begin_s, url = time.monotonic(), self._client.url
        objects = objects_in(instruction)
        if not objects:
            raise TranslationError(
                f"instruction: {one_line(instruction, 100)!r} names no object to reach; name one"
            )
        messages = conversation(instruction)
        options = {"temperature": 0, **constraint(self._config.constrain, objects)}
        for _ in range(2):
            left_s = self._config.time_limit_s - (time.monotonic() - begin_s)
            try:
                answer = self._client.ask(messages, left_s=left_s, **options)
                formula = formula_in(answer, objects)
            except TokenLimitError as error:
                answer, fault = error.answer, "the formula does not come to an end"
            except (FormulaError, _UnusableError) as error:
                fault = str(error)
            else:
                _report_left_out(formula, objects)
                return formula
            messages += repair_messages(answer, fault)
        shown = one_line(strip_answer(answer), SHOWN_TO_USER)
        raise TranslationError(
            f"instruction: no translation: {url} answered {shown!r}: {one_line(fault)}; "
            "say it in other words, or use a larger model"
        )


class _UnusableError(UserError):
    """A formula that must not be carried out; the message goes to the model and to the user."""


def conversation(instruction: str) -> list[dict[str, str]]:
    """Return the messages that ask for an instruction's formula."""
    messages = [{"role": "system", "content": SYSTEM}]
    for sentence, formula in EXAMPLES:
        messages.append({"role": "user", "content": sentence})
        messages.append({"role": "assistant", "content": formula})
    return [*messages, {"role": "user", "content": instruction}]


def repair_messages(answer: str, fault: str) -> list[dict[str, str]]:
    """Return the messages that ask for a corrected formula."""
    wanted = f"This is wrong: {fault}. Answer with the corrected formula only."
    return [
        {"role": "assistant", "content": answer[:SHOWN_TO_MODEL] or "..."},
        {"role": "user", "content": wanted},
    ]


def constraint(kind: str, objects: tuple[str, ...]) -> dict[str, Any]:
    """Return the request fields that limit the answer to formulas about `objects`.

    Without a grammar there is no token limit: hosted models name that field differently, and use
    tokens for thinking. Limits of time and size still apply.

    Args:
        kind: "gbnf" (llama.cpp), "guided_grammar" (vLLM, 0.11 or newer) or "none".
        objects: names that the formula may use.
    """
    if kind == "none":
        return {}
    grammar = gbnf(objects)
    # vLLM had the field `guided_grammar` until 0.12; later versions ignore it.
    field = {"grammar": grammar} if kind == "gbnf" else {"structured_outputs": {"grammar": grammar}}
    return {"max_tokens": MAX_TOKENS, **field}


def formula_in(answer: str, objects: tuple[str, ...]) -> Formula:
    """Return the formula in a model's answer, with canonical names.

    Args:
        answer: the model's text.
        objects: names in the instruction. Other names are refused: the robot must not drive to
            an object that the model invented.

    Raises:
        FormulaError: the answer is no formula.
        UserError: it is too long, or it has another object, or none.
    """
    text = strip_answer(answer)
    if len(text) > MAX_FORMULA_CHARACTERS:
        raise _UnusableError(
            f"the answer has {len(text)} characters; it must be one formula of at most "
            f"{MAX_FORMULA_CHARACTERS}"
        )
    formula = renamed(parse(text), _canonical)
    allowed = {names.canonical(phrase) for phrase in objects}
    strange = [name for name in propositions(formula) if name not in allowed]
    if strange:
        raise _UnusableError(
            f"the instruction names no {strange[0]!r}; it names {', '.join(objects[:20])}"
        )
    if not propositions(formula):
        raise _UnusableError("the formula names no object")
    return formula


def strip_answer(answer: str) -> str:
    """Return an answer without thoughts, code fence and heading.

    >>> strip_answer("```ltl\\nLTL: F chair\\n```")
    'F chair'
    """
    text = re.sub(r"\A\s*<think>.*?</think>", "", answer, flags=re.DOTALL).strip()
    if fenced := re.fullmatch(r"```\w*\n(.*?)\n?```", text, flags=re.DOTALL):
        text = fenced[1].strip()
    text = re.sub(r"\A(?:LTL|Formula|Answer|Output)(?: formula)?\s*[:=]\s*", "", text, flags=re.I)
    return text.strip("`").strip()


def _canonical(name: str) -> str:
    try:
        return names.canonical(name)
    except names.NotANameError as error:
        raise _UnusableError(str(error)) from None


def _report_left_out(formula: Formula, objects: tuple[str, ...]) -> None:
    """Log a warning if the formula misses known objects of the instruction (maybe a ban)."""
    known = dict.fromkeys(names.canonical(phrase) for phrase in objects if names.is_known(phrase))
    left_out = [name for name in known if name not in propositions(formula)]
    if left_out:
        log.warning("mission: the instruction names %s, but the formula does not; check the "
                    "mission's meaning", ", ".join(left_out))  # fmt: skip

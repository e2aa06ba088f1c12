"""`edge eval translate`: how many instructions a translator gets right, by language equivalence.

Four sets: the 2000 tasks of the task-level benchmark (ViTL V-C); Lang2LTL's symbolic utterances
(Liu et al., CoRL 2023), whose formulas are about endless words; what people wrote for a robot in a
house of coloured rooms (Gopalan et al., RSS 2018); and sentences of one's own. A mission ends, so a
formula about endless words applies to the words that fulfil it when nothing more is reached
afterwards; it counts where there is such a word with one object or nothing per step. "Visit a for
ever" has none.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from edge.config import Translator as TranslatorConfig
from edge.config import TranslatorAuto, TranslatorGrammar, TranslatorLlm, TranslatorModel
from edge.config.mission import SMALL_TRANSLATOR
from edge.errors import UserError
from edge.host.bars import counted
from edge.host.files import open_regular, save
from edge.lab.eval.languages import difference, satisfiable, with_weak_untils
from edge.lab.eval.planning.templates import generate
from edge.mission.logic.ltl import (
    FALSE,
    STRENGTH,
    UNARY,
    Formula,
    FormulaError,
    ap,
    conj,
    disj,
    parse,
    renamed,
    to_text,
)
from edge.mission.translate import AmbiguousError, TranslationError, Translator, make_translator
from edge.perception.runtime.cards import load_card
from edge.text import aligned, one_line

_TASKS = 2000
_SHOWN_FAILURES = 5
_SHOWN_CHARS = 400  # of each


@dataclass(frozen=True, slots=True)
class Case:
    """An instruction with the formula it should give.

    Attributes:
        part: what it is counted under.
        others: further formulas that are right.
        endless: the formula is about endless words.
    """

    part: str
    sentence: str
    formula: Formula
    endless: bool = False
    others: tuple[Formula, ...] = ()


@dataclass(frozen=True, slots=True)
class Score:
    """How one case went.

    Attributes:
        outcome: "right", "right if weak" (once the reference's `!x U y` is read as the weak
            until), "wrong", "asked" (which of several readings is meant) or "refused".
        got: the translator's formula as text, or why it asked or refused.
        witness: a shortest word on which reference and translation differ.
    """

    case: Case
    outcome: str
    got: str
    witness: tuple[str, ...] = ()


OUTCOMES = ("right", "right if weak", "wrong", "asked", "refused")


def benchmark_cases(n: int, seed: int = 0) -> list[Case]:
    """The benchmark's tasks."""
    return [Case(task.template, task.sentence, task.formula) for task in generate(n, seed)]


@contextmanager
def _table(path: Path, what: str) -> Iterator[io.TextIOWrapper]:
    """Open a table of sentences.

    Raises:
        UserError: the file cannot be read, or is no such table.
    """
    try:
        with open_regular(path) as file:
            yield io.TextIOWrapper(file, encoding="utf-8", newline="")
    except (
        OSError, ValueError, csv.Error, KeyError, TypeError, AttributeError, FormulaError
    ) as error:  # fmt: skip
        raise UserError(f"{path}: not readable as {what}: {error!r}") from error


def lang2ltl_cases(path: Path) -> tuple[list[Case], Counter[str]]:
    """The utterances whose formulas a mission can fulfil, and how many others by pattern.

    Raises:
        UserError: the file cannot be read, or is no such table.
    """
    cases: list[Case] = []
    left_out: Counter[str] = Counter()
    with _table(path, "Lang2LTL's table") as file:
        for row in csv.DictReader(file):
            formula = from_prefix(row["ltl_formula"])
            if satisfiable(formula, silent_end=True):
                cases.append(Case(row["pattern_type"], row["utterance"], formula, True))
            else:
                left_out[row["pattern_type"]] += 1
    return cases, left_out


_ROOMS = {"B": "blue", "R": "red", "C": "green", "Y": "yellow"}
_ROOM = re.compile(
    r"\b(?:(?:large|small|big|little) )*(blue|red|green|yellow)"
    r"(?: (?:(?:rectangular|square|big|large|small|colored) )?"
    r"(?:rooms?|area|region|section|square|rectangle|rectangular|box|space|zone|block|one)\b)?",
    re.IGNORECASE,
)


def clean_up_cases(path: Path) -> tuple[list[Case], Counter[str]]:
    """The sentences that name the rooms of their formulas, "the blue" written "the blue room";
    how many others: they name other rooms, or a thing to be carried.

    Raises:
        UserError: the file cannot be read, or is no such table.
    """
    cases: list[Case] = []
    left_out: Counter[str] = Counter()
    with _table(path, "the clean-up table") as file:
        for line in file:
            row = json.loads(line)
            prefix = [_ROOMS.get(word, word) for word in row["raw_ltl"].split()]
            rooms = {word for word in prefix if word in _ROOMS.values() or word in "XZ"}
            said = {found[1].lower() for found in _ROOM.finditer(row["natural"])}
            part = " ".join("r" if word in rooms else word for word in prefix)
            if said != rooms:
                left_out[part] += 1
                continue
            formula = renamed(from_prefix(" ".join(prefix)), "{} room".format)
            sentence = _ROOM.sub(lambda found: f"{found[1].lower()} room", row["natural"])
            cases.append(Case(part, sentence, formula, True))
    return cases, left_out


TO_READ, MAY_REFUSE = "to be read", "may be refused or asked about"


def own_cases(path: Path) -> tuple[list[Case], Counter[str]]:
    """Sentences of one's own, in a table with tabs: a sentence in double quotes, as JSON has it,
    and a JSON list of the formulas that are right; an empty list among them says that refusing or
    asking is right. Without a formula any is wrong.

    Raises:
        UserError: the file cannot be read, or is no such table.
    """
    cases: list[Case] = []
    left_out: Counter[str] = Counter()
    with _table(path, "a table of sentences") as file:
        next(file, None)
        for line in file:
            said, right = (json.loads(cell) for cell in line.split("\t")[:2])
            if right == ["LONG"]:
                left_out[TO_READ] += 1
                continue
            part = MAY_REFUSE if [] in right else TO_READ
            formulas = tuple(parse(text) for text in right if text)
            cases.append(Case(part, said, formulas[0] if formulas else FALSE, others=formulas[1:]))
    return cases, left_out


def from_prefix(text: str) -> Formula:
    """The formula that prefix text writes, as Lang2LTL's data does: `& F a U ! b c`.

    `i` is implication and `e` equivalence; a word that is no operator is a proposition.

    Raises:
        ValueError: the text is no formula.
    """
    done: list[Formula] = []
    for word in reversed(text.split()):
        op = {"i": "->", "e": "<->"}.get(word, word)
        n = 1 if op in UNARY else 2 if op in STRENGTH else 0
        if n > len(done):
            raise ValueError(f"{text!r}: an operator lacks an operand")
        args = [done.pop() for _ in range(n)]
        if op in ("&", "|"):
            done.append(conj(*args) if op == "&" else disj(*args))
        else:
            done.append(Formula(op, tuple(args)) if n else ap(op))
    if len(done) != 1:
        raise ValueError(f"{text!r}: it is {len(done)} formulas")
    return done[0]


def score(case: Case, translator: Translator) -> Score:
    """One case, translated and compared.

    Raises:
        UserError: the translator failed, as a server does that is down, or the languages are
            beyond the compiler's limits; neither says anything about the translation.
    """
    try:
        formula = translator.translate(case.sentence).formula
    except AmbiguousError as error:
        return Score(case, "asked", str(error))
    except (TranslationError, FormulaError) as error:
        return Score(case, "refused", str(error))
    witness = difference(formula, case.formula, case.endless)
    if witness is None or any(difference(formula, other) is None for other in case.others):
        return Score(case, "right", to_text(formula))
    weak = with_weak_untils(case.formula)
    outcome = "wrong"
    if weak != case.formula and difference(formula, weak, case.endless) is None:
        outcome = "right if weak"
    return Score(case, outcome, to_text(formula), witness)


def summary(scores: Sequence[Score], left_out: Counter[str]) -> dict[str, Any]:
    """Counts by part and in total."""
    parts = dict.fromkeys([*(s.case.part for s in scores), *left_out])
    return {
        "cases": len(scores),
        **_counts(scores, left_out.total()),
        "parts": {
            part: _counts([s for s in scores if s.case.part == part], left_out[part])
            for part in parts
        },
    }


def _counts(scores: Sequence[Score], left_out: int) -> dict[str, int]:
    outcomes = Counter(s.outcome for s in scores)
    return {**{outcome: outcomes[outcome] for outcome in OUTCOMES}, "not_expressible": left_out}


def table(title: str, counts: dict[str, Any]) -> str:
    """What `summary` counts as aligned text."""
    columns = (*OUTCOMES, "not_expressible")
    rows = [[part, [count[c] for c in columns]] for part, count in counts["parts"].items()]
    rows.append(["all", [counts[c] for c in columns]])
    head = [title, "cases", *OUTCOMES, "not expressible"]
    lines = [head, *([name, sum(cells[:-1]), *cells] for name, cells in rows)]
    return aligned(lines, left=1)


def failure_lines(scores: Iterable[Score], translator: str) -> Iterator[str]:
    """What failed, one line of JSON each."""
    for s in scores:
        if s.outcome != "right":
            yield json.dumps({
                "translator": translator,
                "part": s.case.part,
                "sentence": s.case.sentence,
                "outcome": s.outcome,
                "expected": to_text(s.case.formula),
                "got": s.got,
                "differ_on": list(s.witness),
            }, ensure_ascii=False)  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """`edge eval translate`: tables on the screen, failures and counts into files.

    Raises:
        UserError: bad options; a file cannot be read or written; the scoring was stopped (what
            was done until then is printed and written before).
    """
    translators = {name: make_translator(_config(name, args)) for name in args.backend}
    sets = {VITL: (benchmark_cases(_TASKS, args.seed), Counter[str]())}
    if args.lang2ltl is None:
        print("Lang2LTL: skipped; give its table with --lang2ltl FILE", file=sys.stderr)
    else:
        sets[LANG2LTL] = lang2ltl_cases(args.lang2ltl)
    if args.clean_up is not None:
        sets[CLEAN_UP] = clean_up_cases(args.clean_up)
    if args.own is not None:
        sets["Own"] = own_cases(args.own)
    result: dict[str, Any] = {"seed": args.seed}
    failed: list[str] = []
    stopped_by: BaseException | None = None
    for (title, (cases, left_out)), (name, translator) in product(
        sets.items(), translators.items()
    ):
        began = time.perf_counter()
        scores, stopped_by = _scored(f"{title}, {name}", _sample(cases, args.limit), translator)
        seconds = time.perf_counter() - began
        counts = summary(scores, left_out)
        result.setdefault(title, {})[name] = {**counts, "seconds": round(seconds, 2)}
        lines = list(failure_lines(scores, name))
        failed += lines
        print(table(f"{title}, {name}", counts), *_shown(lines), sep="\n", end="\n\n")
        if stopped_by is not None:
            break
    print(overview(result, _not_seen() if set(args.backend) & set(_OF_THE_CARD) else {}))
    if args.failures is not None:
        save(args.failures, "".join(f"{line}\n" for line in failed).encode())
    if args.out is not None:
        save(args.out, f"{json.dumps(result, indent=2)}\n".encode())
    if stopped_by is not None:
        raise stopped_by
    return 0


VITL, LANG2LTL, CLEAN_UP = "ViTL tasks", "Lang2LTL", "Clean-up"
SEEN = {
    VITL: "made by code",
    LANG2LTL: "seen while the grammar was written, and by the model",
    CLEAN_UP: "seen while the grammar was written, and by the model",
}
"""Set → what is to be known of its figures."""
NOT_SEEN = "not seen by this model; seen while grammar and composer were written"
"""Said of figures of a model that did not learn from the set."""
_OF_THE_CARD = ("model", "auto")


def overview(result: dict[str, Any], not_seen: dict[str, dict[str, dict[str, int]]]) -> str:
    """One row for each set and translator, as shares.

    Args:
        result: set → translator → what `summary` counts; other entries are passed over.
        not_seen: set → translator → outcomes, of models that did not see the set.
    """
    rows = [["set", "translator", "cases", *OUTCOMES, ""]]
    for title, by in result.items():
        if isinstance(by, dict):
            rows += [_shares(title, name, told, SEEN.get(title, "")) for name, told in by.items()]
            rows += [
                _shares(title, name, told, NOT_SEEN)
                for name, told in not_seen.get(title, {}).items()
                if name in by
            ]
    return aligned(rows)


def _shares(title: str, name: str, told: dict[str, Any], note: str) -> list[str]:
    cases = sum(told[outcome] for outcome in OUTCOMES)
    shares = (f"{100 * told[outcome] / max(cases, 1):.1f} %" for outcome in OUTCOMES)
    return [title, name, str(cases), *shares, note]


def _not_seen() -> dict[str, dict[str, dict[str, int]]]:
    """What the small model's card tells of models that did not learn from a set."""
    measured = load_card(SMALL_TRANSLATOR).measured
    found = {
        title: {name: measured.get(f"{title.lower()}, not seen, {name}") for name in _OF_THE_CARD}
        for title in (LANG2LTL, CLEAN_UP)
    }
    return {title: {n: c for n, c in by.items() if c} for title, by in found.items()}


def _scored(
    title: str, cases: Sequence[Case], translator: Translator
) -> tuple[list[Score], BaseException | None]:
    """The scores, and what stopped it early.

    A server that fails is not asked again: at a time limit a case it would take hours to say so.
    """
    scores: list[Score] = []
    try:
        for case in counted(title, cases):
            scores.append(score(case, translator))
    except UserError as error:
        done = f"{len(scores)} of {len(cases)}"
        return scores, UserError(f"{title}: stopped after {done}: {error}")
    except KeyboardInterrupt as error:
        return scores, error
    return scores, None


def _shown(lines: Sequence[str]) -> Iterator[str]:
    """The first of the failures, for the screen."""
    for line in lines[:_SHOWN_FAILURES]:
        yield f"  {one_line(line, _SHOWN_CHARS)}"
    if len(lines) > _SHOWN_FAILURES:
        yield f"  … and {len(lines) - _SHOWN_FAILURES} more (--failures FILE lists them all)"


def _sample(cases: Sequence[Case], limit: int | None) -> Sequence[Case]:
    """Evenly spread, so that a small sample has every part."""
    if limit is None or limit >= len(cases):
        return cases
    return [cases[i * len(cases) // limit] for i in range(limit)]


def _config(name: str, args: argparse.Namespace) -> TranslatorConfig:
    if name != "llm":
        return {"grammar": TranslatorGrammar, "model": TranslatorModel, "auto": TranslatorAuto}[
            name
        ]()
    given = {"url": args.url, "model": args.model, "constrain": args.constrain}
    return TranslatorLlm(**{key: value for key, value in given.items() if value is not None})

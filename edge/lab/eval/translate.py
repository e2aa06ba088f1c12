"""`edge eval translate`: count correct translations of instructions, by language equivalence.

A mission ends, but some sets have formulas about infinite traces. Such a formula counts as true
for a finite trace if it holds for that trace with endless empty steps after it. If it holds for no
trace with at most one object per step, as "visit a for ever", the case counts as not expressible.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeVar

from edge.config import Translator as TranslatorConfig
from edge.config import TranslatorAuto, TranslatorGrammar, TranslatorLlm, TranslatorModel
from edge.errors import UserError
from edge.host.files import save
from edge.host.progress import with_progress
from edge.lab.eval.equivalence import distinguishing_trace, with_weak_untils
from edge.lab.eval.everyday import (
    everyday_cases,
    everyday_counts,
    everyday_failures,
    everyday_table,
    score_everyday,
)
from edge.lab.eval.translation_cases import (
    TranslationCase,
    benchmark_cases,
    clean_up_cases,
    custom_cases,
    lang2ltl_cases,
)
from edge.mission.logic.ltl import FormulaError, to_text
from edge.mission.translate import (
    AmbiguousInstructionError,
    TranslationError,
    Translator,
    make_translator,
)
from edge.text import format_table, one_line

Case = TypeVar("Case")

VITL, LANG2LTL, CLEAN_UP = "ViTL tasks", "Lang2LTL", "Clean-up"
"""Names of the sets; `edge.lab.eval.translation_cases` describes them."""
_TASKS = 2000  # tasks of the task-level benchmark
_SHOWN_FAILURES = 5  # failures on the screen, for each set and translator
_SHOWN_CHARS = 400  # of a failure on the screen


@dataclass(frozen=True, slots=True)
class TranslationScore:
    """The result of one case.

    Attributes:
        outcome: "right"; "right if weak" (right if the reference's `!x U y` is read as the weak
            until, which does not require y); "wrong"; "asked" (the translator asked which reading
            is meant); or "refused".
        got: the translator's formula as text, or its reason to ask or refuse.
        distinguishing_trace: a shortest trace on which reference and translation differ.
    """

    case: TranslationCase
    outcome: str
    got: str
    distinguishing_trace: tuple[str, ...] = ()


OUTCOMES = ("right", "right if weak", "wrong", "asked", "refused")


def score(case: TranslationCase, translator: Translator) -> TranslationScore:
    """Translate one case and compare it with the reference.

    Raises:
        UserError: the translator failed (for example its server is down), or a formula exceeds the
            compiler's limits. Neither judges the translation.
    """
    try:
        formula = translator.translate(case.sentence).formula
    except AmbiguousInstructionError as error:
        return TranslationScore(case, "asked", str(error))
    except (TranslationError, FormulaError) as error:
        return TranslationScore(case, "refused", str(error))
    difference = distinguishing_trace(formula, case.formula, case.endless)
    if difference is None or any(
        distinguishing_trace(formula, other) is None for other in case.others
    ):
        return TranslationScore(case, "right", to_text(formula))
    weak = with_weak_untils(case.formula)
    outcome = "wrong"
    if weak != case.formula and distinguishing_trace(formula, weak, case.endless) is None:
        outcome = "right if weak"
    return TranslationScore(case, outcome, to_text(formula), difference)


def summary(scores: Sequence[TranslationScore], left_out: Counter[str]) -> dict[str, Any]:
    """Count outcomes by part (group of cases) and in total.

    `left_out` is the number of cases that were left out, by part. They count as not expressible.
    """
    parts = dict.fromkeys([*(s.case.part for s in scores), *left_out])
    return {
        "cases": len(scores),
        **_counts(scores, left_out.total()),
        "parts": {
            part: _counts([s for s in scores if s.case.part == part], left_out[part])
            for part in parts
        },
    }


def _counts(scores: Sequence[TranslationScore], left_out: int) -> dict[str, int]:
    outcomes = Counter(s.outcome for s in scores)
    return {**{outcome: outcomes[outcome] for outcome in OUTCOMES}, "not_expressible": left_out}


def table(title: str, counts: dict[str, Any]) -> str:
    """Return the counts of `summary` as aligned text."""
    lines: list[list[object]] = [[title, "cases", *OUTCOMES, "not expressible"]]
    for part, count in {**counts["parts"], "all": counts}.items():
        outcomes = [count[outcome] for outcome in OUTCOMES]
        lines.append([part, sum(outcomes), *outcomes, count["not_expressible"]])
    cases = max(counts["cases"], 1)
    shares = (f"{100 * counts[outcome] / cases:.1f} %" for outcome in OUTCOMES)
    lines.append(["share", "", *shares, ""])
    return format_table(lines, left=1)


def failure_lines(scores: Iterable[TranslationScore], translator: str) -> Iterator[str]:
    """Yield each failure as a line of JSON."""
    for s in scores:
        if s.outcome != "right":
            yield json.dumps({
                "translator": translator,
                "part": s.case.part,
                "sentence": s.case.sentence,
                "outcome": s.outcome,
                "expected": to_text(s.case.formula),
                "got": s.got,
                "differ_on": list(s.distinguishing_trace),
            }, ensure_ascii=False)  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval translate`: print tables, write failures and counts to files.

    Raises:
        UserError: an option is wrong; a file cannot be read or written; or the scoring was stopped,
            after its results so far were printed and written.
    """
    if args.everyday is not None:
        return _run_everyday(args)
    translators = {name: make_translator(_config(name, args)) for name in args.backend}
    sets = {VITL: (benchmark_cases(_TASKS, args.seed), Counter[str]())}
    if args.lang2ltl is None:
        print("Lang2LTL: skipped; give its table with --lang2ltl FILE", file=sys.stderr)
    else:
        sets[LANG2LTL] = lang2ltl_cases(args.lang2ltl)
    if args.clean_up is not None:
        sets[CLEAN_UP] = clean_up_cases(args.clean_up)
    if args.own is not None:
        sets["Own"] = custom_cases(args.own)
    result: dict[str, Any] = {"seed": args.seed}
    failed: list[str] = []
    stopped_by: BaseException | None = None
    for (title, (cases, left_out)), (name, translator) in product(
        sets.items(), translators.items()
    ):
        began = time.perf_counter()
        scores, stopped_by = _score_all(f"{title}, {name}", _sample(cases, args.limit), translator)
        seconds = time.perf_counter() - began
        counts = summary(scores, left_out)
        result.setdefault(title, {})[name] = {**counts, "seconds": round(seconds, 2)}
        lines = list(failure_lines(scores, name))
        failed += lines
        print(table(f"{title}, {name}", counts), *_first_failures(lines), sep="\n", end="\n\n")
        if stopped_by is not None:
            break
    _save(args, failed, result)
    if stopped_by is not None:
        raise stopped_by
    return 0


def _run_everyday(args: argparse.Namespace) -> int:
    """Score everyday sentences with each translator; see `everyday`."""
    cases = _sample(everyday_cases(args.everyday), args.limit)
    failed: list[str] = []
    result: dict[str, Any] = {}
    for name in args.backend:
        scores = [score_everyday(case, _config(name, args)) for case in with_progress(name, cases)]
        lines = everyday_failures(scores, name)
        failed += lines
        result[name] = everyday_counts(scores)
        text = everyday_table(f"Everyday, {name}", result[name])
        print(text, *_first_failures(lines), sep="\n", end="\n\n")
    _save(args, failed, result)
    return 0


def _save(args: argparse.Namespace, failed: Sequence[str], result: dict[str, Any]) -> None:
    """Write failures and counts to the files of --failures and --out, if they are given."""
    if args.failures is not None:
        save(args.failures, "".join(f"{line}\n" for line in failed).encode())
    if args.out is not None:
        save(args.out, f"{json.dumps(result, indent=2)}\n".encode())


def _score_all(
    title: str, cases: Sequence[TranslationCase], translator: Translator
) -> tuple[list[TranslationScore], BaseException | None]:
    """Score cases until one fails; return the scores and the error that stopped it.

    After a failure of the server no more is asked: each case could take the entire time limit.
    """
    scores: list[TranslationScore] = []
    try:
        for case in with_progress(title, cases):
            scores.append(score(case, translator))
    except UserError as error:
        done = f"{len(scores)} of {len(cases)}"
        return scores, UserError(f"{title}: stopped after {done}: {error}")
    except KeyboardInterrupt as error:
        return scores, error
    return scores, None


def _first_failures(lines: Sequence[str]) -> Iterator[str]:
    for line in lines[:_SHOWN_FAILURES]:
        yield f"  {one_line(line, _SHOWN_CHARS)}"
    if len(lines) > _SHOWN_FAILURES:
        yield f"  … and {len(lines) - _SHOWN_FAILURES} more (--failures FILE lists them all)"


def _sample(cases: Sequence[Case], limit: int | None) -> Sequence[Case]:
    """Return `limit` evenly spaced cases, so that a small sample has every part."""
    if limit is None or limit >= len(cases):
        return cases
    return [cases[i * len(cases) // limit] for i in range(limit)]


def _config(name: str, args: argparse.Namespace) -> TranslatorConfig:
    if name != "llm":
        return {"grammar": TranslatorGrammar, "model": TranslatorModel, "auto": TranslatorAuto}[
            name
        ]()
    settings = {"url": args.url, "model": args.model, "constrain": args.constrain}
    return TranslatorLlm(**{key: value for key, value in settings.items() if value is not None})

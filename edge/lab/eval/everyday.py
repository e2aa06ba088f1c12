"""`edge eval translate --everyday`: test how everyday sentences are understood.

Each line of the file is a JSON object. `said` is the sentence, and `expect` is its correct kind:

- "mission", with its `formula`, and `minutes` or `seconds` for waits and other times;
- "question", `about` a name;
- "learn": remember a place, a room or a zone, `about` a name;
- "control": pause, resume, cancel or again;
- "ask": the service should ask what is meant;
- "refuse".

`meaning` has the meaning of a "learn" or "control" sentence in other words. `also` lists other
correct kinds. "ask" and "refuse" count as equal, because the robot does not move
in either case.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from edge import names
from edge.config import MissionConfig
from edge.config import Translator as TranslatorConfig
from edge.geometry import SE2
from edge.host.files import MAX_TEXT_BYTES
from edge.lab.eval.equivalence import distinguishing_trace
from edge.lab.eval.json_lines_file import read_lines
from edge.memory import Place, Site
from edge.mission.instructions import translate
from edge.mission.language.intents import Control, MemoryQuestion, NoMissionError, SiteOrder
from edge.mission.language.words.spans import DURATION, seconds_of
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import (
    Formula,
    ap,
    conj,
    neg,
    parse,
    postorder,
    propositions,
    renamed,
    to_text,
    weak_until,
)
from edge.mission.repetition import recurrence
from edge.mission.translate import TranslationError
from edge.text import format_table

SITE = Site(tuple(Place(name, SE2(1.0, 1.0, 0.0)) for name in ("dock", "shelf", "reception")))
"""The places that the sentences may name."""
OUTCOMES = ("right", "asked or refused", "wrong")
_ARTICLES = re.compile(r"\b(?:the|a|an|my|our|your) ")
# Examples of matches, by row: "forget the dock"; "you may enter the study again"; "stay inside the
# kitchen"; "keep out of the bath"; "a zone here"; "this place is the dock".
_LEARN = (
    (r"forget", ("forget",)),
    (r"\b(?:lift|remove)|\b(?:may|can|allow(?:ed)?)\b.* again|^(?:re-?)?open", ("open",)),
    (r"\bstay(?:ing)? (?:only |just )?(?:in|inside|within)\b|stay-inside|\bonly the\b"
     r"|\b(?:not|never) leave",
     ("stay_inside",)),
    (r"\b(?:ban|forbid|forbidden|prohibited|not|never|avoid|off limits|closed)\b"
     r"|\b(?:keep|stay)[- ](?:out|away|off)|no[- ]go", ("keep_out",)),
    (r"zone", ("stay_inside",)),
    (r"remember|\b(?:name|call|mark|save|store|label|learn|place|room|is)\b", ("place", "room")),
)  # fmt: skip
"""(pattern, orders `SiteOrder.do` that it means): `meaning` is searched first, then `said`.

The first match counts.
"""
_CONTROL = {
    "pause": "stop|wait|pause|halt|hold", "resume": "go on|continue|resume",
    "cancel": "cancel|abort|give up", "again": "again|repeat|once more",
}  # fmt: skip
"""`Control.do` → pattern that `meaning` must match."""


@dataclass(frozen=True, slots=True)
class EverydayScore:
    """The result of one sentence.

    Attributes:
        case: the line of the file.
        outcome: one of `OUTCOMES`.
        got: the formula, question or order that the sentence became, or the reason to refuse it.
    """

    case: dict[str, Any]
    outcome: str
    got: str


def everyday_cases(path: Path) -> list[dict[str, Any]]:
    """Read the sentences."""
    return read_lines(path, MAX_TEXT_BYTES, _parse_case, "a sentence", "see docs/language.md")


def _parse_case(data: dict[str, Any]) -> dict[str, Any]:
    if not all(isinstance(data.get(key), str) for key in ("said", "expect")):
        raise ValueError('expected the texts "said" and "expect"')
    return data


def score_everyday(case: dict[str, Any], translator: TranslatorConfig) -> EverydayScore:
    """Understand one sentence as the running service does, and judge it."""
    accepted = {case["expect"], *case.get("also", ())}
    outcome_if_refused = "right" if accepted & {"ask", "refuse"} else "asked or refused"
    try:
        found = translate(MissionConfig(translator=translator), case["said"], SITE)
        # A patrol repeats its mission: 0.0 is no patrol, None one without an end.
        formula, patrol_s = found.formula, found.repeat.limit_s if found.repeat else 0.0
        asks_for_anything = not compile_formula(formula).accepting[0]
    except NoMissionError as error:
        intent = error.intent
        right = _kind(intent) in accepted and _is_right(case, intent)
        return EverydayScore(case, "right" if right else "wrong", str(intent))
    except TranslationError as error:
        return EverydayScore(case, outcome_if_refused, str(error))
    if not asks_for_anything:
        return EverydayScore(case, outcome_if_refused, f"asks for nothing: {to_text(formula)}")
    right = "mission" in accepted and (
        "formula" not in case or _same_mission(case, formula, patrol_s)
    )
    return EverydayScore(case, "right" if right else "wrong", to_text(formula))


def _kind(intent: MemoryQuestion | SiteOrder | Control) -> str:
    """Return the kind of a sentence that is no mission, as in `expect`."""
    return {MemoryQuestion: "question", SiteOrder: "learn", Control: "control"}[type(intent)]


def _is_right(case: dict[str, Any], intent: MemoryQuestion | SiteOrder | Control) -> bool:
    """Return True if a question, an order or a control has the name and meaning of the case."""
    meaning, about = case.get("meaning", ""), _normalise(case.get("about", ""))
    if isinstance(intent, Control):
        is_meant = re.search(_CONTROL[intent.do], meaning) is not None
        return is_meant and _seconds(case) == (intent.seconds or 0)
    if isinstance(intent, SiteOrder):
        # The orders of the first row that matches; `meaning` is searched before the sentence.
        orders = next(
            (
                do
                for text in (meaning, case["said"])
                for words, do in _LEARN
                if re.search(words, text)
            ),
            (),
        )
        name = _normalise(intent.name or "this room")
        return intent.do in orders and name in (about, _normalise(f"{about} room"))
    # Without any name, a question about all rooms or all objects is right if the case names them.
    named = " in ".join(filter(None, (intent.about, intent.room)))
    return _normalise(named) == about if named else about != "" and intent.topic != "where"


def _normalise(name: str) -> str:
    """Return a name without articles, in canonical words: "lamp next to sofa"."""
    text = _ARTICLES.sub("", f"{name.lower()} ").strip()
    # "nearest lamp to sofa" becomes "lamp nearest to sofa".
    text = re.sub(r"^(?:nearest|closest) (.+?) to ", r"\1 nearest to ", text)
    for word, same in (("beside", "next to"), ("close to", "near"), ("inside", "in")):
        text = re.sub(rf"\b{word}\b", same, text)
    # Each part of "lamp next to sofa" gets its canonical name: "lamp next to", "sofa".
    return (
        " ".join(names.canonical(part) for part in re.split(r"(?<=next to) ", text)) if text else ""
    )


def _seconds(case: dict[str, Any]) -> float:
    """Return the expected time of a case [s]; 0.0 if it has none."""
    return float(60 * case.get("minutes", 0) + case.get("seconds", 0))


def _same_mission(case: dict[str, Any], got: Formula, patrol_s: float | None) -> bool:
    """Return True if formula and time agree; times are no part of the expected propositions.

    A sequence counts, too, if it also forbids each stop before the one that comes first, as "before
    you go to b, visit a" does. `got` is the formula of one round of a patrol, and `patrol_s` its
    time: 0.0 for no patrol, None for one without an end.
    """
    expected = parse(case["formula"])
    # The times within the names of propositions, such as "wait for 5 minutes".
    spans = [m[0] for name in propositions(got) for m in re.finditer(DURATION, name)]
    if sum(map(seconds_of, spans)) + (patrol_s or 0.0) != _seconds(case):
        return False
    timeless = renamed(got, lambda name: _normalise(re.sub(rf" (?:for )?{DURATION}$", "", name)))
    plain = renamed(expected, _normalise)
    # The expected formula may leave out waits.
    if "wait" in propositions(timeless) and "wait" not in propositions(plain):
        timeless = _without_waits(timeless)
    # `got` is one round of a patrol; so take one round of the expected formula, too.
    plain, _ = recurrence(plain, patrol_s != 0.0)
    stops = propositions(plain)
    # Also right: no stop may be reached before the one that comes first.
    strict = conj(plain, *(weak_until(neg(ap(b)), ap(a)) for a, b in pairwise(stops) if a != b))
    return any(distinguishing_trace(timeless, right) is None for right in (plain, strict))


def _without_waits(formula: Formula) -> Formula:
    """Return the formula without the proposition "wait": F(a & F wait) is F a."""
    done: dict[int, Formula | None] = {}  # by id of a node: its new formula; None: nothing is left
    for node in postorder(formula):
        if node.op == "ap":
            done[id(node)] = None if node.name == "wait" else node
            continue
        kept = tuple(arg for arg in (done[id(arg)] for arg in node.args) if arg is not None)
        if node.op in ("&", "|") and len(kept) == 1:
            done[id(node)] = kept[0]
        else:
            done[id(node)] = Formula(node.op, kept, node.name) if kept or not node.args else None
    found = done[id(formula)]
    return formula if found is None else found


def everyday_counts(scores: Sequence[EverydayScore]) -> dict[str, dict[str, int]]:
    """Count outcomes by `expect`, the correct kind of a sentence, and of all sentences."""
    parts = [*dict.fromkeys(s.case["expect"] for s in scores), "all"]
    found = {p: Counter(s.outcome for s in scores if p in ("all", s.case["expect"])) for p in parts}
    return {
        part: {outcome: counts[outcome] for outcome in OUTCOMES} for part, counts in found.items()
    }


def everyday_table(title: str, counts: Mapping[str, Mapping[str, int]]) -> str:
    """Return the counts of `everyday_counts` as aligned text."""
    rows: list[list[object]] = [[title, "cases", *OUTCOMES]]
    rows += [[part, sum(n.values()), *n.values()] for part, n in counts.items()]
    return format_table(rows, left=1)


def everyday_failures(scores: Iterable[EverydayScore], translator: str) -> list[str]:
    """Return each failure as a line of JSON."""
    return [
        json.dumps(
            {"translator": translator, "outcome": s.outcome, "got": s.got, **s.case},
            ensure_ascii=False,
        )
        for s in scores
        if s.outcome != "right"
    ]

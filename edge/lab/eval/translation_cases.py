"""Instructions with the formulas that they should give: four sets of cases.

There are the 2000 tasks of the task-level benchmark (ViTL V-C); Lang2LTL's symbolic utterances (Liu
et al., CoRL 2023), whose formulas are about infinite traces; instructions that people wrote for a
robot in a house of coloured rooms (Gopalan et al., RSS 2018); and a user's own sentences.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from edge.errors import UserError
from edge.host.files import open_regular
from edge.lab.eval.equivalence import satisfiable
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
)

# Parts of a user's own sentences.
TO_READ, MAY_REFUSE = "to be read", "may be refused or asked about"
# Letters of the rooms in the formulas of the clean-up table, and their colours.
_ROOMS = {"B": "blue", "R": "red", "C": "green", "Y": "yellow"}
_ROOM = re.compile(
    r"\b(?:(?:large|small|big|little) )*(blue|red|green|yellow)"
    r"(?: (?:(?:rectangular|square|big|large|small|colored) )?"
    r"(?:rooms?|area|region|section|square|rectangle|rectangular|box|space|zone|block|one)\b)?",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class TranslationCase:
    """An instruction with the formula that it should give.

    Attributes:
        part: group of cases; the counts are by group.
        endless: the formula is about infinite traces.
        others: more correct formulas.
    """

    part: str
    sentence: str
    formula: Formula
    endless: bool = False
    others: tuple[Formula, ...] = ()


def benchmark_cases(n: int, seed: int = 0) -> list[TranslationCase]:
    """Return the tasks of the benchmark."""
    return [TranslationCase(task.family, task.sentence, task.formula) for task in generate(n, seed)]


@contextmanager
def _table(path: Path, what: str) -> Iterator[io.TextIOWrapper]:
    """Open a table of sentences."""
    try:
        with open_regular(path) as file:
            yield io.TextIOWrapper(file, encoding="utf-8", newline="")
    except (
        OSError, ValueError, csv.Error, KeyError, TypeError, AttributeError, FormulaError
    ) as error:  # fmt: skip
        raise UserError(
            f"{path}: not readable as {what}: {error!r}; see `edge eval translate --help`"
        ) from error


def lang2ltl_cases(path: Path) -> tuple[list[TranslationCase], Counter[str]]:
    """Read the utterances whose formulas a mission can fulfil, and count the others by pattern."""
    cases: list[TranslationCase] = []
    left_out: Counter[str] = Counter()
    with _table(path, "Lang2LTL's table") as file:
        for row in csv.DictReader(file):
            formula = from_prefix(row["ltl_formula"])
            if satisfiable(formula):
                cases.append(TranslationCase(row["pattern_type"], row["utterance"], formula, True))
            else:
                left_out[row["pattern_type"]] += 1
    return cases, left_out


def clean_up_cases(path: Path) -> tuple[list[TranslationCase], Counter[str]]:
    """Read the sentences that name the rooms of their formulas, and count the others by pattern.

    "The blue" becomes "the blue room". The others name other rooms, or an object to carry.
    """
    cases: list[TranslationCase] = []
    left_out: Counter[str] = Counter()
    with _table(path, "the clean-up table") as file:
        for line in file:
            row = json.loads(line)
            prefix = [_ROOMS.get(word, word) for word in row["raw_ltl"].split()]
            # X and Z mean a room to which a chair is brought: no name matches, so it is left out.
            rooms = {word for word in prefix if word in _ROOMS.values() or word in "XZ"}
            named = {found[1].lower() for found in _ROOM.finditer(row["natural"])}
            part = " ".join("r" if word in rooms else word for word in prefix)
            if named != rooms:
                left_out[part] += 1
                continue
            formula = renamed(from_prefix(" ".join(prefix)), "{} room".format)
            sentence = _ROOM.sub(lambda found: f"{found[1].lower()} room", row["natural"])
            cases.append(TranslationCase(part, sentence, formula, True))
    return cases, left_out


def custom_cases(path: Path) -> tuple[list[TranslationCase], Counter[str]]:
    """Read a user's own sentences from a table with tabs, and count those that are left out.

    A row is a sentence in double quotes, as in JSON, and a JSON list of the correct formulas. An
    empty list among them allows the translator to refuse or ask. Without a formula, any formula is
    wrong.
    """
    cases: list[TranslationCase] = []
    left_out: Counter[str] = Counter()
    with _table(path, "a table of sentences") as file:
        next(file, None)
        for line in file:
            sentence, right = (json.loads(cell) for cell in line.split("\t")[:2])
            if right == ["LONG"]:
                left_out[TO_READ] += 1
                continue
            part = MAY_REFUSE if [] in right else TO_READ
            formulas = tuple(parse(text) for text in right if text)
            cases.append(
                TranslationCase(
                    part, sentence, formulas[0] if formulas else FALSE, others=formulas[1:]
                )
            )
    return cases, left_out


def from_prefix(text: str) -> Formula:
    """Parse a formula in prefix notation, as in Lang2LTL's data: `& F a U ! b c`.

    `i` is implication and `e` equivalence. A word that is not an operator is a proposition.

    Raises:
        ValueError: the text is not a formula.

    Example:
        >>> str(from_prefix("& F a F b"))
        'F a & F b'
    """
    done: list[Formula] = []
    for word in reversed(text.split()):
        op = {"i": "->", "e": "<->"}.get(word, word)
        n = 1 if op in UNARY else 2 if op in STRENGTH else 0  # number of operands
        if n > len(done):
            raise ValueError(f"formula {text!r}: an operator has too few operands")
        args = [done.pop() for _ in range(n)]
        if op in ("&", "|"):
            done.append(conj(*args) if op == "&" else disj(*args))
        else:
            done.append(Formula(op, tuple(args)) if n else ap(op))
    if len(done) != 1:
        raise ValueError(f"formula {text!r}: expected one formula, got {len(done)}")
    return done[0]

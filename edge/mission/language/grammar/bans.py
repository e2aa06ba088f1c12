"""Bans that the grammar finds in an instruction; a model's formula is checked against them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from edge.mission.language.grammar.instruction import readings
from edge.mission.language.words.tokens import TranslationError
from edge.mission.logic.automaton import CompileError, compile_formula, implies
from edge.mission.logic.ltl import Formula

_MAX_STATES, _MAX_STEPS = 500, 300_000  # limits of one compilation, see `compile_formula`
_SENTENCE = re.compile(r"[,.;:!?]|\b(?:but|then)\b", re.IGNORECASE)
_CLAUSE = re.compile(r"\b(?:and|or)\b|\b(?=without\b|while\b)", re.IGNORECASE)
_ASIDE = re.compile(r"(?:without|while)\b", re.IGNORECASE)
_ANYTHING = 'visit "anything"'  # goes before an avoidance, which the grammar does not read alone


def bans_in(instruction: str) -> tuple[Formula, ...]:
    """Return the bans (`G !x`, `!x W y`) that the grammar reads in an instruction.

    If the grammar refuses the entire instruction, it reads the parts one by one.
    """
    found = _bans_of(instruction)
    if found is None:
        found = []
        for part in _SENTENCE.split(instruction):
            bans = _bans_of(part)
            found += bans if bans is not None else _bans_of_clauses(part)
    return tuple(dict.fromkeys(found))


def does_imply(formula: Formula, ban: Formula) -> bool:
    """Return True if a formula implies a ban; False if the formula is too large to compile."""
    try:
        return implies(*(compile_formula(f, _MAX_STATES, _MAX_STEPS) for f in (formula, ban)))
    except CompileError:
        return False


def _bans_of_clauses(part: str) -> Iterator[Formula]:
    for clause in _CLAUSE.split(part):
        if _ASIDE.match(clause):
            clause = f"{_ANYTHING} {clause}"
        yield from _bans_of(clause) or ()


def _bans_of(text: str) -> list[Formula] | None:
    """Return the bans that all readings of a text share; None if it is refused."""
    try:
        first, *others = readings(text)
    except TranslationError:
        return None
    parts = first.args if first.op == "&" else (first,)
    bans = [part for part in parts if _is_ban(part)]
    return [ban for ban in bans if all(does_imply(other, ban) for other in others)]


def _is_ban(part: Formula) -> bool:
    return (
        part.op in ("G", "W") and part.args[0].op == "!" and part.args[0].args[0].op in ("ap", "|")
    )

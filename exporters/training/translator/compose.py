"""Composed sentences with their formulas: most of the small translator's training data.

`phrases.yaml` has templates for each kind of formula. This module fills them, joins them to longer
instructions, and adds the noise of speech and haste.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import NamedTuple

import yaml

from edge.mission.language.lexicon import expand_word
from edge.mission.language.prefix_notation import MOST_NAMES, NAMES, REFUSED

PHRASES = Path(__file__).with_name("phrases.yaml")
LETTERS = "abcde"
"""Names in templates and formulas."""
_AFTER = "fghij"  # names of the second of two joined instructions
REFUSED_SHARE = 0.12
"""Share of sentences that no formula expresses."""
JOINED_SHARE = 0.18
"""Share of sentences that join two instructions."""
_SLOT = re.compile(r"\{(\w+)\}")
_CHOICE = re.compile(r"\(([^()]*)\)")
_HOLE = re.compile(r"\$([a-e])")


class Pair(NamedTuple):
    """Words of a delexicalised instruction (names replaced), and the formula in compact tokens."""

    words: tuple[str, ...]
    tokens: tuple[str, ...]


@dataclass(slots=True)
class Family:
    """A kind of formula over letters, and its templates."""

    tokens: tuple[str, ...]
    weight: float
    templates: tuple[str, ...]

    @property
    def letters(self) -> list[str]:
        return [letter for letter in LETTERS if letter in self.tokens]


@dataclass(slots=True)
class Phrases:
    """Tables of `phrases.yaml`."""

    slots: dict[str, list[str]]
    families: list[Family]
    refused: list[str]
    goals: list[Family] = field(init=False)
    bans: list[Family] = field(init=False)

    def __post_init__(self) -> None:
        self.goals = [f for f in self.families if f.tokens[0] in "F&" and "W" not in f.tokens]
        self.bans = [f for f in self.families if f.tokens[0][0] in "GW<"]


def load(path: Path = PHRASES) -> Phrases:
    """Return the tables of a file."""
    tables = yaml.safe_load(path.read_text(encoding="utf-8"))
    slots = {name: " ".join(text.split()).split("|") for name, text in tables["slots"].items()}
    for name, table in tables["verbs"].items():
        rows = [row.strip().partition("|") for row in table.replace("\n", ";").split(";")]
        rows = [row for row in rows if row[0]]
        for form, slot in enumerate(_FORMS[name]):
            slots[slot] = [f"{verbs.split()[form]} {rest}".strip() for verbs, _, rest in rows]
    families = [
        Family(tuple(row["formula"].split()), row["weight"], tuple(row["say"].splitlines()))
        for row in tables["families"]
    ]
    return Phrases(slots, families, tables["refused"].splitlines())


_FORMS = {"go": ("go", "goes", "going", "gone"), "pass": ("pass", "passes", "passing", "passed")}


class Composer:
    """Source of random pairs; the same generator gives the same pairs."""

    def __init__(self, phrases: Phrases, rng: Random) -> None:
        self._phrases, self._rng = phrases, rng
        self._weights = [family.weight for family in phrases.families]
        self._goal_weights = [family.weight for family in phrases.goals]
        self._ban_weights = [family.weight for family in phrases.bans]

    def pair(self) -> Pair:
        """Return one sentence and its formula."""
        rng, phrases = self._rng, self._phrases
        drawn = rng.random()
        if drawn < REFUSED_SHARE:
            return self._refused_pair()
        if drawn < REFUSED_SHARE + JOINED_SHARE:
            return self._join_two()
        family = rng.choices(phrases.families, self._weights)[0]
        return delexicalised(self._add_noise(self._fill_template_of(family)), family.tokens)

    def _fill_template_of(self, family: Family) -> str:
        """Return a sentence of a family."""
        return self.filled(self._rng.choice(family.templates))

    def filled(self, template: str) -> str:
        """Fill a template: a phrase for each slot, and one option of each choice."""
        rng = self._rng
        for pattern, options in ((_SLOT, self._phrases.slots.__getitem__), (_CHOICE, _split)):
            while found := pattern.search(template):
                chosen = rng.choice(options(found[1]))
                template = f"{template[: found.start()]}{chosen}{template[found.end() :]}"
                if pattern is _CHOICE and _SLOT.search(template):
                    return self.filled(template)
        return template

    def _join_two(self) -> Pair:
        """Return two instructions in one or two sentences."""
        rng = self._rng
        goal = rng.choices(self._phrases.goals, self._goal_weights)[0]
        other, weights = (
            (self._phrases.bans, self._ban_weights)
            if rng.random() < 0.75
            else (self._phrases.goals, self._goal_weights)
        )
        rule = rng.choices(other, weights)[0]
        shared = rng.random() < 0.15 and rule.tokens[0] != "G"
        first, second = (
            self._fill_template_of(goal),
            _shift_sentence(self._fill_template_of(rule), goal, rule, shared),
        )
        tokens = ("&", *goal.tokens, *_shift(rule.tokens, goal, rule, shared))
        if rng.random() < 0.2:
            first, second = second, first
        joint = rng.choice((" . ", " . ", " , ", " , and ", " and ", " . also , ", " but "))
        if len(set(tokens) & set(LETTERS + _AFTER)) > MOST_NAMES:
            return self.pair()
        return delexicalised(self._add_noise(f"{first}{joint}{second}"), tokens)

    def _refused_pair(self) -> Pair:
        sentence = self.filled(self._rng.choice(self._phrases.refused))
        if self._rng.random() < 0.3:
            goal = self._rng.choices(self._phrases.goals, self._goal_weights)[0]
            other = _shift_sentence(
                self._fill_template_of(goal), Family(tuple("abc"), 0, ()), goal, False
            )
            sentence = self._rng.choice((f"{sentence} . {other}", f"{other} , then {sentence}"))
        return delexicalised(self._add_noise(sentence), (REFUSED,))

    def _add_noise(self, sentence: str) -> str:
        """Add the noise of speech: missing punctuation, hesitation, thanks."""
        rng = self._rng
        words = sentence.split()
        if rng.random() < 0.45:
            words = [word for word in words if word not in (",", ".")]
        if words and rng.random() < 0.03:
            at = rng.randrange(len(words))
            words.insert(at, rng.choice(self._phrases.slots["hesitation"]))
        if words and rng.random() < 0.3:
            words.append(".")
        if rng.random() < 0.12:
            words += rng.choice(self._phrases.slots["thanks"]).split()
        return " ".join(words)


def delexicalised(sentence: str, tokens: Sequence[str]) -> Pair:
    """Replace names by placeholders in the order of their first use, as `delexicalise_text`."""
    order: dict[str, str] = {}
    words: list[str] = []
    for word in sentence.split():
        hole = re.fullmatch(r"\$(\w)", word)
        if hole:
            if hole[1] not in order:
                order[hole[1]] = NAMES[len(order)]
            words.append(order[hole[1]])
        else:
            words += expand_word(word)
    return Pair(tuple(words), tuple(order.get(token, token) for token in tokens))


def _split(options: str) -> list[str]:
    return options.split("|")


def _shift(tokens: Sequence[str], goal: Family, rule: Family, shared: bool) -> tuple[str, ...]:
    """Return the rule's formula over other letters than the goal's; one letter may be shared."""
    moved = dict(zip(LETTERS, _AFTER, strict=True))
    if shared:
        moved[rule.letters[0]] = goal.letters[-1]
    return tuple(moved.get(token, token) for token in tokens)


def _shift_sentence(sentence: str, goal: Family, rule: Family, shared: bool) -> str:
    words = sentence.split()
    named = [word[1:] if _HOLE.fullmatch(word) else word for word in words]
    marks = ["$" if _HOLE.fullmatch(word) else "" for word in words]
    moved = [
        mark + (_shift([word], goal, rule, shared)[0] if mark else word)
        for mark, word in zip(marks, named, strict=True)
    ]
    return " ".join(moved)

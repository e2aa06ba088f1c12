"""Composed sentences with their formulas: most of the small translator's training data.

`phrases.yaml` has templates for each kind of formula. This module fills them, joins them to longer
instructions, and adds the noise of speech and haste. In a template, $a to $e stand for names of
targets, {slot} for a phrase of a table, and (one|another) for a choice. A pair is a sentence with
its formula; the operators of formulas are F (eventually), G (always), W (weak until), & and others.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import NamedTuple

import yaml

from edge.mission.language.grammar.prefix_notation import MOST_NAMES, NAMES, REFUSED
from edge.mission.language.words.spelling import expand_word

PHRASES = Path(__file__).with_name("phrases.yaml")
LETTERS = "abcde"
"""Letters that stand for names in templates and formulas."""
_SECOND_LETTERS = "fghij"  # those of the second of two joined instructions; see `_join_two`
REFUSED_SHARE = 0.12
"""Share of sentences that no formula expresses."""
JOINED_SHARE = 0.18
"""Share of sentences that join two instructions."""
# Table of verbs → names of the slots for the forms of a verb, in the order of the table.
_FORMS = {"go": ("go", "goes", "going", "gone"), "pass": ("pass", "passes", "passing", "passed")}
_SLOT = re.compile(r"\{(\w+)\}")  # {go}
_CHOICE = re.compile(r"\(([^()]*)\)")  # (the|a), without brackets inside
_NAME = re.compile(r"\$([a-e])")  # $a


class Pair(NamedTuple):
    """An instruction and its formula.

    Attributes:
        words: the instruction, delexicalised: placeholders instead of names.
        tokens: the formula in prefix notation (`edge.mission.language.grammar.prefix_notation`).
    """

    words: tuple[str, ...]
    tokens: tuple[str, ...]


@dataclass(slots=True)
class Family:
    """A formula over letters, and the templates of sentences that mean it.

    Attributes:
        tokens: the formula in prefix notation, such as F & a F b: first a, then b.
        weight: relative frequency of the family.
        templates: sentences with slots and choices, see the module.
    """

    tokens: tuple[str, ...]
    weight: float
    templates: tuple[str, ...]

    @property
    def letters(self) -> list[str]:
        """The letters in the formula."""
        return [letter for letter in LETTERS if letter in self.tokens]


@dataclass(slots=True)
class Phrases:
    """Tables of `phrases.yaml`.

    Attributes:
        refused: templates of sentences that no formula expresses.
        goals: families whose formula says what to reach: it begins with F or &.
        bans: families whose formula forbids something or sets an order: its first token
            begins with G, W or <.
    """

    slots: dict[str, list[str]]
    families: list[Family]
    refused: list[str]
    goals: list[Family] = field(init=False)
    bans: list[Family] = field(init=False)

    def __post_init__(self) -> None:
        # The first token is the outermost operator. `<=2 a` allows two visits at most.
        self.goals = [f for f in self.families if f.tokens[0] in "F&" and "W" not in f.tokens]
        self.bans = [f for f in self.families if f.tokens[0][0] in "GW<"]


def load(path: Path = PHRASES) -> Phrases:
    """Return the tables of a file."""
    tables = yaml.safe_load(path.read_text(encoding="utf-8"))
    slots = {name: " ".join(text.split()).split("|") for name, text in tables["slots"].items()}
    # A row of the verbs is "go goes going gone|to": all forms, then the rest of the phrase.
    for name, table in tables["verbs"].items():
        rows = [row.strip().partition("|") for row in table.replace("\n", ";").split(";")]
        rows = [row for row in rows if row[0]]
        for form, slot in enumerate(_FORMS[name]):
            slots[slot] = [f"{forms.split()[form]} {rest}".strip() for forms, _, rest in rows]
    families = [
        Family(tuple(row["formula"].split()), row["weight"], tuple(row["say"].splitlines()))
        for row in tables["families"]
    ]
    return Phrases(slots, families, tables["refused"].splitlines())


class Composer:
    """Source of random pairs."""

    def __init__(self, phrases: Phrases, rng: Random) -> None:
        self._phrases, self._rng = phrases, rng
        self._weights = [family.weight for family in phrases.families]
        self._goal_weights = [family.weight for family in phrases.goals]
        self._ban_weights = [family.weight for family in phrases.bans]

    def pair(self) -> Pair:
        """Return one sentence and its formula."""
        rng, phrases = self._rng, self._phrases
        share = rng.random()
        if share < REFUSED_SHARE:
            return self._refused_pair()
        if share < REFUSED_SHARE + JOINED_SHARE:
            return self._join_two()
        family = rng.choices(phrases.families, self._weights)[0]
        return delexicalised(self._add_noise(self._fill_template_of(family)), family.tokens)

    def _fill_template_of(self, family: Family) -> str:
        return self.filled(self._rng.choice(family.templates))

    def filled(self, template: str) -> str:
        """Fill a template: a phrase for each slot, and one option of each choice."""
        rng = self._rng
        for pattern, options in ((_SLOT, self._phrases.slots.__getitem__), (_CHOICE, _split)):
            while found := pattern.search(template):
                chosen = rng.choice(options(found[1]))
                template = f"{template[: found.start()]}{chosen}{template[found.end() :]}"
                # The option has a slot: begin again.
                if pattern is _CHOICE and _SLOT.search(template):
                    return self.filled(template)
        return template

    def _join_two(self) -> Pair:
        """Return two instructions in one or two sentences: a goal, and a rule or another goal."""
        rng = self._rng
        goal = rng.choices(self._phrases.goals, self._goal_weights)[0]
        other, weights = (
            (self._phrases.bans, self._ban_weights)
            if rng.random() < 0.75
            else (self._phrases.goals, self._goal_weights)
        )
        rule = rng.choices(other, weights)[0]
        # Sometimes the rule is about the goal's last target.
        shared = rng.random() < 0.15 and rule.tokens[0] != "G"
        first, second = (
            self._fill_template_of(goal),
            _sentence_with_other_letters(self._fill_template_of(rule), goal, rule, shared),
        )
        tokens = ("&", *goal.tokens, *_with_other_letters(rule.tokens, goal, rule, shared))
        if rng.random() < 0.2:
            first, second = second, first
        joint = rng.choice((" . ", " . ", " , ", " , and ", " and ", " . also , ", " but "))
        if len(set(tokens) & set(LETTERS + _SECOND_LETTERS)) > MOST_NAMES:
            return self.pair()  # too many names for the network: draw again
        return delexicalised(self._add_noise(f"{first}{joint}{second}"), tokens)

    def _refused_pair(self) -> Pair:
        """Return a sentence that no formula expresses, sometimes together with a goal."""
        sentence = self.filled(self._rng.choice(self._phrases.refused))
        if self._rng.random() < 0.3:
            goal = self._rng.choices(self._phrases.goals, self._goal_weights)[0]
            # The letters a to c may be taken by the refused sentence.
            other = _sentence_with_other_letters(
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
    """Replace letters by placeholders in the order of their first use (`delexicalise_text`)."""
    order: dict[str, str] = {}  # letter -> placeholder
    words: list[str] = []
    for word in sentence.split():
        name = re.fullmatch(r"\$(\w)", word)
        if name:
            if name[1] not in order:
                order[name[1]] = NAMES[len(order)]
            words.append(order[name[1]])
        else:
            words += expand_word(word)
    return Pair(tuple(words), tuple(order.get(token, token) for token in tokens))


def _split(options: str) -> list[str]:
    return options.split("|")


def _with_other_letters(
    tokens: Sequence[str], goal: Family, rule: Family, shared: bool
) -> tuple[str, ...]:
    """Return a rule's formula over other letters than the goal's.

    With `shared`, the rule's first letter is the goal's last one.
    """
    new_letter = dict(zip(LETTERS, _SECOND_LETTERS, strict=True))
    if shared:
        new_letter[rule.letters[0]] = goal.letters[-1]
    return tuple(new_letter.get(token, token) for token in tokens)


def _sentence_with_other_letters(sentence: str, goal: Family, rule: Family, shared: bool) -> str:
    """Return a rule's sentence with the letters of `_with_other_letters`."""

    def replaced(word: str) -> str:
        name = _NAME.fullmatch(word)
        if name is None:
            return word
        return "$" + _with_other_letters([name[1]], goal, rule, shared)[0]

    return " ".join(map(replaced, sentence.split()))

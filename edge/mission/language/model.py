"""Translator `model`: a small network of our own reads what the grammar does not.

It is trusted where its translation tells the sentence back better than any other does; where that
is in doubt, whoever gave the instruction is asked, with what it may mean in plain English.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass

from edge.mission.automaton import Automaton, CompileError, compile_formula, implies
from edge.mission.language import nouns
from edge.mission.language.compact import REFUSED, formula_of
from edge.mission.language.lexicon import AFTER_VERB, TABLE
from edge.mission.language.lifting import ARTICLES, Lifted, lift
from edge.mission.language.network import MOST_WORDS, Network, Written
from edge.mission.language.words import TranslationError, not_understood
from edge.mission.ltl import Formula, propositions
from edge.text import one_line

TRUSTED_P = 0.95
"""Share of the probability that one language has among all that were written."""
TRUSTED_MARGIN = 1.0
"""By how much another language may tell the sentence better, being so much less likely [nats]."""
TRUSTED_START, TRUSTED_WORD = -2.0, -2.8
"""The least log probability of a sentence, told back, and of each of its words [nats]: it takes the
more to say which verb and which turn of phrase began it."""
OFFERED_P, OFFERED_WORD, MOST_OFFERED = 0.15, -6.0, 4
"""What is shown to whoever is asked, and how many."""
MOST_SLIPS = 3
_CLOSE, _CLOSER = 0.75, 0.8
_MAX_STATES, _MAX_STEPS = 500, 300_000
_REFUSED = "instruction: no formula over what is reached says this; say it in other words"


@dataclass(frozen=True, slots=True)
class Meaning:
    """One language that a sentence may ask for.

    Attributes:
        p: share of the probability of all that was written.
        told: log probability of the sentence, told back, by the token sequence that tells it best.
    """

    formula: Formula
    p: float
    told: float


@dataclass(frozen=True, slots=True)
class Guess:
    """What the network made of a sentence.

    Attributes:
        formulas: what it may mean, the likeliest first.
        sure: the first may be carried out unasked.
        doubts: words that are not known, and what they were taken for, to be told with a question.
    """

    formulas: tuple[Formula, ...]
    sure: bool
    doubts: tuple[str, ...] = ()


class SmallModel:
    """Reads instructions with a network."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def read(self, instruction: str) -> Guess:
        """What the instruction may mean.

        Raises:
            TranslationError: it names nothing, most of its words are not known, or no formula
                says it.
        """
        if nouns.is_foreign(instruction):
            raise not_understood(instruction, 1, "instructions are read in English only")
        said, words, doubts = self._known(instruction)
        if not said.names:
            raise TranslationError(
                "instruction: it names nothing that is known; write what it is in double quotes"
            )
        written = self._network.formulas(words, len(said.names))
        total = sum(math.exp(one.log_p) for one in written)
        refused = sum(math.exp(one.log_p) for one in written if one.tokens == (REFUSED,))
        if not written or refused > 0.5 * total:
            raise TranslationError(_REFUSED)
        meanings = self._meanings(written, words, said)
        offered = [
            meaning.formula
            for meaning in meanings
            if meaning.p >= OFFERED_P and meaning.told >= OFFERED_WORD * len(words)
        ]
        if not offered:
            raise TranslationError(_REFUSED)
        if not doubts and self._trusts(meanings, words, said):
            return Guess((meanings[0].formula,), True)
        return Guess(tuple(offered[:MOST_OFFERED]), False, doubts)

    def _trusts(self, meanings: Sequence[Meaning], words: Sequence[str], said: Lifted) -> bool:
        """Whether the likeliest meaning is likely enough, uses every name, and tells back best."""
        first, *others = meanings
        return (
            first.p >= TRUSTED_P
            and set(propositions(first.formula)) == set(said.names)
            and first.told >= TRUSTED_START + TRUSTED_WORD * len(words)
            and all(first.told >= other.told - TRUSTED_MARGIN for other in others)
        )

    def _known(self, instruction: str) -> tuple[Lifted, tuple[str, ...], tuple[str, ...]]:
        """The instruction with its names lifted out, its words with close ones in the place of
        those that are not known, and what is to be doubted of them.

        Raises:
            TranslationError: it is too long, or has more slips than `MOST_SLIPS`.
        """
        said, doubts = lift(instruction), []
        for _ in range(MOST_SLIPS):  # a name that was a slip is lifted out when it is mended
            unknown = (i for i, word in enumerate(said.words) if not self._is_known(word))
            slips = ((i, _name_meant(said.words, i)) for i in unknown)
            at, name = next(((i, name) for i, name in slips if name), (0, None))
            if name is None:
                break
            word, start = said.words[at], said.starts[at]
            doubts.append(f"{one_line(word, 40)}: {name}?")
            instruction = f"{instruction[:start]}{name}{instruction[start + len(word) :]}"
            said = lift(instruction)
        if len(said.words) > MOST_WORDS:
            late = said.starts[MOST_WORDS]
            raise not_understood(instruction[late:], late + 1, "too long for one sentence")
        words = list(said.words)
        for i, word in enumerate(words):
            if self._network.knows(word):
                continue
            close = difflib.get_close_matches(word[:40], self._network.words, n=1, cutoff=_CLOSE)
            doubts.append(f"{one_line(word, 40)}: {close[0] if close else 'not known'}?")
            words[i] = close[0] if close else word
            if len(doubts) > MOST_SLIPS:
                start = said.starts[i]
                raise not_understood(instruction[start:], start + 1, "no word that is known here")
        return said, tuple(words), tuple(doubts)

    def _is_known(self, word: str) -> bool:
        return self._network.knows(word) or (word,) in TABLE

    def _meanings(
        self, written: Sequence[Written], words: Sequence[str], said: Lifted
    ) -> list[Meaning]:
        """One for each language among what was written, the likeliest first."""
        total = sum(math.exp(one.log_p) for one in written)
        kinds: list[tuple[Automaton, list[Written]]] = []
        for one in written:
            if one.tokens == (REFUSED,):
                continue
            try:
                formula = formula_of(one.tokens, said.names)
                automaton = compile_formula(formula, _MAX_STATES, _MAX_STEPS)
            except CompileError:
                continue
            if automaton.steps_left[0] < 0:
                continue  # nothing fulfils it: nobody says that
            same = next((ones for kind, ones in kinds if _equal(kind, automaton)), None)
            if same is None:
                kinds.append((automaton, [one]))
            else:
                same.append(one)
        meanings = [
            Meaning(
                automaton.formula,
                sum(math.exp(one.log_p) for one in ones) / total,
                max(self._network.telling(one.tokens, words) for one in ones[:2]),
            )
            for automaton, ones in kinds
        ]
        return sorted(meanings, key=lambda meaning: -meaning.p)


def _name_meant(words: Sequence[str], at: int) -> str | None:
    """The name that a word is most likely a slip of, where one may stand: behind an article, and
    more surely behind a particle, which verbs follow too ("to complete")."""
    before, word = words[at - 1] if at else "", words[at]
    name = nouns.meant(word) if before in ARTICLES or before in AFTER_VERB else None
    if name is None or before in ARTICLES:
        return name
    return name if difflib.SequenceMatcher(None, word, name).ratio() >= _CLOSER else None


def _equal(a: Automaton, b: Automaton) -> bool:
    return implies(a, b) and implies(b, a)

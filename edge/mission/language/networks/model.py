"""Translator `model`: a small network for sentences that the grammar refuses.

The network writes formulas. Formulas that mean the same make one reading of the sentence. A reading
is carried out without a question only if it is likely enough, uses every name, and passes two
checks. Back-translation: no other reading explains the sentence better. Coverage: the reading
leaves no word of the sentence unexplained. Other readings become a question; a reading with an
unexplained word that changes the meaning is dropped.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from edge.mission.language.grammar.english import is_plain
from edge.mission.language.grammar.prefix_notation import NAMES, REFUSED, formula_of
from edge.mission.language.networks.delexicalisation import (
    ARTICLES,
    DelexicalisedText,
    delexicalise_text,
)
from edge.mission.language.networks.network import MOST_WORDS, FormulaHypothesis, TranslationNetwork
from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import AFTER_VERB, NUMBERS, TABLE
from edge.mission.language.words.tokens import TranslationError, not_understood
from edge.mission.logic.automaton import Automaton, CompileError, compile_formula, implies
from edge.mission.logic.ltl import Formula, propositions
from edge.text import one_line

TRUSTED_P = 0.95
"""Least share of a trusted reading in the probability of all hypotheses."""
TRUSTED_MARGIN = 1.0
"""Another reading may explain the sentence better than the trusted one by at most this much [nats].
A little better is no doubt: with `TRUSTED_P`, the other reading is much less likely."""
TRUSTED_START = -2.0
"""Least log probability of the back-translation of a trusted reading: the constant part [nats]."""
TRUSTED_WORD = -2.8
"""The part of this least log probability for each word of the sentence [nats]."""
OFFERED_P = 0.15
"""Least share of an offered reading in the probability of all hypotheses."""
OFFERED_WORD = -6.0
"""Least log probability of the back-translation of an offered reading, for each word [nats]."""
OFFERED_IN_ALL = 0.9
"""Least share of all offered readings together in the probability of all hypotheses."""
MOST_OFFERED = 4
"""Largest number of offered readings."""
OFFERED_LOSS = 4.0
"""A reading is not offered if leaving out one of its unexplained words makes the sentence more
likely by more than this [nats]."""
LONGEST_PHRASE = 3
"""Largest number of words that are deleted together: "every time" is one phrase."""
_FUNCTION_WORDS = """
    a an the and then to of that it you your i please must should have has be is are been
    go move head drive walk visit reach get into through throught up
"""
FUNCTION_WORDS = frozenset(_FUNCTION_WORDS.split())
"""The only words that a trusted reading may leave unexplained."""
_LIGHT_KINDS = (
    "filler", "verb", "you", "to", "article", "be", "must", "can", "ensure", "do", "goal",
    "addressed", "happen", "pronoun",
)  # fmt: skip
"""Kinds of the lexicon with little effect on the meaning. All other kinds change it."""
_CHANGING = """
    not never no without only if when unless until all both every each once twice first last again
    stop exit leave out off away beyond outside within from another other else nowhere nobody
    nothing none except excluding barring besides instead rather otherwise hardly miss refuse
    decline pm am minute minutes hour hours second seconds half quarter metres meters left right
"""
_CHANGING_WORDS = frozenset(_CHANGING.split())
"""Words that change the meaning, so they must be explained, like numbers."""
_ATTACHED = re.compile(r"<\d> (by|from|off|out of) <\d>")
"""Ambiguous: the second object is the place of the first, or on the way to it."""
_LOOKED_AROUND = re.compile(
    r"\b(look|looks|looking|search|searching|peek|wander|stroll) around <\d>"
)
MOST_SLIPS = 3
"""Largest number of corrected or unknown words in a sentence."""
_MAX_STATES, _MAX_STEPS = 500, 300_000  # limits of one compilation, see `compile_formula`
_BEFORE_VERB = (",", ".", "and", "then", "please", "you", "not")  # a verb may follow them
_REFUSED = "instruction: it could not be translated to a mission; say it in other words"


@dataclass(frozen=True, slots=True)
class CandidateReading:
    """One meaning that a sentence may have.

    Attributes:
        p: share of all formulas with this meaning in the probability of all hypotheses.
        back_translation_log_p: log probability of the sentence given `tokens` [nats].
        tokens: the formula in prefix notation, as the hypothesis writes it that explains the
            sentence best.
        idle: True if the formula asks for no object, as a ban alone does.
    """

    formula: Formula
    p: float
    back_translation_log_p: float
    tokens: tuple[str, ...]
    idle: bool


@dataclass(frozen=True, slots=True)
class NeuralReading:
    """The network's reading of a sentence.

    Attributes:
        formulas: possible formulas, the most likely first.
        confident: True if the first may be carried out without a question.
        doubts: unknown words and their assumed replacements, shown with the question.
    """

    formulas: tuple[Formula, ...]
    confident: bool
    doubts: tuple[str, ...] = ()


class NeuralTranslator:
    """Translator with a small network."""

    def __init__(self, network: TranslationNetwork) -> None:
        self._network = network

    def read(self, instruction: str) -> NeuralReading:
        """Return the possible formulas of an instruction.

        Raises:
            TranslationError: the instruction names no known object, has too many unknown words, or
                could not be translated.
        """
        if nouns.is_foreign(instruction):
            raise not_understood(instruction, 1, "instructions are read in English only")
        text, words, doubts = self._correct(instruction)
        if not text.names:
            raise TranslationError(
                "instruction: no known object in it; write the object's name in double quotes"
            )
        if ambiguity := _ambiguity(words):
            raise TranslationError(f"instruction: {ambiguity}")
        hypotheses = self._network.formulas(words, len(text.names))
        total = sum(math.exp(hypothesis.log_p) for hypothesis in hypotheses)
        refused = sum(math.exp(h.log_p) for h in hypotheses if h.tokens == (REFUSED,))
        if not hypotheses or refused > 0.5 * total:
            raise TranslationError(_REFUSED)
        readings = self._readings(hypotheses, words, text)
        if readings and not doubts and self._trusts(readings, words, text):
            return NeuralReading((readings[0].formula,), True)
        offered = self._offered_formulas(readings, words, text)
        if offered:
            return NeuralReading(tuple(offered), False, doubts)
        if readings and (gains := self._unexplained(readings[0], words)):
            # The words that are least explained, at least half as bad as the worst one.
            worst = [words[at] for at in sorted(gains) if 2 * gains[at] >= max(gains.values())]
            part = one_line(" ".join(worst), 60)
            raise TranslationError(
                f"instruction: did not understand {part!r}; say it in other words", part
            )
        raise TranslationError(_REFUSED)

    def _trusts(
        self, readings: Sequence[CandidateReading], words: Sequence[str], text: DelexicalisedText
    ) -> bool:
        """Return True if the most likely reading may be carried out without a question.

        The reading must be likely enough, use every name, explain the sentence well and at least
        about as well as any other, and leave no word unexplained.
        """
        first, *others = readings
        return (
            first.p >= TRUSTED_P
            and set(propositions(first.formula)) == set(text.names)
            and first.back_translation_log_p >= TRUSTED_START + TRUSTED_WORD * len(words)
            and all(
                first.back_translation_log_p >= other.back_translation_log_p - TRUSTED_MARGIN
                for other in others
            )
            and not self._unexplained(first, words)
        )

    def _offered_formulas(
        self, readings: Sequence[CandidateReading], words: Sequence[str], text: DelexicalisedText
    ) -> list[Formula]:
        """Return the formulas to ask about; none if the right one is probably not among them.

        Each asks for an object, uses every name, and explains all words that change the meaning.
        """
        likely = [
            reading
            for reading in readings
            if reading.p >= OFFERED_P
            and reading.back_translation_log_p >= OFFERED_WORD * len(words)
            and set(propositions(reading.formula)) == set(text.names)
            and not reading.idle
            and is_plain(reading.formula)
            and not any(
                self._changes_meaning(words[at], gain)
                for at, gain in self._unexplained(reading, words).items()
            )
        ]
        if sum(reading.p for reading in likely) < OFFERED_IN_ALL:
            return []
        return [reading.formula for reading in likely[:MOST_OFFERED]]

    def _unexplained(self, reading: CandidateReading, words: Sequence[str]) -> dict[int, float]:
        """Return the words that a reading does not explain.

        A word, or a phrase of up to `LONGEST_PHRASE` words, is unexplained if the back-translation
        is more likely without it.

        Returns:
            Position of the word → gain of log probability without the word or its phrase [nats].
        """
        # True for each word that must be explained; a phrase has only such words.
        counts = [not (w in FUNCTION_WORDS or w in NAMES or w in ",.") for w in words]
        phrases = [
            (start, end)
            for start in range(len(words))
            for end in range(start + 1, min(start + LONGEST_PHRASE, len(words)) + 1)
            if all(counts[start:end])
        ]
        without = [_without(words, start, end) for start, end in phrases]
        whole, *scores = self._network.back_translation_log_p(reading.tokens, [words, *without])
        gains: dict[int, float] = {}
        for (start, end), score in zip(phrases, scores, strict=True):
            if score > whole:
                for at in range(start, end):
                    gains[at] = max(gains.get(at, 0.0), score - whole)
        return gains

    def _correct(
        self, instruction: str
    ) -> tuple[DelexicalisedText, tuple[str, ...], tuple[str, ...]]:
        """Return the delexicalised instruction, its words with slips corrected, and the doubts."""
        instruction, text, doubts = self._correct_names(instruction)
        if len(text.words) > MOST_WORDS:
            late = text.starts[MOST_WORDS]
            raise not_understood(instruction[late:], late + 1, "too long for one sentence")
        words = list(text.words)
        for i, word in enumerate(words):
            if self._network.knows(word):
                continue
            is_word = (word,) in TABLE or nouns.is_word(word)
            slip = None if is_word else nouns.slip_of(word[:40], self._network.words)
            doubts.append(f"{one_line(word, 40)}: {slip or 'not known'}?")
            if slip is None:
                _refuse_unknown(words, i, text)
            words[i] = slip or word
            if word in _CHANGING_WORDS or word in nouns.PLAIN_WORDS:
                raise not_understood(word, text.starts[i] + 1, "unknown word")
            if len(doubts) > MOST_SLIPS:
                start = text.starts[i]
                raise not_understood(instruction[start:], start + 1, "unknown word")
        return text, tuple(words), tuple(doubts)

    def _correct_names(self, instruction: str) -> tuple[str, DelexicalisedText, list[str]]:
        """Correct the slips in names.

        Returns:
            The corrected instruction, its delexicalised text, and a doubt for each correction.
        """
        text, doubts = delexicalise_text(instruction), []
        for _ in range(MOST_SLIPS):  # a corrected name is replaced by a placeholder, too
            unknown = (i for i, word in enumerate(text.words) if not self._is_known(word))
            slips = ((i, _name_meant(text.words, i)) for i in unknown)
            at, name = next(((i, name) for i, name in slips if name), (0, None))
            if name is None:
                break
            word, start = text.words[at], text.starts[at]
            doubts.append(f"{one_line(word, 40)}: {name}?")
            instruction = f"{instruction[:start]}{name}{instruction[start + len(word) :]}"
            text = delexicalise_text(instruction)
        return instruction, text, doubts

    def _changes_meaning(self, word: str, gain: float) -> bool:
        """Return True if an unexplained word changes the meaning.

        An unknown word does not count: the question shows it.
        """
        if word in _CHANGING_WORDS or word in NUMBERS or word.isdecimal():
            return True
        light = TABLE.get((word,)) in _LIGHT_KINDS or not self._network.knows(word)
        return gain > OFFERED_LOSS and not light

    def _is_known(self, word: str) -> bool:
        return self._network.knows(word) or (word,) in TABLE

    def _readings(
        self, hypotheses: Sequence[FormulaHypothesis], words: Sequence[str], text: DelexicalisedText
    ) -> list[CandidateReading]:
        """Return one reading for each meaning among the hypotheses, the most likely first."""
        total = sum(math.exp(hypothesis.log_p) for hypothesis in hypotheses)
        groups: list[tuple[Automaton, list[FormulaHypothesis]]] = []  # hypotheses of one meaning
        for hypothesis in hypotheses:
            if hypothesis.tokens == (REFUSED,):
                continue
            try:
                formula = formula_of(hypothesis.tokens, text.names)
                automaton = compile_formula(formula, _MAX_STATES, _MAX_STEPS)
            except CompileError:
                continue
            if automaton.steps_left[0] < 0:
                continue  # it cannot be fulfilled, so it is not meant
            same = next(
                (
                    members
                    for other, members in groups
                    if implies(other, automaton) and implies(automaton, other)
                ),
                None,
            )
            if same is None:
                groups.append((automaton, [hypothesis]))
            else:
                same.append(hypothesis)
        readings = []
        for automaton, members in groups:
            log_ps = [
                self._network.back_translation_log_p(member.tokens, [words])[0]
                for member in members[:2]  # the most likely two: each costs a run of the network
            ]
            best = max(range(len(log_ps)), key=log_ps.__getitem__)
            p = sum(math.exp(member.log_p) for member in members) / total
            idle = bool(automaton.accepting[0])
            readings.append(
                CandidateReading(automaton.formula, p, log_ps[best], members[best].tokens, idle)
            )
        return sorted(readings, key=lambda reading: -reading.p)


def _without(words: Sequence[str], start: int, end: int) -> tuple[str, ...]:
    """Return a sentence without a phrase, and without an article that would then precede a name.

    The network never saw an article there. "Go to the second <0>" without "second" is "go to <0>".
    """
    stranded = words[end : end + 1] and words[end] in NAMES and words[start - 1 : start]
    start -= bool(stranded and words[start - 1] in ARTICLES)
    return (*words[:start], *words[end:])


def _refuse_unknown(words: Sequence[str], at: int, text: DelexicalisedText) -> None:
    """Refuse an unknown word that is a verb before a name, or a vehicle after "by"."""
    word, start = words[at], text.starts[at]
    before_name = at + 1 < len(words) and words[at + 1] in NAMES
    if before_name and (at == 0 or words[at - 1] in _BEFORE_VERB):
        raise not_understood(word, start + 1, "unknown verb")
    if at and words[at - 1] == "by":
        raise not_understood(word, start + 1, "say where to go, without the means of transport")


def _ambiguity(words: Sequence[str]) -> str:
    """Return what is unclear in a sentence; "" if nothing is.

    Three forms are unclear: "<0> by <1>", "look around <0>", and "in the." without a name.
    """
    text = " ".join(words)
    if _ATTACHED.search(text):
        return "unclear: is one object at the other, or on the way to it? use two sentences"
    if _LOOKED_AROUND.search(text):
        return "'around' can mean inside it or past it; say which"
    if any(a in ARTICLES and _ends_name(b) for a, b in pairwise((*words, "."))):
        return "there is an article without a name; complete the name"
    return ""


def _ends_name(word: str) -> bool:
    """Return True if no name may begin with this word."""
    return word in (".", ",") or (TABLE.get((word,)) == "verb" and not nouns.is_noun(word))


def _name_meant(words: Sequence[str], at: int) -> str | None:
    """Return the name that a word is most likely a slip of, if a name may stand there.

    A name may follow an article or a particle.
    """
    before = words[at - 1] if at else ""
    return nouns.suggest_word(words[at]) if before in ARTICLES or before in AFTER_VERB else None

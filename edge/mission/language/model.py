"""Translator `model`: a small network for sentences that the grammar refuses.

A translation is carried out without a question only if two checks pass. Back-translation: no other
candidate explains the sentence better. Coverage: it leaves no word of the sentence unexplained.
A doubtful translation becomes a question. It is refused if an unexplained word changes the meaning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from edge.mission.language import nouns
from edge.mission.language.delexicalisation import ARTICLES, DelexicalisedText, delexicalise_text
from edge.mission.language.english import is_plain
from edge.mission.language.lexicon import AFTER_VERB, NUMBERS, TABLE
from edge.mission.language.network import MOST_WORDS, FormulaHypothesis, TranslationNetwork
from edge.mission.language.prefix_notation import NAMES, REFUSED, formula_of
from edge.mission.language.tokens import TranslationError, not_understood
from edge.mission.logic.automaton import Automaton, CompileError, compile_formula, implies
from edge.mission.logic.ltl import Formula, propositions
from edge.text import one_line

TRUSTED_P = 0.95
"""Least share of one language in the probability of all hypotheses."""
TRUSTED_MARGIN = 1.0
"""Largest advantage of another language in back-translation [nats], as it is much less likely."""
TRUSTED_START, TRUSTED_WORD = -2.0, -2.8
"""Least log probability of the back-translation: a constant, plus a part for each word [nats]. The
constant is for the choice of the first verb and phrase."""
OFFERED_P, OFFERED_WORD, OFFERED_IN_ALL, MOST_OFFERED = 0.15, -6.0, 0.9, 4
"""Conditions to offer a meaning in a question: least share of the probability, least log
probability per word, least share of all offered meanings together, and their largest number."""
OFFERED_LOSS = 4.0
"""Largest loss of an unexplained word in an offered meaning: the gain in log probability of the
back-translation without the word [nats]. A trusted meaning has no unexplained word."""
LONGEST_PHRASE = 3
"""Largest number of words that are deleted together: "every time" is one phrase."""
_FUNCTION_WORDS = """
    a an the and then to of that it you your i please must should have has be is are been
    go move head drive walk visit reach get into through throught up
"""
FUNCTION_WORDS = frozenset(_FUNCTION_WORDS.split())
"""The only words that a trusted meaning may leave unexplained."""
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
_MAX_STATES, _MAX_STEPS = 500, 300_000
_BEFORE_VERB = (",", ".", "and", "then", "please", "you", "not")
_REFUSED = "instruction: it could not be translated to a mission; say it in other words"


@dataclass(frozen=True, slots=True)
class CandidateReading:
    """One formal language that a sentence may ask for.

    Attributes:
        formula: a formula of the language.
        p: its share of the probability of all hypotheses.
        back_translation_log_p: log probability of the sentence given the formula, by the best token
            sequence.
        tokens: that token sequence.
        idle: True if it asks for no object, such as a ban alone.
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
        said, words, doubts = self._known(instruction)
        if not said.names:
            raise TranslationError(
                "instruction: no known object in it; write the object's name in double quotes"
            )
        if unclear := _unclear(words):
            raise TranslationError(f"instruction: {unclear}")
        written = self._network.formulas(words, len(said.names))
        total = sum(math.exp(one.log_p) for one in written)
        refused = sum(math.exp(one.log_p) for one in written if one.tokens == (REFUSED,))
        if not written or refused > 0.5 * total:
            raise TranslationError(_REFUSED)
        meanings = self._meanings(written, words, said)
        if meanings and not doubts and self._trusts(meanings, words, said):
            return NeuralReading((meanings[0].formula,), True)
        offered = self._offered(meanings, words, said)
        if offered:
            return NeuralReading(tuple(offered), False, doubts)
        if meanings and (left := self._left_over(meanings[0], words)):
            worst = [words[at] for at in sorted(left) if 2 * left[at] >= max(left.values())]
            part = one_line(" ".join(worst), 60)
            raise TranslationError(
                f"instruction: did not understand {part!r}; say it in other words", part
            )
        raise TranslationError(_REFUSED)

    def _trusts(
        self, meanings: Sequence[CandidateReading], words: Sequence[str], said: DelexicalisedText
    ) -> bool:
        """Return True if the most likely meaning may be carried out without a question.

        It must be likely enough, use every name, have the best back-translation, and leave no word
        unexplained.
        """
        first, *others = meanings
        return (
            first.p >= TRUSTED_P
            and set(propositions(first.formula)) == set(said.names)
            and first.back_translation_log_p >= TRUSTED_START + TRUSTED_WORD * len(words)
            and all(
                first.back_translation_log_p >= other.back_translation_log_p - TRUSTED_MARGIN
                for other in others
            )
            and not self._left_over(first, words)
        )

    def _offered(
        self, meanings: Sequence[CandidateReading], words: Sequence[str], said: DelexicalisedText
    ) -> list[Formula]:
        """Return the formulas to ask about; none if the right one is probably not among them.

        Each asks for an object, uses every name, and explains all words that change the meaning.
        """
        likely = [
            meaning
            for meaning in meanings
            if meaning.p >= OFFERED_P
            and meaning.back_translation_log_p >= OFFERED_WORD * len(words)
            and set(propositions(meaning.formula)) == set(said.names)
            and not meaning.idle
            and is_plain(meaning.formula)
            and not any(
                self._changes(words[at], loss)
                for at, loss in self._left_over(meaning, words).items()
            )
        ]
        if sum(meaning.p for meaning in likely) < OFFERED_IN_ALL:
            return []
        return [meaning.formula for meaning in likely[:MOST_OFFERED]]

    def _left_over(self, meaning: CandidateReading, words: Sequence[str]) -> dict[int, float]:
        """Return the unexplained words of a meaning, by position, with their loss.

        A word, or a phrase of up to `LONGEST_PHRASE` words, is unexplained if the back-translation
        is more likely without it. The loss is the difference of log probabilities [nats].
        """
        counts = [not (w in FUNCTION_WORDS or w in NAMES or w in ",.") for w in words]
        phrases = [
            (start, end)
            for start in range(len(words))
            for end in range(start + 1, min(start + LONGEST_PHRASE, len(words)) + 1)
            if all(counts[start:end])
        ]
        without = [_without(words, start, end) for start, end in phrases]
        whole, *scores = self._network.back_translation_log_p(meaning.tokens, [words, *without])
        left: dict[int, float] = {}
        for (start, end), score in zip(phrases, scores, strict=True):
            if score > whole:
                for at in range(start, end):
                    left[at] = max(left.get(at, 0.0), score - whole)
        return left

    def _known(
        self, instruction: str
    ) -> tuple[DelexicalisedText, tuple[str, ...], tuple[str, ...]]:
        """Return the delexicalised instruction, its words with slips corrected, and the doubts.

        Raises:
            TranslationError: it is too long, or has more slips than `MOST_SLIPS`.
        """
        said, doubts = delexicalise_text(instruction), []
        for _ in range(MOST_SLIPS):  # a corrected name is replaced by a placeholder, too
            unknown = (i for i, word in enumerate(said.words) if not self._is_known(word))
            slips = ((i, _name_meant(said.words, i)) for i in unknown)
            at, name = next(((i, name) for i, name in slips if name), (0, None))
            if name is None:
                break
            word, start = said.words[at], said.starts[at]
            doubts.append(f"{one_line(word, 40)}: {name}?")
            instruction = f"{instruction[:start]}{name}{instruction[start + len(word) :]}"
            said = delexicalise_text(instruction)
        if len(said.words) > MOST_WORDS:
            late = said.starts[MOST_WORDS]
            raise not_understood(instruction[late:], late + 1, "too long for one sentence")
        words = list(said.words)
        for i, word in enumerate(words):
            if self._network.knows(word):
                continue
            is_word = (word,) in TABLE or nouns.is_word(word)
            slip = None if is_word else nouns.slip_of(word[:40], self._network.words)
            doubts.append(f"{one_line(word, 40)}: {slip or 'not known'}?")
            words[i] = slip or word
            acts = i + 1 < len(words) and words[i + 1] in NAMES
            if not slip and acts and (i == 0 or words[i - 1] in _BEFORE_VERB):
                raise not_understood(word, said.starts[i] + 1, "unknown verb")
            if not slip and i and words[i - 1] == "by":
                raise not_understood(
                    word, said.starts[i] + 1, "say where to go, without the means of transport"
                )
            if word in _CHANGING_WORDS or word in nouns.PLAIN_WORDS:
                raise not_understood(word, said.starts[i] + 1, "unknown word")
            if len(doubts) > MOST_SLIPS:
                start = said.starts[i]
                raise not_understood(instruction[start:], start + 1, "unknown word")
        return said, tuple(words), tuple(doubts)

    def _changes(self, word: str, loss: float) -> bool:
        """Return True if an unexplained word with this loss changes the meaning.

        An unknown word does not count: the question shows it.
        """
        if word in _CHANGING_WORDS or word in NUMBERS or word.isdecimal():
            return True
        light = TABLE.get((word,)) in _LIGHT_KINDS or not self._network.knows(word)
        return loss > OFFERED_LOSS and not light

    def _is_known(self, word: str) -> bool:
        return self._network.knows(word) or (word,) in TABLE

    def _meanings(
        self, written: Sequence[FormulaHypothesis], words: Sequence[str], said: DelexicalisedText
    ) -> list[CandidateReading]:
        """Return one meaning for each language among the hypotheses, the most likely first."""
        total = sum(math.exp(one.log_p) for one in written)
        kinds: list[tuple[Automaton, list[FormulaHypothesis]]] = []
        for one in written:
            if one.tokens == (REFUSED,):
                continue
            try:
                formula = formula_of(one.tokens, said.names)
                automaton = compile_formula(formula, _MAX_STATES, _MAX_STEPS)
            except CompileError:
                continue
            if automaton.steps_left[0] < 0:
                continue  # it cannot be fulfilled, so it is not meant
            same = next((ones for kind, ones in kinds if _equal(kind, automaton)), None)
            if same is None:
                kinds.append((automaton, [one]))
            else:
                same.append(one)
        meanings = []
        for automaton, ones in kinds:
            told = [
                self._network.back_translation_log_p(one.tokens, [words])[0] for one in ones[:2]
            ]
            best = max(range(len(told)), key=told.__getitem__)
            p = sum(math.exp(one.log_p) for one in ones) / total
            idle = bool(automaton.accepting[0])
            meanings.append(
                CandidateReading(automaton.formula, p, told[best], ones[best].tokens, idle)
            )
        return sorted(meanings, key=lambda meaning: -meaning.p)


def _without(words: Sequence[str], start: int, end: int) -> tuple[str, ...]:
    """Return a sentence without a phrase, and without an article that would then precede a name.

    The network never saw an article there.
    """
    stranded = words[end : end + 1] and words[end] in NAMES and words[start - 1 : start]
    start -= bool(stranded and words[start - 1] in ARTICLES)
    return (*words[:start], *words[end:])


def _unclear(words: Sequence[str]) -> str:
    """Return the question that "<0> by <1>", "look around <0>" or "in the." leaves open, or ""."""
    said = " ".join(words)
    if _ATTACHED.search(said):
        return "unclear: is one object at the other, or on the way to it? use two sentences"
    if _LOOKED_AROUND.search(said):
        return "'around' can mean inside it or past it; say which"
    if any(a in ARTICLES and _ends_name(b) for a, b in pairwise((*words, "."))):
        return "there is an article without a name; complete the name"
    return ""


def _ends_name(word: str) -> bool:
    """Return whether no name may begin with a word."""
    return word in (".", ",") or (TABLE.get((word,)) == "verb" and not nouns.is_noun(word))


def _name_meant(words: Sequence[str], at: int) -> str | None:
    """Return the name that a word is most likely a slip of, if a name may stand there.

    A name may follow an article or a particle.
    """
    before = words[at - 1] if at else ""
    return nouns.meant(words[at]) if before in ARTICLES or before in AFTER_VERB else None


def _equal(a: Automaton, b: Automaton) -> bool:
    return implies(a, b) and implies(b, a)

"""Training data of the small translator: composed and human sentences as token ids."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from random import Random

import torch
from torch import Tensor

from edge.lab.eval.equivalence import distinguishing_trace, with_weak_untils
from edge.lab.eval.translate import CLEAN_UP, LANG2LTL
from edge.lab.eval.translation_cases import TranslationCase, clean_up_cases, lang2ltl_cases
from edge.mission.language.grammar.prefix_notation import (
    MOST_NAMES,
    NAMES,
    OPERATORS,
    REFUSED,
    formula_of,
)
from edge.mission.language.networks.delexicalisation import delexicalise_text
from edge.mission.language.networks.network import (
    END,
    MOST_TOKENS,
    MOST_WORDS,
    PAD,
    SPECIAL,
    TO_FORMULA,
    TO_WORDS,
    UNKNOWN,
)
from edge.mission.language.words.tokens import TranslationError
from edge.mission.logic.ltl import Formula, propositions, renamed
from exporters.training.translator.compose import Composer, Pair, Phrases, delexicalised

RARE = 4
"""Words in fewer sentences are unknown to the network."""
COUNTED = 60_000
"""Composed sentences whose words are counted for the vocabulary."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """Tokens by their ids, in this order: special ones, names, operators, words."""

    tokens: tuple[str, ...]

    def ids(self) -> dict[str, int]:
        """Return the id of each token."""
        return {token: i for i, token in enumerate(self.tokens)}


def vocabulary_of(phrases: Phrases, seed: int) -> Vocabulary:
    """Return the vocabulary of composed sentences, without rare words."""
    composer = Composer(phrases, Random(f"{seed} words"))
    counts = Counter(word for _ in range(COUNTED) for word in composer.pair().words)
    return _with_words(Vocabulary((*SPECIAL, *NAMES, REFUSED, *OPERATORS)), counts)


def extended(vocabulary: Vocabulary, human: Sequence[Pair]) -> Vocabulary:
    """Return the vocabulary with the words of human sentences, without rare ones."""
    return _with_words(vocabulary, Counter(word for pair in human for word in pair.words))


def _with_words(vocabulary: Vocabulary, counts: Counter[str]) -> Vocabulary:
    """Return the vocabulary with the words of `counts` that are not rare."""
    known = set(vocabulary.tokens)
    words = sorted(word for word, n in counts.items() if n >= RARE and word not in known)
    return Vocabulary((*vocabulary.tokens, *words))


def human_pairs(cases: Sequence[TranslationCase], phrases: Phrases) -> list[Pair]:
    """Return human sentences with their formulas in prefix notation.

    A sentence is left out if no family of `phrases` has an equivalent formula, if its names differ
    from its formula's, or if it is too long.
    """
    matcher = _FormulaMatcher(phrases)
    pairs = []
    for case in cases:
        try:
            text = delexicalise_text(case.sentence)
        except TranslationError:
            continue
        wanted = set(propositions(case.formula))
        if wanted != set(text.names) or len(text.words) > MOST_WORDS:
            continue
        tokens = matcher.tokens_of(case.formula, text.names)
        if tokens is not None:
            pairs.append(Pair(text.words, tokens))
    return pairs


class _FormulaMatcher:
    """Search for the family whose formula is equivalent to a given formula.

    Formulas have three kinds of names: letters in templates, placeholders (`NAMES`) for the
    network, and `PLAIN` names to compare them.
    """

    def __init__(self, phrases: Phrases) -> None:
        unique = {family.tokens: family for family in phrases.families}
        # (formula over placeholders, number of names) of each family. A sentence "$a $b …" of all
        # letters gives them placeholders in this order.
        self._families = [
            (delexicalised(" ".join(f"${x}" for x in f.letters), f.tokens).tokens, len(f.letters))
            for f in unique.values()
        ]
        # Results by formula over `PLAIN` names.
        self._known: dict[Formula, tuple[str, ...] | None] = {}

    def tokens_of(self, formula: Formula, names: Sequence[str]) -> tuple[str, ...] | None:
        """Return the family's formula over placeholders; None if no family matches."""
        key = _with_plain_names(formula, names)
        if key not in self._known:
            self._known[key] = self._search(key, len(names))
        return self._known[key]

    def _search(self, formula: Formula, n: int) -> tuple[str, ...] | None:
        """Try all families with `n` names, and all orders of the names."""
        for tokens, count in self._families:
            if count != n:
                continue
            for order in permutations(NAMES[:n]):
                new_name = dict(zip(NAMES, order, strict=False))
                candidate = tuple(new_name.get(token, token) for token in tokens)
                # Without a trace that distinguishes them, the formulas are equivalent.
                if (
                    distinguishing_trace(formula_of(candidate, PLAIN), formula, silent_end=True)
                    is None
                ):
                    return candidate
        return None


PLAIN = tuple(f"x{i}" for i in range(MOST_NAMES))
"""Names instead of an instruction's own, so that formulas can be compared."""


def _with_plain_names(formula: Formula, names: Sequence[str]) -> Formula:
    """Return the formula with `PLAIN` instead of the names, and with weak untils."""
    return with_weak_untils(renamed(formula, dict(zip(names, PLAIN, strict=False)).__getitem__))


def corpora(lang2ltl: Path | None, clean_up: Path | None) -> dict[str, list[TranslationCase]]:
    """Return the available human sentences, by corpus."""
    cases = {}
    if lang2ltl is not None:
        cases[LANG2LTL.lower()] = lang2ltl_cases(lang2ltl)[0]
    if clean_up is not None:
        cases[CLEAN_UP.lower()] = clean_up_cases(clean_up)[0]
    return cases


@dataclass(slots=True)
class Source:
    """Endless source of pairs: composed ones, and a share of human ones."""

    composer: Composer
    human: Sequence[Pair]
    share: float
    rng: Random

    def draw(self) -> Pair:
        """Return a pair that is not too long for the network."""
        if self.human and self.rng.random() < self.share:
            return self._disturbed(self.rng.choice(self.human))
        while True:
            pair = self.composer.pair()
            if len(pair.words) <= MOST_WORDS and len(pair.tokens) <= MOST_TOKENS:
                return pair

    def _disturbed(self, pair: Pair) -> Pair:
        """Return the pair with a full stop added, or without its punctuation."""
        words = (
            tuple(w for w in pair.words if w not in ",.") if self.rng.random() < 0.3 else pair.words
        )
        return Pair((*words, ".") if self.rng.random() < 0.2 else words, pair.tokens)


class Batcher:
    """Makes batches of pairs with similar lengths, and padded tensors of them.

    `unknown_share` of the words are replaced by the token for unknown words.
    """

    def __init__(self, vocabulary: Vocabulary, unknown_share: float = 0.01) -> None:
        self._ids = vocabulary.ids()
        self._unknown_share = unknown_share

    def batches(self, source: Source, size: int, ahead: int = 24) -> Iterator[list[Pair]]:
        """Yield batches endlessly; `ahead` batches are drawn at once and sorted by length."""
        while True:
            drawn = sorted((source.draw() for _ in range(size * ahead)), key=lambda p: len(p.words))
            batches = [drawn[i : i + size] for i in range(0, len(drawn), size)]
            source.rng.shuffle(batches)
            yield from batches

    def tensors(self, pairs: Sequence[Pair], rng: Random) -> list[tuple[Tensor, Tensor]]:
        """Return (source, target) of both directions, each (b, n) int64: to formulas, to words.

        Sentences without a formula have no direction to words; if all are such, it is left out.
        """
        words = [[self._word(word, rng) for word in pair.words] for pair in pairs]
        tokens = [[self._ids[token] for token in pair.tokens] for pair in pairs]
        to_formula, to_words, end = (self._ids[token] for token in (TO_FORMULA, TO_WORDS, END))
        formula_targets = [[to_formula, *row, end] for row in tokens]
        word_targets = [[to_words, *row, end] for row in words]
        tensors = [(self._padded(words), self._padded(formula_targets))]
        kept = [i for i, pair in enumerate(pairs) if pair.tokens != (REFUSED,)]
        if kept:
            sources, targets = [tokens[i] for i in kept], [word_targets[i] for i in kept]
            tensors.append((self._padded(sources), self._padded(targets)))
        return tensors

    def _word(self, word: str, rng: Random) -> int:
        """Return the id of a word; sometimes that of an unknown word."""
        known = self._ids.get(word, self._ids[UNKNOWN])
        return self._ids[UNKNOWN] if rng.random() < self._unknown_share else known

    def _padded(self, rows: Sequence[Sequence[int]]) -> Tensor:
        """Return rows of different lengths as one tensor."""
        longest = max(map(len, rows))
        return torch.tensor([[*row, *[self._ids[PAD]] * (longest - len(row))] for row in rows])

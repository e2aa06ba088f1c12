"""Text encoder of the small detector: "tall white trash bin" → a category, a colour and a size.

Words are read by the alias table (`edge.names`) and the vocabulary in the encoder's ONNX file. The
file's metadata key `vocabulary` is JSON with the lists `categories`, `colors` and `sizes`. A phrase
becomes three numbers (category, colour, size): positions in those lists, from 1; 0 for none.
"""

from __future__ import annotations

import difflib
import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge import names
from edge.perception.embedding.text import PromptError, check_prompts, run_encoder
from edge.perception.runtime.card_types import TextCard
from edge.perception.runtime.cards import ModelError, verify_model
from edge.perception.runtime.sessions import open_session

log = logging.getLogger(__name__)

CPU = ("CPUExecutionProvider",)

SYNONYMS: dict[str, tuple[str, ...]] = {
    "red": ("crimson", "scarlet", "maroon"),
    "yellow": ("golden",),
    "green": ("olive", "lime"),
    "blue": ("navy", "azure"),
    "purple": ("violet", "lilac"),
    "pink": ("rose", "magenta"),
    "brown": ("chestnut", "walnut"),
    "beige": ("cream", "tan", "sand", "ivory"),
    "gray": ("grey", "silver"),
    "tall": ("high", "taller", "tallest", "higher", "highest"),
    "short": ("low", "shorter", "shortest", "lower", "lowest"),
    "wide": ("broad", "long", "wider", "widest", "broader", "longer", "longest"),
    "narrow": ("slim", "thin", "slender", "narrower", "narrowest", "thinner", "thinnest"),
    "large": ("big", "huge", "larger", "largest", "bigger", "biggest"),
    "small": ("little", "tiny", "mini", "smaller", "smallest", "littler", "tiniest"),
}
"""Word of the vocabulary → other words for it. A word occurs once only."""

NEGATIONS = ("not", "non", "no")  # adjectives that are refused
OPPOSITES = (("tall", "short"), ("wide", "narrow"), ("large", "small"))  # refused in one phrase
ALIKE: dict[str, tuple[str, ...]] = {
    "tall": ("large", "narrow"),
    "short": ("small", "wide"),
    "wide": ("large", "short"),
    "narrow": ("small", "tall"),
    "large": ("tall", "wide"),
    "small": ("short", "narrow"),
}
"""Size → other sizes that the same object may have; they are no contrast (see `contrasting`)."""

_PLAIN = {canonical: canonical for canonical in SYNONYMS} | {
    other: canonical for canonical, others in SYNONYMS.items() for other in others
}
"""Any word of `SYNONYMS` → the word of the vocabulary."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The words that the model was trained on; their positions are the model's numbers."""

    categories: tuple[str, ...]
    colors: tuple[str, ...]
    sizes: tuple[str, ...]

    @classmethod
    def from_json(cls, text: str) -> Vocabulary:
        """Parse the three lists of words; raise ValueError for anything else."""
        data = json.loads(text)
        if not isinstance(data, dict) or set(data) != {"categories", "colors", "sizes"}:
            raise ValueError("not an object with categories, colors, sizes")
        for key, words in data.items():
            if not isinstance(words, list) or not all(isinstance(w, str) for w in words):
                raise ValueError(f"{key} is not a list of words")
        return cls(*(tuple(data[key]) for key in ("categories", "colors", "sizes")))

    def to_json(self) -> str:
        """Return the JSON text that `from_json` reads."""
        return json.dumps(
            {"categories": self.categories, "colors": self.colors, "sizes": self.sizes}
        )


@dataclass(frozen=True, slots=True)
class Phrase:
    """A parsed prompt, as words of the vocabulary; color and size are None if it names none.

    Attributes:
        ignored: words of the prompt that the model does not know, and the part after its noun.
    """

    category: str
    color: str | None = None
    size: str | None = None
    ignored: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " ".join(word for word in (self.size, self.color, self.category) if word)


def parse(prompt: str, vocabulary: Vocabulary) -> Phrase:
    """Parse a prompt.

    Raises:
        PromptError: the prompt is empty, its noun is not in the vocabulary, it names two colours
            or opposite sizes, or it negates a property.

    Example:
        >>> words = Vocabulary(("bed", "trash can"), ("white", "red"), ("tall", "short"))
        >>> str(parse("high white trash bin", words))
        'tall white trash can'
    """
    try:
        head = names.head_phrase(prompt)
    except names.NotANameError as error:
        raise PromptError(f"prompt: {error}; give a name such as 'chair'") from None
    words = head.replace(",", " ").split()
    after = names.normalise(prompt)[len(head) :].strip()
    for start in range(len(words)):
        noun = " ".join(words[start:])
        if category := _category(noun, vocabulary):
            phrase = _describe(prompt, words[:start], category, vocabulary)
            return replace(phrase, ignored=(*phrase.ignored, after)) if after else phrase
        if names.is_known(noun):  # a known object that the model lacks: do not read a shorter noun
            break
    raise PromptError(
        f"prompt {prompt!r}: this model knows only the built-in world's "
        f"{len(vocabulary.categories)} categories (nearest: "
        f"{', '.join(nearest(' '.join(words), vocabulary))})"
    )


def _category(noun: str, vocabulary: Vocabulary) -> str | None:
    """Return the category that a noun names or is a kind of (dining table: table), else None."""
    try:
        known = names.canonical(noun)
    except names.NotANameError:  # a character that no name has
        return None
    for name in names.head_nouns(known):
        if (category := names.canonical(name)) in vocabulary.categories:
            return category
        if not names.is_known(noun):  # an unknown noun is a kind of nothing: try no shorter ending
            return None
    return None


def _describe(prompt: str, adjectives: list[str], category: str, vocabulary: Vocabulary) -> Phrase:
    """Return the phrase of a category with the colour and size that the adjectives name."""
    if denied := next((word for word in adjectives if word in NEGATIONS), None):
        raise PromptError(
            f"prompt {prompt!r}: {denied!r} is not understood; say what the object is like, not "
            "what it is not like"
        )
    plain = [_PLAIN.get(word, word) for word in adjectives]
    colors = list(dict.fromkeys(word for word in plain if word in vocabulary.colors))
    sizes = list(dict.fromkeys(word for word in plain if word in vocabulary.sizes))
    known = {*colors, *sizes}
    ignored = [a for a, word in zip(adjectives, plain, strict=True) if word not in known]
    if len(colors) > 1:
        raise PromptError(
            f"prompt {prompt!r}: names two colours, {colors[0]} and {colors[1]}; name one"
        )
    for pair in OPPOSITES:
        if all(size in sizes for size in pair):
            raise PromptError(
                f"prompt {prompt!r}: an object is not {pair[0]} and {pair[1]} at once"
            )
    return Phrase(
        category,
        colors[0] if colors else None,
        sizes[0] if sizes else None,
        tuple(ignored + sizes[1:]),
    )


def contrasting(phrase: Phrase, vocabulary: Vocabulary, in_full: bool = True) -> list[str]:
    """Return phrases for the same category with another colour or another size.

    Args:
        phrase: the prompt.
        vocabulary: colours and sizes to use.
        in_full: False: the object is only partly in view, so only the colour changes.
    """
    others: list[Phrase] = []
    if phrase.color is not None:
        others += [replace(phrase, color=c) for c in vocabulary.colors if c != phrase.color]
    if phrase.size is not None and in_full:
        alike = (phrase.size, *ALIKE.get(phrase.size, ()))
        others += [replace(phrase, size=s) for s in vocabulary.sizes if s not in alike]
    return [str(other) for other in others]


def nearest(word: str, vocabulary: Vocabulary, n: int = 5) -> list[str]:
    """Return at most `n` categories spelt like a phrase or its last word; else the first `n`."""
    category_of = {alias: c for c in vocabulary.categories for alias in names.names_of(c)}
    found: list[str] = []
    for text in (word, word.split()[-1]):
        found += difflib.get_close_matches(text, list(category_of), n=2 * n, cutoff=0.3)
    return list(dict.fromkeys(category_of[alias] for alias in found))[:n] or list(
        vocabulary.categories[:n]
    )


class AttributeEncoder:
    """A `TextEncoder` that reads category, colour and size.

    Raises:
        ModelError: the model is missing or unusable, or its file has no vocabulary.

    Example:
        >>> from edge.perception.runtime.cards import load_card_of
        >>> encoder = AttributeEncoder(load_card_of(TextCard, "mini-house-text"))
        >>> encoder.resolve("high white trash bin")
        'tall white trash can'
        >>> encoder.embed(["chair", "red bed"]).shape == (1, 2, encoder.dim)
        True
    """

    def __init__(self, card: TextCard) -> None:
        self.card = card
        self.dim = card.dim
        path = verify_model(card, believe_cache=True)
        self._session = open_session(path, CPU, threads=1)
        metadata = self._session.get_modelmeta().custom_metadata_map
        try:
            self.vocabulary = Vocabulary.from_json(metadata["vocabulary"])
        except (KeyError, ValueError) as error:
            raise ModelError(
                f"{path}: the model's metadata has no vocabulary ({error}): export the model again"
            ) from None
        self._warned: set[tuple[str, ...]] = set()

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        """Return one unit row per prompt; see `TextEncoder.embed`."""
        phrases = [self._read(prompt) for prompt in check_prompts(prompts)]
        tokens = np.array([self._tokens(phrase) for phrase in phrases], np.int64)
        rows = run_encoder(self._session, self.card.file, "tokens", tokens, self.dim)
        return np.ascontiguousarray(rows)[None]

    def resolve(self, prompt: str) -> str:
        """Return the words that the model reads in a prompt, such as `tall white trash can`."""
        return str(self._read(prompt))

    def synonyms(self, prompt: str) -> list[str]:
        """Return none: the model has one word for each category; see `TextEncoder.synonyms`."""
        return []

    def contrasts(self, prompt: str, in_full: bool = True) -> list[str]:
        return contrasting(self._read(prompt), self.vocabulary, in_full)

    def __repr__(self) -> str:
        return str(self.card.path)

    def _read(self, prompt: str) -> Phrase:
        """Parse a prompt; warn once of words that are ignored."""
        phrase = parse(prompt, self.vocabulary)
        if phrase.ignored and phrase.ignored not in self._warned:
            self._warned.add(phrase.ignored)
            log.warning(
                "prompt %r: this model ignores %s and looks for %r",
                prompt, ", ".join(map(repr, phrase.ignored)), str(phrase),
            )  # fmt: skip
        return phrase

    def _tokens(self, phrase: Phrase) -> tuple[int, int, int]:
        """Return category, colour and size as numbers from 1; 0 for none."""
        v = self.vocabulary
        return (
            v.categories.index(phrase.category) + 1,
            v.colors.index(phrase.color) + 1 if phrase.color else 0,
            v.sizes.index(phrase.size) + 1 if phrase.size else 0,
        )

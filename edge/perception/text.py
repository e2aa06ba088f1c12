"""Prompt words → text embeddings: what an encoder is, which one is taken, and the vocabulary.

A vocabulary file holds embeddings of single words that were made beforehand. With a CLIP text
model (`edge.perception.clip` says what its ONNX file and its card must be like) whole phrases are
understood; a small detector of our own brings an encoder along.
"""

from __future__ import annotations

import contextlib
import difflib
import logging
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from edge import names
from edge.errors import UserError
from edge.host import resources
from edge.host.files import open_regular
from edge.perception.card_types import DetectCard, TextCard
from edge.perception.cards import ModelError, card_names, load_card, load_text_card

log = logging.getLogger(__name__)

VOCABULARY_FILE = "clip_vitb32_vocab.npz"
MAX_VOCABULARY_BYTES = 1 << 30
"""Half a million words."""
VOCABULARY_FAMILY = "clip-vit-b-32"
"""Family of the text cards whose embeddings the vocabulary holds. Other CLIP models embed words
elsewhere, many of them at the same length, so neither can stand in for the other."""


_UNREADABLE = (
    OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip
"""What NumPy raises for a damaged .npz, and what comes of a file that holds other things."""


class PromptError(UserError, ValueError):
    """A prompt or vocabulary that cannot be used; one line with what to do."""


class TextEncoder(Protocol):
    """Turns prompts into what a detector or an image encoder compares with.

    Attributes:
        dim: length of an embedding.
    """

    dim: int

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        """One unit row per prompt.

        Returns:
            (1, n, dim) float32.

        Raises:
            PromptError: no prompt, an empty one, or one that is not understood.
        """
        ...

    def resolve(self, prompt: str) -> str:
        """The words that stand for a prompt; raises PromptError as `embed` does."""
        ...

    def contrasts(self, prompt: str, whole: bool = True) -> list[str]:
        """Phrases that differ from the prompt in just what it says of its thing (another colour);
        none where phrases are not understood.

        Args:
            whole: whether the thing is wholly in view; else only what a part of it shows.
        """
        ...


def make_text_encoder(card: DetectCard, vocabulary: str | None) -> TextEncoder:
    """The encoder for a detector's prompts.

    The card's own; where it names none, CLIP ViT-B/32's: the text model, when its file is there,
    else the vocabulary.

    Args:
        vocabulary: as configured; see `find_vocabulary`.

    Raises:
        ModelError: a model is there and cannot be used.
        PromptError: there is neither a model nor a vocabulary, or its embeddings do not fit.
    """
    named = None if card.text_encoder is None else load_text_card(card.text_encoder)
    encoder = open_text_encoder(named, vocabulary)
    if encoder.dim != card.text_dim:
        raise PromptError(
            f"{encoder!r}: embeddings have length {encoder.dim}, "
            f"model {card.name} needs {card.text_dim}"
        )
    return encoder


def open_text_encoder(named: TextCard | None, vocabulary: str | None) -> TextEncoder:
    """See `make_text_encoder`.

    Args:
        named: the encoder asked for; None for CLIP ViT-B/32's.
    """
    if named is not None and named.tokenizer.kind == "attributes":
        from edge.perception.attributes import AttributeEncoder

        return AttributeEncoder(named)
    models = [named] if named is not None else _vocabulary_models()
    for model in models:
        if model.path.is_file() or model.family != VOCABULARY_FAMILY:
            from edge.perception.clip import ClipTextEncoder

            return ClipTextEncoder(model)
    try:
        return TextEmbeddings(vocabulary)
    except PromptError as error:
        wanted = " or ".join(str(model.path) for model in models)
        wanted = wanted or f"no text card of family {VOCABULARY_FAMILY}"
        raise PromptError(f"no CLIP text model ({wanted}), and {error}") from None


def _vocabulary_models() -> list[TextCard]:
    """Cards of text models that embed as the vocabulary does."""
    found = []
    for name in card_names():
        try:
            card = load_card(name)
        except ModelError as error:  # a detector need not wait for another model's card
            log.warning("%s: passed over", error)
            continue
        if isinstance(card, TextCard) and card.family == VOCABULARY_FAMILY:
            found.append(card)
    return found


def words_for(labels: Iterable[str], resolve: Callable[[str], str]) -> dict[str, str]:
    """Label → the text encoder's word for it (`TextEncoder.resolve`), without the labels that it
    has none for."""
    words = {}
    for label in labels:
        with contextlib.suppress(PromptError):
            words[label] = resolve(label)
    return words


def find_vocabulary(configured: str | None) -> Path:
    """The vocabulary file: as configured, else `$EDGE_VOCABULARY`, else in the models' cache.

    Raises:
        PromptError: it is not there.
    """
    told = configured or os.environ.get("EDGE_VOCABULARY")
    path = resources.expand(told) if told else resources.models_dir() / VOCABULARY_FILE
    if path.is_file():
        return path
    raise PromptError(
        f"{path}: no vocabulary of text embeddings; put an .npz with `names` (n) and `emb` "
        "(n, 512) there, or name one in perception.detector.vocabulary or $EDGE_VOCABULARY"
    )


class TextEmbeddings:
    """Embeddings of a fixed vocabulary, looked up through the alias table."""

    def __init__(self, vocabulary: str | None = None) -> None:
        """
        Args:
            vocabulary: an .npz with `names` (n,) and `emb` (n, d); see `find_vocabulary`.

        Raises:
            PromptError: the file is missing or is no vocabulary.
        """
        self.path = find_vocabulary(vocabulary)
        try:
            with (
                open_regular(self.path, MAX_VOCABULARY_BYTES) as content,
                np.load(content, allow_pickle=False) as file,
            ):
                words = [str(word).lower() for word in file["names"]]
                self._rows = file["emb"].astype(np.float32)
        except _UNREADABLE as error:
            raise PromptError(
                f"{self.path}: not a vocabulary (needs arrays `names` and `emb`): {error}"
            ) from None
        if self._rows.ndim != 2 or len(self._rows) != len(words) or not words:
            raise PromptError(
                f"{self.path}: {len(words)} names but embeddings of shape {self._rows.shape}"
            )
        norms = np.linalg.norm(self._rows, axis=1, keepdims=True)
        usable = np.isfinite(norms) & (norms > 0.0)
        if not usable.all():
            raise PromptError(
                f"{self.path}: the embedding of {words[int(np.argmin(usable))]!r} is zero or not "
                "finite: make the vocabulary anew, or leave the word out"
            )
        self._rows /= norms
        self._row_of: dict[str, int] = {}
        for row, word in enumerate(words):
            self._row_of.setdefault(word, row)

    @property
    def dim(self) -> int:
        return self._rows.shape[1]

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        """One unit row per prompt.

        Args:
            prompts: words or phrases; a phrase that the vocabulary lacks is read as its longest
                known ending ("tall white trash bin": trash bin), with a warning.

        Returns:
            (1, n, d) float32.

        Raises:
            PromptError: an empty prompt, or a word outside the vocabulary (nearest are listed).
        """
        if not prompts:
            raise PromptError("no prompt: name at least one thing to look for")
        rows = [self._row_of[self.resolve(prompt)] for prompt in prompts]
        return np.ascontiguousarray(self._rows[rows])[None]

    def contrasts(self, prompt: str, whole: bool = True) -> list[str]:
        """See `TextEncoder.contrasts`: words say nothing of colours."""
        return []

    def resolve(self, prompt: str) -> str:
        """The vocabulary word that stands for a prompt; see `embed`."""
        try:
            word = names.normalise(prompt)
        except names.NotANameError as error:
            raise PromptError(f"prompt: {error}, such as 'chair'") from None
        if found := self._lookup(word):
            return found
        for noun in names.head_nouns(word):
            if found := self._lookup(noun):
                log.warning(
                    "prompt %r: no embedding for the phrase, looking for %r (vocabulary word %r)",
                    prompt, noun, found,
                )  # fmt: skip
                return found
        close = ", ".join(self.nearest(word))
        raise PromptError(
            f"prompt {prompt!r}: not in the vocabulary {self.path.name} (nearest: {close})"
        )

    def nearest(self, word: str, n: int = 5) -> list[str]:
        """Vocabulary words and aliases spelt most like `word`, at most `n`."""
        known = [*self._row_of, *(a for others in names.ALIASES.values() for a in others)]
        return list(dict.fromkeys(difflib.get_close_matches(word, known, n=n + 2, cutoff=0.4)))[:n]

    def __repr__(self) -> str:
        return str(self.path)

    def _lookup(self, word: str) -> str | None:
        return next((name for name in names.names_of(word) if name in self._row_of), None)

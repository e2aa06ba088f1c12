"""Prompt words → text embeddings: what an encoder is, and the vocabulary.

A vocabulary file holds embeddings of single words that were made beforehand. With a CLIP text
model (`clip.py` says what its ONNX file and its card must be like) whole phrases are understood; a
small detector of our own brings an encoder along (`attributes.py`). `encoders.py` chooses.
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
from typing import Any, Protocol

import numpy as np

from edge import names
from edge.errors import UserError
from edge.host import resources
from edge.host.files import open_regular
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import failing_as
from edge.text import one_line

log = logging.getLogger(__name__)

VOCABULARY_FILE = "clip_vitb32_vocab.npz"
MAX_VOCABULARY_BYTES = 1 << 30
"""Half a million words."""
SYNONYM_COSINE = 0.95
"""Words whose embeddings are nearer than that name one thing: of CLIP ViT-B/32's, chair and
armchair (0.96), cushion and pillow (0.96), but not table and desk (0.93) nor cup and mug (0.93)."""
MAX_SYNONYMS = 6

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

    def synonyms(self, prompt: str) -> list[str]:
        """What else the thing of a prompt is called, in words that `embed` takes; not its `resolve`
        word, nor a name of something broader."""
        ...

    def contrasts(self, prompt: str, whole: bool = True) -> list[str]:
        """Phrases that differ from the prompt in just what it says of its thing (another colour);
        none where phrases are not understood.

        Args:
            whole: whether the thing is wholly in view; else only what a part of it shows.
        """
        ...


def check_prompts(prompts: Sequence[str]) -> tuple[str, ...]:
    """The prompts; raises PromptError for none, and for one text in the place of several."""
    if isinstance(prompts, str):
        raise PromptError(f"prompts must be a list of words, got {prompts!r}")
    if not prompts:
        raise PromptError("no prompt: name at least one thing to look for")
    return tuple(prompts)


def tidy(prompt: str) -> str:
    """A prompt as names are compared; raises PromptError for one that names nothing."""
    try:
        return names.normalise(prompt)
    except names.NotANameError as error:
        raise PromptError(f"prompt: {error}, such as 'chair'") from None


def run_encoder(session: Any, file: str, name: str, batch: np.ndarray, dim: int) -> np.ndarray:
    """What an encoder's session makes of a batch: (n, dim) float32, finite, no row zero.

    Args:
        file: of the model, for messages.
        name: of its input.

    Raises:
        ModelError: the model fails, or its output is anything else.
    """
    with failing_as(f"{file}: it fails"):
        (rows,) = session.run(["embeddings"], {name: batch})
    norms = np.linalg.norm(rows, axis=-1)
    shape = (len(batch), dim)
    if rows.shape != shape or not (np.isfinite(norms).all() and (norms > 0.0).all()):
        raise ModelError(
            f"{file}: embeddings of shape {rows.shape}, zero or not finite; they must be {shape}"
        )
    return rows


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


def load_vocabulary(path: Path) -> tuple[list[str], np.ndarray]:
    """Words in lower case and their embeddings, (n, d) float32 unit rows.

    Raises:
        PromptError: the file is no vocabulary.
    """
    try:
        with (
            open_regular(path, MAX_VOCABULARY_BYTES) as content,
            np.load(content, allow_pickle=False) as file,
        ):
            words = [str(word).lower() for word in file["names"]]
            rows = file["emb"].astype(np.float32)
    except _UNREADABLE as error:
        raise PromptError(
            f"{path}: not a vocabulary (needs arrays `names` and `emb`): {one_line(error)}"
        ) from None
    if rows.ndim != 2 or len(rows) != len(words) or not words:
        raise PromptError(f"{path}: {len(words)} names but embeddings of shape {rows.shape}")
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    usable = np.isfinite(norms) & (norms > 0.0)
    if not usable.all():
        raise PromptError(
            f"{path}: the embedding of {words[int(np.argmin(usable))]!r} is zero or not "
            "finite: make the vocabulary anew, or leave the word out"
        )
    return words, rows / norms


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
        words, self._rows = load_vocabulary(self.path)
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
        rows = [self._row_of[self.resolve(prompt)] for prompt in check_prompts(prompts)]
        return np.ascontiguousarray(self._rows[rows])[None]

    def synonyms(self, prompt: str) -> list[str]:
        """See `TextEncoder.synonyms`: the vocabulary's names for it, and what it embeds within
        SYNONYM_COSINE of its own, at most MAX_SYNONYMS."""
        word = self.resolve(prompt)
        near = self._rows @ self._rows[self._row_of[word]]
        found = [name for name in names.names_of(word) if name in self._row_of]
        by_nearness = sorted(self._row_of.items(), key=lambda item: -near[item[1]])
        for name, row in by_nearness:
            if near[row] < SYNONYM_COSINE:
                break
            if not names.is_name(name) or names.is_kind_of(word, name):
                continue
            if names.is_kind_of(name, word) or not names.is_known(name):  # not a thing of its own
                found.append(name)
        return [name for name in dict.fromkeys(found) if name != word][:MAX_SYNONYMS]

    def contrasts(self, prompt: str, whole: bool = True) -> list[str]:
        """See `TextEncoder.contrasts`: words say nothing of colours."""
        return []

    def resolve(self, prompt: str) -> str:
        """The vocabulary word that stands for a prompt; see `embed`."""
        word = tidy(prompt)
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

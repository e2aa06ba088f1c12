"""Prompt words → CLIP text embeddings, from a vocabulary file made beforehand.

The seam for a text encoder: whatever turns prompts into (1, n, 512) unit rows can stand in for
`TextEmbeddings.embed`; nothing else knows where the rows come from.
"""

from __future__ import annotations

import difflib
import logging
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from edge import names, resources
from edge.errors import UserError

log = logging.getLogger(__name__)

VOCABULARY_FILE = "clip_vitb32_vocab.npz"


class PromptError(UserError, ValueError):
    """A prompt or vocabulary that cannot be used; one line with what to do."""


def find_vocabulary(configured: str | None) -> Path:
    """The vocabulary file: as configured, else `$EDGE_VOCABULARY`, else in the models' cache.

    Raises:
        PromptError: it is not there.
    """
    told = configured or os.environ.get("EDGE_VOCABULARY")
    path = Path(told).expanduser() if told else resources.models_dir() / VOCABULARY_FILE
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
            with np.load(self.path, allow_pickle=False) as file:
                words = [str(word).lower() for word in file["names"]]
                self._rows = file["emb"].astype(np.float32)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise PromptError(
                f"{self.path}: not a vocabulary (needs arrays `names` and `emb`): {error}"
            ) from None
        if self._rows.ndim != 2 or len(self._rows) != len(words) or not words:
            raise PromptError(
                f"{self.path}: {len(words)} names but embeddings of shape {self._rows.shape}"
            )
        self._rows /= np.linalg.norm(self._rows, axis=1, keepdims=True)
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

    def resolve(self, prompt: str) -> str:
        """The vocabulary word that stands for a prompt; see `embed`."""
        try:
            word = names.normalise(prompt)
        except ValueError:
            raise PromptError("empty prompt: name a thing to look for, such as 'chair'") from None
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

    def _lookup(self, word: str) -> str | None:
        return next((name for name in names.names_of(word) if name in self._row_of), None)

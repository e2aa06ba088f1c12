"""Prompt words → text embeddings: the interface of an encoder, and the vocabulary.

A vocabulary file holds embeddings of single words, made beforehand. A CLIP text model (`clip.py`
describes its ONNX file and its card) understands entire phrases. A small detector of our own brings
its encoder along (`attributes.py`). `encoders.py` chooses. The alias table (`edge.names`) has the
names of known objects.
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
from edge.perception.runtime.sessions import raise_as_model_error
from edge.text import one_line

log = logging.getLogger(__name__)

VOCABULARY_FILE = "clip_vitb32_vocab.npz"
MAX_VOCABULARY_BYTES = 1 << 30
"""Size limit of a vocabulary file: half a million words."""
SYNONYM_COSINE = 0.95
"""Words with a higher cosine between their embeddings name one object.

In CLIP ViT-B/32 these are chair and armchair (0.96), cushion and pillow (0.96), but not table and
desk (0.93) nor cup and mug (0.93)."""
NARROWER_COSINE = 0.90
"""Kinds of an object with a higher cosine are asked for, too, unless the alias table lists them.

On views of `furnished[0:100]`, YOLO-World INT8 found more boxes (recall 0.22 to 0.47, by "storage
box"), cabinets (0.42 to 0.58, "file cabinet"), beds (0.46 to 0.57, "infant bed") and helmets (0 to
0.28, "football helmet"); over six words 0.34 to 0.45, at a precision of 0.62 to 0.64. Kinds that
are less alike cost precision ("bread-bin" for a bin)."""
_MOST_WARNINGS = 1000  # remembered ones
MAX_SYNONYMS = 6
"""Largest number of synonyms of one prompt."""

_UNREADABLE = (
    OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip
"""Errors of NumPy for a damaged .npz, and of a file with other content."""


class PromptError(UserError, ValueError):
    """A prompt or vocabulary that cannot be used; one line with what to do."""


class TextEncoder(Protocol):
    """Turns prompts into embeddings for a detector or an image encoder."""

    dim: int

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        """Return one unit row per prompt, (1, n, dim) float32.

        Raises:
            PromptError: there is no prompt, a prompt is empty, or a prompt is not understood.
        """
        ...

    def resolve(self, prompt: str) -> str:
        """Return the encoder's words for a prompt; raise PromptError as `embed` does."""
        ...

    def synonyms(self, prompt: str) -> list[str]:
        """Return other names of a prompt's object that `embed` takes.

        The `resolve` word and names of something broader are left out.
        """
        ...

    def contrasts(self, prompt: str, in_full: bool = True) -> list[str]:
        """Return phrases that differ from the prompt only in an attribute (another colour).

        There are none if the encoder does not understand phrases.

        Args:
            prompt: a word or phrase.
            in_full: False: the object is only partly in view, so only attributes that a part shows,
                such as the colour, are used.
        """
        ...


def check_prompts(prompts: Sequence[str]) -> tuple[str, ...]:
    """Return the prompts as a tuple; raise PromptError if they are empty, or a single text."""
    if isinstance(prompts, str):
        raise PromptError(f"prompts must be a list of words, got {prompts!r}")
    if not prompts:
        raise PromptError("no prompt: name at least one object to look for")
    return tuple(prompts)


def tidy(prompt: str) -> str:
    """Return a prompt in the form for comparing names; raise PromptError if it names nothing."""
    try:
        return names.normalise(prompt)
    except names.NotANameError as error:
        raise PromptError(f"prompt: {error}; give a name such as 'chair'") from None


def run_encoder(session: Any, file: str, name: str, batch: np.ndarray, dim: int) -> np.ndarray:
    """Run an encoder on a batch; return (n, dim) float32, finite, without a row of zeros.

    Raises:
        ModelError: the model fails, or its output is anything else.
    """
    with raise_as_model_error(f"{file}: it fails"):
        (rows,) = session.run(["embeddings"], {name: batch})
    norms = np.linalg.norm(rows, axis=-1)
    shape = (len(batch), dim)
    if rows.shape != shape or not (np.isfinite(norms).all() and (norms > 0.0).all()):
        raise ModelError(
            f"{file}: embeddings of shape {rows.shape}, some zero or not finite; expected "
            f"{shape}, finite and not zero"
        )
    return rows


def words_for(labels: Iterable[str], resolve: Callable[[str], str]) -> dict[str, str]:
    """Map each label to the text encoder's word for it (`TextEncoder.resolve`).

    Labels without such a word are left out.
    """
    words = {}
    for label in labels:
        with contextlib.suppress(PromptError):
            words[label] = resolve(label)
    return words


def find_vocabulary(configured: str | None) -> Path:
    """Return the path of the vocabulary: as configured, else `$EDGE_VOCABULARY`, else in the cache.

    Raises:
        PromptError: there is no such file.
    """
    named = configured or os.environ.get("EDGE_VOCABULARY")
    path = resources.expand(named) if named else resources.models_dir() / VOCABULARY_FILE
    if path.is_file():
        return path
    raise PromptError(
        f"{path}: no vocabulary of text embeddings; put an .npz with `names` (n) and `emb` "
        "(n, 512) there, or name one in perception.detector.vocabulary or $EDGE_VOCABULARY"
    )


def load_vocabulary(path: Path) -> tuple[list[str], np.ndarray]:
    """Load words in lower case and their embeddings, (n, d) float32 unit rows.

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
        raise PromptError(
            f"{path}: {len(words)} names, but embeddings of shape {rows.shape}; expected one row "
            "for each name"
        )
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    usable = np.isfinite(norms) & (norms > 0.0)
    if not usable.all():
        raise PromptError(
            f"{path}: the embedding of {words[int(np.argmin(usable))]!r} is zero or not "
            "finite: make the vocabulary again, or leave the word out"
        )
    return words, rows / norms


class TextEmbeddings:
    """A `TextEncoder` with the embeddings of a fixed vocabulary, looked up by the alias table.

    Args:
        vocabulary: path of an .npz with `names` (n,) and `emb` (n, d); see `find_vocabulary`.

    Raises:
        PromptError: the file is missing or is no vocabulary.
    """

    def __init__(self, vocabulary: str | None = None) -> None:
        self.path = find_vocabulary(vocabulary)
        words, self._rows = load_vocabulary(self.path)
        self._row_of: dict[str, int] = {}
        for row, word in enumerate(words):  # the first of two equal words counts
            self._row_of.setdefault(word, row)
        self._bracketed = _bracketed(self._row_of)
        self._warnings: set[str] = set()  # warnings that were logged

    @property
    def dim(self) -> int:
        return self._rows.shape[1]

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        """Return one unit row per prompt, (1, n, d) float32.

        Args:
            prompts: words or phrases. A phrase that the vocabulary lacks is read as its longest
                known ending ("tall white trash bin": trash bin), and a kind as the broader word
                ("bush": plant, see `names.HYPERNYMS`), with a warning.

        Raises:
            PromptError: an empty prompt, or a word outside the vocabulary (nearest words are
                listed).
        """
        rows = [self._row_of[self.resolve(prompt)] for prompt in check_prompts(prompts)]
        return np.ascontiguousarray(self._rows[rows])[None]

    def synonyms(self, prompt: str) -> list[str]:
        """Return other names of the word, and words that the two cosines count as names of it.

        See `TextEncoder.synonyms`.
        """
        word = self.resolve(prompt)
        near = self._rows @ self._rows[self._row_of[word]]
        found = [name for name in names.names_of(word) if name in self._row_of]
        by_nearness = sorted(self._row_of.items(), key=lambda item: -near[item[1]])
        for name, row in by_nearness:
            if near[row] < NARROWER_COSINE:
                break
            if not names.is_name(name) or names.is_kind_of(word, name):  # no name, or a broader one
                continue
            # Kinds of the word, and words without an entry in the alias table: all others that the
            # table knows are different objects.
            kind = names.is_kind_of(name, word)
            unlisted = not names.is_known(name) and name not in names.BROADER
            least = NARROWER_COSINE if kind and unlisted else SYNONYM_COSINE
            if near[row] >= least and (kind or unlisted):
                found.append(name)
        return [name for name in dict.fromkeys(found) if name != word][:MAX_SYNONYMS]

    def contrasts(self, prompt: str, in_full: bool = True) -> list[str]:
        """Return none: single words have no attributes; see `TextEncoder.contrasts`."""
        return []

    def resolve(self, prompt: str) -> str:
        """Return the vocabulary word that stands for a prompt; see `embed`."""
        word = tidy(prompt)
        if found := self._lookup(word):
            return found
        for noun in names.head_nouns(word):
            if found := self._lookup(noun):
                self._warn_once(
                    f"prompt {prompt!r}: no embedding for the phrase; looking for {noun!r} "
                    f"(vocabulary word {found!r})"
                )
                return found
            broader = names.hypernym(noun)
            if broader and (found := self._lookup(broader)):
                self._warn_once(f"prompt {prompt!r}: no embedding; searched as {broader!r}")
                return found
        close = ", ".join(self.nearest(word))
        raise PromptError(
            f"prompt {prompt!r}: not in the vocabulary {self.path.name} (nearest: {close})"
        )

    def _warn_once(self, text: str) -> None:
        """Log a warning, unless it was logged before: prompts are resolved again and again."""
        if text not in self._warnings:
            if len(self._warnings) == _MOST_WARNINGS:
                self._warnings.clear()
            self._warnings.add(text)
            log.warning("%s", text)

    def nearest(self, word: str, n: int = 5) -> list[str]:
        """Return vocabulary words and aliases spelt most like `word`, at most `n`."""
        known = [*self._row_of, *(a for others in names.ALIASES.values() for a in others)]
        return list(dict.fromkeys(difflib.get_close_matches(word, known, n=n + 2, cutoff=0.4)))[:n]

    def __repr__(self) -> str:
        return str(self.path)

    def _lookup(self, word: str) -> str | None:
        """Return the vocabulary word that is one of a word's names; None if there is none."""
        known = names.names_of(word)
        plain = next((name for name in known if name in self._row_of), None)
        return plain or next(filter(None, map(self._bracketed.get, known)), None)


def _bracketed(words: Iterable[str]) -> dict[str, str]:
    """Return the vocabulary words with a remark in brackets, by the word without it.

    Words with several remarks are left out: "bow (weapon)", "bow (decorative ribbons)".

    >>> _bracketed(["tractor (farm equipment)", "bow (weapon)", "bow (decorative ribbons)"])
    {'tractor': 'tractor (farm equipment)'}
    """
    found: dict[str, list[str]] = {}
    for word in words:
        if word.endswith(")"):
            found.setdefault(word.partition(" (")[0], []).append(word)
    return {plain: full[0] for plain, full in found.items() if len(full) == 1}

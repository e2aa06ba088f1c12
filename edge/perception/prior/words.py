"""Index of words: it maps any word to a class that the prior knows, by name or by embedding.

A phrase ("red sofa") or a synonym finds the row of its class in the table (`table.ObjectPrior`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from edge import config, names
from edge.perception.embedding.text import PromptError, find_vocabulary, load_vocabulary
from edge.perception.prior.table import ObjectPrior

log = logging.getLogger(__name__)

ALIKE = 0.92
"""Least cosine of CLIP ViT-B/32 embeddings for a word to stand for a class.

Of the pairs of different classes in the table, one in ten reaches it. Of 30 synonyms in the
vocabulary for one of its classes, 15 reach it, none of them wrongly."""


class PriorWordIndex:
    """Index of words: finds a word's row in the table, and remembers it.

    Args:
        vocabulary: words and their unit embeddings, (v, d) float32; None: words match by name only.
    """

    def __init__(
        self, table: ObjectPrior, vocabulary: tuple[list[str], np.ndarray] | None = None
    ) -> None:
        self._table = table
        self._found: dict[str, int] = {}  # rows of the table, by word
        self._row_of: dict[str, int] = {}  # rows of the vocabulary, by word
        if vocabulary is not None:
            words, self._vectors = vocabulary
            for i, word in enumerate(words):
                self._row_of.setdefault(word, i)
            known = [(row, self._vector(name)) for row, name in enumerate(table.classes)]
            embedded = [(row, vector) for row, vector in known if vector is not None]
            # Rows of the table whose classes have an embedding, and these embeddings (n, d).
            self._rows = np.array([row for row, _ in embedded], np.int64)
            self._class_vectors = np.array([v for _, v in embedded]).reshape(
                -1, self._vectors.shape[1]
            )

    def row(self, word: str) -> int:
        """Return the table's row for a word or phrase; -1 if the table has nothing like it.

        The row is found by name (an alias, the phrase's noun), else by the nearest embedding, if
        the cosine is at least `ALIKE`.
        """
        if word not in self._found:
            self._found[word] = self._find(word)
        return self._found[word]

    def alike(self, word: str, others: Sequence[str]) -> list[str]:
        """Return the words among others whose embeddings are alike (`ALIKE`), most alike first.

        Without a vocabulary, or for a word outside it, there are none.
        """
        vector = self._vector(word)
        if vector is None:
            return []
        known = [(other, self._vector(other)) for other in others]
        cosine = {name: float(v @ vector) for name, v in known if v is not None}
        return sorted((n for n, c in cosine.items() if c >= ALIKE), key=lambda n: (-cosine[n], n))

    def _find(self, word: str) -> int:
        """Find the row of a word for the first time; see `row`."""
        if not names.is_name(word):
            return -1
        for noun in names.head_nouns(word):
            if (row := self._table.row(noun)) >= 0:
                return row
        vector = self._vector(word)
        if vector is None or not len(self._rows):
            return -1
        cosine = self._class_vectors @ vector
        return int(self._rows[cosine.argmax()]) if cosine.max() >= ALIKE else -1

    def _vector(self, word: str) -> np.ndarray | None:
        """Return the embedding of a word or of another name of it; None if there is none."""
        at = next((self._row_of[n] for n in names.names_of(word) if n in self._row_of), None)
        return None if at is None else self._vectors[at]


def make_words(
    table: ObjectPrior, detector: config.DetectorOnnx | config.DetectorSim
) -> PriorWordIndex:
    """Make the index for a detector's words, with the detector's vocabulary if there is one."""
    if detector.kind == "onnx":
        try:
            return PriorWordIndex(table, load_vocabulary(find_vocabulary(detector.vocabulary)))
        except PromptError as error:
            log.info("%s; until then perception.prior gives no hints about objects that its table "
                     "does not name (the search still finds them)", error)  # fmt: skip
    return PriorWordIndex(table)

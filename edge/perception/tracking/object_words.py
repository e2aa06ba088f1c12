"""Words of the object map: canonical class names of targets and context."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge import names

_BROADER_WEIGHT = 0.75
"""Weight of a broader word against a narrower one.

An armchair is a chair. But an object that is clearly a chair and hardly an armchair is no armchair.
"""
_NO_WEIGHTS = np.zeros(0, np.float32)


class ObjectWords:
    """The words of all objects, and those that the detector looks for now.

    Args:
        words: `TrackedObjects.words`; new words are appended to it.

    Attributes:
        index: index of each word in `words`.
        looked_for: (words,) bool, True if the detector looked for the word in the newest image.
        of_class: word of each class id in the newest image, of targets and of context.
    """

    def __init__(self, words: list[str]) -> None:
        self._words = words
        self.index: dict[str, int] = {}
        self.of_class: tuple[np.ndarray, np.ndarray] = (np.zeros(0, np.int16),) * 2
        self._weights: dict[str, np.ndarray] = {}  # of all words against an object of a name
        self.looked_for = np.zeros(0, np.bool_)
        # The detector's prompts and context words.
        self._prompts_and_words: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())

    def look_for(self, prompts: tuple[str, ...], context: tuple[str, ...]) -> None:
        """Set the prompts and context words that the detector looked for in this image."""
        if (prompts, context) == self._prompts_and_words:
            return
        self._prompts_and_words = prompts, context
        self.of_class = (
            self.indices([names.canonical(names.head_phrase(prompt)) for prompt in prompts]),
            self.indices(context),
        )  # fmt: skip
        self.looked_for = np.zeros(len(self._words), np.bool_)
        for indices in self.of_class:
            self.looked_for[indices] = True

    def look_for_nothing(self) -> None:
        """Forget what the detector looked for."""
        self.looked_for, self._prompts_and_words = np.zeros(len(self._words), np.bool_), ((), ())

    def indices(self, words: Sequence[str]) -> np.ndarray:
        """Return the indices of words, (k,) int16; new words are appended."""
        for word in words:
            if word not in self.index:
                self.index[word] = len(self._words)
                self._words.append(word)
        return np.array([self.index[word] for word in words], np.int16)

    def weights_against(self, name: str) -> np.ndarray:
        """Return the weight of each word's confidence against an object, (words,) float32.

        Words that the detector does not look for now have no weight: no view could lower their
        confidence.
        """
        known = self._weights.get(name, _NO_WEIGHTS)
        if len(known) < len(self._words):
            more = [_weight_against(word, name) for word in self._words[len(known) :]]
            known = self._weights[name] = np.append(known, np.array(more, np.float32))
        return known * self.looked_for


def _weight_against(word: str, name: str) -> float:
    """Return the weight of a word's confidence against an object of this name.

    The weight is 0 if the word names the same object, or a kind of it.
    """
    if names.is_kind_of(word, name):
        return 0.0
    return _BROADER_WEIGHT if names.is_kind_of(name, word) else 1.0

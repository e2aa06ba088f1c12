"""Neural network that translates an instruction into a mission formula (LTL), and back.

It also gives the log probability of an instruction for a formula.

The ONNX file has two halves. The encoder (`source` → `across`) runs once for a text. The decoder
(`target`, `past`, `across_in` → `logits`, `present`) runs once for each written token. `across` is
the encoder's output for the decoder's cross-attention. The unused half gets one padding token as
input.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge.mission.language.grammar.prefix_notation import NAMES, OPERATORS, REFUSED, allowed
from edge.perception.runtime.card_types import TranslateCard
from edge.perception.runtime.cards import load_card_of, verify_model
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import open_session

MOST_WORDS = 90
"""Largest number of words in a sentence; the caller refuses longer ones."""
MOST_TOKENS = 60
"""Largest number of tokens in a formula."""
BEAM = 6
"""Number of hypotheses that the search keeps."""
PAD, END, UNKNOWN, TO_FORMULA, TO_WORDS = SPECIAL = (
    "<pad>", "<end>", "<unknown>", "<formula>", "<words>",
)  # fmt: skip
VOCABULARY = "vocabulary"
"""Metadata key of the ONNX file: a JSON list of tokens, in the order of their ids."""


@dataclass(frozen=True, slots=True)
class FormulaHypothesis:
    """A hypothesis of the beam search: tokens of a formula, and their log probability [nats]."""

    tokens: tuple[str, ...]
    log_p: float


class TranslationNetwork:
    """A session with the translation network, on one CPU core.

    Raises:
        ModelError: there is no such card, or its file is missing or damaged.
    """

    def __init__(self, card: str) -> None:
        described = load_card_of(TranslateCard, card)
        self._open(verify_model(described))

    @classmethod
    def from_file(cls, path: Path) -> TranslationNetwork:
        """Return a network from a file that has no card yet."""
        network = cls.__new__(cls)  # without __init__, which needs a card
        network._open(path)
        return network

    def _open(self, path: Path) -> None:
        self._session = open_session(
            path, ["CPUExecutionProvider"], 1, key="mission.translator.card"
        )
        text = self._session.get_modelmeta().custom_metadata_map.get(VOCABULARY, "")
        self.tokens = _parse_vocabulary(path, text)
        self._ids = {token: i for i, token in enumerate(self.tokens)}
        past = next(i for i in self._session.get_inputs() if i.name == "past")
        # `past` has the shape (keys and values of all layers, batch, heads, tokens, width).
        parts, _, heads, _, width = past.shape
        self._no_past = np.zeros((parts, 1, heads, 0, width), np.float32)
        self._no_across = np.zeros((parts, 1, heads, 1, width), np.float32)
        self._padding_token = np.array([[self._ids[PAD]]], np.int64)

    def knows(self, word: str) -> bool:
        """Return True if the word is in the vocabulary."""
        return word in self._ids

    @property
    def words(self) -> tuple[str, ...]:
        """The words of the vocabulary."""
        return tuple(t for t in self.tokens if t not in OPERATORS and not t.startswith("<"))

    def formulas(
        self, words: Sequence[str], n_names: int, beam: int = BEAM
    ) -> list[FormulaHypothesis]:
        """Return the most likely formulas, the best first.

        Beam search over the tokens that the prefix notation allows. Probabilities are normalised
        over the allowed tokens.
        """
        across = self._encode(words)
        target = np.array([[self._ids[TO_FORMULA]]], np.int64)
        logits, past = self._decode(target, self._no_past, across)
        beams: list[tuple[list[str], float]] = [([], 0.0)]
        complete: list[FormulaHypothesis] = []
        while beams and len(beams[0][0]) < MOST_TOKENS:
            # Log probability, row of the hypothesis in `logits` and `past`, next token.
            extended: list[tuple[float, int, str]] = []
            for row, (tokens, log_p) in enumerate(beams):
                options = list(allowed(tokens, n_names, MOST_TOKENS))
                log_ps = _log_softmax(logits[row, -1, [self._ids[token] for token in options]])
                extended += [
                    (log_p + p, row, token)
                    for p, token in zip(log_ps.tolist(), options, strict=True)
                ]
            extended.sort(key=lambda candidate: -candidate[0])
            following: list[tuple[list[str], float]] = []
            rows: list[int] = []
            for log_p, row, token in extended[:beam]:
                tokens = [*beams[row][0], token]
                if token == REFUSED or not any(allowed(tokens, n_names, MOST_TOKENS)):
                    complete.append(FormulaHypothesis(tuple(tokens), log_p))
                else:
                    following.append((tokens, log_p))
                    rows.append(row)
            beams = following
            if not beams or (
                len(complete) >= beam and max(d.log_p for d in complete) > beams[0][1]
            ):
                break
            target = np.array([[self._ids[tokens[-1]]] for tokens, _ in beams], np.int64)
            logits, past = self._decode(target, past[:, rows], across)
        return sorted(complete, key=lambda hypothesis: -hypothesis.log_p)[:beam]

    def back_translation_log_p(
        self, tokens: Sequence[str], sentences: Sequence[Sequence[str]]
    ) -> list[float]:
        """Return the log probability [nats] of each sentence, given the formula.

        This back-translation checks a reading.
        """
        across = self._encode(tokens)
        ids = [[self._ids.get(word, self._ids[UNKNOWN]) for word in words] for words in sentences]
        longest = max(map(len, ids))
        target = np.full((len(ids), longest + 1), self._ids[PAD], np.int64)
        target[:, 0] = self._ids[TO_WORDS]
        for row, sentence in enumerate(ids):
            target[row, 1 : len(sentence) + 1] = sentence
        logits, _ = self._decode(target, self._no_past.repeat(len(ids), axis=1), across)
        log_ps = _log_softmax(logits)
        return [
            float(log_ps[row, np.arange(len(sentence) + 1), [*sentence, self._ids[END]]].sum())
            for row, sentence in enumerate(ids)
        ]

    def _encode(self, tokens: Sequence[str]) -> np.ndarray:
        """Return the encoder's output for a text, for all steps of the decoder."""
        ids = [self._ids.get(token, self._ids[UNKNOWN]) for token in tokens]
        feeds = {
            "source": np.array([ids], np.int64), "target": self._padding_token,
            "past": self._no_past, "across_in": self._no_across,
        }  # fmt: skip
        return self._session.run(["across"], feeds)[0]

    def _decode(
        self, target: np.ndarray, past: np.ndarray, across: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Run the decoder; return the logits of the next tokens, and the new `past`."""
        feeds = {"source": self._padding_token, "target": target, "past": past, "across_in": across}
        logits, present = self._session.run(["logits", "present"], feeds)
        return logits, present


def _parse_vocabulary(path: Path, text: str) -> tuple[str, ...]:
    """Return the tokens of the metadata `VOCABULARY` of a file."""
    try:
        tokens = json.loads(text)
    except ValueError:
        tokens = None
    needed = {*SPECIAL, *NAMES, REFUSED, *OPERATORS}
    if not isinstance(tokens, list) or not needed <= set(map(str, tokens)):
        raise ModelError(
            f"{path}: the model's metadata has no {VOCABULARY!r} with the tokens of formulas; "
            "export the model again"
        )
    return tuple(map(str, tokens))


def _log_softmax(x: np.ndarray) -> np.ndarray:
    shifted = x - x.max(axis=-1, keepdims=True)
    return shifted - np.log(np.exp(shifted).sum(axis=-1, keepdims=True))

"""Probabilities of a question's answers from the model's next token (ViTL eq. 4 and 5).

`probabilities` reads a chat server's list of likely tokens, `answer_probabilities` all logits of a
local model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge.errors import UserError

YES_NO = ("Yes", "No")
MISSING_NATS = 1.0
"""Penalty for an answer whose tokens the server does not list.

The server lists only the likeliest tokens. An answer without a listed token gets the
log-probability of the least likely listed token minus this. But all such answers together get at
most the probability that is not listed: 1 minus the sum of the listed ones."""
_LEAST_LEFT = 1e-9  # least remaining probability: keeps the logarithm finite if rounding leaves 0

# Characters around an answer in a token: white space (also as tokenizers write it), punctuation.
_WRAPPING = " \t\r\n▁ĠĊ\"'`*_([{<>}]).,:;"


class MultipleChoice(NamedTuple):
    """A question and its possible answers."""

    question: str
    answers: tuple[str, ...]


class NoAnswerError(UserError):
    """The model's next token is none of the answers."""


def probabilities(tokens: Sequence[tuple[str, float]], answers: Sequence[str]) -> np.ndarray:
    """Return the softmax over exactly the offered answers.

    Log-probabilities are logits up to a constant, which cancels out. The tokens of one answer
    ("A", " A", "(A") are one event, so their probabilities are added. Words are compared without
    regard to case; single letters are not, since "a" begins many sentences.

    Args:
        tokens: the likeliest next tokens with their log-probabilities, at most 0.
        answers: the n possible answers, at least one, all different.

    Returns:
        (n,) float32, positive or zero, sums to 1.

    Raises:
        NoAnswerError: none of the answers is among the tokens.
    """
    index_of = {_key(answer): i for i, answer in enumerate(answers)}
    logits = np.full(len(answers), -math.inf)
    for token, logprob in tokens:
        i = index_of.get(_key(token.strip(_WRAPPING)))
        if i is not None:
            logits[i] = np.logaddexp(logits[i], logprob)
    if not np.isfinite(logits).any():
        likeliest = ", ".join(repr(token) for token, _ in tokens[:3])
        raise NoAnswerError(
            f"the model begins its answer with {likeliest:.60}, not with {', '.join(answers)}; "
            "use a model that answers at once, without reasoning"
        )
    missing = np.isneginf(logits)
    if missing.any():
        unlisted = max(1.0 - math.fsum(math.exp(logprob) for _, logprob in tokens), _LEAST_LEFT)
        least = min(logprob for _, logprob in tokens) - MISSING_NATS
        logits[missing] = min(least, math.log(unlisted / missing.sum()))
    p = np.exp(logits - logits.max())
    return (p / p.sum()).astype(np.float32)


def _key(text: str) -> str:
    """Return the form of an answer that is compared; see `probabilities`."""
    return text if len(text) == 1 else text.casefold()


def answer_token_ids(vocabulary: Sequence[str], answers: Sequence[str]) -> list[np.ndarray]:
    """Find the tokens of a vocabulary that mean each answer, as `probabilities` reads them.

    Args:
        vocabulary: the text of each token, by id.
        answers: the possible answers, all different.

    Returns:
        For each answer, the ids of its tokens, (k,) int64; k may be 0.

    >>> [ids.tolist() for ids in answer_token_ids(["A", "b", " A", "B", "yes"], ("A", "B", "Yes"))]
    [[0, 2], [3], [4]]
    """
    index_of = {_key(answer): i for i, answer in enumerate(answers)}
    found: list[list[int]] = [[] for _ in answers]
    for token, text in enumerate(vocabulary):
        i = index_of.get(_key(text.strip(_WRAPPING)))
        if i is not None:
            found[i].append(token)
    return [np.array(ids, np.int64) for ids in found]


def answer_probabilities(logits: np.ndarray, ids: Sequence[np.ndarray]) -> np.ndarray:
    """Return the softmax over exactly the answers, from all logits (ViTL eq. 4).

    Args:
        logits: (v,) logits of the next token, one for each token of the vocabulary.
        ids: for each answer, the ids of its tokens, at least one. The tokens of one answer are one
            event, as in `probabilities`.

    Returns:
        (n,) float32, sums to 1; NaN if a logit of an answer is not finite.
    """
    by_answer = [logits[tokens].astype(np.float64) for tokens in ids]
    top = max(float(values.max()) for values in by_answer)
    with np.errstate(invalid="ignore"):
        p = np.array([np.exp(values - top).sum() for values in by_answer])
        return (p / p.sum()).astype(np.float32)

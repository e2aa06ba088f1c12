"""What of a model's next token is which answer (ViTL eq. 4 and 5): letters, Yes and No."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge.errors import UserError

YES_NO = ("Yes", "No")
MISSING_NATS = 1.0
"""How much less likely than the least likely token that the server told of an answer is taken to
be which it did not tell of. At most as likely is known, and that all of them together have no more
than what the told tokens leave of 1."""
_LEAST_LEFT = 1e-9  # so that what is left has a logarithm, also where rounding leaves nothing

_WRAPPING = " \t\r\n▁ĠĊ\"'`*_([{<>}]).,:;"


class NoAnswerError(UserError):
    """The model is about to say something else than any of the answers."""


def probabilities(tokens: Sequence[tuple[str, float]], answers: Sequence[str]) -> np.ndarray:
    """Softmax over exactly the answers that were offered.

    log-probabilities are logits up to a constant, which falls out. The tokens of one answer
    ("A", " A", "(A") are one event, so their probabilities are added. Words are compared without
    regard to case; single letters are not, since "a" begins a sentence about anything.

    Args:
        tokens: the likeliest next tokens with their log-probabilities, at most 0.
        answers: at least one, all different.

    Returns:
        (n,) float32, positive or zero, sums to 1.

    Raises:
        NoAnswerError: none of the answers is among the tokens.
    """
    place = {_key(answer): i for i, answer in enumerate(answers)}
    logits = np.full(len(answers), -math.inf)
    for token, logprob in tokens:
        i = place.get(_key(token.strip(_WRAPPING)))
        if i is not None:
            logits[i] = np.logaddexp(logits[i], logprob)
    if not np.isfinite(logits).any():
        said = ", ".join(repr(token) for token, _ in tokens[:3])
        raise NoAnswerError(
            f"the model begins its answer with {said:.60}, not with {', '.join(answers)}; "
            "use one that answers at once"
        )
    missing = np.isneginf(logits)
    if missing.any():
        left = max(1.0 - math.fsum(math.exp(logprob) for _, logprob in tokens), _LEAST_LEFT)
        least = min(logprob for _, logprob in tokens) - MISSING_NATS
        logits[missing] = min(least, math.log(left / missing.sum()))
    p = np.exp(logits - logits.max())
    return (p / p.sum()).astype(np.float32)


def _key(text: str) -> str:
    return text if len(text) == 1 else text.casefold()


def spellings(vocabulary: Sequence[str], answers: Sequence[str]) -> list[np.ndarray]:
    """Which tokens of a vocabulary are which answer, as `probabilities` reads them.

    Args:
        vocabulary: the text of each token, by id.

    Returns:
        Ids of the tokens that say each answer, (k,) int64, of which there may be none.

    >>> [ids.tolist() for ids in spellings(["A", "b", " A", "B", "yes"], ("A", "B", "Yes"))]
    [[0, 2], [3], [4]]
    """
    place = {_key(answer): i for i, answer in enumerate(answers)}
    found: list[list[int]] = [[] for _ in answers]
    for token, text in enumerate(vocabulary):
        i = place.get(_key(text.strip(_WRAPPING)))
        if i is not None:
            found[i].append(token)
    return [np.array(ids, np.int64) for ids in found]


def shares(logits: np.ndarray, ids: Sequence[np.ndarray]) -> np.ndarray:
    """ViTL eq. 4: softmax over exactly the answers, where all logits are known.

    Args:
        logits: (v,) of the next token.
        ids: of the tokens of each answer, at least one each; they are one event, as in
            `probabilities`.

    Returns:
        (n,) float32, sums to 1; NaN where a logit of an answer is not finite.
    """
    each = [logits[some].astype(np.float64) for some in ids]
    top = max(float(some.max()) for some in each)
    with np.errstate(invalid="ignore"):
        p = np.array([np.exp(some - top).sum() for some in each])
        return (p / p.sum()).astype(np.float32)

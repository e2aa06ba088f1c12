"""Parity check of encoders of images or texts: how closely one repeats another after an export."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from exporters.files import ExportError
from exporters.reports import Report

LIMITS = {
    "fp32": {"cosine": 0.99999, "rank_agreement": 0.999},
    "fp16": {"cosine": 0.999, "rank_agreement": 0.99},
    "int8": {"cosine": 0.995, "rank_agreement": 0.97},
    "int8-cpu": {"cosine": 0.95, "rank_agreement": 0.9},
}
"""Smallest allowed figures of `EmbeddingReport`, by the precision of the candidate."""


@dataclass(frozen=True)
class EmbeddingReport(Report):
    """Agreement of a candidate's embeddings with a reference's.

    Attributes:
        inputs: number of images or texts.
        cosine: lowest cosine between the two embeddings of an input.
        rank_agreement: see `rank_agreement`; NaN if nothing was ranked.
        max_abs_diff: largest difference of an element of two unit rows.
    """

    inputs: int
    cosine: float
    rank_agreement: float
    max_abs_diff: float

    def for_card(self, reference: str) -> dict:
        """Return the figures that a card keeps (`card_types.EmbeddingParity`)."""
        unknown = math.isnan(self.rank_agreement)
        return {
            "reference": reference,
            "inputs": self.inputs,
            "cosine": round(self.cosine, 5),
            "rank_agreement": None if unknown else round(self.rank_agreement, 4),
        }


def compare(
    reference: np.ndarray, candidate: np.ndarray, others: np.ndarray | None = None
) -> EmbeddingReport:
    """Compare embeddings (n, d) of the same inputs, n > 0, by the original encoder and a new one.

    `others` (m, d) are by the encoder of the other kind. The inputs are ranked by their likeness to
    each of these, as VLFM ranks views by a text.

    Raises:
        ExportError: a row has no direction.
    """
    exact, found = _unit("reference", reference), _unit("candidate", candidate)
    cosines = (exact * found).sum(axis=1)
    agreement = float("nan")
    if others is not None and len(others):
        others_unit = _unit("other tower", others).T
        agreement = rank_agreement(exact @ others_unit, found @ others_unit)
    return EmbeddingReport(
        inputs=len(exact),
        cosine=float(cosines.min()),
        rank_agreement=agreement,
        max_abs_diff=float(np.abs(exact - found).max()),
    )


def rank_agreement(reference: np.ndarray, candidate: np.ndarray) -> float:
    """Return the share of row pairs that two score tables (n, m) order alike, over all columns.

    This is Kendall's tau (Kendall 1938, "A new measure of rank correlation") as a share, (tau +
    1)/2. Pairs with equal reference scores are not counted; NaN if no pair is left.
    """
    first, second = np.triu_indices(len(reference), k=1)
    above = np.sign(reference[first] - reference[second])
    differs = above != 0
    if not differs.any():
        return float("nan")
    return float((np.sign(candidate[first] - candidate[second]) == above)[differs].mean())


def _unit(which: str, rows: np.ndarray) -> np.ndarray:
    """Return the rows with length 1; `which` names them in the error."""
    norms = np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
    if not (np.isfinite(norms).all() and norms.all()):
        raise ExportError(f"the {which}'s embeddings are zero or not finite; check the weights")
    return rows / norms

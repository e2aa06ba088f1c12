"""How well one encoder repeats another: the check at the end of each export step of an encoder."""

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
"""By the precision of what is compared."""


@dataclass(frozen=True)
class EmbeddingReport(Report):
    """What a candidate kept of a reference.

    Attributes:
        inputs: number of images or texts.
        cosine: the lowest between the two embeddings of an input.
        mean_cosine: the mean of them.
        rank_agreement: see `rank_agreement`; NaN where nothing was ranked.
        max_abs_diff: largest difference of a number of two unit rows.
    """

    inputs: int
    cosine: float
    mean_cosine: float
    rank_agreement: float
    max_abs_diff: float

    def for_card(self, reference: str) -> dict:
        """The part that a card keeps (`edge.perception.runtime.card_types.EmbeddingParity`)."""
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
    """Embeddings of the same inputs by two encoders, (n, d) each.

    Args:
        others: (m, d), what the inputs are ranked by, as VLFM ranks views by a text: the text rows
            that images are compared with, or the image rows for texts.

    Raises:
        ExportError: nothing to compare, or a row that has no direction.
    """
    if not len(reference):
        raise ExportError("parity: nothing to compare on; give pictures or texts")
    exact, found = _unit("reference", reference), _unit("candidate", candidate)
    cosines = (exact * found).sum(axis=1)
    order = float("nan")
    if others is not None and len(others):
        by = _unit("other tower", others).T
        order = rank_agreement(exact @ by, found @ by)
    return EmbeddingReport(
        inputs=len(exact),
        cosine=float(cosines.min()),
        mean_cosine=float(cosines.mean()),
        rank_agreement=order,
        max_abs_diff=float(np.abs(exact - found).max()),
    )


def rank_agreement(reference: np.ndarray, candidate: np.ndarray) -> float:
    """Share of the pairs of rows that two tables of scores (n, m) order alike, over all columns.

    It is Kendall's tau (Kendall 1938, "A new measure of rank correlation") as a share, (tau + 1)/2.
    Pairs that the reference scores alike are not counted; NaN where there are no others.
    """
    first, second = np.triu_indices(len(reference), k=1)
    above = np.sign(reference[first] - reference[second])
    told = above != 0
    if not told.any():
        return float("nan")
    return float((np.sign(candidate[first] - candidate[second]) == above)[told].mean())


def _unit(which: str, rows: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
    if not (np.isfinite(norms).all() and norms.all()):
        raise ExportError(
            f"the {which}'s embeddings are zero or not finite; check the weights that it is made of"
        )
    return rows / norms

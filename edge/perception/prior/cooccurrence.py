"""P(target near a place | what stands near it in sight): one logistic model a target.

Local on purpose: what stands elsewhere in the house says nothing, so a house may have two bedrooms.
"""

from __future__ import annotations

import numpy as np

from edge.perception.prior.table import Table

NEAR_M = 3.0
"""How far around a place things count, and how near the target would be."""


def lift(table: Table, row: int, near: np.ndarray, out: np.ndarray) -> None:
    """P(target near | near) / P(target near | nothing known), for each place, into out.

    Args:
        row: of the target; -1: no opinion.
        near: (n, things) float32 in [0, 1], how surely each thing is near; see `nearby`.
        out: (n,) float32; 1 where nothing is near.
    """
    if row < 0:
        out[:] = 1.0
        return
    bias = table.near_bias[row]
    odds = near @ table.near_weight[row] + bias
    np.divide(1.0 + np.exp(-bias), 1.0 + np.exp(-odds), out=out)

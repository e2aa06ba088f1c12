"""P(target near a place | objects near it in sight): one logistic model for each target.

Only objects near the place count, not all of the house: it may have two bedrooms.
"""

from __future__ import annotations

import numpy as np

from edge.perception.prior.table import ObjectPrior

NEAR_M = 3.0
"""Radius around a place for the objects that count, and for the target."""


def likelihood_ratio(table: ObjectPrior, row: int, near: np.ndarray, out: np.ndarray) -> None:
    """Write the likelihood ratio of a target near each place.

    The ratio is P(target near the place | classes near it) / P(target near the place).

    Args:
        table: the learned weights.
        row: the target's row in the table; -1: unknown, so the ratio is 1.
        near: (n, classes) float32 in [0, 1], confidence that each class (kind of object, such as
            chair) is near each place; see `nearby`.
        out: (n,) float32; 1 if nothing is near.
    """
    if row < 0:
        out[:] = 1.0
        return
    bias = table.near_bias[row]
    odds = near @ table.near_weight[row] + bias
    np.divide(1.0 + np.exp(-bias), 1.0 + np.exp(-odds), out=out)

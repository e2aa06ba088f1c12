"""Kind of room of a region, by the objects seen there; and likelihood of a target in it."""

from __future__ import annotations

import numpy as np

from edge.perception.prior.table import ObjectPrior

_PRIOR_ROOMS = 4.0
"""Pseudo-count of average rooms, added to each kind; pulls small counts to the average."""


def object_given_room(table: ObjectPrior) -> np.ndarray:
    """Return P(a thing is in view in a room | its kind): (kinds, things) float64, in (0, 1)."""
    share = (table.kind_rooms_with.sum(0) + 0.5) / (table.kind_rooms.sum() + 1.0)
    return (table.kind_rooms_with + _PRIOR_ROOMS * share) / (
        table.kind_rooms[:, None] + _PRIOR_ROOMS
    )


def room_prior(table: ObjectPrior) -> np.ndarray:
    """Return P(kind) of a room without evidence: (kinds,) float64, sums to 1."""
    return table.kind_rooms / table.kind_rooms.sum()


def room_posterior(table: ObjectPrior, chance: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Return P(kind | objects seen there): naive Bayes, discounted by `ObjectPrior.evidence`.

    Objects that were not seen do not count: a region is seldom seen as a whole.

    Args:
        table: the prior.
        chance: see `object_given_room`.
        held: (m, things) float32 in [0, 1], confidence that each thing is in each region.

    Returns:
        (m, kinds) float64, rows sum to 1.
    """
    prior = room_prior(table)
    log_ratio = np.log(chance) - np.log(prior @ chance)
    log_p = np.log(prior) + table.evidence * (held @ log_ratio.T)
    p = np.exp(log_p - log_p.max(1, keepdims=True))
    return p / p.sum(1, keepdims=True)


def adjacent_room_posterior(table: ObjectPrior, belief: np.ndarray) -> np.ndarray:
    """Return P(kind) of the room behind a door of each region: (m, kinds) float64.

    Args:
        table: the prior.
        belief: (m, kinds), of the regions.
    """
    p = belief @ (table.neighbours * room_prior(table))
    return p / p.sum(1, keepdims=True)


def room_posterior_at(
    table: ObjectPrior, chance: np.ndarray, held: np.ndarray, beside: np.ndarray
) -> np.ndarray:
    """Return P(kind) of the room that each place is in: (m, kinds) float64.

    It follows from the objects in the place's region; without any, from the adjacent region;
    without any there, it is the average.

    Args:
        table: the prior.
        chance: see `object_given_room`.
        held: (m, things) float32 in [0, 1], of the place's region; see `room_posterior`.
        beside: (m, things) float32, the same of an adjacent region; see `neighbours`.
    """
    belief = room_posterior(table, chance, held)
    nothing = ~held.any(1)
    belief[nothing] = adjacent_room_posterior(table, room_posterior(table, chance, beside[nothing]))
    belief[nothing & ~beside.any(1)] = room_prior(table)
    return belief


def neighbours(border: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Return the adjacent region with the longest common border, of those with objects seen.

    Args:
        border: (n + 1, n + 1), length of each common border.
        held: (n + 1, things), see `room_posterior`; region 0 is none.

    Returns:
        (n + 1,) int64; 0 for none.
    """
    return np.where(held.any(1), border, 0).argmax(1)


def likelihood_ratio(
    chance: np.ndarray, prior: np.ndarray, row: int, belief: np.ndarray
) -> np.ndarray:
    """Return the likelihood ratio P(the room holds the target | belief) / P(a room holds it).

    Args:
        chance: see `object_given_room`.
        prior: see `room_prior`.
        row: of the target; -1: the ratio is 1.
        belief: (m, kinds).

    Returns:
        (m,) float64.
    """
    if row < 0:
        return np.ones(len(belief))
    return (belief @ chance[:, row]) / (prior @ chance[:, row])

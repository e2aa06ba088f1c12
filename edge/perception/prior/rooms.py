"""Which kind of room a region of the map is, by what was seen there, and where a target stands."""

from __future__ import annotations

import numpy as np

from edge.perception.prior.table import Table

_PRIOR_ROOMS = 4.0
"""Rooms more of each kind, which hold things as rooms do on the whole: draws small counts there."""


def chances(table: Table) -> np.ndarray:
    """P(a thing is in view in a room | its kind): (kinds, things) float64, in (0, 1)."""
    share = (table.kind_rooms_with.sum(0) + 0.5) / (table.kind_rooms.sum() + 1.0)
    return (table.kind_rooms_with + _PRIOR_ROOMS * share) / (
        table.kind_rooms[:, None] + _PRIOR_ROOMS
    )


def average(table: Table) -> np.ndarray:
    """What a room that nothing is known of is: (kinds,) float64, sums to 1."""
    return table.kind_rooms / table.kind_rooms.sum()


def beliefs(table: Table, chance: np.ndarray, held: np.ndarray) -> np.ndarray:
    """P(kind | what was seen there), by a naive Bayes whose evidence counts in part.

    What was not seen there does not count: a region is seldom seen whole.

    Args:
        chance: see `chances`.
        held: (m, things) float32 in [0, 1], how surely each thing is in each region.

    Returns:
        (m, kinds) float64, rows sum to 1.
    """
    prior = average(table)
    tell = np.log(chance) - np.log(prior @ chance)
    log_p = np.log(prior) + table.evidence * (held @ tell.T)
    p = np.exp(log_p - log_p.max(1, keepdims=True))
    return p / p.sum(1, keepdims=True)


def next_door(table: Table, belief: np.ndarray) -> np.ndarray:
    """What lies behind a door of a region: P(kind), (m, kinds) float64.

    Args:
        belief: (m, kinds), of the regions.
    """
    p = belief @ (table.neighbours * average(table))
    return p / p.sum(1, keepdims=True)


def at_places(table: Table, chance: np.ndarray, held: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """What kind of room places are in: P(kind), (m, kinds) float64.

    By what the region of each holds; where nothing was seen there, by the room next door; and
    where nothing was seen there either, any kind of room.

    Args:
        held: (m, things) float32 in [0, 1], see `beliefs`.
        beside: the same, of a region that shares a border with that of the place.
    """
    belief = beliefs(table, chance, held)
    nothing = ~held.any(1)
    belief[nothing] = next_door(table, beliefs(table, chance, beside[nothing]))
    belief[nothing & ~beside.any(1)] = average(table)
    return belief


def neighbours(border: np.ndarray, held: np.ndarray) -> np.ndarray:
    """For each region the one with the longest common border, of those in which something was
    seen: (n + 1,) int64; 0 for none.

    Args:
        border: (n + 1, n + 1), how long each two regions touch.
        held: (n + 1, things), see `beliefs`; region 0 is none.
    """
    return np.where(held.any(1), border, 0).argmax(1)


def lift(chance: np.ndarray, prior: np.ndarray, row: int, belief: np.ndarray) -> np.ndarray:
    """P(the room holds the target | belief) / P(a room holds it): (m,) float64.

    Args:
        prior: see `average`.
        row: of the target; -1: no opinion.
        belief: (m, kinds).
    """
    if row < 0:
        return np.ones(len(belief))
    return (belief @ chance[:, row]) / (prior @ chance[:, row])

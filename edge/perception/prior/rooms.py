"""Kind of room of a region, by the objects seen there; and likelihood of a target in it."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from edge.perception.prior.table import ObjectPrior

_PRIOR_ROOMS = 4.0
"""Pseudo-count of average rooms, added to each kind; pulls small counts to the average."""
# Of a region of the map that may hold two rooms without a wall between, such as a kitchen and a
# living room: weight of a thing as evidence, probability that there are two, and the area below
# which two are less likely by a factor of e per m². Tuned on houses for training.
_EVIDENCE, _TWO, _TWO_M2 = 0.5, 0.1, 20.0


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


def included_kinds(
    table: ObjectPrior, chance: np.ndarray, held: np.ndarray, area_m2: np.ndarray
) -> np.ndarray:
    """Return P(a region holds a room of each kind | objects seen there): (m, kinds) float64.

    A region holds one room, or two of different kinds; so rows may sum to more than 1.

    Args:
        table: the prior.
        chance: see `object_given_room`.
        held: (m, things) float32 in [0, 1], confidence that each thing is in each region.
        area_m2: (m,) areas.
    """
    prior, k = room_prior(table), len(table.kinds)
    members = [(i,) for i in range(k)] + list(combinations(range(k), 2))
    log_p = np.empty((len(held), len(members)))
    for column, those in enumerate(members):
        there = 1.0 - np.prod(1.0 - chance[list(those)], axis=0)
        base = np.log(prior[list(those)]).sum() + np.log(1.0 - _TWO)
        if len(those) == 2:
            base += np.log(2.0 * _TWO / (1.0 - _TWO)) - np.maximum(_TWO_M2 - area_m2, 0.0)
        log_p[:, column] = base + _EVIDENCE * (held @ np.log(there / (prior @ chance)))
    p = np.exp(log_p - log_p.max(1, keepdims=True))
    p /= p.sum(1, keepdims=True)
    return p @ np.array([[i in those for i in range(k)] for those in members], np.float64)


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

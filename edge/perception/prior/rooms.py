"""Kind of room of a region, by the objects seen there; and likelihood of a target in it.

The location prior (`edge.loop.scoring.prior`) and the rooms (`edge.memory.rooms`) use these
functions. A class is a kind of object that the table has, such as chair. A region is a
part of the map behind doors; it holds one room, or two without a wall between them.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import numpy as np

from edge.perception.prior.table import ObjectPrior

_PRIOR_ROOMS = 4.0
"""Pseudo-count of average rooms, added to each kind; pulls small counts to the average."""
_ON_COUNTERTOP = ("sink", "faucet")
"""Objects on a countertop in real homes.

In the houses that the table was learned from, only bathrooms have them.
"""
# A region may hold two rooms, such as a kitchen and a living room. These numbers of
# `included_kinds` were tuned on houses for training.
_PAIR_EVIDENCE = 0.5  # weight of a class as evidence for the one or two kinds of a region
_P_TWO = 0.1  # probability of two rooms in a region of at least _TWO_ROOMS_M2
_TWO_ROOMS_M2 = 20.0  # area; below it, two rooms are less likely by a factor of e per m²


@lru_cache(maxsize=8)
def object_given_room(table: ObjectPrior) -> np.ndarray:
    """Return P(a class is in view in a room | kind of the room).

    The result is (kinds, classes) float64, in (0, 1).
    """
    rooms_with, counter = table.kind_rooms_with.copy(), table.row("countertop")
    for row in map(table.row, _ON_COUNTERTOP):
        if min(row, counter) >= 0:
            rooms_with[:, row] = np.maximum(rooms_with[:, row], rooms_with[:, counter])
    share = (rooms_with.sum(0) + 0.5) / (table.kind_rooms.sum() + 1.0)
    return (rooms_with + _PRIOR_ROOMS * share) / (table.kind_rooms[:, None] + _PRIOR_ROOMS)


@lru_cache(maxsize=8)
def room_prior(table: ObjectPrior) -> np.ndarray:
    """Return P(kind) of a room without evidence: (kinds,) float64, sums to 1."""
    return table.kind_rooms / table.kind_rooms.sum()


def room_posterior(table: ObjectPrior, seen: np.ndarray) -> np.ndarray:
    """Return P(kind | classes seen in the region): naive Bayes, (m, kinds) float64, rows sum to 1.

    Each class counts with the weight `ObjectPrior.evidence`, since classes are not independent.
    Classes that were not seen do not count: a region is rarely seen completely.

    Args:
        table: the learned counts.
        seen: (m, classes) float32 in [0, 1], confidence that each class is in each region.
    """
    prior, p_class = room_prior(table), object_given_room(table)
    log_ratio = np.log(p_class) - np.log(prior @ p_class)
    log_p = np.log(prior) + table.evidence * (seen @ log_ratio.T)
    p = np.exp(log_p - log_p.max(1, keepdims=True))
    return p / p.sum(1, keepdims=True)


def included_kinds(table: ObjectPrior, seen: np.ndarray, area_m2: np.ndarray) -> np.ndarray:
    """Return P(a region holds a room of a kind | classes seen in it): (m, kinds) float64.

    A region holds one room, or two of different kinds. So rows may sum to more than 1.

    Args:
        table: the learned counts.
        seen: (m, classes) float32 in [0, 1], confidence that each class is in each region.
        area_m2: (m,) areas.
    """
    prior, p_class, k = room_prior(table), object_given_room(table), len(table.kinds)
    # Hypotheses: each kind alone, then each pair of kinds.
    members = [(i,) for i in range(k)] + list(combinations(range(k), 2))
    log_p = np.empty((len(seen), len(members)))
    for column, kinds in enumerate(members):
        in_view = 1.0 - np.prod(1.0 - p_class[list(kinds)], axis=0)  # in at least one of the rooms
        log_prior = np.log(prior[list(kinds)]).sum() + np.log(1.0 - _P_TWO)
        if len(kinds) == 2:  # 2: the pair may come in either order
            missing_m2 = np.maximum(_TWO_ROOMS_M2 - area_m2, 0.0)
            log_prior += np.log(2.0 * _P_TWO / (1.0 - _P_TWO)) - missing_m2
        log_p[:, column] = log_prior + _PAIR_EVIDENCE * (seen @ np.log(in_view / (prior @ p_class)))
    p = np.exp(log_p - log_p.max(1, keepdims=True))
    p /= p.sum(1, keepdims=True)
    # Sum, for each kind, the probabilities of the hypotheses that include it.
    return p @ np.array([[i in kinds for i in range(k)] for kinds in members], np.float64)


def room_posterior_at(
    table: ObjectPrior, seen: np.ndarray, seen_adjacent: np.ndarray
) -> np.ndarray:
    """Return P(kind) of the room that each place is in: (m, kinds) float64.

    The evidence is the classes in the place's region. If there are none, it is the classes in the
    adjacent region. If there are none either, the result is `room_prior`.

    Args:
        table: the learned counts.
        seen: (m, classes) float32 in [0, 1], classes in each place's region; see `room_posterior`.
        seen_adjacent: (m, classes) float32 in [0, 1], classes in the adjacent region; see
            `adjacent_regions`.
    """
    belief = room_posterior(table, seen)
    nothing = ~seen.any(1)
    # The rooms behind a door: kinds of rooms that share doors with the adjacent region's kinds.
    adjacent = room_posterior(table, seen_adjacent[nothing])
    p = adjacent @ (table.neighbours * room_prior(table))
    belief[nothing] = p / p.sum(1, keepdims=True)
    belief[nothing & ~seen_adjacent.any(1)] = room_prior(table)
    return belief


def adjacent_regions(border: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return, for each region, the adjacent region with the longest common border.

    Only regions in which classes were seen count.

    Args:
        border: (n + 1, n + 1), length of each common border.
        seen: (n + 1, classes), see `room_posterior`; index 0 stands for no region.

    Returns:
        (n + 1,) int64, indices of regions; 0: there is none.
    """
    return np.where(seen.any(1), border, 0).argmax(1)


def likelihood_ratio(table: ObjectPrior, row: int, belief: np.ndarray) -> np.ndarray:
    """Return P(the room holds the target | belief) / P(a room holds the target), (m,) float64.

    Args:
        table: the learned counts.
        row: the target's row in the table; -1: unknown, so the ratio is 1.
        belief: (m, kinds), P(kind) of each room.
    """
    if row < 0:
        return np.ones(len(belief))
    p_class = object_given_room(table)[:, row]
    return (belief @ p_class) / (room_prior(table) @ p_class)

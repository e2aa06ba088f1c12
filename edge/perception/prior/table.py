"""What was learned from furnished houses: which things stand in the same room, what stands near
what, and which rooms hold what.

The table beside this file was learned from the 400 training houses of ProcTHOR (AllenAI,
Apache-2.0), by `exporters.training.prior`; it names its source and the command.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from edge import names

FILE = Path(__file__).with_name("table.json")
# Rooms more with both, had they nothing to do with one another: pulls small counts to 1.
_PRIOR_ROOMS = 2.0
_PRIOR_DOORS = 10.0
SCALE = 100
"""Weights and biases stand in the file as whole hundredths."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Counts and weights; n things, k kinds of room.

    Attributes:
        n_rooms: all of them.
        things: canonical names, n.
        rooms_with_both: (n, n) int64, symmetric; the diagonal is of rooms that hold at least one.
        near_bias: (n,) float32, log-odds that a thing is near a place that nothing is known of.
        near_weight: (n, n) float32; row t: what each thing in sight adds to that for thing t. All
            zero where that told held-out houses nothing.
        kinds: of rooms, k.
        kind_rooms: (k,) int64, rooms of each kind.
        kind_rooms_with: (k, n) int64, of these with each thing in view.
        neighbours: (k, k) float64, how much likelier two kinds share a door than two rooms of a
            house do; 1 on the diagonal, of which the houses say nothing.
        evidence: how far the evidence of a thing in a room counts, of all that it would count if
            things stood there independently.
        room_power: how far the lift by rooms counts, in `rooms` alone and in `both`.
    """

    n_rooms: int
    things: tuple[str, ...]
    rooms_with_both: np.ndarray
    near_bias: np.ndarray
    near_weight: np.ndarray
    kinds: tuple[str, ...]
    kind_rooms: np.ndarray
    kind_rooms_with: np.ndarray
    neighbours: np.ndarray
    evidence: float
    room_power: tuple[float, float]

    def row(self, word: str) -> int:
        """Row of a word, by its canonical name; -1 where the table lacks it."""
        return _rows(self.things).get(names.canonical(word), -1)

    def lift(self, words: Sequence[str]) -> np.ndarray:
        """How much likelier a room holds one thing if it is known to hold another.

        P(a | b) / P(a) = P(a and b) / (P(a) P(b)), drawn towards 1 as if two rooms more had
        been seen in which both come as often as by chance.

        Returns:
            (m, m) float64, symmetric; 1 for words that the table lacks and on the diagonal.
        """
        m = len(words)
        rows = [self.row(word) for word in words]
        rooms_with = self.rooms_with_both.diagonal()
        lift = np.ones((m, m))
        for i, j in combinations(range(m), 2):
            a, b = rows[i], rows[j]
            if a >= 0 and b >= 0 and a != b:
                by_chance = rooms_with[a] * rooms_with[b] / self.n_rooms
                both = self.rooms_with_both[a, b]
                lift[i, j] = lift[j, i] = (both + _PRIOR_ROOMS) / (by_chance + _PRIOR_ROOMS)
        return lift


@lru_cache(maxsize=8)
def _rows(things: tuple[str, ...]) -> dict[str, int]:
    return {name: i for i, name in enumerate(things)}


def parse(data: dict[str, Any]) -> Table:
    """The table of a file's content."""
    n, rooms, near = len(data["things"]), data["kinds"], data["near"]
    both = np.zeros((n, n), np.int64)
    both[np.tril_indices(n)] = np.concatenate(data["rooms_with_both"])
    both += np.tril(both, -1).T
    weight = np.zeros((n, n), np.float32)
    for target, by_thing in near["weight"].items():
        for thing, value in by_thing.items():
            weight[data["things"].index(target), data["things"].index(thing)] = value / SCALE
    return Table(
        data["rooms"],
        tuple(data["things"]),
        both,
        np.array(near["bias"], np.float32) / SCALE,
        weight,
        tuple(rooms["names"]),
        np.array(rooms["rooms"], np.int64),
        np.array(rooms["rooms_with"], np.int64).reshape(-1, n),
        _neighbours(np.array(rooms["doors"], float), np.array(rooms["pairs"], float)),
        rooms["evidence"],
        tuple(rooms["power"]),
    )


def _neighbours(doors: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """See `Table.neighbours`: from the rooms of a house with a door between them, and all pairs."""
    by_chance = pairs * doors.sum() / max(pairs.sum(), 1.0)
    ratio = (doors + _PRIOR_DOORS) / (by_chance + _PRIOR_DOORS)
    np.fill_diagonal(ratio, 1.0)
    return ratio


@lru_cache(maxsize=1)
def load() -> Table:
    """The table that comes with the package."""
    return parse(json.loads(FILE.read_text(encoding="utf-8")))

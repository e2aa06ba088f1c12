"""Table of the prior: classes in the same room, near each other, and by kind of room.

A class is a kind of object, such as chair. The table (`table.json` next to this file) was learned
from the 400 training houses of ProcTHOR (AllenAI, Apache-2.0) by `exporters.training.prior`. The
file names its source and the command.
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
# Rooms and doors that are added to all counts: so the likelihood ratio of small counts is near 1.
_PRIOR_ROOMS = 2.0
_PRIOR_DOORS = 10.0
SCALE = 100
"""Factor of weights and biases in the file, which has integers in hundredths."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectPrior:
    """The learned counts and weights; n classes, k kinds of room.

    Attributes:
        classes: canonical names, n.
        rooms_with_both: (n, n) int64, symmetric, number of rooms that hold both classes; on the
            diagonal, rooms that hold the class.
        near_bias: (n,) float32, log-odds of a class near a place without evidence.
        near_weight: (n, n) float32; row t: log-odds that each class in sight adds for class t. All
            zero if that did not help on held-out houses.
        kind_rooms: (k,) int64, rooms of each kind.
        kind_rooms_with: (k, n) int64, rooms of each kind with each class in view.
        neighbours: (k, k) float64, likelihood ratio that rooms of two kinds share a door, compared
            with any two rooms of a house; 1 on the diagonal, for which there are no data.
        evidence: weight of a class as evidence for the kind of room; 1: classes are independent.
        room_power: exponents of the rooms' likelihood ratio: for the prior `rooms` alone, and for
            `both`.
    """

    n_rooms: int
    classes: tuple[str, ...]
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
        """Return the row of a word, by its canonical name; -1 if the table lacks it."""
        return _rows(self.classes).get(names.canonical(word), -1)

    def likelihood_ratio(self, words: Sequence[str]) -> np.ndarray:
        """Return the likelihood ratio that a room holds one class, given another in it.

        P(a | b) / P(a) = P(a and b) / (P(a) P(b)). Two pseudo-rooms, in which both classes occur as
        often as by chance, draw the ratio towards 1.

        Args:
            words: m names of classes.

        Returns:
            (m, m) float64, symmetric; 1 for words that the table lacks and on the diagonal.
        """
        m = len(words)
        rows = [self.row(word) for word in words]
        rooms_with = self.rooms_with_both.diagonal()
        ratio = np.ones((m, m))
        for i, j in combinations(range(m), 2):
            a, b = rows[i], rows[j]
            if a >= 0 and b >= 0 and a != b:
                by_chance = rooms_with[a] * rooms_with[b] / self.n_rooms
                both = self.rooms_with_both[a, b]
                ratio[i, j] = ratio[j, i] = (both + _PRIOR_ROOMS) / (by_chance + _PRIOR_ROOMS)
        return ratio


@lru_cache(maxsize=8)
def _rows(classes: tuple[str, ...]) -> dict[str, int]:
    return {name: i for i, name in enumerate(classes)}


def parse(data: dict[str, Any]) -> ObjectPrior:
    """Build the table from a file's content."""
    n, rooms, near = len(data["things"]), data["kinds"], data["near"]
    both = np.zeros((n, n), np.int64)
    # The file has the lower triangle, row by row: mirror it.
    both[np.tril_indices(n)] = np.concatenate(data["rooms_with_both"])
    both += np.tril(both, -1).T
    weight = np.zeros((n, n), np.float32)
    for target, by_class in near["weight"].items():
        for name, value in by_class.items():
            weight[data["things"].index(target), data["things"].index(name)] = value / SCALE
    return ObjectPrior(
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
    """Return `ObjectPrior.neighbours`.

    Args:
        pairs: (k, k), number of pairs of rooms of two kinds in one house.
        doors: (k, k), number of these pairs that share a door.
    """
    by_chance = pairs * doors.sum() / max(pairs.sum(), 1.0)
    ratio = (doors + _PRIOR_DOORS) / (by_chance + _PRIOR_DOORS)
    np.fill_diagonal(ratio, 1.0)
    return ratio


@lru_cache(maxsize=1)
def load() -> ObjectPrior:
    """Load the table that comes with the package."""
    return parse(json.loads(FILE.read_text(encoding="utf-8")))

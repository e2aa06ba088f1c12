"""Which objects stand in the same room: counts over furnished houses, and the lift from them.

The table beside this file was counted over the 400 training houses of ProcTHOR (AllenAI,
Apache-2.0), by `exporters.cooccurrence`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np

from edge import names

_FILE = Path(__file__).with_name("cooccurrence.json")
# One more room with both, had they nothing to do with one another: pulls small counts to 1.
_PRIOR_ROOMS = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Counts of rooms.

    Attributes:
        n_rooms: all of them.
        index: canonical name -> row.
        rooms_with: (n,) int64, rooms that hold at least one.
        rooms_with_both: (n, n) int64, symmetric; the diagonal is `rooms_with`.
    """

    n_rooms: int
    index: dict[str, int]
    rooms_with: np.ndarray
    rooms_with_both: np.ndarray

    def lift(self, words: Sequence[str]) -> np.ndarray:
        """How much likelier a room holds one thing if it is known to hold another.

        P(a | b) / P(a) = P(a and b) / (P(a) P(b)), drawn towards 1 as if two rooms more had
        been seen in which both come as often as by chance.

        Returns:
            (m, m) float64, symmetric; 1 for words that the table lacks and on the diagonal.
        """
        m = len(words)
        rows = [self.index.get(names.canonical(word)) for word in words]
        lift = np.ones((m, m))
        for i, j in combinations(range(m), 2):
            a, b = rows[i], rows[j]
            if a is not None and b is not None and a != b:
                by_chance = self.rooms_with[a] * self.rooms_with[b] / self.n_rooms
                both = self.rooms_with_both[a, b]
                lift[i, j] = lift[j, i] = (both + _PRIOR_ROOMS) / (by_chance + _PRIOR_ROOMS)
        return lift


@lru_cache(maxsize=1)
def load() -> Table:
    """The table that comes with the package."""
    data = json.loads(_FILE.read_text(encoding="utf-8"))
    n = len(data["things"])
    both = np.zeros((n, n), np.int64)
    both[np.tril_indices(n)] = np.concatenate(data["rooms_with_both"])
    both += np.tril(both, -1).T
    index = {name: i for i, name in enumerate(data["things"])}
    return Table(data["rooms"], index, both.diagonal().copy(), both)

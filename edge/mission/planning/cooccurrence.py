"""Which objects stand in the same room: counts over furnished houses, and the lift from them.

The table beside this file was counted over the 400 training houses of ProcTHOR (AllenAI,
Apache-2.0), by

    python -m edge.mission.planning.cooccurrence HOUSES.jsonl.gz > cooccurrence.json
"""

from __future__ import annotations

import argparse
import gzip
import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from edge import names
from edge.errors import UserError
from edge.host.files import open_regular

_FILE = Path(__file__).with_name("cooccurrence.json")
_RARE = 5
"""Things in fewer rooms than this are left out: their counts say nothing."""
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


def count(houses: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The table of some houses, as it stands in the file.

    Args:
        houses: dicts with `rooms` (`polygon`: corners x, y) and `objects` (`category`,
            `center`). Objects outside all rooms do not count.

    Returns:
        `rooms`, `things` in alphabetical order, and `rooms_with_both`, of which row i has
        entries for things 0 … i; the last one is the number of rooms with thing i.
    """
    n_rooms, single, pairs = 0, Counter(), Counter()
    for house in houses:
        for room in house["rooms"]:
            n_rooms += 1
            held = sorted(
                {
                    names.canonical(item["category"])
                    for item in house["objects"]
                    if inside(room["polygon"], *item["center"][:2])
                }
            )
            single.update(held)
            pairs.update(combinations(held, 2))
    things = sorted(name for name, rooms in single.items() if rooms >= _RARE)
    both = [
        [pairs[other, name] for other in things[:i]] + [single[name]]
        for i, name in enumerate(things)
    ]
    return {"rooms": n_rooms, "things": things, "rooms_with_both": both}


def inside(polygon: Sequence[Sequence[float]], x: float, y: float) -> bool:
    """Whether a point lies in a polygon, by the even-odd rule.

    >>> inside([(0, 0), (2, 0), (2, 2), (0, 2)], 1, 1)
    True
    """
    odd = False
    for (x0, y0), (x1, y1) in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            odd = not odd
    return odd


def read_houses(path: Path) -> Iterator[dict[str, Any]]:
    """The houses of a `.jsonl.gz` file.

    Raises:
        UserError: it cannot be read, or a line is not JSON.
    """
    number = 0
    try:
        with open_regular(path) as content, gzip.open(content) as file:
            for line in file:
                number += 1
                yield json.loads(line)
    except (OSError, EOFError) as error:
        raise UserError(f"{path}: {error}") from None
    except ValueError as error:
        raise UserError(f"{path}: line {number}: not JSON: {error}") from None


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of a file of houses as JSON."""
    parser = argparse.ArgumentParser(description="Count which things stand in the same room.")
    parser.add_argument("file", type=Path, help="houses, .jsonl.gz")
    path = parser.parse_args(arguments).file
    try:
        table = count(read_houses(path))
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    except (KeyError, TypeError, ValueError) as error:
        print(f"{path}: not houses with rooms and objects: {error!r}", file=sys.stderr)
        return 1
    about = {
        "about": "Rooms that hold two things; row i has entries for things 0 ... i. Made by "
        "python -m edge.mission.planning.cooccurrence.",
        "licence": "Counts over houses of ProcTHOR (Allen Institute for AI), Apache-2.0.",
    }
    print(json.dumps({**about, **table}, separators=(",", ":")))
    return 0


if __name__ == "__main__":
    sys.exit(main())

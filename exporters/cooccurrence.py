"""Which things stand in the same room of furnished houses: the table of the planner's prior.

python -m exporters.cooccurrence HOUSES.jsonl.gz > edge/perception/prior/table.json
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from edge import names
from edge.sim.procthor import read_houses
from exporters.files import ExportError, tells_errors

_RARE = 5
"""Things in fewer rooms than this are left out: their counts say nothing."""


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


@tells_errors
def main(argv: list[str] | None) -> None:
    """Print the table of a file of houses as JSON."""
    parser = argparse.ArgumentParser(description="Count which things stand in the same room.")
    parser.add_argument("file", type=Path, help="houses, .jsonl.gz")
    path = parser.parse_args(argv).file
    try:
        table = count(read_houses(path))
    except (KeyError, TypeError, ValueError) as error:
        raise ExportError(f"{path}: not houses with rooms and objects: {error!r}") from None
    about = {
        "about": "Rooms that hold two things; row i has entries for things 0 ... i. Made by "
        "python -m exporters.cooccurrence.",
        "licence": "Counts over houses of ProcTHOR (Allen Institute for AI), Apache-2.0.",
    }
    print(json.dumps({**about, **table}, separators=(",", ":")))


if __name__ == "__main__":
    sys.exit(main())

"""Counts in furnished houses for the prior's table.

They are objects in the same room, objects by kind of room, and doors between kinds of room.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import cv2
import numpy as np

from edge import names
from exporters.training.prior.house import HousePlan

_RARE = 5
"""Categories that fewer rooms have are left out: such counts mean nothing."""


def count(houses: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Count the objects that stand in the same room.

    Args:
        houses: dicts with `rooms` (`polygon`: corners x, y) and `objects` (`category`, `center`).
            Objects outside all rooms do not count.

    Returns:
        `rooms`, `things` in alphabetical order, and `rooms_with_both`, whose row i has entries for
        objects 0 … i; the last one is the number of rooms with object i.
    """
    n_rooms, single, pairs = 0, Counter(), Counter()
    for house in houses:
        for room in house["rooms"]:
            n_rooms += 1
            categories = sorted(
                {
                    names.canonical(item["category"])
                    for item in house["objects"]
                    if inside(room["polygon"], *item["center"][:2])
                }
            )
            single.update(categories)
            pairs.update(combinations(categories, 2))
    classes = sorted(name for name, rooms in single.items() if rooms >= _RARE)
    rooms_with_both = [
        [pairs[other, name] for other in classes[:i]] + [single[name]]
        for i, name in enumerate(classes)
    ]
    return {"rooms": n_rooms, "things": classes, "rooms_with_both": rooms_with_both}


def count_kinds(plans: Sequence[HousePlan], classes: Sequence[str], kinds: Sequence[str]) -> dict:
    """Count the rooms with each visible object by kind of room, and the doors between kinds.

    Returns:
        `names`; `rooms` of each kind; `rooms_with` each object, by kind; `doors` between two kinds
        and `pairs` of two kinds in a house, symmetric.
    """
    k, m = len(kinds), len(classes)
    rooms, rooms_with = np.zeros(k, int), np.zeros((k, m), int)
    doors, pairs = np.zeros((k, k), int), np.zeros((k, k), int)
    # Kinds are indices. Each pair of rooms counts in both orders, so the tables are symmetric.
    for plan in plans:
        room_kinds = [kinds.index(name) for name in plan.kinds]
        for room, kind in enumerate(room_kinds):
            rooms[kind] += 1
            names_here = {plan.words[w] for w in plan.word[plan.object_room == room]}
            rooms_with[kind, [classes.index(name) for name in names_here if name in classes]] += 1
        for a, b in combinations(range(len(room_kinds)), 2):
            for i, j in ((room_kinds[a], room_kinds[b]), (room_kinds[b], room_kinds[a])):
                pairs[i, j] += 1
                doors[i, j] += (a, b) in plan.doors
    return {
        "names": list(kinds),
        "rooms": rooms.tolist(),
        "rooms_with": rooms_with.tolist(),
        "doors": doors.tolist(),
        "pairs": pairs.tolist(),
    }


def inside(polygon: Sequence[Sequence[float]], x: float, y: float) -> bool:
    """Return True if a point is in a polygon, not on its edge.

    >>> inside([(0, 0), (2, 0), (2, 2), (0, 2)], 1, 1)
    True
    """
    corners = np.array(polygon, np.float32).reshape(-1, 2)
    return cv2.pointPolygonTest(corners, (x, y), measureDist=False) > 0

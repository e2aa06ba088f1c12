"""Viewpoints as evidence: many images from one place say hardly more than one.

A wrong detection lasts while the robot stands still, and mostly vanishes from another side.
"""

from __future__ import annotations

import math

_APART_M = 0.5
"""Least distance between two different viewpoints."""
_APART_COS = math.cos(math.radians(20.0))
"""Two nearer viewpoints are different, too, if they are this angle apart, seen from the object."""

Point = tuple[float, float]


def hits_per_view(confirm_hits: int) -> int:
    """Return how many images of one viewpoint count: half of those that confirm an object.

    Example:
        >>> [hits_per_view(n) for n in (1, 2, 3, 4)]
        [1, 1, 2, 2]
    """
    return (confirm_hits + 1) // 2


def is_other_view(object_m: Point, first_m: Point, second_m: Point) -> bool:
    """Return True if two places show an object from different viewpoints.

    Args:
        object_m: x and y of the object.
        first_m: x and y of one place.
        second_m: x and y of the other place.

    Example:
        >>> is_other_view((2.0, 0.0), (0.0, 0.0), (0.3, 0.0))
        False
        >>> is_other_view((0.5, 0.0), (0.0, 0.0), (0.3, 0.4))
        True
    """
    if math.dist(first_m, second_m) >= _APART_M:
        return True
    ax, ay = first_m[0] - object_m[0], first_m[1] - object_m[1]
    bx, by = second_m[0] - object_m[0], second_m[1] - object_m[1]
    return ax * bx + ay * by < _APART_COS * math.hypot(ax, ay) * math.hypot(bx, by)

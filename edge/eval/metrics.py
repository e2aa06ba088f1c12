"""Navigation metrics, an episode each; a column's figure is their mean."""

from __future__ import annotations

from collections.abc import Sequence

REACHED_M = 1.0
"""Within this of a thing's footprint the robot has reached it; shortest ways end there."""


def success_rate(successes: Sequence[bool]) -> float:
    """Share of episodes that succeeded; 0 for none.

    >>> success_rate([True, False])
    0.5
    """
    return sum(successes) / len(successes) if successes else 0.0


def spl(successes: Sequence[bool], shortest_m: Sequence[float], path_m: Sequence[float]) -> float:
    """Success weighted by path length (Anderson et al. 2018, eq. 1), as VL-Nav's table I.

    Args:
        shortest_m: geodesic distance from each start to where success begins.
        path_m: length of the path that was driven.

    >>> spl([True, False], [2.0, 1.0], [4.0, 1.0])
    0.25
    """
    if not successes:
        return 0.0
    total = 0.0
    for success, shortest, path in zip(successes, shortest_m, path_m, strict=True):
        if success:
            longest = max(path, shortest)
            total += 1.0 if longest == 0.0 else shortest / longest
    return total / len(successes)

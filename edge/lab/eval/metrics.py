"""Navigation metrics, an episode each; a column's figure is their mean."""

from __future__ import annotations

import numpy as np

REACHED_M = 1.0
"""Within this of a thing's footprint the robot has reached it; shortest ways end there."""


def episode_spl(success: np.ndarray, shortest_m: np.ndarray, path_m: np.ndarray) -> np.ndarray:
    """Success weighted by path length (Anderson et al. 2018, eq. 1), as VL-Nav's table I.

    Args:
        success: bool, or 0 and 1.
        shortest_m: geodesic distance from each start to where success begins.
        path_m: length of the path that was driven.

    Returns:
        Their common shape, in [0, 1]; a path shorter than the shortest earns no bonus.
    """
    return np.where(np.asarray(success, bool), efficiency(shortest_m, path_m), 0.0)


def episode_soft_spl(
    success: np.ndarray, shortest_m: np.ndarray, path_m: np.ndarray, left_m: np.ndarray
) -> np.ndarray:
    """Soft SPL (Datta et al. 2020): progress to the goal in place of success.

    Args:
        left_m: geodesic distance from where the robot ended to where success begins; taken as 0 for
            a success.

    Returns:
        Their common shape, in [0, 1]; NaN where what is left is NaN, unless it was a success.
    """
    left_m = np.where(np.asarray(success, bool), 0.0, np.asarray(left_m, np.float64))
    share = _share(left_m, shortest_m, 0.0)
    return np.clip(1.0 - share, 0.0, 1.0) * efficiency(shortest_m, path_m)


def efficiency(shortest_m: np.ndarray, path_m: np.ndarray) -> np.ndarray:
    """The shortest way as a share of the driven path, at most 1; 1 where nothing was to drive."""
    return _share(shortest_m, np.maximum(path_m, shortest_m), 1.0)


def _share(part: np.ndarray, whole: np.ndarray, of_nothing: float) -> np.ndarray:
    """part / whole; nothing of nothing is `of_nothing`, something of nothing infinite."""
    part, whole = np.broadcast_arrays(np.asarray(part, np.float64), np.asarray(whole, np.float64))
    with np.errstate(all="ignore"):
        return np.where((whole == 0.0) & (part == 0.0), of_nothing, part / whole)

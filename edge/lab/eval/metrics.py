"""Navigation metrics SPL and soft SPL of an episode. An arm's figure is the mean over episodes."""

from __future__ import annotations

import numpy as np

REACHED_M = 1.0
"""A robot this near to an object's footprint has reached it. Shortest paths end there."""


def episode_spl(success: np.ndarray, shortest_m: np.ndarray, path_m: np.ndarray) -> np.ndarray:
    """Return success weighted by path length (Anderson et al. 2018, eq. 1), as in VL-Nav's table I.

    Returns:
        Array of their common shape, in [0, 1]. A path shorter than the shortest earns no bonus.

    Example:
        >>> episode_spl(np.array([1, 0]), np.array([4.0, 4.0]), np.array([5.0, 5.0])).tolist()
        [0.8, 0.0]
    """
    return np.where(np.asarray(success, bool), efficiency(shortest_m, path_m), 0.0)


def episode_soft_spl(
    success: np.ndarray, shortest_m: np.ndarray, path_m: np.ndarray, left_m: np.ndarray
) -> np.ndarray:
    """Return soft SPL (Datta et al. 2020), in [0, 1]: progress to the goal in place of success.

    `shortest_m` and `left_m` are geodesic distances to the nearest place of success, from the start
    and from the robot's end. The latter is taken as 0 for a success. The result is NaN if it is
    NaN.
    """
    left_m = np.where(np.asarray(success, bool), 0.0, np.asarray(left_m, np.float64))
    share = _share(left_m, shortest_m, 0.0)
    return np.clip(1.0 - share, 0.0, 1.0) * efficiency(shortest_m, path_m)


def efficiency(shortest_m: np.ndarray, path_m: np.ndarray) -> np.ndarray:
    """Return the shortest path as a share of the driven path, at most 1; 1 if both are 0."""
    return _share(shortest_m, np.maximum(path_m, shortest_m), 1.0)


def _share(part: np.ndarray, total: np.ndarray, if_both_0: float) -> np.ndarray:
    """Return part / total. 0 / 0 gives `if_both_0`, any other division by 0 gives inf."""
    part, total = np.broadcast_arrays(np.asarray(part, np.float64), np.asarray(total, np.float64))
    with np.errstate(all="ignore"):
        return np.where((total == 0.0) & (part == 0.0), if_both_0, part / total)

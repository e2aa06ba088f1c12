"""Scores of a trajectory against its reference: OpenNav's tables I and II, and true collisions.

Trajectories are (n, 2) float64 in `map`, n >= 1; a refused one is the robot's place. An occupancy
grid has int8 cells, 100 for occupied.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from edge.geometry import Grid
from edge.jit import jit
from edge.lab.eval.metrics import REACHED_M
from edge.tasks.scene.value_map import closed_cells
from edge.trajectory.smoothing import resample

SPACING_M = 0.5
"""NDTW compares points at this distance, however densely a trajectory was sampled."""
FRECHET_M = 0.02
"""The Fréchet distance compares points at this distance."""


def navigation_error_m(path_m: np.ndarray, reference_m: np.ndarray) -> float:
    """Return the distance between the ends (NE). OpenNav's success rate counts those within 1 m."""
    path, reference = _points(path_m), _points(reference_m)
    return math.dist(path[-1], reference[-1])


def frechet_m(a_m: np.ndarray, b_m: np.ndarray) -> float:
    """Return the Fréchet distance of two polylines (n, 2), n >= 1.

    It is the shortest leash with which a dog and its owner can walk along the two without going
    back. They stop at points `FRECHET_M` apart, which makes it longer by less than that.
    """
    return _discrete_frechet_m(*(resample(_points(path_m), FRECHET_M) for path_m in (a_m, b_m)))


def ndtw(path_m: np.ndarray, reference_m: np.ndarray) -> float:
    """Return the normalised dynamic time warping (Ilharco et al. 2019): exp(-DTW / (|R| d_th)).

    It is in (0, 1], and 1 for the same trajectory. Both are compared at points `SPACING_M` apart.
    d_th, the distance at which a robot has reached a place, is `REACHED_M`.

    Example:
        >>> path = np.array([(0.0, 0.0), (1.0, 0.0)])
        >>> ndtw(path, path)
        1.0
    """
    path, reference = (resample_evenly(_points(p), SPACING_M) for p in (path_m, reference_m))
    return math.exp(-_warping_cost_m(reference, path) / (len(reference) * REACHED_M))


def resample_evenly(path_m: np.ndarray, spacing_m: float) -> np.ndarray:
    """Resample a path (n, 2) at equal distances of at most `spacing_m`: (k, 2).

    The ends stay. A corner between two samples is lost.
    """
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(path_m, axis=0).T)))
    if along_m[-1] == 0.0:
        return path_m[:1]
    at_m = np.linspace(0.0, along_m[-1], math.ceil(along_m[-1] / spacing_m) + 1)
    return np.column_stack([np.interp(at_m, along_m, axis) for axis in path_m.T])


def contacts(path_m: np.ndarray, occupancy: Grid, clearance_m: float = 0.0) -> int:
    """Count the collisions: stretches of a path in, or within `clearance_m` of, an occupied cell.

    `clearance_m` is the robot's radius. Outside the map, nothing is occupied.
    """
    points = resample(_points(path_m), 0.25 * occupancy.resolution_m)
    cells = np.floor(occupancy.to_cells(points)).astype(np.int64)
    inside = ((cells >= 0) & (cells < occupancy.cells.shape[::-1])).all(axis=1)
    touches = np.zeros(len(points) + 1, bool)
    columns, rows = cells[inside].T
    # The entry before the first point is False, so that contact at the start counts as a stretch.
    touches[1:][inside] = closed_cells(occupancy, clearance_m)[rows, columns]
    return int((touches[1:] & ~touches[:-1]).sum())


def point_contacts(
    path_m: np.ndarray, solid_m: np.ndarray, clearance_m: float
) -> tuple[int, float]:
    """Compare a path with obstacle points (m, 2).

    Returns:
        The number of stretches within `clearance_m` of any point; and how much nearer than that the
        path comes to one, in m, 0 if it does not.
    """
    points = resample(_points(path_m), 0.05)  # 5 cm apart
    away_m, _ = cKDTree(solid_m.reshape(-1, 2)).query(points)
    touches = np.append(False, away_m < clearance_m)
    depth_m = max(clearance_m - float(away_m.min()), 0.0)
    return int((touches[1:] & ~touches[:-1]).sum()), depth_m


def _points(path_m: np.ndarray) -> np.ndarray:
    """Return the points as float64, contiguous.

    Raises:
        ValueError: they are not (n, 2), n >= 1, or not finite.
    """
    path = np.ascontiguousarray(path_m, np.float64)
    if path.ndim != 2 or path.shape[1] != 2 or not len(path) or not np.isfinite(path).all():
        raise ValueError(
            f"trajectory: expected at least one point, shape (n, 2), all finite; got {path.shape}"
        )
    return path


@jit
def _discrete_frechet_m(a, b):
    """Return the discrete Fréchet distance (Eiter & Mannila 1994): jumps from point to point.

    `row[j]` is the distance of `a` up to point i and `b` up to j; `diagonal` that of i - 1, j - 1.
    """
    row = np.empty(len(b))
    for i in range(len(a)):
        diagonal = 0.0
        for j in range(len(b)):
            d = math.hypot(a[i, 0] - b[j, 0], a[i, 1] - b[j, 1])
            if i == 0:
                reached = row[j - 1] if j > 0 else 0.0
            elif j == 0:
                reached = row[0]
            else:
                reached = min(row[j], row[j - 1], diagonal)
            diagonal = row[j]
            row[j] = max(d, reached)
    return row[-1]


@jit
def _warping_cost_m(reference, path):
    """Return the least sum of distances over all monotone matchings of the points.

    `row[j]` is the sum for the first i points of `reference` and the first j of `path`.
    """
    row = np.full(len(path) + 1, math.inf)
    row[0] = 0.0
    for i in range(len(reference)):
        diagonal = row[0]
        row[0] = math.inf
        for j in range(len(path)):
            d = math.hypot(reference[i, 0] - path[j, 0], reference[i, 1] - path[j, 1])
            least = min(row[j + 1], row[j], diagonal)
            diagonal = row[j + 1]
            row[j + 1] = d + least
    return row[-1]

"""Occupancy cells to the pixels of a picture: crop to what is known, thin, colour."""

from __future__ import annotations

import numpy as np

from edge.mapping.results import OccupancySnapshot
from edge.report import palette

MAX_SIDE_PX = 1600
Box = tuple[float, float, float, float]


def thin(cells: np.ndarray, max_side: int = MAX_SIDE_PX) -> tuple[np.ndarray, int]:
    """Blocks of k x k cells as one: the highest of them, so occupied before free before unknown.

    Args:
        cells: (h, w) int8, -1 to 100.

    Returns:
        (ceil(h / k), ceil(w / k)) int8, and the smallest k that keeps both within `max_side`.
    """
    h, w = cells.shape
    k = max(1, -(-max(h, w) // max_side))
    if k == 1:
        return cells, 1
    padded = np.full((-(-h // k) * k, -(-w // k) * k), -1, dtype=np.int8)
    padded[:h, :w] = cells
    blocks = padded.reshape(padded.shape[0] // k, k, padded.shape[1] // k, k)
    return blocks.max(axis=(1, 3)), k


def crop(snapshot: OccupancySnapshot) -> OccupancySnapshot | None:
    """The smallest part of the map that holds every known cell; None when nothing is known."""
    known = snapshot.cells >= 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return None
    y, x, resolution_m = int(rows[0]), int(columns[0]), snapshot.resolution_m
    origin_x_m, origin_y_m = snapshot.origin_xy_m
    origin = (origin_x_m + x * resolution_m, origin_y_m + y * resolution_m)
    return OccupancySnapshot(
        snapshot.cells[y : rows[-1] + 1, x : columns[-1] + 1], origin, resolution_m
    )


def box_of(snapshot: OccupancySnapshot) -> Box:
    """(x_min, x_max, y_min, y_max) in m, as matplotlib's `extent`."""
    (h, w), (x_m, y_m) = snapshot.cells.shape, snapshot.origin_xy_m
    return (x_m, x_m + w * snapshot.resolution_m, y_m, y_m + h * snapshot.resolution_m)


def colour(cells: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 of the palette's unknown (< 0), free (0), inflated (1-99) and occupied."""
    kinds = (palette.UNKNOWN, palette.FREE, palette.INFLATED, palette.OCCUPIED)
    table = np.array([_rgb(kind) for kind in kinds])
    return table[np.searchsorted((-1, 0, 99), cells)]


def _rgb(hex_colour: str) -> np.ndarray:
    return np.frombuffer(bytes.fromhex(hex_colour[1:]), dtype=np.uint8)

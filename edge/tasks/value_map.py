"""What each cell costs a trajectory that is to keep to what was said (OpenNav III-A4, III-B)."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.geometry import Grid
from edge.trajectory.costmap import OCCUPIED, CostMap, from_weights

TUBE, DRIVABLE, HIGH = 10, 20, 250
"""Weights of a cell; TUBE is 1 a metre. The paper gives their order and no figures: DRIVABLE is the
least that keeps A* from cutting a half circle short (pi / 2 times its chord)."""
CLOSED = 0
_SUB_PX = 4  # OpenCV draws lines from points in sixteenths of a cell


@dataclass(frozen=True, slots=True)
class Body:
    """The robot's room and the coarse trajectory's.

    Attributes:
        clearance_m: see `closed_cells`.
        tube_m: radius around the coarse trajectory; what it says is meant within this.
    """

    clearance_m: float
    tube_m: float = 1.0


def value_map(
    occupancy: Grid, regions: Grid, drivable: Collection[int], coarse_m: np.ndarray, body: Body
) -> CostMap:
    """The BEV value map (OpenNav III-A4), ready for A*.

    | cell | value |
    |---|---|
    | drivable, within `tube_m` of the coarse trajectory | TUBE, the lowest |
    | drivable: of a chosen region | DRIVABLE, slightly higher |
    | other ground | HIGH |
    | occupied | HIGH in the paper, closed here |
    | too near to what is occupied, or never seen | closed |

    In the paper a cost is all that keeps A* out of what is occupied, and Table II counts 2
    collisions in 30: here no path enters it at any price. What is closed is so for who writes the
    trajectory as well (`open_cells`). The tube lowers the cost of chosen regions only, else a
    coarse line that is straight would lead over the lawn which the choice of regions leaves out.

    Args:
        occupancy: int8; -1 unknown, 0 free, 100 occupied.
        regions: uint8, the same cells: the region's id, 0 where there is none.
        drivable: the ids chosen, 1 to 255.
        coarse_m: (n, 2) float64 in `map`; no tube for an empty one.

    Raises:
        ValueError: grids of other types, or not the same cells; an id that is none.
    """
    cells = occupancy.cells
    if cells.dtype != np.int8 or regions.cells.dtype != np.uint8:
        raise ValueError(
            f"expected int8 occupancy and uint8 regions, got {cells.dtype}, {regions.cells.dtype}"
        )
    place = (occupancy.origin_xy_m, occupancy.resolution_m, cells.shape)
    if place != (regions.origin_xy_m, regions.resolution_m, regions.cells.shape):
        raise ValueError("occupancy and regions lie on different cells")
    if not all(0 < region < 256 for region in drivable):
        raise ValueError(f"regions are numbered 1 to 255, got {sorted(drivable)}")
    if cells.size == 0:
        return from_weights(replace(occupancy, cells=np.zeros(cells.shape, np.uint8)), TUBE)
    table = np.full(256, HIGH, np.uint8)
    table[list(drivable)] = DRIVABLE
    weights = cv2.LUT(regions.cells, table)
    if len(coarse_m):
        tube = _tube(occupancy, coarse_m, body.tube_m)
        tube &= cv2.compare(weights, DRIVABLE, cv2.CMP_EQ)
        weights[tube.view(bool)] = TUBE
    weights[~open_cells(occupancy, regions, body.clearance_m)] = CLOSED
    return from_weights(replace(occupancy, cells=weights), TUBE)


def closed_cells(grid: Grid, clearance_m: float) -> np.ndarray:
    """(h, w) bool: where a robot's middle may not be, whatever is known of the ground there.

    Occupied cells, and those whose middle is nearer than `clearance_m` to the rim of one.
    """
    if grid.cells.size == 0:
        return np.zeros(grid.cells.shape, bool)
    occupied = cv2.compare(grid.cells, OCCUPIED, cv2.CMP_GE)
    reach = math.ceil(clearance_m / grid.resolution_m)
    gap_m = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 0.5, 0.0) * grid.resolution_m
    # An exact disc: over few cells a dilation costs a tenth of a distance transform.
    disc = gap_m**2 + gap_m[:, None] ** 2 < max(clearance_m, 1e-9) ** 2
    return cv2.dilate(occupied, disc.astype(np.uint8)).view(bool)


def open_cells(occupancy: Grid, regions: Grid, clearance_m: float) -> np.ndarray:
    """(h, w) bool: where a robot's middle may be: not closed, and seen free or of a region, which
    reaches over cells that nothing hit, as between the rings of a LiDAR.

    Args:
        regions: the same cells, 0 where there is none.
    """
    known = (occupancy.cells >= 0) | (regions.cells > 0)
    return known & ~closed_cells(occupancy, clearance_m)


def _tube(grid: Grid, coarse_m: np.ndarray, radius_m: float) -> np.ndarray:
    """(h, w) uint8, 255 within a radius of a polyline."""
    tube = np.zeros(grid.cells.shape, np.uint8)
    # OpenCV has a pixel's centre at whole numbers, a grid its corner.
    at = np.clip((grid.of_metres(coarse_m) - 0.5) * (1 << _SUB_PX), -(2**24), 2**24)
    points = np.rint(at).astype(np.int32).reshape(-1, 1, 2)
    radius = radius_m / grid.resolution_m
    cv2.polylines(tube, [points], False, 255, max(round(2 * radius), 1), cv2.LINE_8, _SUB_PX)
    for end in points[[0, -1], 0]:
        cv2.circle(tube, end.tolist(), round(radius * (1 << _SUB_PX)), 255, -1, shift=_SUB_PX)
    return tube

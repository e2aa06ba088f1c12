"""Value map: the cost of each cell for a trajectory along the coarse one (OpenNav III-A4)."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.geometry import Grid
from edge.trajectory.costmap import OCCUPIED, CostMap, from_weights

TUBE, DRIVABLE, BRIDGE, HIGH = 10, 20, 50, 250
"""Weights of cells in the tube, of other drivable cells, of short bridges over unseen ground, and
of all other ground; see `value_map`. A cell of weight TUBE costs 1 per metre.

The paper gives the order of the weights but no numbers. A half circle is pi / 2 times as long as
its chord. So DRIVABLE must be so much larger than TUBE that A* does not take the chord. A bridge
may cost a detour of a few metres, but not the entire way back around the object that it is behind.
"""
CLOSED = 0
"""Weight of a cell that no path may enter."""
BRIDGE_M = 0.45
"""Unseen ground within this distance of seen ground is open, as in the shadow of a low bush."""
IN_ZONE = 25
"""Occupancy of a cell that a zone closes: below `OCCUPIED`, so it hides nothing behind it."""
_SUB_PX = 4  # fractional bits of points for OpenCV: 1/16 cell


@dataclass(frozen=True, slots=True)
class PathMargins:
    """Clearance of the robot, and width of the tube around the coarse trajectory.

    Attributes:
        clearance_m: least distance of the robot's centre from occupied cells; see `closed_cells`.
        tube_m: radius of the tube; the refined trajectory prefers to stay inside.
    """

    clearance_m: float
    tube_m: float = 1.0


def value_map(
    occupancy: Grid,
    regions: Grid,
    drivable: Collection[int],
    coarse_m: np.ndarray,
    margins: PathMargins,
) -> CostMap:
    """Build the bird's-eye-view value map (OpenNav III-A4), ready for A*.

    | cell | value |
    |---|---|
    | drivable, within `tube_m` of the coarse trajectory | TUBE, the lowest |
    | drivable: of a chosen region | DRIVABLE, slightly higher |
    | unseen, within `BRIDGE_M` of seen ground | BRIDGE |
    | other ground | HIGH |
    | occupied | HIGH in the paper, closed here |
    | in a zone, too near to an occupied cell, or too far from seen ground (`BRIDGE_M`) | closed |

    In the paper only the cost keeps A* out of occupied cells, and Table II counts 2 collisions in
    30. Here no path enters them. Closed cells are also closed for the writer of the trajectory
    (`open_cells`). The tube lowers the cost only in chosen regions. Otherwise a straight coarse
    line would lead over the lawn that the choice of regions leaves out.

    Args:
        occupancy: int8; -1 unknown, 0 free, `IN_ZONE`, 100 occupied.
        regions: uint8, the same cells: id of the region, 0 = none.
        drivable: ids of the chosen regions, 1 to 255.
        coarse_m: (n, 2) float64 in `map`; empty: no tube.
        margins: clearance and tube radius.
    """
    cells = occupancy.cells
    if cells.size == 0:
        return from_weights(replace(occupancy, cells=np.zeros(cells.shape, np.uint8)), TUBE)
    table = np.full(256, HIGH, np.uint8)
    table[list(drivable)] = DRIVABLE
    weights = cv2.LUT(regions.cells, table)
    if len(coarse_m):
        tube = _tube(occupancy, coarse_m, margins.tube_m)
        tube &= cv2.compare(weights, DRIVABLE, cv2.CMP_EQ)
        weights[tube.view(bool)] = TUBE
    weights[(cells < 0) & (regions.cells == 0)] = BRIDGE
    weights[~open_cells(occupancy, regions, margins.clearance_m)] = CLOSED
    return from_weights(replace(occupancy, cells=weights), TUBE)


def closed_cells(grid: Grid, clearance_m: float) -> np.ndarray:
    """Return the cells that the robot's centre must not enter, known or not, (h, w) bool.

    These are occupied cells, cells with a centre nearer than `clearance_m` to an occupied cell's
    rim, and cells in zones. Zones have their clearance already (`edge.mapping.zones`).
    """
    if grid.cells.size == 0:
        return np.zeros(grid.cells.shape, bool)
    occupied = cv2.compare(grid.cells, OCCUPIED, cv2.CMP_GE)
    reach = math.ceil(clearance_m / grid.resolution_m)
    gap_m = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 0.5, 0.0) * grid.resolution_m
    # An exact disc: with a small radius, dilation costs a tenth of a distance transform.
    disc = gap_m**2 + gap_m[:, None] ** 2 < max(clearance_m, 1e-9) ** 2
    return cv2.dilate(occupied, disc.astype(np.uint8)).view(bool) | (grid.cells > 0)


def open_cells(occupancy: Grid, regions: Grid, clearance_m: float) -> np.ndarray:
    """Return the cells that the robot's centre may enter, (h, w) bool.

    A cell is open if it is not closed, and was seen to be free or is part of a region, or is within
    `BRIDGE_M` of such a cell. A region also covers cells that no ray hit, as between the rings of a
    LiDAR. `regions` has the same cells, 0 = none.
    """
    seen = (occupancy.cells == 0) | (regions.cells > 0)
    return near_seen(seen, occupancy.resolution_m) & ~closed_cells(occupancy, clearance_m)


def near_seen(seen: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return the cells within `BRIDGE_M` of cells (h, w) bool that were seen, and those."""
    reach = int(BRIDGE_M / resolution_m)
    offset = np.arange(-reach, reach + 1)
    disc = (offset**2 + offset[:, None] ** 2 <= reach**2).astype(np.uint8)
    return cv2.dilate(seen.astype(np.uint8), disc).view(bool) if seen.size else seen


def _tube(grid: Grid, coarse_m: np.ndarray, radius_m: float) -> np.ndarray:
    """Return the cells within a radius of a polyline, (h, w) uint8, 255 inside."""
    tube = np.zeros(grid.cells.shape, np.uint8)
    # OpenCV has pixel centres at integers, a grid has cell corners there.
    at = np.clip((grid.to_cells(coarse_m) - 0.5) * (1 << _SUB_PX), -(2**24), 2**24)
    points = np.rint(at).astype(np.int32).reshape(-1, 1, 2)
    radius = radius_m / grid.resolution_m
    cv2.polylines(tube, [points], False, 255, max(round(2 * radius), 1), cv2.LINE_8, _SUB_PX)
    for end in points[[0, -1], 0]:
        cv2.circle(tube, end.tolist(), round(radius * (1 << _SUB_PX)), 255, -1, shift=_SUB_PX)
    return tube

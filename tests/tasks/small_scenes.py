"""Small scenes with known cells."""

from __future__ import annotations

import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.scene.scene import Region, Scene
from edge.tasks.scene.value_map import PathMargins
from edge.trajectory.pursuit import MotionLimits

CELL_M = 0.1
LIMITS = MotionLimits(speed_mps=1.0, turn_radps=1.0, accel_mps2=0.8, turn_accel_radps2=3.0)
BODY = PathMargins(clearance_m=0.4, tube_m=1.0)
START = SE2(-7.0, 0.0, 0.0)
Box = tuple[float, float, float, float]


def scene(*obstacles: Box, pose: SE2 = START, road: Box = (-9.0, -9.0, 9.0, 9.0)) -> Scene:
    """20 m by 20 m around the origin; boxes (x0, y0, x1, y1) [m]: obstacles, and region 1."""
    occupancy = Grid(np.zeros((200, 200), np.int8), (-10.0, -10.0), CELL_M)
    regions = Grid(np.zeros((200, 200), np.uint8), (-10.0, -10.0), CELL_M)
    for box in obstacles:
        fill(occupancy, box, 100)
    fill(regions, road, 1)
    area_m2 = (road[2] - road[0]) * (road[3] - road[1])
    named = {1: Region(1, "road", area_m2)}
    return Scene(0, pose, {}, named, occupancy, regions, None, None, None, {})


def fill(grid: Grid, box: Box, value: int) -> None:
    (c0, r0), (c1, r1) = np.rint(grid.to_cells(np.reshape(box, (2, 2)))).astype(int)
    grid.cells[max(r0, 0) : max(r1, 0), max(c0, 0) : max(c1, 0)] = value

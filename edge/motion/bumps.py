"""Remembering where the robot was held up by something that the map does not show."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from edge.geometry import SE2

AHEAD_M, RADIUS_M = 0.15, 0.1
KEEP_NS = 60_000_000_000
OCCUPIED = 100


class Bumps:
    """Places that are closed for a while: a chair leg below the camera, a glass door.

    Without them the next path leads through the same gap again.
    """

    def __init__(self, capacity: int = 16) -> None:
        self._places: deque[tuple[float, float, int]] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._places)

    def add(self, pose: SE2, forward: bool, now_ns: int) -> None:
        """The robot was told to drive and did not move.

        Args:
            forward: whether it was told to drive ahead, not back.
        """
        ahead_m = AHEAD_M if forward else -AHEAD_M
        x_m = pose.x_m + ahead_m * math.cos(pose.yaw_rad)
        y_m = pose.y_m + ahead_m * math.sin(pose.yaw_rad)
        self._places.append((x_m, y_m, now_ns + KEEP_NS))

    def close(
        self, cells: np.ndarray, origin_xy_m: tuple[float, float], resolution_m: float, now_ns: int
    ) -> np.ndarray:
        """The map with these places occupied.

        Args:
            cells: (h, w) int8, as in nav_msgs/OccupancyGrid; not changed.

        Returns:
            A changed copy, or `cells` itself where no place is closed.
        """
        while self._places and not now_ns < self._places[0][2] <= now_ns + KEEP_NS:
            self._places.popleft()
        if not self._places:
            return cells
        closed = cells.copy()
        radius = RADIUS_M / resolution_m
        for x_m, y_m, _ in self._places:
            u = (x_m - origin_xy_m[0]) / resolution_m - 0.5
            v = (y_m - origin_xy_m[1]) / resolution_m - 0.5
            top, left = max(0, math.ceil(v - radius)), max(0, math.ceil(u - radius))
            window = closed[top : max(0, int(v + radius) + 1), left : max(0, int(u + radius) + 1)]
            rows, columns = np.ogrid[: window.shape[0], : window.shape[1]]
            window[(rows + top - v) ** 2 + (columns + left - u) ** 2 <= radius**2] = OCCUPIED
        return closed

"""The driven path in limited memory, for the live view and reports."""

from __future__ import annotations

import numpy as np

from edge.geometry import SE2

# Smallest distance and time between two poses, at first.
STEP_M = 0.05
STEP_NS = 100_000_000


class DrivenPath:
    """A path in a fixed array: if full, every other pose is dropped and the spacing doubles.

    Args:
        capacity: largest number of poses, each x and y in metres and yaw in radians.
    """

    def __init__(self, capacity: int = 16384) -> None:
        self._poses = np.zeros((capacity, 3))
        self._stamp_ns = np.zeros(capacity, dtype=np.int64)
        self._n = 0
        self._stride = 1  # doubled whenever the array is full
        self._last: tuple[int, SE2] | None = None

    def append(self, stamp_ns: int, pose: SE2) -> None:
        """Append the pose if it is `STEP_M` or `STEP_NS` (times the stride) after the last pose."""
        if self._last is not None:
            last_ns, last = self._last
            moved_m = last.distance_to(pose.x_m, pose.y_m)
            is_near = moved_m < STEP_M * self._stride
            if is_near and stamp_ns - last_ns < STEP_NS * self._stride:
                return
        if self._n == len(self._poses):
            self._halve()
        self._poses[self._n] = pose.x_m, pose.y_m, pose.yaw_rad
        self._stamp_ns[self._n] = stamp_ns
        self._n += 1
        self._last = (stamp_ns, pose)

    def _halve(self) -> None:
        """Drop every other pose."""
        kept = (self._n + 1) // 2
        self._poses[:kept] = self._poses[: self._n : 2].copy()
        self._stamp_ns[:kept] = self._stamp_ns[: self._n : 2].copy()
        self._n = kept
        self._stride *= 2

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of (n, 3) float64 poses and (n,) int64 stamps."""
        return self._poses[: self._n].copy(), self._stamp_ns[: self._n].copy()

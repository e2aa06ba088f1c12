"""Preallocated frames that are reused when every reader has released them."""

from __future__ import annotations

import threading

import numpy as np


class PoolSlot:
    """The arrays of one frame, with a count of its readers (an `edge.types.Slot`).

    Attributes:
        rgb: (h, w, 3) uint8; None if the pool has no images.
        depth_m: (h, w) float32, or None.
        cloud_m: (cap, 3) float32, or None.
        holds: number of readers; 0: free.
    """

    __slots__ = ("_lock", "cloud_m", "depth_m", "holds", "rgb")

    def __init__(
        self, lock: threading.Lock, image_hw: tuple[int, int] | None, cloud_points: int, depth: bool
    ) -> None:
        self._lock = lock
        self.holds = 0
        self.rgb = np.zeros((*image_hw, 3), np.uint8) if image_hw else None
        self.depth_m = np.zeros(image_hw, np.float32) if image_hw and depth else None
        self.cloud_m = np.zeros((cloud_points, 3), np.float32) if cloud_points else None

    def hold(self) -> None:
        with self._lock:
            if self.holds == 0:
                raise RuntimeError("a frame was held after its last reader had released it")
            self.holds += 1

    def release(self) -> None:
        with self._lock:
            if self.holds == 0:
                raise RuntimeError("a frame was released more often than it was held")
            self.holds -= 1


class FramePool:
    """`n_slots` frames, allocated once; thread-safe.

    Args:
        image_hw: size of rgb and depth; None for a robot without a camera.
        cloud_points: capacity for points, 0 for none.
        depth: True if slots have `depth_m`.

    Example:
        >>> pool = FramePool(1, image_hw=(480, 640))
        >>> slot = pool.acquire()
        >>> slot.rgb.shape, pool.acquire()
        ((480, 640, 3), None)
        >>> slot.release()
    """

    def __init__(
        self,
        n_slots: int,
        image_hw: tuple[int, int] | None = None,
        cloud_points: int = 0,
        depth: bool = True,
    ) -> None:
        self._lock = threading.Lock()
        self._next = 0
        self._slots = [PoolSlot(self._lock, image_hw, cloud_points, depth) for _ in range(n_slots)]

    def acquire(self) -> PoolSlot | None:
        """Return a free slot, held once for the caller; None if all are in use."""
        with self._lock:
            for i in range(len(self._slots)):
                slot = self._slots[(self._next + i) % len(self._slots)]
                if slot.holds == 0:
                    slot.holds = 1
                    self._next = (self._next + i + 1) % len(self._slots)
                    return slot
            return None

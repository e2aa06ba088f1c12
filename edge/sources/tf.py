"""Where the robot's frames are to each other, by tf: the newest transform of each."""

from __future__ import annotations

import numpy as np

from edge.bus.wire.messages import Odometry
from edge.bus.wire.transforms import MOST_TRANSFORMS, Transform, decode_transforms
from edge.config.ros2 import Ros2
from edge.geometry import invert

_DEEPEST = 64


class TfBuffer:
    """A tree of frames, each with the newest transform to its parent; for one thread.

    Only the newest is kept: what is asked for is where sensors sit and how far odometry has
    drifted, which change slowly or never.
    """

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}

    def offer(self, transform: Transform) -> bool:
        """Take a transform; False where there are too many frames already, or it is a loop."""
        child, parent = transform.child, transform.parent
        if child == parent or (
            child not in self._parents and len(self._parents) >= MOST_TRANSFORMS
        ):
            return False
        self._parents[child] = parent, transform.T
        return True

    def lookup(self, target: str, source: str) -> np.ndarray | None:
        """(4, 4) `T_target_source`; None where the two are not connected."""
        if target == source:
            return np.eye(4)
        above_target = self._above(target)
        T_ancestor_source = np.eye(4)
        frame = source
        for _ in range(_DEEPEST):
            if frame in above_target:
                return invert(above_target[frame]) @ T_ancestor_source
            if frame not in self._parents:
                return None
            frame, T = self._parents[frame]
            T_ancestor_source = T @ T_ancestor_source
        return None

    def _above(self, frame: str) -> dict[str, np.ndarray]:
        """The frame and all above it, each with the transform from `frame` into it."""
        above = {frame: np.eye(4)}
        T = np.eye(4)
        for _ in range(_DEEPEST):
            if frame not in self._parents:
                break
            parent, T_parent_frame = self._parents[frame]
            if parent in above:
                break  # a loop
            T = T_parent_frame @ T
            above[parent], frame = T, parent
        return above


class Frames:
    """What tf says of the robot's base, its sensors and `map`.

    Attributes:
        by_tf: whether it, not the configuration, says where the sensors sit.
    """

    def __init__(self, settings: Ros2) -> None:
        self.by_tf = settings.mounts == "tf"
        self._map, self._base = settings.map_frame, settings.base_frame
        self._tf = TfBuffer()

    def take(self, payload: bytes) -> int:
        """Take a tf2_msgs/TFMessage; how many transforms could not be taken.

        Raises:
            DecodeError: malformed.
        """
        return sum(not self._tf.offer(transform) for transform in decode_transforms(payload))

    def mount_of(self, frame_id: str) -> np.ndarray | None:
        """(4, 4) `T_base_sensor` of the sensor whose messages name this frame; None: unknown."""
        return self._tf.lookup(self._base, frame_id.lstrip("/"))

    def base_in_map(self, odometry: Odometry) -> np.ndarray | None:
        """(4, 4) `T_map_base` as odometry tells it of its own two frames; None: unknown yet."""
        T_map_odom = self._tf.lookup(self._map, odometry.frame_id.lstrip("/"))
        T_child_base = self._tf.lookup(odometry.child_frame_id.lstrip("/"), self._base)
        if T_map_odom is None or T_child_base is None:
            return None
        return T_map_odom @ odometry.T_map_base @ T_child_base

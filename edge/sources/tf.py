"""Time-stamped buffer of tf: transforms between the robot's frames at an instant.

A frame here is a coordinate frame, never an image.
"""

from __future__ import annotations

import numpy as np

from edge.bus.wire.messages import OdometryMessage
from edge.bus.wire.transforms import MOST_TRANSFORMS, Transform, decode_transforms
from edge.config import Config
from edge.geometry import invert
from edge.sources.messages import TransformLookup
from edge.sources.odometry import StampedPoses, StampGuard

_MAX_DEPTH = 64  # frames from a leaf to the root
_HISTORY = 128  # transforms that are kept of each moving frame
_RARELY_NS = 500_000_000  # smallest `rarely_ns`, see `_Edge`
_IDENTITY = TransformLookup(np.eye(4))
_IDENTITY.T.flags.writeable = False


class _Edge:
    """The transforms of one frame to its parent.

    Usually the transform at an instant is interpolated between two. But a transform holds until the
    next one if that comes more than `rarely_ns` later; a single transform holds for all time. Such
    a frame moves in steps, or never, so no lookup waits.

    Attributes:
        T: the newest transform, (4, 4).
    """

    __slots__ = ("T", "_guard", "_history", "_rarely_ns", "parent")

    def __init__(self, transform: Transform, rarely_ns: int) -> None:
        self.parent, self.T = transform.parent, transform.T
        self._rarely_ns = rarely_ns
        self._guard = StampGuard()
        self._guard.check(transform.stamp_ns)
        self._history: StampedPoses | None = None  # None: there is only one transform

    def push(self, transform: Transform) -> None:
        """Add a later transform of the frame."""
        first_ns = self._guard.newest_ns
        verdict = self._guard.check(transform.stamp_ns)
        if verdict == "backward":
            return
        if verdict == "clock_reset":
            self._history = None
        elif verdict == "ok":
            if self._history is None:
                # A full history covers at least four times `rarely_ns` (see `StampedPoses`).
                self._history = StampedPoses(_HISTORY, 8 * self._rarely_ns // _HISTORY)
                self._history.push(first_ns, self.T)
            self._history.push(transform.stamp_ns, transform.T)
        elif self._history is not None:  # repeated: the same stamp again
            self._history.replace(transform.T)
        self.T = transform.T

    def at(self, stamp_ns: int) -> tuple[np.ndarray, int]:
        """Return the transform at an instant, and its age in ns at that instant.

        If the instant is before all transforms, the age is negative: minus the time to the first.
        """
        history = self._history
        if history is None:
            return self.T, 0
        n = history.count_newer(stamp_ns)  # index of the newest that is not later
        if n == len(history):
            return history.pose(n - 1), stamp_ns - history.stamp(n - 1)
        before_ns = history.stamp(n)
        if before_ns == stamp_ns:
            return history.pose(n).copy(), 0
        # The step around the instant; after all transforms (n is 0), the last step.
        later = max(n, 1) - 1
        is_step = history.stamp(later) - history.stamp(later + 1) > self._rarely_ns
        if n == 0:
            return history.pose(0).copy(), 0 if is_step else stamp_ns - before_ns
        return history.pose(n).copy() if is_step else history.interpolate_at(n, stamp_ns), 0


class TfBuffer:
    """A tree of frames with the recent transforms to their parents; for one thread.

    Args:
        wait_ns: how long an image or cloud waits for a transform. The history covers at least four
            times as much.

    Example:
        >>> tf = TfBuffer(wait_ns=100_000_000)
        >>> tf.offer(Transform(0, "map", "base_link", np.eye(4)), static=True)
        True
        >>> tf.lookup("map", "base_link", 1_000).T.shape
        (4, 4)
        >>> tf.lookup("map", "camera", 1_000).why
        "no transform from 'camera' to 'map' in tf, which has no 'camera'"
    """

    def __init__(self, wait_ns: int) -> None:
        self._rarely_ns = max(wait_ns, _RARELY_NS)
        self._edges: dict[str, _Edge] = {}

    def offer(self, transform: Transform, static: bool = False) -> bool:
        """Add a transform; return False if it is invalid or there are too many frames.

        Args:
            transform: from child to parent.
            static: True if it holds for all time, at any stamp.
        """
        child, parent = transform.child, transform.parent
        edge = self._edges.get(child)
        full = edge is None and len(self._edges) >= MOST_TRANSFORMS
        if child == parent or not child or not parent or full:
            return False
        if edge is None or static or edge.parent != parent:
            self._edges[child] = _Edge(transform, self._rarely_ns)
        else:
            edge.push(transform)
        return True

    def why_apart(self, target: str, source: str) -> str:
        """Return which transform between two frames is missing; "" if they are connected."""
        if not set(self._path_to_root(target)).isdisjoint(self._path_to_root(source)):
            return ""
        known = self._edges.keys() | {edge.parent for edge in self._edges.values()}
        absent = " and ".join(f"'{frame}'" for frame in (source, target) if frame not in known)
        tail = f", which has no {absent}" if absent else ""
        return f"no transform from '{source}' to '{target}' in tf{tail}"

    def lookup(self, target: str, source: str, stamp_ns: int) -> TransformLookup:
        """Return `T_target_source` at an instant, or why it is not known."""
        if target == source:
            return _IDENTITY
        above_target, above_source = self._path_to_root(target), self._path_to_root(source)
        meeting = next((frame for frame in above_source if frame in above_target), None)
        if meeting is None:
            return TransformLookup(None, why=self.why_apart(target, source))
        T_meeting_source, age_ns, why = self._climb(above_source, meeting, stamp_ns)
        if target == meeting:
            return TransformLookup(None if why else T_meeting_source, age_ns, why)
        T_meeting_target, age_target_ns, why_target = self._climb(above_target, meeting, stamp_ns)
        if why := why or why_target:
            return TransformLookup(None, why=why)
        T = invert(T_meeting_target) @ T_meeting_source
        return TransformLookup(T, max(age_ns, age_target_ns))

    def _climb(self, above: list[str], top: str, stamp_ns: int) -> tuple[np.ndarray, int, str]:
        """Return (`T_top_first`, age of its oldest part in ns, error or "")."""
        T, oldest_ns, why = _IDENTITY.T, 0, ""
        for frame in above:
            if frame == top:
                break
            edge = self._edges[frame]
            T_parent_frame, age_ns = edge.at(stamp_ns)
            if age_ns < 0:
                first = f"the first transform from '{frame}' to '{edge.parent}' is"
                why = why or f"{first} {-age_ns / 1e6:.0f} ms later"
            T = T_parent_frame if T is _IDENTITY.T else T_parent_frame @ T
            oldest_ns = max(oldest_ns, age_ns)
        return T, oldest_ns, why

    def _path_to_root(self, frame: str) -> list[str]:
        above = [frame]
        while len(above) < _MAX_DEPTH and (edge := self._edges.get(above[-1])) is not None:
            if edge.parent in above:
                break  # a cycle
            above.append(edge.parent)
        return above


class RobotFrames:
    """The frames of the robot's base, its sensors and `map` in tf.

    Attributes:
        by_tf: True if mounts come from tf and not from the configuration.
    """

    def __init__(self, config: Config) -> None:
        settings = config.ros2
        self.by_tf = settings.mounts == "tf"
        self._map, self._base = settings.map_frame, settings.base_frame
        self._tf = TfBuffer(int(config.source.wait_s * 1e9))

    def take(self, payload: bytes, static: bool) -> str:
        """Process a tf2_msgs/TFMessage; describe transforms that could not be used, or return "".

        Raises:
            DecodeError: the message is malformed.
        """
        transforms, faults = decode_transforms(payload)
        faults += [
            f"from '{t.child}' to '{t.parent}'" for t in transforms if not self._tf.offer(t, static)
        ]
        return f"{len(faults)} transforms, the first {faults[0]}" if faults else ""

    def why_unplaced(self, frame_id: str) -> str:
        """Return why a sensor's mount is unknown, given the frame id of its messages, or ""."""
        frame = frame_id.lstrip("/")
        if not frame:
            return f"header.frame_id is {_quote(frame_id)}: the driver must name the sensor's frame"
        return self._tf.why_apart(self._base, frame)

    def mount_at(self, frame_id: str, stamp_ns: int) -> TransformLookup:
        """Return `T_base_sensor` at an instant, given the frame id of the sensor's messages."""
        return self._tf.lookup(self._base, frame_id.lstrip("/"), stamp_ns)

    def base_in_map(self, odometry: OdometryMessage) -> TransformLookup:
        """Return `T_map_base` at the stamp of odometry, from its own frames through tf."""
        parent, child = odometry.frame_id.lstrip("/"), odometry.child_frame_id.lstrip("/")
        if not parent:
            shown = _quote(odometry.frame_id)
            return TransformLookup(
                None, why=f"header.frame_id is {shown}: the driver must set it, as odom"
            )
        if not child:
            shown = _quote(odometry.child_frame_id)
            fix = f"the driver must set it to the robot's frame, as {self._base}"
            return TransformLookup(None, why=f"child_frame_id is {shown}: {fix}")
        T_map_odom = self._tf.lookup(self._map, parent, odometry.stamp_ns)
        T_child_base = self._tf.lookup(child, self._base, odometry.stamp_ns)
        if T_map_odom.T is None or T_child_base.T is None:
            return TransformLookup(None, why=T_map_odom.why or T_child_base.why)
        T = T_map_odom.T @ odometry.T_map_base @ T_child_base.T
        return TransformLookup(T, max(T_map_odom.age_ns, T_child_base.age_ns))


def _quote(name: str) -> str:
    return f"'{name}'" if name else "empty"

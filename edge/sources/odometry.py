"""Recent poses of the base, and interpolation between them."""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import Literal

import numpy as np

from edge.geometry import SE2, interpolate, se2_of, wrap_angle

RESET_AFTER = 8
"""Number of stamps in a row after which earlier stamps count as a clock reset."""
_SPEED_MARGIN = 1.5  # robots exceed their configured speed, downhill or when pushed
_N_LINEAR = 4  # newest poses that are searched one by one, before bisection
_SPEED_WINDOW_NS = 100_000_000  # shortest time over which the speed is measured
_MAX_TURN_RAD = 1.0  # largest jump of yaw

# Reason why there is no pose, see `OdometryRing.pose_at`; "": there is one.
Missing = Literal["", "empty", "too_old", "too_new", "gap"]


class StampGuard:
    """Accepts stamps that move forward.

    A restarted sender may begin with earlier stamps, and one wrong stamp from the future would
    block all that follow. So `RESET_AFTER` consecutive stamps that are behind, but move forward
    among themselves, count as a clock reset.

    Attributes:
        behind_since_ns: the first stamp of the series that led to the last `clock_reset`.

    Example:
        >>> guard = StampGuard()
        >>> [guard.check(stamp_ns) for stamp_ns in (10, 20, 20, 5)]
        ['ok', 'ok', 'repeated', 'backward']
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        self.behind_since_ns: int | None = None
        # Of the present series of earlier stamps: the last one, and their number.
        self._behind_ns: int | None = None
        self._behind = 0

    def check(self, stamp_ns: int) -> Literal["ok", "repeated", "backward", "clock_reset"]:
        """Classify a stamp; messages with `ok` and `clock_reset` are to be used."""
        if self.newest_ns is None or stamp_ns > self.newest_ns:
            self._accept(stamp_ns)
            return "ok"
        if stamp_ns == self.newest_ns:
            return "repeated"
        forward = self._behind_ns is None or stamp_ns > self._behind_ns
        self._behind = self._behind + 1 if forward else 1
        self._behind_ns = stamp_ns
        if self._behind == 1:
            self.behind_since_ns = stamp_ns
        if self._behind < RESET_AFTER:
            return "backward"
        self._accept(stamp_ns)
        return "clock_reset"

    def _accept(self, stamp_ns: int) -> None:
        self.newest_ns = stamp_ns
        self._behind_ns, self._behind = None, 0


class StampedPoses:
    """(4, 4) transforms ordered by stamp, in a preallocated ring; for one thread.

    Args:
        capacity: size of the ring, 2 or more.
        apart_ns: of transforms with stamps closer than this, only the newest is kept. So a flood
            does not push out transforms that frames still need.
    """

    def __init__(self, capacity: int, apart_ns: int = 0) -> None:
        if capacity < 2:
            raise ValueError(f"capacity {capacity}: at least 2 poses are needed")
        self._apart_ns = apart_ns
        self._stamps_ns, self._ages_ns = [0] * capacity, [0] * capacity
        self._poses = np.zeros((capacity, 4, 4))
        self._n_pushed = 0
        self._n_kept = 0

    def __len__(self) -> int:
        return self._n_kept

    def clear(self) -> None:
        self._n_kept = 0

    def push(self, stamp_ns: int, T: np.ndarray, age_ns: int = 0) -> None:
        """Append the newest transform.

        Args:
            stamp_ns: stamp of the transform.
            T: the transform.
            age_ns: age at the stamp of the oldest transform from which `T` was computed; 0: exact.
        """
        # If the new one and the second newest are this close, the one between them is overwritten.
        if self._n_kept > 1 and stamp_ns - self.stamp(1) < self._apart_ns:
            self._n_pushed -= 1
            self._n_kept -= 1
        i = self._n_pushed % len(self._stamps_ns)
        self._stamps_ns[i], self._ages_ns[i], self._poses[i] = stamp_ns, age_ns, T
        self._n_pushed += 1
        self._n_kept = min(self._n_kept + 1, len(self._stamps_ns))

    def replace(self, T: np.ndarray) -> None:
        """Replace the newest transform."""
        self._poses[(self._n_pushed - 1) % len(self._stamps_ns)] = T

    def stamp(self, n: int) -> int:
        """Return the stamp of the `n`-th newest transform; 0 is the newest."""
        return self._stamps_ns[(self._n_pushed - 1 - n) % len(self._stamps_ns)]

    def age(self, n: int) -> int:
        """Return the age in ns that was pushed with the `n`-th newest transform."""
        return self._ages_ns[(self._n_pushed - 1 - n) % len(self._stamps_ns)]

    def pose(self, n: int) -> np.ndarray:
        """Return the `n`-th newest transform, as a view of the ring."""
        return self._poses[(self._n_pushed - 1 - n) % len(self._stamps_ns)]

    def count_newer(self, stamp_ns: int) -> int:
        """Return the number of transforms newer than an instant."""
        n_linear = min(_N_LINEAR, self._n_kept)
        for n in range(n_linear):  # the usual case
            if self.stamp(n) <= stamp_ns:
                return n
        # Bisection needs ascending values, and stamps descend with `n`.
        return bisect_left(range(self._n_kept), -stamp_ns, n_linear, key=lambda n: -self.stamp(n))

    def interpolate_at(self, n: int, stamp_ns: int) -> np.ndarray:
        """Interpolate between the `n`-th newest transform and its successor."""
        before_ns = self.stamp(n)
        fraction = (stamp_ns - before_ns) / (self.stamp(n - 1) - before_ns)
        return interpolate(self.pose(n), self.pose(n - 1), fraction)


class OdometryRing:
    """Poses in a preallocated ring; for one thread.

    Args:
        max_gap_s: longest time between two poses that is interpolated, or that is extrapolated.
        max_jump_m: distance that a pose may move beyond what the robot can drive in the time.
        max_speed_mps: top speed of the robot.
        max_turn_radps: top turn rate of the robot.
        apart_ns: see `StampedPoses`.

    Attributes:
        epoch: increases when the pose jumps, so poses before and after are unrelated. The ring is
            then cleared, as it is after a clock reset.
        came_ns: arrival of the newest pose, set by the synchronizer; -1 before the first.
        delay_ns: arrival minus stamp of the newest pose; None before the first.
    """

    def __init__(
        self,
        capacity: int,
        max_gap_s: float,
        max_jump_m: float,
        max_speed_mps: float = 0.0,
        max_turn_radps: float = 0.0,
        apart_ns: int = 0,
    ) -> None:
        self.epoch = 0
        self.came_ns = -1
        self.delay_ns: int | None = None
        self._max_gap_ns = int(max_gap_s * 1e9)
        self._max_jump_m = max_jump_m
        self._max_speed_mps = max_speed_mps
        self._max_turn_radps = max_turn_radps
        self._poses = StampedPoses(capacity, apart_ns)
        self._guard = StampGuard()
        self._latest: np.ndarray | None = None  # the pose that arrived last, with any stamp

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose; None if there is none."""
        return self._poses.stamp(0) if len(self) else None

    @property
    def newest_pose(self) -> SE2 | None:
        """The pose that arrived last.

        A pose with a rejected stamp still is the robot's place now. A robot that must hold at an
        older pose would drive back there.
        """
        return None if self._latest is None else se2_of(self._latest)

    def push(self, stamp_ns: int, T_map_base: np.ndarray, age_ns: int = 0) -> str:
        """Append a pose; `age_ns` is the age of the transforms that converted it into `map`.

        Returns:
            "", or a word for what was unusual. `repeated` and `backward` poses are rejected; after
            `clock_reset` the new clock is used; `pose_jump` begins a new epoch.
        """
        self._latest = T_map_base
        last_ns = self._guard.newest_ns
        verdict: str = self._guard.check(stamp_ns)
        if verdict in ("repeated", "backward"):
            return verdict
        # After a clock reset only the time since the reset is known.
        since_ns = self._guard.behind_since_ns if verdict == "clock_reset" else last_ns
        if len(self) and self._is_jump(T_map_base, (stamp_ns - since_ns) * 1e-9):
            self.epoch += 1
            verdict = "pose_jump"
        if verdict != "ok":
            self._poses.clear()
        self._poses.push(stamp_ns, T_map_base, age_ns)
        return "" if verdict == "ok" else verdict

    def _is_jump(self, T_map_base: np.ndarray, elapsed_s: float) -> bool:
        """Return True if the robot cannot move from the newest pose to this one in that time."""
        last = self._poses.pose(0)
        moved_m = math.dist(T_map_base[:3, 3], last[:3, 3])
        turned_rad = abs(wrap_angle(se2_of(T_map_base).yaw_rad - se2_of(last).yaw_rad))
        farthest_m = self._max_jump_m + _SPEED_MARGIN * self._max_speed_mps * elapsed_s
        widest_rad = _MAX_TURN_RAD + _SPEED_MARGIN * self._max_turn_radps * elapsed_s
        return moved_m > farthest_m or turned_rad > widest_rad

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray | None, Missing, int]:
        """Return the pose at an instant, interpolated between its two neighbours.

        Returns:
            (T_map_base, "", age of its transforms in ns) or (None, reason, 0). After `too_new` and
            `empty` a later call may succeed. `too_old` (the instant is before the ring) and `gap`
            (the neighbours are further apart than the largest gap) stay.
        """
        poses = self._poses
        if not len(poses):
            return None, "empty", 0
        n = poses.count_newer(stamp_ns)
        if n == len(poses):
            return None, "too_old", 0
        before_ns = poses.stamp(n)
        if before_ns == stamp_ns:
            return poses.pose(n).copy(), "", poses.age(n)
        if n == 0:
            return None, "too_new", 0
        if poses.stamp(n - 1) - before_ns > self._max_gap_ns:
            return None, "gap", 0
        return poses.interpolate_at(n, stamp_ns), "", max(poses.age(n), poses.age(n - 1))

    def extrapolate(self, stamp_ns: int) -> tuple[np.ndarray | None, int]:
        """Extrapolate the newest pose to an instant, with the speed of the poses before it.

        Returns:
            (T_map_base, age of its transforms); (None, 0) if the instant is before the newest pose,
            or later than it by more than the largest gap.
        """
        poses, newest_ns = self._poses, self.newest_ns
        if newest_ns is None or not 0 <= stamp_ns - newest_ns <= self._max_gap_ns:
            return None, 0
        # Measure the speed over at least as long a time as is extrapolated.
        over_ns = max(stamp_ns - newest_ns, _SPEED_WINDOW_NS)
        n = min(poses.count_newer(newest_ns - over_ns), len(poses) - 1)
        since_ns = poses.stamp(n)
        if newest_ns - since_ns < stamp_ns - newest_ns:  # too few poses to extrapolate this far
            return poses.pose(0).copy(), poses.age(0)
        fraction = (stamp_ns - since_ns) / (newest_ns - since_ns)  # above 1: beyond the newest
        return interpolate(poses.pose(n), poses.pose(0), fraction), poses.age(0)

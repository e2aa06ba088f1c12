"""Pure pursuit for a robot that can turn on the spot: from a path to speeds.

The functions have no state and need no map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge import config
from edge.geometry import SE2, wrap_angle

ROTATE_RAD = 0.8  # larger heading errors are corrected on the spot
TURN_GAIN = 2.5  # rad/s for each rad of heading error
CREEP_MPS = 0.05  # slowest approach: below it, friction and rounding stop the robot


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """Speeds for the robot.

    Attributes:
        v_mps: forward speed.
        w_radps: turn rate, positive counter-clockwise.
    """

    v_mps: float = 0.0
    w_radps: float = 0.0

    @property
    def moves(self) -> bool:
        """True if a speed is not 0."""
        return self.v_mps != 0.0 or self.w_radps != 0.0


STOP = VelocityCommand()
"""Command to stand still."""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Highest speeds and accelerations that may be commanded.

    Attributes:
        turn_radps: highest turn rate.
        accel_mps2: highest acceleration, also when braking.
        turn_accel_radps2: highest change of the turn rate in a second.
    """

    speed_mps: float
    turn_radps: float
    accel_mps2: float
    turn_accel_radps2: float

    @classmethod
    def of(cls, robot: config.RobotConfig) -> MotionLimits:
        """Take the limits from the robot's configuration."""
        return cls(
            robot.max_speed_mps,
            robot.max_turn_radps,
            robot.max_accel_mps2,
            robot.max_turn_accel_radps2,
        )

    def clip(self, v_mps: float, w_radps: float) -> VelocityCommand:
        """Scale both speeds by one factor to keep the limits, so that the arc stays the same."""
        scale = max(abs(v_mps) / self.speed_mps, abs(w_radps) / self.turn_radps, 1.0)
        return VelocityCommand(v_mps / scale, w_radps / scale)

    def ramp(self, wanted: VelocityCommand, last: VelocityCommand, dt_s: float) -> VelocityCommand:
        """Return the command nearest to `wanted` that the accelerations allow after `dt_s`."""
        dv, dw = self.accel_mps2 * dt_s, self.turn_accel_radps2 * dt_s
        return VelocityCommand(
            min(max(wanted.v_mps, last.v_mps - dv), last.v_mps + dv),
            min(max(wanted.w_radps, last.w_radps - dw), last.w_radps + dw),
        )


def nearest_index(path_m: np.ndarray, x_m: float, y_m: float, start: int = 0) -> int:
    """Return the index of the path point nearest to (x_m, y_m), from `start` on.

    `path_m` is (n, 2) float64 with n > start.
    """
    d = path_m[start:] - (x_m, y_m)
    return start + int(np.argmin((d * d).sum(axis=1)))


def index_ahead(path_m: np.ndarray, index: int, ahead_m: float) -> int:
    """Return the first index at least `ahead_m` along the path from `index`, or the last index."""
    legs = np.hypot(*np.diff(path_m[index:], axis=0).T)
    return index + min(int(np.searchsorted(np.cumsum(legs), ahead_m)) + 1, len(legs))


def length_m(path_m: Sequence[Sequence[float]] | np.ndarray) -> float:
    """Return the length of a path (n, 2), n > 0."""
    return float(np.hypot(*np.diff(path_m, axis=0).T).sum())


def pursue(
    pose: SE2, x_m: float, y_m: float, remaining_m: float, limits: MotionLimits
) -> VelocityCommand:
    """Return the speeds on the arc through a point; turn on the spot if it is far to the side.

    Args:
        pose: pose of the robot in `map`.
        x_m: x of the point on the path to aim at, in `map`.
        y_m: y of that point.
        remaining_m: length of the path to the goal; the robot slows down to stop there.
        limits: highest speeds and accelerations.

    Example:
        >>> limits = MotionLimits(0.5, 1.0, 0.5, 2.0)
        >>> pursue(SE2(0.0, 0.0, 0.0), 1.0, 0.0, 5.0, limits)
        VelocityCommand(v_mps=0.5, w_radps=0.0)
    """
    bearing = pose.bearing_to(x_m, y_m)
    distance = pose.distance_to(x_m, y_m)
    if distance < 1e-6:
        return STOP
    if abs(bearing) > ROTATE_RAD:
        return turn_by(bearing, limits)
    # Speed from which the robot stops at the goal with half of the allowed deceleration.
    braking = math.sqrt(limits.accel_mps2 * max(remaining_m, 0.0))
    v = min(limits.speed_mps, max(braking, CREEP_MPS)) * math.cos(bearing)
    return limits.clip(v, v * 2.0 * math.sin(bearing) / distance)


def turn_by(error_rad: float, limits: MotionLimits) -> VelocityCommand:
    """Return the command to turn on the spot by an angle, slower near its end."""
    w = max(TURN_GAIN * abs(error_rad), 0.1)
    return limits.clip(0.0, math.copysign(w, error_rad))


def turn_to(pose: SE2, yaw_rad: float, limits: MotionLimits) -> VelocityCommand:
    """Return the command to turn on the spot to a heading, the short way round."""
    return turn_by(wrap_angle(yaw_rad - pose.yaw_rad), limits)

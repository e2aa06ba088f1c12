"""From a path to one with times: as fast as the robot's limits let it be."""

from __future__ import annotations

import numpy as np

from edge.trajectory.pursuit import MotionLimits


def headings_rad(path_m: np.ndarray) -> np.ndarray:
    """(n,) float64: where each point of a path (n, 2) leads next; the last one as before it."""
    if len(path_m) < 2:
        return np.zeros(len(path_m))
    leg = np.arctan2(*np.diff(path_m, axis=0).T[::-1])
    return np.append(leg, leg[-1])


def speeds_mps(path_m: np.ndarray, limits: MotionLimits, start_mps: float = 0.0) -> np.ndarray:
    """The highest speed at each point that keeps to the limits and ends at rest.

    A corner is taken no faster than the turn between its legs allows; then a pass forward limits
    what is gained and a pass backward what has to be lost (v^2 = u^2 + 2 a s).

    Args:
        path_m: (n, 2) float64, no point twice in a row.
        start_mps: of the robot at the first point; higher than it can lose, the limit of
            acceleration is broken at the start and nowhere else.

    Returns:
        (n,) float64; 0 at the last point.
    """
    n = len(path_m)
    speeds = np.full(n, limits.speed_mps)
    if n == 0:
        return speeds
    legs = np.hypot(*np.diff(path_m, axis=0).T)
    turn = np.abs((np.diff(headings_rad(path_m)[: n - 1]) + np.pi) % (2 * np.pi) - np.pi)
    with np.errstate(divide="ignore"):
        corner = limits.turn_radps * 0.5 * (legs[:-1] + legs[1:]) / turn
    speeds[1:-1] = np.minimum(speeds[1:-1], corner)
    speeds[0], speeds[-1] = min(start_mps, limits.speed_mps), 0.0
    gain = 2.0 * limits.accel_mps2 * legs
    for k in range(n - 1):
        speeds[k + 1] = min(speeds[k + 1], np.sqrt(speeds[k] ** 2 + gain[k]))
    for k in range(n - 2, -1, -1):
        speeds[k] = min(speeds[k], np.sqrt(speeds[k + 1] ** 2 + gain[k]))
    return speeds


def times_s(path_m: np.ndarray, speeds: np.ndarray, accel_mps2: float) -> np.ndarray:
    """(n,) float64: when each point is passed, from 0; between points the acceleration is even.

    A leg from rest to rest is driven in two halves.
    """
    legs = np.hypot(*np.diff(path_m, axis=0).T)
    mean = 0.5 * (speeds[:-1] + speeds[1:])
    took = np.where(mean > 0.0, legs / np.maximum(mean, 1e-9), 2.0 * np.sqrt(legs / accel_mps2))
    return np.concatenate([np.zeros(min(len(path_m), 1)), np.cumsum(took)])

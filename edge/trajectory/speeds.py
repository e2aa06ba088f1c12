"""Speeds and times along a path, as fast as the robot's limits allow."""

from __future__ import annotations

import numpy as np

from edge.trajectory.pursuit import MotionLimits


def headings_rad(path_m: np.ndarray) -> np.ndarray:
    """Return the direction from each point of a path (n, 2) to the next, (n,) float64.

    The last point has the direction of the one before.
    """
    if len(path_m) < 2:
        return np.zeros(len(path_m))
    leg = np.arctan2(*np.diff(path_m, axis=0).T[::-1])  # arctan2(dy, dx)
    return np.append(leg, leg[-1])


def speeds_mps(path_m: np.ndarray, limits: MotionLimits) -> np.ndarray:
    """Return the highest speed at each point that keeps the limits, from rest to rest.

    The turn between two legs limits the speed at their corner. Then a forward pass limits the
    acceleration and a backward pass the braking (v^2 = u^2 + 2 a s).

    Args:
        path_m: (n, 2) float64, without repeated points.
        limits: highest speeds and accelerations.

    Returns:
        (n,) float64; 0 at the first and the last point.
    """
    n = len(path_m)
    speeds = np.full(n, limits.speed_mps)
    if n == 0:
        return speeds
    legs = np.hypot(*np.diff(path_m, axis=0).T)
    turn = np.abs((np.diff(headings_rad(path_m)[: n - 1]) + np.pi) % (2 * np.pi) - np.pi)
    # The robot turns at a corner on the way from the middle of one leg to the middle of the next.
    with np.errstate(divide="ignore"):
        corner = limits.turn_radps * 0.5 * (legs[:-1] + legs[1:]) / turn
    speeds[1:-1] = np.minimum(speeds[1:-1], corner)
    speeds[0] = speeds[-1] = 0.0
    gain = 2.0 * limits.accel_mps2 * legs
    for k in range(n - 1):
        speeds[k + 1] = min(speeds[k + 1], np.sqrt(speeds[k] ** 2 + gain[k]))
    for k in range(n - 2, -1, -1):
        speeds[k] = min(speeds[k], np.sqrt(speeds[k + 1] ** 2 + gain[k]))
    return speeds


def times_s(path_m: np.ndarray, speeds: np.ndarray, accel_mps2: float) -> np.ndarray:
    """Return the time at each point from 0, (n,) float64; acceleration is constant between points.

    A leg from rest to rest speeds up in its first half and brakes in the second.
    """
    legs = np.hypot(*np.diff(path_m, axis=0).T)
    mean = 0.5 * (speeds[:-1] + speeds[1:])
    took = np.where(mean > 0.0, legs / np.maximum(mean, 1e-9), 2.0 * np.sqrt(legs / accel_mps2))
    return np.concatenate([np.zeros(min(len(path_m), 1)), np.cumsum(took)])

"""The floor under the robot, and the ground that is followed outward from it.

The kernels work on the lowest points of the polar bins of `edge.mapping.points`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edge import config
from edge.geometry import FARTHEST_M
from edge.jit import jit

if TYPE_CHECKING:
    from edge.mapping.points import PolarGrid, PolarScan

GROUND_SLOPE = 0.3
"""Largest slope of ground that the robot can drive on; see `sweep_ground`."""
# Weight of a new measurement of the floor's height.
_FLOOR_GAIN = 0.2

# Ground that varies by less is still the same ground (depth noise, carpets).
_GROUND_NOISE_M = 0.02
# Rings within this range give the height of the floor under the robot.
_NEAR_GROUND_M = 1.5
# Only ground seen over this length of a ray counts for that height. The foot of a bed is one
# ring; if the floor before it is in the blind zone, it would raise the floor as the robot nears.
_GROUND_RUN_M = 0.3
_RUN_GAP = 2  # largest number of rings without ground in such a length
# Largest height of the base frame over the floor (a legged robot has it in its body).
_HIGHEST_BASE_M = 0.9
# Ground of a smaller area is not the floor: a wall fills one ring, and objects are narrower.
_LEAST_FLOOR_M2 = 0.3
# The same, as a share of the largest area at one height.
_LEAST_FLOOR_SHARE = 0.3
# The search for the floor counts area in levels of this height; the floor has this many levels.
_LEVEL_M = 0.05
_LEVELS_OF_FLOOR = 4
# A ray that falls less than this slope hits a wall: a level scan sees no floor.
_LEAST_FALL = 0.08
# Range of the search for the floor: the largest of this many heights of the sensor (there rays are
# steep enough), this many metres, and this many times the sensor's smallest range.
_SEARCH_HEIGHTS = 4.0
_SEARCH_M = 3.0
_SEARCH_BLIND = 2.0
# Largest slope of the floor, from a tilted map or a climbing road.
_STEEPEST_FLOOR = 0.15
# The first fit of the floor's plane also takes ground that rises or falls by this slope.
_FLOOR_SPREAD = 0.06
_FITS = 3  # number of fits, each to the ground near the plane of the last fit


class FloorTracker:
    """The height of the floor below the robot's base, followed from scan to scan.

    The floor keeps its height below the base, also in a lift. The search for it goes on until it is
    found. It starts again if the base suddenly moves up or down, because the robot may have
    crouched.

    Attributes:
        over_base_m: height of the floor over the base, usually negative; NaN until it was seen.
        is_seen: True if the newest scan saw the floor.
        is_missing: True if there is only ground far below the base; then no cell is freed.
    """

    def __init__(self, config: config.MappingConfig) -> None:
        self.over_base_m = math.nan
        self.is_seen = self.is_missing = False
        self._config = config
        self._base_z_m = math.nan  # height of the base when the floor was last seen
        self._plane, self._levels = np.zeros(3), np.zeros((2, 64))  # see `find_floor`

    def update(self, scan: PolarScan, polar: PolarGrid, sensor_z: float, base_z: float) -> None:
        """Follow the ground of a binned scan outward from the floor under the robot."""
        c, plane = self._config, self._plane
        step_m = c.obstacle_min_m
        # Range in which to search for the floor under the robot.
        near_m = max(
            _SEARCH_M, _SEARCH_HEIGHTS * (sensor_z - base_z), _SEARCH_BLIND * c.min_range_m
        )
        floor_z, below_m2 = base_z + self.over_base_m, 0.0  # area [m²] of ground below the base
        if not abs(base_z - self._base_z_m) <= 0.5 * step_m:
            search = scan.lowest_m, polar, sensor_z, base_z, step_m
            found_z, below_m2 = find_floor(*search, near_m, self._levels)
            if math.isnan(found_z):
                found_z, below_m2 = find_floor(*search, c.range_m, self._levels)
            if not abs(found_z - floor_z) <= step_m:
                # Without a visible floor, assume it is at least two steps below the sensor.
                heights_z = found_z, floor_z, min(base_z, sensor_z - 2.0 * step_m)
                floor_z = next(z for z in heights_z if math.isfinite(z))
        plane[0], plane[1], plane[2] = floor_z, 0.0, 0.0  # height, slope along x and y
        sweep = (
            scan, polar, plane, sensor_z, GROUND_SLOPE, step_m, c.range_m, 1.0 / c.resolution_m,
        )  # fmt: skip
        total, count = sweep_ground(*sweep)
        if not count:  # no height near the robot: fit a plane to the ground farther away
            fit = scan.lowest_m, polar, sensor_z, step_m
            if any(fit_floor(*fit, m, plane) for m in (near_m, 2.0 * near_m)):
                total, count = float(plane[0]), 1
                sweep_ground(*sweep)
        self.is_seen = count > 0
        if self.is_seen:
            known = abs(floor_z - base_z - self.over_base_m) <= step_m
            floor_z += (_FLOOR_GAIN if known else 1.0) * (total / count - floor_z)
            self.over_base_m, self._base_z_m = floor_z - base_z, base_z
        self.is_missing = not count and below_m2 > _LEAST_FLOOR_M2

    def state(self) -> np.ndarray:
        """Return one row (height of the floor over the base, of the base in `map`), or none."""
        row = self.over_base_m, self._base_z_m
        return np.array(row if all(abs(z_m) < FARTHEST_M for z_m in row) else ()).reshape(-1, 2)

    def load_state(self, rows: np.ndarray) -> None:
        """Restore a `state`."""
        for row in rows.tolist():
            self.over_base_m, self._base_z_m = row


@jit
def find_floor(lowest_m, polar, sensor_z, base_z, step_m, search_m, levels):
    """Find the height of the floor: the lowest height with enough ground near the robot.

    Higher ground may be a table. Ground much lower than the base is not under the robot. `levels`
    is (2, 64) float64 scratch: area of ground at each height, and area times height.

    Returns:
        (height or NaN, area [m2] that is lower than the base by more than a step).
    """
    area, moment = levels[0], levels[1]
    levels[:] = 0.0
    lowest_z = base_z - _HIGHEST_BASE_M
    used = min(int((_HIGHEST_BASE_M + step_m) / _LEVEL_M), len(area))
    below_m2 = 0.0
    wide = 2.0 * math.pi / polar.sectors * polar.ring_m
    for s in range(polar.sectors):
        for r in range(min(polar.rings, int(search_m / polar.ring_m))):
            z, d = lowest_m[s, r], (r + 0.5) * polar.ring_m
            if not z < sensor_z - max(_LEAST_FALL * d, step_m):
                continue
            m2 = d * wide
            if z < base_z - step_m:
                below_m2 += m2
            k = math.floor((z - lowest_z) / _LEVEL_M)
            if 0 <= k < used:
                area[k] += m2
                moment[k] += m2 * z
    # Largest area in `_LEVELS_OF_FLOOR` levels in a row; then the lowest such levels with enough.
    most = 0.0
    for k in range(used - _LEVELS_OF_FLOOR + 1):
        most = max(most, area[k : k + _LEVELS_OF_FLOOR].sum())
    for k in range(used - _LEVELS_OF_FLOOR + 1):
        m2 = area[k : k + _LEVELS_OF_FLOOR].sum()
        if m2 >= max(_LEAST_FLOOR_M2, _LEAST_FLOOR_SHARE * most):
            return moment[k : k + _LEVELS_OF_FLOOR].sum() / m2, below_m2
    return np.nan, below_m2


@jit
def fit_floor(lowest_m, polar, sensor_z, step_m, search_m, floor):
    """Fit a plane to the ground near the robot, to bridge a blind zone or a gap.

    An object in a few sectors deviates from the plane of the others and is left out. `floor` is
    (3,) float64, input and output: height at the sensor's cell, and slope along x and y, which is 0
    on entry.

    Returns:
        True if there was enough ground. Else the floor stays level at its height.
    """
    start_z = floor[0]
    a, b, c, total = start_z, 0.0, 0.0, 0.0
    wide = 2.0 * math.pi / polar.sectors * polar.ring_m
    for k in range(_FITS):
        near_m, spread = (step_m, _FLOOR_SPREAD) if k == 0 else (0.5 * step_m, 0.0)
        total = sx = sy = sz = sxx = sxy = syy = sxz = syz = 0.0
        for s in range(polar.sectors):
            for r in range(min(polar.rings, int(search_m / polar.ring_m))):
                z, d = lowest_m[s, r], (r + 0.5) * polar.ring_m
                if not z < sensor_z - max(_LEAST_FALL * d, step_m):
                    continue
                x, y = d * polar.direction[s, 0], d * polar.direction[s, 1]
                if abs(z - a - b * x - c * y) > near_m + spread * d:
                    continue
                m2, z = d * wide, z - start_z
                total += m2
                sx, sy, sz = sx + m2 * x, sy + m2 * y, sz + m2 * z
                sxx, sxy, syy = sxx + m2 * x * x, sxy + m2 * x * y, syy + m2 * y * y
                sxz, syz = sxz + m2 * x * z, syz + m2 * y * z
        if total < _LEAST_FLOOR_M2:
            break
        x, y, z = sx / total, sy / total, sz / total
        # Ground in only one direction hardly fixes the slope across it: pull that weakly to level.
        sxx, syy = sxx / total - x * x + 0.02, syy / total - y * y + 0.02
        sxy, sxz, syz = sxy / total - x * y, sxz / total - x * z, syz / total - y * z
        det = sxx * syy - sxy * sxy
        b, c = (sxz * syy - syz * sxy) / det, (syz * sxx - sxz * sxy) / det
        a = start_z + z - b * x - c * y
    floor[0], floor[1], floor[2] = a, b, c
    if total < _LEAST_FLOOR_M2 or math.hypot(b, c) > _STEEPEST_FLOOR:
        floor[0], floor[1], floor[2] = start_z, 0.0, 0.0
        return False
    return True


@jit
def sweep_ground(scan, polar, floor, sensor_z, slope, step_m, range_m, inv_res):
    """Follow the ground outward in every sector.

    Writes into `scan`: the ground's height in each bin (`ground_m`), the lowest slope of a ray over
    each bin (`pass_slope`), the range to which rays free cells (`reach_m`), and the rectangle
    around all cells seen (`box`).

    It starts at the floor (see `fit_floor`). The ground may rise or fall by `slope` from the last
    ground seen. Over a gap, the limit is `step_m` where ground is first seen, so that a low box
    just outside the blind zone is not a ramp, and twice that later. A return far below is a drop.
    Rays free nothing beyond the last ground before a drop, unless level ground follows (a stray
    reflection).

    Returns:
        (sum of the floor heights near the robot, number of these heights).
    """
    half = polar.bin_of.shape[0] // 2
    scan.box[0] = scan.box[1] = half
    scan.box[2] = scan.box[3] = half + 1
    near_sum, near_count = 0.0, 0
    for s in range(polar.sectors):
        last = _last_ring(scan.lowest_m, s)
        far = scan.far_slope[s] < np.inf
        scan.reach_m[s] = 0.0
        if last < 0 and not far:
            continue
        floor_slope = floor[1] * polar.direction[s, 0] + floor[2] * polar.direction[s, 1]
        reach_m, sum_m, count = _follow_ground(
            scan.lowest_m,
            scan.ground_m,
            s,
            last,
            polar.ring_m,
            floor[0],
            floor_slope,
            slope,
            step_m,
        )
        near_sum += sum_m
        near_count += count
        scan.reach_m[s] = range_m if far and reach_m >= last * polar.ring_m else reach_m
        _fill_pass_slopes(scan, s, last, polar.ring_m, sensor_z)
        end_m = range_m if far else (last + 1) * polar.ring_m
        _grow_box(scan.box, polar, s, end_m * inv_res, half)
    return near_sum, near_count


@jit(inline="always")
def _last_ring(lowest_m, s):
    """Return the farthest ring of a sector with a point, or -1."""
    for r in range(lowest_m.shape[1] - 1, -1, -1):
        if lowest_m[s, r] < np.inf:
            return r
    return -1


@jit(inline="always")
def _follow_ground(lowest_m, ground_m, s, last, ring_m, floor_z, floor_slope, slope, step_m):
    """Fill one sector's ground; return its reach, and sum and number of near floor heights.

    The parameters are as in `sweep_ground`. `last` is the sector's farthest ring with a point.
    """
    # Newest ground seen: its height and distance (0: none yet), and True after a drop.
    ground, ground_d, drop = floor_z, 0.0, False
    near_sum, near_count = 0.0, 0
    # The present run of rings with ground. Its heights count when it is `_GROUND_RUN_M` long.
    run_from, run_to, run_sum, run_count = 0, -1 - _RUN_GAP, 0.0, 0
    for r in range(last + 1):
        d = (r + 0.5) * ring_m
        expected, z = ground, lowest_m[s, r]
        if ground_d == 0.0:
            expected += floor_slope * d
        if z < np.inf:
            limit = step_m if ground_d == 0.0 else 2.0 * step_m
            allowed = min(slope * (d - ground_d) + _GROUND_NOISE_M, limit)
            if abs(z - expected) <= allowed:
                ground, ground_d, drop, expected = z, d, False, z
                if d < _NEAR_GROUND_M:
                    if r - run_to > _RUN_GAP:
                        run_from, run_sum, run_count = r, 0.0, 0
                    run_to, run_sum, run_count = r, run_sum + z - floor_slope * d, run_count + 1
                    if (r - run_from) * ring_m >= _GROUND_RUN_M:
                        near_sum, near_count = near_sum + run_sum, near_count + run_count
                        run_sum, run_count = 0.0, 0
            elif z < expected:
                drop = True
        ground_m[s, r] = expected
    for r in range(last + 1, lowest_m.shape[1]):
        ground_m[s, r] = ground if ground_d > 0.0 else ground + floor_slope * (r + 0.5) * ring_m
    reach_m = max(last, 0) * ring_m
    return (min(reach_m, ground_d) if drop else reach_m), near_sum, near_count


@jit(inline="always")
def _fill_pass_slopes(scan, s, last, ring_m, sensor_z):
    """Fill one sector's pass slopes, from rays that end two rings farther or more."""
    lowest = scan.far_slope[s]
    for r in range(scan.lowest_m.shape[1] - 1, -1, -1):
        beyond = r + 2
        if beyond <= last and scan.lowest_m[s, beyond] < np.inf:
            run = (beyond + 0.5) * ring_m
            lowest = min(lowest, (scan.lowest_m[s, beyond] - sensor_z) / run)
        scan.pass_slope[s, r] = lowest


@jit(inline="always")
def _grow_box(box, polar, s, end_cells, half):
    """Extend the box to contain one sector up to its end."""
    side = polar.bin_of.shape[0]
    margin = int(end_cells * math.pi / polar.sectors) + 2
    x = half + int(end_cells * polar.direction[s, 0])
    y = half + int(end_cells * polar.direction[s, 1])
    box[0] = max(min(box[0], x - margin), 0)
    box[1] = max(min(box[1], y - margin), 0)
    box[2] = min(max(box[2], x + margin + 1), side)
    box[3] = min(max(box[3], y + margin + 1), side)

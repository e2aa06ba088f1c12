"""Kernels that classify sensor points as floor, obstacle or overhang.

Depth images and clouds take the same path. Points in map axes are binned by sector and ring around
the sensor's cell. A sweep outward along each sector follows the local ground (`ground.py`). So
heights are also correct on ramps, and the floor of a tilted 3-D LiDAR is not a wall.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edge.geometry import FARTHEST_M
from edge.jit import jit

# Values of `PolarScan.seen` for a cell: floor, a step (too low for an obstacle, but not floor), or
# 3 + height over the ground in units of coded_m / HEIGHT_CODES, as in `top`.
FLOOR, STEP = 1, 2
LOWEST_OBSTACLE, HEIGHT_CODES = 3, 250
# A step is at least this share of obstacle_min_m high, such as a sill that stops the robot.
_STEP_FROM = 0.5
TALL = LOWEST_OBSTACLE + int(0.85 * HEIGHT_CODES)
"""Value of `Layers.top` from which an obstacle is a wall, which the robot cannot see over."""
CODED_M = 1.0
"""Heights are coded up to this height, or up to `obstacle_max_m` if that is higher. So a low robot
can also distinguish walls and furniture."""
# An obstacle that ends at most this far below `obstacle_max_m` may continue in the points above it.
_CONTINUES_M = 0.1
# Slopes of rays without a return are kept as bits: `_LOST_BITS` bits from slope `_LOST_FROM`
# upwards, `_LOST_PER_SLOPE` bits for each 1.0 of slope. Lower rays meet the floor near the sensor,
# where many cameras return nothing.
_LOST_FROM, _LOST_PER_SLOPE, _LOST_BITS = -0.75, 64, 64
# Rays that meet the floor within this distance are ignored.
_LOST_NEAR_M = 1.0
# Fewer rays without a return are only holes in the image.
_LOST_LEAST = 3
# Values beyond this range are no returns.
_FARTHEST_M = np.float32(FARTHEST_M)
_MIN_SECTOR_RAD = 0.0175  # smallest width of a sector: a degree
_MAX_SPREAD = 16  # largest value of `PolarGrid.spread`


class PolarGrid(NamedTuple):
    """The polar bins of a square of (2 half + 1)^2 cells around the sensor's cell.

    Attributes:
        bin_of: (side, side) int32, sector * rings + ring of a cell's centre.
        sector_of: (side, side) int16, sector of a cell's centre.
        ring_of: (side, side) int16, ring of a cell's centre.
        distance_m: (side, side) float32, from the centre of the sensor's cell.
        spread: (side, side) uint8, number of sectors on each side of its own that an obstacle in
            the cell blocks.
        direction: (sectors, 2) float32, unit vector of a sector's centre line.
    """

    bin_of: np.ndarray
    sector_of: np.ndarray
    ring_of: np.ndarray
    distance_m: np.ndarray
    spread: np.ndarray
    direction: np.ndarray
    sectors: int
    rings: int
    ring_m: float


class PolarScan(NamedTuple):
    """Scratch arrays of an update, reused by every update.

    Attributes:
        xyz: (3, capacity) float32, points: x and y relative to the sensor, z in `map`.
        cell: (capacity,) int32, flat cell of each point within range.
        z_m: (capacity,) float32, height of each such point in `map`.
        lowest_m: (sectors, rings) float32, lowest point of each bin; inf = none.
        far_slope: (sectors,) float32, lowest slope (rise / run) of a ray beyond range; inf = none.
        ground_m: (sectors, rings) float32, height of the local ground.
        pass_slope: (sectors, rings) float32, lowest slope of a ray that passed over the bin.
        reach_m: (sectors,) float32, range to which rays free unknown cells; 0 = nothing seen.
        seen: (side, side) uint8, per cell 0, FLOOR, STEP, or the code of the highest obstacle
            point.
        box: (4,) int64, half-open rectangle around the sensor's cell and all cells seen.
        flipped: (side * side,) int32, cells that became occupied or free, y in the high half.
    """

    xyz: np.ndarray
    cell: np.ndarray
    z_m: np.ndarray
    lowest_m: np.ndarray
    far_slope: np.ndarray
    ground_m: np.ndarray
    pass_slope: np.ndarray
    reach_m: np.ndarray
    seen: np.ndarray
    box: np.ndarray
    flipped: np.ndarray


def make_polar(range_m: float, resolution_m: float) -> PolarGrid:
    """Make sectors 1.5 cells wide at full range (but at least a degree), and rings of two cells."""
    half = math.ceil(range_m / resolution_m) + 1
    width_rad = max(1.5 * resolution_m / range_m, _MIN_SECTOR_RAD)
    sectors = max(8, math.ceil(2 * math.pi / width_rad))
    ring_m = max(2 * resolution_m, range_m / 128)
    rings = math.ceil(range_m / ring_m)
    offset_m = np.arange(-half, half + 1) * resolution_m
    # Not zero in the centre: slopes may be infinite, and 0 * inf is NaN.
    distance = np.maximum(np.hypot(offset_m[:, None], offset_m[None, :]), 0.25 * resolution_m)
    angle = np.arctan2(offset_m[:, None], offset_m[None, :]) + math.pi
    sector = np.minimum((angle * (sectors / (2 * math.pi))).astype(np.int64), sectors - 1)
    ring = np.minimum((distance / ring_m).astype(np.int64), rings - 1)
    middle = (np.arange(sectors) + 0.5) * (2 * math.pi / sectors) - math.pi
    subtended = 0.5 * resolution_m / np.maximum(distance, 0.5 * resolution_m)
    spread = np.minimum(subtended * sectors / (2 * math.pi) + 0.5, _MAX_SPREAD)
    return PolarGrid(
        (sector * rings + ring).astype(np.int32),
        sector.astype(np.int16),
        ring.astype(np.int16),
        distance.astype(np.float32),
        spread.astype(np.uint8),
        np.stack([np.cos(middle), np.sin(middle)], axis=1).astype(np.float32),
        sectors,
        rings,
        ring_m,
    )


def make_scan(polar: PolarGrid, capacity: int) -> PolarScan:
    """Make scratch arrays for `capacity` points."""
    bins = (polar.sectors, polar.rings)
    return PolarScan(
        xyz=np.zeros((3, capacity), np.float32),
        cell=np.zeros(capacity, np.int32),
        z_m=np.zeros(capacity, np.float32),
        lowest_m=np.full(bins, np.inf, np.float32),
        far_slope=np.full(polar.sectors, np.inf, np.float32),
        ground_m=np.zeros(bins, np.float32),
        pass_slope=np.zeros(bins, np.float32),
        reach_m=np.zeros(polar.sectors, np.float32),
        seen=np.zeros(polar.bin_of.shape, np.uint8),
        box=np.zeros(4, np.int64),
        flipped=np.zeros(polar.bin_of.size, np.int32),
    )


@jit
def from_depth(depth_m, stride_u, stride_v, column, row, T, min_range_m, xyz):
    """Compute the points of every stride-th pixel: x and y relative to the sensor, z in `map`.

    - `column`, `row`: (w,) and (h,) float32: (u - cx) / fx and (v - cy) / fy of each pixel.
    - `T`: (3, 4) float32, `map` from the optical frame.
    - `xyz`: (3, capacity) float32 output.

    Returns:
        The number of points; pixels without a return give none.
    """
    n = 0
    xx, yx, zx = T[0, 0], T[1, 0], T[2, 0]
    for v in range(stride_v // 2, depth_m.shape[0], stride_v):
        bx = T[0, 1] * row[v] + T[0, 2]
        by = T[1, 1] * row[v] + T[1, 2]
        bz = T[2, 1] * row[v] + T[2, 2]
        for u in range(stride_u // 2, depth_m.shape[1], stride_u):
            d = depth_m[v, u]
            if not (d > min_range_m and d < _FARTHEST_M):
                continue
            xyz[0, n] = d * (xx * column[u] + bx)
            xyz[1, n] = d * (yx * column[u] + by)
            xyz[2, n] = d * (zx * column[u] + bz) + T[2, 3]
            n += 1
    return n


@jit
def lost_rays(depth_m, stride_u, stride_v, column, row, T, min_range_m, polar, lost):
    """Mark the rays of the pixels that `from_depth` leaves out; see `is_open`.

    `lost` is (sectors,) uint64 output, one bit for each slope at which a ray gave no return. The
    other parameters are as in `from_depth`.
    """
    half = polar.bin_of.shape[0] // 2
    for v in range(stride_v // 2, depth_m.shape[0], stride_v):
        for u in range(stride_u // 2, depth_m.shape[1], stride_u):
            d = depth_m[v, u]
            if d > min_range_m and d < _FARTHEST_M:
                continue
            x = T[0, 0] * column[u] + T[0, 1] * row[v] + T[0, 2]
            y = T[1, 0] * column[u] + T[1, 1] * row[v] + T[1, 2]
            z = T[2, 0] * column[u] + T[2, 1] * row[v] + T[2, 2]
            run = np.sqrt(x * x + y * y)
            bit = int((z / run - _LOST_FROM) * _LOST_PER_SLOPE)
            if not (_LOST_FROM * run <= z and bit < _LOST_BITS):
                continue
            cells = np.float32(half - 1) / run
            sector = polar.sector_of[int(half + 0.5 + y * cells), int(half + 0.5 + x * cells)]
            lost[sector] |= np.uint64(1) << np.uint64(bit)


@jit
def is_open(lost, below_m, over_m, d, step_m, high_m):
    """Return True if nothing can stand in a cell that a ray passed over.

    A ray lower than a step proves that. A higher ray proves it only if no lower ray was sent,
    because lower rays without a return may have hit something black or transparent. Rays that meet
    the floor within `_LOST_NEAR_M` are ignored: many cameras see nothing so near.

    Args:
        lost: bits of the cell's sector, one for each slope, see `lost_rays`.
        below_m: height over the ground at which the lowest ray passed over the cell.
        over_m: height of the sensor over the ground there.
        d: distance of the cell in metres.
        step_m: height of a step.
        high_m: a ray higher than this, and higher than the sensor, proves nothing.
    """
    if below_m < step_m:
        return True
    if below_m > max(high_m, over_m):
        return False
    lowest = -over_m / max(d, np.float32(_LOST_NEAR_M))
    first = int((lowest - _LOST_FROM) * _LOST_PER_SLOPE) + 1
    end = int(((below_m - over_m) / d - _LOST_FROM) * _LOST_PER_SLOPE)
    first, end = max(first, 0), min(end, _LOST_BITS)
    if end <= first:
        return True
    # Bits `first` to `end` - 1: the slopes of rays that would meet the cell below `below_m`.
    bits = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(_LOST_BITS - (end - first))
    hidden = lost & (bits << np.uint64(first))
    # Open if fewer than `_LOST_LEAST` bits are set: clear the lowest one that many times less one.
    for _ in range(_LOST_LEAST - 1):
        hidden &= hidden - np.uint64(1)
    return hidden == np.uint64(0)


@jit
def from_cloud(cloud_m, T, min_range_m, xyz):
    """Compute the points of a cloud, like `from_depth`.

    Points that are not finite or too near give none. A row (x, y, inf) is a ray that hit nothing up
    to (x, y, 0). The ends of such rays follow the points.

    Returns:
        (number of points, number of points and ends).
    """
    n = ends = 0
    for i in range(cloud_m.shape[0]):
        a, b, c = cloud_m[i, 0], cloud_m[i, 1], cloud_m[i, 2]
        squared = a * a + b * b + c * c
        if not (squared > min_range_m * min_range_m and squared < _FARTHEST_M * _FARTHEST_M):
            ends += c == np.inf
            continue
        xyz[0, n] = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c
        xyz[1, n] = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c
        xyz[2, n] = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        n += 1
    hits = n
    for i in range(cloud_m.shape[0] if ends else 0):  # most clouds have no ends: skip this pass
        a, b = cloud_m[i, 0], cloud_m[i, 1]
        squared = a * a + b * b
        if (
            cloud_m[i, 2] == np.inf
            and squared > min_range_m * min_range_m
            and squared < _FARTHEST_M * _FARTHEST_M
        ):
            xyz[0, n] = T[0, 0] * a + T[0, 1] * b
            xyz[1, n] = T[1, 0] * a + T[1, 1] * b
            xyz[2, n] = T[2, 0] * a + T[2, 1] * b + T[2, 3]
            n += 1
    return hits, n


@jit
def drop_self_points(n, hits, xyz, axes, sensor_m, sensor_z, radius_m, height_m):
    """Remove the points of the robot itself from `xyz`; return (points left, hits left).

    The robot is a cylinder around the axis of its base. The cylinder has no top, because something
    above the robot is not an obstacle where the robot stands.

    - `n`, `hits`: number of all points, and of the hits, which come first.
    - `axes`: (3, 3) float32, directions x, y, z of the base in `map`, as columns.
    - `sensor_m`: (3,) float32, the sensor on the base.
    - `sensor_z`: height of the sensor in `map`.
    - `radius_m`, `height_m`: size of the robot; the height also covers its points when it is
      tilted.
    """
    x, y, z = sensor_m[0], sensor_m[1], sensor_m[2]
    tilted_m = np.hypot(axes[2, 0], axes[2, 1]) * (height_m + abs(z))
    far2 = (radius_m + np.hypot(x, y) + tilted_m) ** 2
    xs, ys, zs = xyz[0], xyz[1], xyz[2]
    near = 0
    for i in range(n):
        near += xs[i] * xs[i] + ys[i] * ys[i] < far2
    if near == 0:
        return n, hits
    left = left_hits = 0
    for i in range(n):
        up = zs[i] - sensor_z
        a = axes[0, 0] * xs[i] + axes[1, 0] * ys[i] + axes[2, 0] * up + x
        b = axes[0, 1] * xs[i] + axes[1, 1] * ys[i] + axes[2, 1] * up + y
        if xs[i] * xs[i] + ys[i] * ys[i] < far2 and a * a + b * b < radius_m * radius_m:
            continue
        xs[left], ys[left], zs[left] = xs[i], ys[i], zs[i]
        left += 1
        left_hits += i < hits
    return left, left_hits


@jit
def bin_points(n_points, hits, sensor_z, range_m, inv_res, fx, fy, polar, scan):
    """Bin scan.xyz: the lowest point of each bin, and the cell of each point within range.

    The ray of a point beyond range passes through the entire range: its slope goes to `far_slope`.
    Points from `hits` on are ends of rays that hit nothing. They have no cell, and count in the
    sectors on both sides, because beams of a planar LiDAR may be that far apart. (`fx`, `fy`) is
    the position of the sensor in the scratch grid, in cells from its lower-left corner.

    Returns:
        The number of points within range, in scan.cell and scan.z_m.
    """
    bins, sector_of, side = polar.bin_of.ravel(), polar.sector_of.ravel(), polar.bin_of.shape[1]
    lowest, far_slope = scan.lowest_m.ravel(), scan.far_slope
    xs, ys, zs = scan.xyz[0], scan.xyz[1], scan.xyz[2]
    cells, heights = scan.cell, scan.z_m
    lowest[:] = np.inf
    far_slope[:] = np.inf
    n = 0
    for i in range(hits):
        x, y, z = xs[i], ys[i], zs[i]
        d2 = x * x + y * y
        if d2 <= range_m * range_m:
            cell = int(y * inv_res + fy) * side + int(x * inv_res + fx)
            at = bins[cell]
            lowest[at] = min(lowest[at], z)
            cells[n] = cell
            heights[n] = z
            n += 1
            continue
        scale = range_m / np.sqrt(d2)
        cell = int(y * scale * inv_res + fy) * side + int(x * scale * inv_res + fx)
        sector = sector_of[cell]
        far_slope[sector] = min(far_slope[sector], (z - sensor_z) * scale / range_m)
    for i in range(hits, n_points):
        x, y, z = xs[i], ys[i], zs[i]
        scale = np.float32(min(range_m / np.sqrt(x * x + y * y), np.float32(1.0)))
        at = bins[int(y * scale * inv_res + fy) * side + int(x * scale * inv_res + fx)]
        for neighbour in (-1, 0, 1):
            sector = (at // polar.rings + neighbour) % polar.sectors
            if scale < 1.0:
                far_slope[sector] = min(far_slope[sector], (z - sensor_z) * scale / range_m)
            else:
                k = sector * polar.rings + at % polar.rings
                lowest[k] = min(lowest[k], z)
    return n


@jit
def classify(n, scan, polar, obstacle_min_m, obstacle_max_m, coded_m):
    """Split points by height over the local ground; obstacles end the rays of their sectors.

    Points below `obstacle_min_m` are floor. Points above `obstacle_max_m` are an overhang with free
    space below. Each cell of `scan.seen` stores the height of its highest obstacle point as one
    byte: a code from `LOWEST_OBSTACLE` (the ground's height) to 253 (`coded_m` above the ground).
    """
    per_m = np.float32(HEIGHT_CODES / coded_m)
    lowest, highest = np.float32(obstacle_min_m), np.float32(obstacle_max_m)
    step = np.float32(_STEP_FROM * obstacle_min_m)
    bins, seen, ground = polar.bin_of.ravel(), scan.seen.ravel(), scan.ground_m.ravel()
    cells, heights = scan.cell, scan.z_m
    for i in range(n):
        cell = cells[i]
        height = heights[i] - ground[bins[cell]]
        if height < lowest:
            if height >= step:
                seen[cell] = max(seen[cell], STEP)
            elif seen[cell] == 0 and height > -lowest:
                seen[cell] = FLOOR
        elif height <= highest:
            if seen[cell] < LOWEST_OBSTACLE:
                _block(scan.reach_m, polar, cell)
            code = LOWEST_OBSTACLE + int(height * per_m)
            if code > seen[cell]:
                seen[cell] = code


@jit
def extend_obstacles_up(n, scan, polar, obstacle_max_m, coded_m):
    """Extend obstacles that reach `obstacle_max_m` by the points above them, up to `coded_m`."""
    per_m = np.float32(HEIGHT_CODES / coded_m)
    highest, coded = np.float32(obstacle_max_m), np.float32(coded_m)
    from_code = LOWEST_OBSTACLE + max(int((highest - np.float32(_CONTINUES_M)) * per_m), 0)
    bins, seen, ground = polar.bin_of.ravel(), scan.seen.ravel(), scan.ground_m.ravel()
    for i in range(n):
        cell = scan.cell[i]
        height = scan.z_m[i] - ground[bins[cell]]
        if highest < height <= coded and seen[cell] >= from_code:
            seen[cell] = max(seen[cell], LOWEST_OBSTACLE + int(height * per_m))


@jit
def _block(reach_m, polar, cell):
    """End the rays of all sectors that an obstacle's cell subtends."""
    side = polar.bin_of.shape[1]
    y, x = cell // side, cell % side
    sector, wide = int(polar.sector_of[y, x]), int(polar.spread[y, x])
    for k in range(sector - wide, sector + wide + 1):
        j = k % polar.sectors
        reach_m[j] = min(reach_m[j], polar.distance_m[y, x])

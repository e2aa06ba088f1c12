"""Plain NumPy and Python twins of the mapping kernels, and small worlds to look at."""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from edge import config
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.mapping import layers as ly
from edge.mapping.grid import RollingMap

CAMERA = CameraModel.from_hfov(160, 120, math.radians(75))
T_BASE_CAMERA = to_optical(se3(0.1, 0.0, 0.6, pitch_rad=math.radians(5)))
SMALL = config.MappingConfig(extent_m=9.0, range_m=3.0, inflation_m=0.2)
ORIGIN = SE2(0.0, 0.0, 0.0)
Box = tuple[float, float, float, float, float, float]


def render(
    camera: CameraModel, T: np.ndarray, boxes: Sequence[Box], floor: bool = True
) -> np.ndarray:
    """Depth image (h, w) float32 of axis-aligned boxes (x0, y0, z0, x1, y1, z1) and the floor."""
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    to_optical = np.stack(
        [
            (u - camera.cx_px) / camera.fx_px,
            (v - camera.cy_px) / camera.fy_px,
            np.ones_like(u, np.float64),
        ],
        axis=-1,
    )
    rays, origin = to_optical @ T[:3, :3].T, T[:3, 3]
    depth = np.full(u.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        if floor:
            t = -origin[2] / rays[..., 2]
            depth = np.where(t > 0, t, depth)
        for box in boxes:
            a = (np.array(box[:3]) - origin) / rays
            b = (np.array(box[3:]) - origin) / rays
            enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
            depth = np.where((enter <= leave) & (enter > 0), np.minimum(depth, enter), depth)
    return depth.astype(np.float32)


def look(grid: RollingMap, pose: SE2, boxes: Sequence[Box], camera: CameraModel = CAMERA):
    """Update the map with the view of a camera on a robot at `pose`."""
    T_map_base = pose.matrix()
    depth = render(camera, T_map_base @ T_BASE_CAMERA, boxes)
    return grid.update_depth(depth, camera, T_map_base, T_BASE_CAMERA)


def seen_around(
    boxes: Sequence[Box] = (), pose: SE2 = ORIGIN, settings: config.MappingConfig = SMALL
) -> RollingMap:
    """Return the cells that a robot observes in one spin."""
    grid = RollingMap(settings)
    for yaw in np.arange(0.0, 2 * math.pi, 0.4):
        look(grid, SE2(pose.x_m, pose.y_m, yaw), boxes)
    return grid


def complete(grid: RollingMap, pose: SE2) -> None:
    """Step until a field that begins with the first step is in use."""
    wanted = grid.travel_cost.generation + 2
    for _ in range(10000):
        grid.travel_cost.step(pose)
        if grid.travel_cost.generation >= wanted:
            return
    raise AssertionError("no field was completed")


def room(half_m: float, height_m: float = 2.5) -> list[Box]:
    """Four walls around the origin."""
    h, t = half_m, 0.1
    return [
        (h, -h, 0, h + t, h, height_m),
        (-h - t, -h, 0, -h, h, height_m),
        (-h, h, 0, h, h + t, height_m),
        (-h, -h - t, 0, h, -h, height_m),
    ]


def window(grid: RollingMap, layer: str) -> np.ndarray:
    """Return a layer in window coordinates: [0, 0] is the lower-left cell."""
    shift_x, shift_y = grid.window.shift
    array = getattr(grid.layers, layer)
    if array.dtype == np.uint64:
        array = np.unpackbits(array.view(np.uint8), axis=1, bitorder="little")
    return np.roll(array, (-shift_y, -shift_x), axis=(0, 1))


def states(grid: RollingMap) -> np.ndarray:
    """Return the published state of the entire window (-1, 0 or 100), inflated from scratch."""
    raw = window(grid, "raw")
    blocked = np.zeros(raw.shape, bool)
    disc = grid._cells.disc
    radius, n = len(disc) // 2, len(raw)
    for y, x in np.argwhere(raw >= 2):
        for k, half in enumerate(disc):
            row = y + k - radius
            if 0 <= row < n:
                blocked[row, max(x - half, 0) : x + half + 1] = True
    return np.where(blocked, 100, np.where(raw > 0, 0, -1)).astype(np.int8)


def frontier_cells(state: np.ndarray) -> np.ndarray:
    """Free cells with an unknown one among their four neighbours, (n, n) bool."""
    unknown = np.pad(state == -1, 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    return (state == 0) & beside


def unknown_ratio(state: np.ndarray, x: int, y: int, radius: float) -> float:
    """VL-Nav eq. 6 around one window cell, by breadth-first search."""
    n = len(state)
    if not (0 <= x < n and 0 <= y < n) or state[y, x] == 100:
        return 0.0
    reached, queue = {(x, y)}, deque([(x, y)])
    while queue:
        a, b = queue.popleft()
        for c, d in ((a + 1, b), (a - 1, b), (a, b + 1), (a, b - 1)):
            if not (0 <= c < n and 0 <= d < n) or (c, d) in reached or state[d, c] == 100:
                continue
            if math.hypot(c - x, d - y) > radius + 1e-6:
                continue
            reached.add((c, d))
            queue.append((c, d))
    return sum(state[b, a] == -1 for a, b in reached) / len(reached)


def geodesic(state: np.ndarray, x: int, y: int, straight: int, diagonal: int) -> np.ndarray:
    """Return Dijkstra's distances over free cells, -1 if unreachable.

    8-connected, without cutting the corners of occupied cells.
    """
    passable, occupied = state == 0, state == 100
    n = len(passable)
    distance = np.full(passable.shape, -1)
    best = {(x, y): 0}
    queue = [(0, x, y)]
    while queue:
        cost, a, b = heapq.heappop(queue)
        if distance[b, a] >= 0:
            continue
        distance[b, a] = cost
        for c in range(max(a - 1, 0), min(a + 2, n)):
            for d in range(max(b - 1, 0), min(b + 2, n)):
                if occupied[b, c] or occupied[d, a]:
                    continue
                further = cost + (diagonal if c != a and d != b else straight)
                if passable[d, c] and further < best.get((c, d), 1 << 60):
                    best[c, d] = further
                    heapq.heappush(queue, (further, c, d))
    return distance


def scan_twin(xyz, hits, sensor_z, range_m, inv_res, fx, fy, polar):
    """Twin of `bin_points`: (lowest_m, far_slope, cell, z_m)."""
    x, y, z = xyz
    d2 = x * x + y * y
    near = d2 <= range_m * range_m
    scale = np.where(near, np.float32(1), range_m / np.sqrt(np.maximum(d2, np.float32(1e-12))))
    cx = (x * scale * inv_res + fx).astype(np.int64)
    cy = (y * scale * inv_res + fy).astype(np.int64)
    lowest = np.full((polar.sectors, polar.rings), np.inf, np.float32)
    far_slope = np.full(polar.sectors, np.inf, np.float32)
    slope = (z - sensor_z) * scale / range_m
    hit = np.arange(len(x)) < hits
    for aside in (-1, 0, 1):
        sector, ring = (polar.sector_of[cy, cx] + aside) % polar.sectors, polar.ring_of[cy, cx]
        told = ~hit if aside else np.ones_like(hit)
        np.minimum.at(lowest, (sector[told & near], ring[told & near]), z[told & near])
        np.minimum.at(far_slope, sector[told & ~near], slope[told & ~near])
    near &= hit
    return lowest, far_slope, (cy * polar.bin_of.shape[1] + cx)[near], z[near]


def near_ground(lowest, polar, sensor_z, step_m, search_m):
    """Return ground candidates, (x, y, z) and area of each bin, for the twins below."""
    s, r = np.nonzero(lowest[:, : int(search_m / polar.ring_m)] < np.inf)
    d, z = (r + 0.5) * polar.ring_m, lowest[s, r].astype(np.float64)
    keep = z < sensor_z - np.maximum(0.08 * d, step_m)
    d, z, (x, y) = d[keep], z[keep], polar.direction[s[keep]].T.astype(np.float64)
    return d * x, d * y, z, d * polar.ring_m * 2 * math.pi / polar.sectors


def find_twin(lowest, polar, sensor_z, base_z, step_m, search_m):
    """Twin of `find_floor`."""
    _, _, z, m2 = near_ground(lowest, polar, sensor_z, step_m, search_m)
    level = np.floor((z - (base_z - 0.9)) / 0.05).astype(int)
    sums = []
    for k in range(int((0.9 + step_m) / 0.05) - 3):
        inside = (k <= level) & (level < k + 4)
        sums.append((m2[inside].sum(), (m2 * z)[inside].sum()))
    least = max(0.3, 0.3 * max(area for area, _ in sums))
    found = next((total / area for area, total in sums if area >= least), math.nan)
    return found, m2[z < base_z - step_m].sum()


def fit_twin(lowest, polar, sensor_z, start_z, step_m, search_m):
    """Twin of `fit_floor`: the plane, or None."""
    x, y, z, m2 = near_ground(lowest, polar, sensor_z, step_m, search_m)
    a, b, c = start_z, 0.0, 0.0
    for k in range(3):
        tolerance = step_m + 0.06 * np.hypot(x, y) if k == 0 else 0.5 * step_m
        fits = np.abs(z - a - b * x - c * y) <= tolerance
        w = m2[fits]
        if w.sum() < 0.3:
            return None
        xy = np.stack([x, y], axis=1)[fits]
        middle, height = np.average(xy, axis=0, weights=w), np.average(z[fits], weights=w)
        spread = (xy - middle) * w[:, None] / w.sum()
        matrix = spread.T @ (xy - middle) + 0.02 * np.eye(2)
        b, c = np.linalg.solve(matrix, spread.T @ (z[fits] - height))
        a = height - middle @ (b, c)
    return None if math.hypot(b, c) > 0.15 else np.array([a, b, c])


def sweep_twin(lowest, far_slope, polar, sensor_z, floor, slope, step_m, range_m):
    """Compute the twin of `sweep_ground` for sectors with data.

    Returns (ground_m, pass_slope, reach_m, heights of the near floor).
    """
    (sectors, rings), ring_m = lowest.shape, polar.ring_m
    ground = np.full(lowest.shape, np.nan)
    passing = np.full(lowest.shape, np.inf)
    reach = np.zeros(sectors)
    near = []
    for s in range(sectors):
        run: list[tuple[int, float]] = []
        hit = np.flatnonzero(np.isfinite(lowest[s]))
        far = np.isfinite(far_slope[s])
        if len(hit) == 0 and not far:
            continue
        lean = floor[1:] @ polar.direction[s]
        level, at, drop = floor[0], 0.0, False
        for r in range(rings):
            if at == 0.0:
                level = floor[0] + lean * (r + 0.5) * ring_m
            if r in hit:
                d, z = (r + 0.5) * ring_m, lowest[s, r]
                limit = step_m if at == 0.0 else 2 * step_m
                if abs(z - level) <= min(slope * (d - at) + 0.02, limit):
                    level, at, drop = z, d, False
                    if d < 1.5:
                        if run and r - run[-1][0] > 2:
                            near += _long(run, ring_m)
                            run = []
                        run.append((r, z - lean * d))
                elif z < level:
                    drop = True
            ground[s, r] = level
        near += _long(run, ring_m)
        last = hit[-1] if len(hit) else 0
        end = range_m if far else last * ring_m
        reach[s] = min(at, last * ring_m) if drop else end
        for r in range(rings):
            slopes = [(lowest[s, k] - sensor_z) / ((k + 0.5) * ring_m) for k in hit if k >= r + 2]
            passing[s, r] = min([*slopes, far_slope[s]])
    return ground, passing, reach, near


def _long(run: list[tuple[int, float]], ring_m: float) -> list[float]:
    """Return the heights of a ground run that is long enough to be floor."""
    return [z for _, z in run] if run and (run[-1][0] - run[0][0]) * ring_m >= 0.3 else []


def classify_twin(cell, z_m, ground, polar, low_m, high_m, coded_m):
    """Twin of `classify` and `go_on`: (side, side) uint8 codes."""
    height = z_m - ground.ravel()[polar.bin_of.ravel()[cell]]
    codes = np.zeros(polar.bin_of.size, np.uint8)
    floor = (height < np.float32(low_m)) & (height > -np.float32(low_m))
    codes[cell[floor]] = 1
    codes[cell[floor & (height >= np.float32(0.5 * low_m))]] = 2
    obstacle = (height >= np.float32(low_m)) & (height <= np.float32(high_m))
    over = (height > np.float32(high_m)) & (height <= np.float32(coded_m))
    code = 3 + (height * np.float32(250 / coded_m)).astype(np.int64)
    goes_on = 3 + int((np.float32(high_m) - np.float32(0.1)) * np.float32(250 / coded_m))
    over &= np.isin(cell, cell[obstacle & (code >= goes_on)])
    for some in (obstacle, over):
        np.maximum.at(codes, cell[some], code[some].astype(np.uint8))
    return codes.reshape(polar.bin_of.shape)


def basins(cells, apart, order, door_half_m, narrower, least_cells):
    """Regions numbered in reading order; see `edge.mapping.regions.segment_rooms`."""
    of: dict[tuple[int, int], int] = {}
    peak: dict[int, float] = {}
    for y, x in zip(*np.unravel_index(order, cells.shape), strict=True):
        if cells[y, x] != 1:
            continue
        here = apart[y, x]
        around = [(y + dy, x + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        around = [cell for cell in around if cell in of]
        if not around:
            of[(y, x)] = len(peak) + 1
            peak[of[(y, x)]] = here
            continue
        home = max(around, key=lambda cell: apart[cell])
        for cell in around:
            pair = of[home], of[cell]
            if pair[0] == pair[1]:
                continue
            size = [sum(b == basin for b in of.values()) for basin in pair]
            lower, higher = sorted(pair, key=lambda basin: peak[basin])
            passage = here <= door_half_m and here < np.float64(narrower) * peak[lower]
            if not passage or min(size) < least_cells:
                of = {c: higher if b == lower else b for c, b in of.items()}
        of[(y, x)] = of[home]
    number: dict[int, int] = {}
    label = np.zeros(cells.shape, np.int64)
    for y, x in sorted(of):
        label[y, x] = number.setdefault(of[(y, x)], len(number) + 1)
    return label


def writable(grid: RollingMap) -> ly.Layers:
    """Return the map's writable layers, for a test that makes a map by hand."""
    return grid._cells.layers


def set_free(grid: RollingMap, x: int, y: int) -> None:
    ly.set_free(writable(grid), *grid.window.shift, x, y, grid._cells.changed)


def occupy(grid: RollingMap, x: int, y: int) -> None:
    """Occupy a cell of the window if it is not occupied yet."""
    layers, n, (sx, sy) = writable(grid), grid.window.n, grid.window.shift
    at = (y + sy) % n, (x + sx) % n
    if layers.raw[at] < ly.OCCUPIED:
        layers.raw[at] = ly.OCCUPIED
        ly.bit_set(layers.known, *at, True)
        ly.add_disc(layers, sx, sy, x, y, 1, grid._cells.disc, (0, 0, n, n), grid._cells.changed)


def move_to(grid: RollingMap, x: int, y: int) -> None:
    """Put the window around a cell."""
    grid._move_window(x, y)

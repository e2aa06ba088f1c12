"""Value maps: a score of each place for each target.

There are two ways to write scores: VLFM (Yokoyama et al., ICRA 2024) writes one score for an entire
view, and ViTL (IV-B2) one for each direction. ViTL's scene score S rates the entire image; its
value V of a direction is S times the probability that the target is there.

A cell is about 0.2 m wide. For each target it has a value and a weight of 16 bits each. The weight
is the scene score when ViTL writes, and the confidence when VLFM writes. Weight 0: no score yet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.geometry import Grid, optical_yaw_rad
from edge.jit import jit
from edge.mapping.layers import OCCUPIED, UNSEEN, Layers, plain
from edge.mapping.window import TILE, Window
from edge.types import Observation

RAYS = 128
"""Number of directions of a `RangeProfile`."""
ROWS = 120
"""Number of rows of a depth image that are read; more would not change cells of this width."""
UNIT = 65535
"""Stored value of 1.0."""


@dataclass(frozen=True, slots=True, eq=False)
class RangeProfile:
    """Range of one observation in each direction, kept so that a late score can still be written.

    Attributes:
        x_m: the camera's x in `map`.
        y_m: the camera's y in `map`.
        fov_rad: horizontal field of view, half to each side.
        range_m: (RAYS,) float32, from the right edge to the left: range of visible floor.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    fov_rad: float
    range_m: np.ndarray

    def bearing_rad(self, xy_m: np.ndarray) -> np.ndarray:
        """Return the bearing (n,) float64 of places (n, 2) in `map`, positive to the left."""
        x, y = xy_m[:, 0] - self.x_m, xy_m[:, 1] - self.y_m
        return np.remainder(np.arctan2(y, x) - self.yaw_rad + math.pi, 2.0 * math.pi) - math.pi


class ValueMap:
    """A channel of values for each target, on the map's torus.

    `set_targets` allocates the memory: 4 bytes per cell and channel, or 1 MB for four targets in a
    window of 50 m (1000 x 1000 map cells of 0.05 m). The cost of a write depends only on the cells
    in view.

    Attributes:
        cell_m: side of a cell, a power of two of the map's cells.
        value: (m, m, targets) uint16 by storage cell; 65535 stands for 1.
        weight: (m, m, targets) uint16 by storage cell; 65535 stands for 1.
        targets: targets of the channels; set by `set_targets`.
    """

    def __init__(
        self, layers: Layers, window: Window, cell_m: float, range_m: float, beta: float
    ) -> None:
        """Prepare a map without channels; `set_targets` adds them.

        Args:
            layers: layers of the map.
            window: window of the map.
            cell_m: rounded so that a move of the window moves complete cells.
            range_m: farthest range that counts as in view.
            beta: in [0, 1]; ViTL assumes a frontier of value beta * S at both edges of a view.
        """
        # A value cell has 2**_cell_bits map cells on a side, at most 64: the window moves by
        # multiples of 64 map cells.
        self._cell_bits = min(6, max(0, round(math.log2(cell_m / window.resolution_m))))
        self.cell_m = window.resolution_m * 2**self._cell_bits
        self._layers, self._window = layers, window
        self._range_m, self._beta = range_m, beta
        m = self._cells = window.n >> self._cell_bits
        # Targets, values and weights. Another thread takes all three, so they are replaced at once.
        none = np.zeros((m, m, 0), np.uint16)
        self._channels: tuple[tuple[str, ...], np.ndarray, np.ndarray] = (), none, none
        side = 2 * math.ceil(range_m / self.cell_m) + 4
        # Results of `seen_cells`.
        self._seen_cells = np.zeros((side * side, 2), np.int32)
        self._seen_bearings = np.zeros(side * side, np.float32)

    @property
    def targets(self) -> tuple[str, ...]:
        """The target of each channel."""
        return self._channels[0]

    @property
    def value(self) -> np.ndarray:
        return self._channels[1]

    @property
    def weight(self) -> np.ndarray:
        return self._channels[2]

    def set_targets(self, targets: Sequence[str]) -> None:
        """Make one channel per target, in this order; targets that stay keep their values."""
        if tuple(targets) == self.targets:
            return
        m = self._cells
        value, weight = (np.zeros((m, m, len(targets)), np.uint16) for _ in range(2))
        for channel, target in enumerate(targets):
            if target in self.targets:
                old = self.targets.index(target)
                value[..., channel] = self.value[..., old]
                weight[..., channel] = self.weight[..., old]
        self._channels = tuple(targets), value, weight
        self._window.written[:] = True

    @property
    def n_side_cells(self) -> int:
        """Value cells on a side of a tile of the map."""
        return TILE >> self._cell_bits

    def roll(self, axis: int, by: int) -> None:
        """Clear the strip that leaves the window when it moves by `by` map cells along x or y."""
        leaving = self._window.leaving(axis, by, self._cell_bits)
        self.value[leaving] = self.weight[leaving] = 0

    def range_profile(self, observation: Observation) -> RangeProfile | None:
        """Return how far an observation sees, by its depth image, else up to the map's obstacles.

        A direction without any return in the depth image has range 0.

        Returns:
            None if the observation has no camera, or its pose is not finite.
        """
        camera, depth = observation.camera, observation.depth_m
        T = observation.T_map_base @ observation.T_base_camera
        if camera is None or not np.isfinite(T).all():
            return None
        x_m, y_m, yaw_rad = float(T[0, 3]), float(T[1, 3]), optical_yaw_rad(T)
        range_m = np.zeros(RAYS, np.float32)
        if depth is not None and depth.shape == (camera.height_px, camera.width_px):
            depth_profile(
                plain(depth), camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px,
                np.ascontiguousarray(T[:2, :3]), camera.hfov_rad, self._range_m, range_m,
            )  # fmt: skip
        elif self._window.placed:
            res, (ox, oy) = self._window.resolution_m, self._window.origin
            map_profile(
                self._layers.raw, *self._window.shift, x_m / res - ox, y_m / res - oy,
                yaw_rad, camera.hfov_rad, self._range_m / res, res, range_m,
            )  # fmt: skip
        return RangeProfile(x_m, y_m, yaw_rad, camera.hfov_rad, range_m)

    def write_view(self, profile: RangeProfile, targets: Sequence[str], score: np.ndarray) -> None:
        """Write one VLFM score per target for everything in view, with more weight in the middle.

        The value v and confidence c of a cell are merged with those of the view (v', c'):
        v = (c v + c' v') / (c + c'), c = (c^2 + c'^2) / (c + c'). The confidence c' falls as cos^2
        from 1 in the middle of the field of view to 0 at its edges.

        Args:
            profile: range of the observation.
            targets: targets of the scores; targets without a channel are ignored.
            score: (n,) one for each target, clipped to [0, 1].
        """
        channel = [self.targets.index(t) for t in targets if t in self.targets]
        scores = np.array([s for t, s in zip(targets, score, strict=True) if t in self.targets])
        n = self._find_seen_cells(profile)
        if n and channel:
            blend(
                self.value, self.weight, self._seen_cells, self._seen_bearings, n, profile.fov_rad,
                np.array(channel, np.int64), np.clip(scores, 0.0, 1.0).astype(np.float64),
            )  # fmt: skip

    def write_directions(
        self, profile: RangeProfile, target: str, xy_m: np.ndarray, p: np.ndarray, scene: float
    ) -> None:
        """Write ViTL's score of each direction, fused with the earlier values, over the view.

        Frontiers outside the field of view are ignored. Without a frontier in view, the value of
        the edges fills the view.

        Args:
            profile: range of the observation.
            target: target of the scores; without a channel nothing is written.
            xy_m: (n, 2) frontiers in `map`.
            p: (n,) probabilities of eq. 4.
            scene: scene score S of eq. 5, in [0, 1].
        """
        n = self._find_seen_cells(profile)
        if n == 0 or target not in self.targets:
            return
        channel, half = self.targets.index(target), 0.5 * profile.fov_rad
        bearing = profile.bearing_rad(xy_m)
        inside = np.flatnonzero(np.abs(bearing) <= half)
        # (bearing, fused value) of each frontier in view, from right to left; then both edges.
        points = sorted(
            (float(bearing[i]), fuse(*self._value_at(channel, xy_m[i]), scene * float(p[i]), scene))
            for i in inside
        )
        edge = self._beta * scene
        angle, value = zip((-half, edge), *points, (half, edge), strict=True)
        spread(
            self.value, self.weight, self._seen_cells, self._seen_bearings, n, channel,
            np.array(angle), np.array(value), scene,
        )  # fmt: skip

    def best(
        self, channel: int, xy_m: np.ndarray, n: int, radius_m: float, out: np.ndarray
    ) -> None:
        """Write the highest value within a radius of each place (ViTL eq. 9) into out[:n].

        Args:
            channel: index of a target, as in `set_targets`.
            xy_m: (n or more, 2) float32 in `map`.
            n: number of places.
            radius_m: radius.
            out: (n or more,) float32; NaN if no cell within the radius has a score.

        Raises:
            IndexError: there is no such channel.
        """
        if not 0 <= channel < len(self.targets):
            raise IndexError(f"value channel {channel}: the map has {len(self.targets)} channels")
        ox, oy = self._window.origin
        best_near(
            self.value, self.weight, channel, ox >> self._cell_bits, oy >> self._cell_bits,
            self.cell_m, xy_m, n, radius_m, out,
        )  # fmt: skip

    def snapshot(self, target: str) -> Grid:
        """Return a copy of a target's values; see `Window.copy_of`.

        Returns:
            uint8 cells: 0 = no score, else 1 + 254 times the value.
        """

        def plane() -> np.ndarray:
            targets, value, weight = self._channels
            if target not in targets:
                return np.zeros(value.shape[:2], np.uint8)
            channel = targets.index(target)
            shown = np.uint8(1) + (value[..., channel] // np.uint16(258)).astype(np.uint8)
            return np.where(weight[..., channel] > 0, shown, np.uint8(0))

        return self._window.copy_of(plane)

    def _value_at(self, channel: int, xy_m: np.ndarray) -> tuple[float, float]:
        """Return (value, weight) of a place's cell; (0, 0) outside the window."""
        window, m = self._window, self._cells
        x, y = window.cell_of(float(xy_m[0]), float(xy_m[1]))
        if not window.contains(x, y):
            return 0.0, 0.0
        at = (y >> self._cell_bits) % m, (x >> self._cell_bits) % m, channel
        return float(self.value[at]) / UNIT, float(self.weight[at]) / UNIT

    def _find_seen_cells(self, profile: RangeProfile) -> int:
        """Write the cells in view to `_seen_cells`, mark tiles as written; return their number."""
        if not self._window.placed:
            return 0
        window, (ox, oy) = self._window, self._window.origin
        x, y = window.cell_of(profile.x_m, profile.y_m)
        reach = math.ceil((float(profile.range_m.max()) + self.cell_m) / window.resolution_m) + 1
        window.mark_written(x - reach, y - reach, x + reach + 1, y + reach + 1)
        return seen_cells(
            profile.x_m, profile.y_m, profile.yaw_rad, profile.fov_rad, profile.range_m,
            ox >> self._cell_bits, oy >> self._cell_bits, self._cells, self.cell_m,
            self._seen_cells, self._seen_bearings,
        )  # fmt: skip


def fuse(v_old: float, s_old: float, v_curr: float, s_curr: float) -> float:
    """Return the fused value of a frontier from the stored value and this view (ViTL eq. 7).

    V is S times a probability, so V <= S in every cell. The quotient is the mean probability
    weighted by scene scores, so the result is at most `s_curr`. Rounding to 16 bits can break V <=
    S by half a step, which is clipped.
    """
    if s_old == 0.0 or s_curr == 0.0:
        return min(v_curr, s_curr)
    return min((v_old + v_curr) / (s_old + s_curr) * s_curr, s_curr)


@jit
def depth_profile(depth, fx, fy, cx, cy, R, fov, limit, range_m):
    """Compute the range of visible floor in each direction: the farthest return of a column (VLFM).

    - `depth`: (h, w) float32; values that are not finite, 0 or less, or over 1e6 are no returns.
    - `fx`, `fy`, `cx`, `cy`: intrinsics in pixels.
    - `R`: (2, 3) float64, rotates a direction from the optical frame to x and y of `map`.
    - `fov`: horizontal field of view in radians.
    - `limit`: largest range in metres.
    - `range_m`: (RAYS,) float32 output; 0 without a return.
    """
    h, w = depth.shape
    k = len(range_m)
    cos_pitch = math.hypot(R[0, 2], R[1, 2])  # cosine of the camera's pitch
    column = np.empty(k, np.int64)
    # The ray of a pixel in x and y of `map` is a (from its column) plus b (from its row).
    a0, a1, best = np.empty(k), np.empty(k), np.zeros(k)  # best: squared range
    for i in range(k):
        bearing = ((i + 0.5) / k - 0.5) * fov
        u = cx - fx * math.tan(bearing) / max(cos_pitch, 1e-3)
        column[i] = min(max(math.floor(u + 0.5), 0), w - 1)
        x = (column[i] - cx) / fx
        a0[i], a1[i] = R[0, 0] * x + R[0, 2], R[1, 0] * x + R[1, 2]
    for v in range(0, h, max(1, h // ROWS)):
        y = (v - cy) / fy
        b0, b1 = R[0, 1] * y, R[1, 1] * y
        for i in range(k):
            z = depth[v, column[i]]
            if z > 0.0 and z < 1e6:
                p, q = z * (a0[i] + b0), z * (a1[i] + b1)
                best[i] = max(best[i], p * p + q * q)
    for i in range(k):
        range_m[i] = min(math.sqrt(best[i]), limit)


@jit
def map_profile(raw, shift_x, shift_y, x, y, yaw, fov, max_cells, res, range_m):
    """Compute the range in each direction from the map: up to the first occupied or unseen cell.

    - `raw`: (N, N) uint8 by storage cell.
    - `x`, `y`: window coordinates in map cells, with fractions.
    - `max_cells`: largest range in cells.
    - `res`: metres per cell.
    - `range_m`: (RAYS,) float32 output.
    """
    n, k = raw.shape[0], len(range_m)
    for i in range(k):
        angle = yaw + ((i + 0.5) / k - 0.5) * fov
        dx, dy, along = math.cos(angle), math.sin(angle), 0.0
        while along < max_cells:
            wx, wy = math.floor(x + along * dx), math.floor(y + along * dy)
            if wx < 0 or wy < 0 or wx >= n or wy >= n:
                break
            state = raw[(wy + shift_y) % n, (wx + shift_x) % n]
            if state == UNSEEN or state >= OCCUPIED:
                break
            along += 1.0
        range_m[i] = min(along, max_cells) * res


@jit
def seen_cells(x, y, yaw, fov, range_m, origin_x, origin_y, m, cell, cells, bearings):
    """List the window's cells in view: their centres are in range, or at most half a cell beyond.

    - `x`, `y`, `cell`: place of the camera and side of a cell, metres.
    - `origin_x`, `origin_y`: first cell of the window, which has `m` cells on a side.
    - `cells`: (cap, 2) int32 output, storage row and column.
    - `bearings`: (cap,) float32 output.

    Returns:
        The number of cells.
    """
    k, n = len(range_m), 0
    farthest_m = 0.0
    for i in range(k):
        farthest_m = max(farthest_m, range_m[i])
    if farthest_m == 0.0:
        return 0
    farthest_m += 0.5 * cell
    c, s = math.cos(yaw), math.sin(yaw)
    x0 = max(math.floor((x - farthest_m) / cell), origin_x)
    x1 = min(math.floor((x + farthest_m) / cell) + 1, origin_x + m)
    y0 = max(math.floor((y - farthest_m) / cell), origin_y)
    y1 = min(math.floor((y + farthest_m) / cell) + 1, origin_y + m)
    for cy in range(y0, y1):
        dy = (cy + 0.5) * cell - y
        for cx in range(x0, x1):
            dx = (cx + 0.5) * cell - x
            d2 = dx * dx + dy * dy
            if d2 > farthest_m * farthest_m:
                continue
            bearing = math.atan2(dy * c - dx * s, dx * c + dy * s)
            i = math.floor((bearing / fov + 0.5) * k)
            if i < 0 or i >= k or range_m[i] == 0.0:
                continue
            reach = range_m[i] + 0.5 * cell
            if d2 <= reach * reach:
                cells[n, 0], cells[n, 1], bearings[n] = cy % m, cx % m, bearing
                n += 1
    return n


@jit
def blend(value, weight, cells, bearings, n, fov, channels, score):
    """Apply VLFM's update to `n` listed cells; see `ValueMap.write_view`."""
    for i in range(n):
        confidence = math.cos(bearings[i] / fov * math.pi) ** 2
        if confidence * UNIT < 0.5:
            continue
        sy, sx = cells[i, 0], cells[i, 1]
        for j in range(len(channels)):
            at = channels[j]
            c_old, v_old = weight[sy, sx, at] / UNIT, value[sy, sx, at] / UNIT
            total = c_old + confidence
            v = (c_old * v_old + confidence * score[j]) / total
            c = (c_old * c_old + confidence * confidence) / total
            value[sy, sx, at] = np.uint16(v * UNIT + 0.5)
            weight[sy, sx, at] = np.uint16(c * UNIT + 0.5)


@jit
def spread(value, weight, cells, bearings, n, channel, angle, v, scene):
    """Write ViTL eq. 8 into `n` listed cells: linear in the bearing between neighbouring frontiers.

    `angle` is (k,) float64, ascending from one edge of the field of view to the other. `v` is (k,)
    float64 in [0, scene].
    """
    last = len(angle) - 2
    stored = np.uint16(max(1.0, scene * UNIT + 0.5))  # above 0: a score of 0 is a score too
    for i in range(n):
        j = 0
        while j < last and bearings[i] > angle[j + 1]:
            j += 1
        width = angle[j + 1] - angle[j]
        along = (bearings[i] - angle[j]) / width if width > 0.0 else 1.0
        smooth = v[j] + min(max(along, 0.0), 1.0) * (v[j + 1] - v[j])
        value[cells[i, 0], cells[i, 1], channel] = np.uint16(smooth * UNIT + 0.5)
        weight[cells[i, 0], cells[i, 1], channel] = stored


@jit
def best_near(value, weight, channel, origin_x, origin_y, cell, xy, n, radius, out):
    """Do the work of `ValueMap.best`.

    It reads the cells with centres within the radius, and the cell that contains the place.
    """
    m = value.shape[0]
    reach = int(radius / cell) + 1
    for i in range(n):
        x, y = xy[i, 0] / cell, xy[i, 1] / cell
        mx, my = math.floor(x), math.floor(y)
        best = -1
        for cy in range(max(my - reach, origin_y), min(my + reach + 1, origin_y + m)):
            for cx in range(max(mx - reach, origin_x), min(mx + reach + 1, origin_x + m)):
                if math.hypot(cx + 0.5 - x, cy + 0.5 - y) * cell > radius and (cx, cy) != (mx, my):
                    continue
                if weight[cy % m, cx % m, channel] > 0:
                    best = max(best, np.int64(value[cy % m, cx % m, channel]))
        out[i] = best / UNIT if best >= 0 else np.nan

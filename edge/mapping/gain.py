"""Information gain: the unknown area that a view or a full turn from a place would show.

The area is an expectation, because space behind the edge of the known area is not all open. A ray
that has crossed unknown cells over a length u continues with probability exp(-u / `OPEN_M`), as if
walls and furniture were spread at random. So a gap behind a table does not count as a room.
"""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import SE2, wrap_angle
from edge.host.checkpoint import Arrays, Rows, check_arrays
from edge.jit import jit
from edge.mapping.layers import OCCUPIED, UNSEEN, ZONE, Layers, bits_of
from edge.mapping.window import Window

OPEN_M = 2.5
"""Mean free length of a ray through rooms that were not seen yet."""
RAYS = 64
"""Number of rays of a full turn; a remembered place has one bit for each."""
STEP_CELLS = 2.0
"""Step along a ray in cells."""
SAFE_SHARE = 0.85
"""Share of the field of view and of the range that is used, to be on the safe side."""
SAME_PLACE_M = 0.8
"""Views in one direction from places within this distance show the same."""
PLACES = 256
"""Largest number of remembered places; the oldest are forgotten."""
CROWDED = 5
"""With this many occupied cells around it, a free cell is a gap in a wall seen from afar."""
RAY_LEAST_M2 = 0.05
"""Smallest area of a ray that counts; less is only the edge of something."""


class InformationGain:
    """Computes the information gain over the map, and remembers what was seen from where."""

    def __init__(self, layers: Layers, window: Window, range_m: float) -> None:
        self._layers, self._window = layers, window
        cells = STEP_CELLS * window.resolution_m
        self._steps = max(1, int(SAFE_SHARE * range_m / cells))
        self._decay = math.exp(-cells / OPEN_M)
        angle = 2.0 * math.pi / RAYS * np.arange(RAYS)
        self._direction = np.stack([np.cos(angle), np.sin(angle)], axis=1) * STEP_CELLS
        # Area of a ray's share of the ring at each step.
        self._area_m2 = 2.0 * math.pi / RAYS * (np.arange(self._steps) + 1.0) * cells * cells
        self._ray_m2 = np.zeros(RAYS)
        # Remembered places: (x, y), and the rays that the camera saw from there, as bits.
        self._at_m = np.full((PLACES, 2), np.inf)
        self._looked = np.zeros(PLACES, np.uint64)
        self._next = 0  # place that is overwritten next

    def around(self, xy_m: np.ndarray, indices: np.ndarray, n: int, out_m2: np.ndarray) -> None:
        """Compute the expected area that a full turn at each of some places would show.

        Args:
            xy_m: (m, 2) float32 in `map`.
            indices: (n or more,) int32, indices into `xy_m`; the first `n` count.
            n: number of places.
            out_m2: (m,) float32, written at these indices.
        """
        window = self._window
        gains(
            self._layers, *window.origin, 1.0 / window.resolution_m, xy_m, indices, n,
            self._direction, self._area_m2, self._decay, self._ray_m2, out_m2,
        )  # fmt: skip

    def on_view(self, pose: SE2, camera_yaw_rad: float, fov_rad: float) -> None:
        """Remember a view of the camera: it shows nothing new from this place in this direction."""
        in_view = np.abs(_offsets_rad(pose.yaw_rad + camera_yaw_rad)) <= 0.5 * SAFE_SHARE * fov_rad
        self._looked[self._place(pose)] |= bits_of(in_view[None])[0, 0]

    def best_spin(
        self, pose: SE2, camera_yaw_rad: float, fov_rad: float
    ) -> tuple[float, float, float]:
        """Find the turn on the spot that shows unknown area in directions not yet seen from here.

        Returns:
            (heading_rad, turn_rad, area_m2): heading of the robot for the next view of the turn,
            angle of the entire turn, and the area that it shows; 0 if there is nothing to see.
        """
        window = self._window
        if not window.placed:
            return pose.yaw_rad, 0.0, 0.0
        x, y = pose.x_m / window.resolution_m, pose.y_m / window.resolution_m
        cast(
            self._layers, *window.origin, x, y, self._direction, self._area_m2, self._decay,
            self._ray_m2,
        )  # fmt: skip
        near = np.hypot(self._at_m[:, 0] - pose.x_m, self._at_m[:, 1] - pose.y_m) < SAME_PLACE_M
        bits = np.bitwise_or.reduce(self._looked[near], initial=np.uint64(0))
        looked = bits >> np.arange(RAYS, dtype=np.uint64) & np.uint64(1) != 0
        ahead = pose.yaw_rad + camera_yaw_rad
        turn, sweep, area_m2 = best_sweep(self._ray_m2, looked, SAFE_SHARE * fov_rad, ahead)
        return wrap_angle(pose.yaw_rad + turn), sweep, area_m2

    def state_dict(self) -> Arrays:
        """Return the places and the directions that the camera saw from them."""
        used = np.isfinite(self._at_m[:, 0])  # used entries come first
        return {
            "at_m": self._at_m[used], "looked": self._looked[used], "next": np.array(self._next),
        }  # fmt: skip

    def load_state_dict(self, state: Arrays) -> None:
        """Restore a `state_dict`.

        Raises:
            ValueError: the state is invalid.
        """
        rows: Rows = {("at_m", "looked"): PLACES}
        check_arrays(state, self.state_dict(), rows, {"next": PLACES - 1})
        n = len(state["at_m"])
        self._at_m[:n], self._looked[:n] = state["at_m"], state["looked"]
        self._next = int(state["next"])

    def _place(self, pose: SE2) -> int:
        """Return the index of the robot's place; make a new place if none is near."""
        away = np.hypot(self._at_m[:, 0] - pose.x_m, self._at_m[:, 1] - pose.y_m)
        k = int(away.argmin())
        if away[k] > 0.5 * SAME_PLACE_M:
            k, self._next = self._next, (self._next + 1) % PLACES
            self._at_m[k] = pose.x_m, pose.y_m
            self._looked[k] = 0
        return k


@jit
def cast(layers, origin_x, origin_y, x, y, direction, area, decay, out):
    """Compute the expected unknown area that each ray from a place shows; return the sum of `out`.

    - `x`, `y`: world coordinates in cells, with fractions.
    - `direction`: (rays, 2) float64, one step along each ray, in cells.
    - `area`: (steps,) float64, area of a ray's sector at each step.
    - `decay`: probability that a ray continues after a step through unknown cells.
    - `out`: (rays,) float64 output.
    """
    raw, near = layers.raw, layers.near
    n = raw.shape[0]
    total = 0.0
    for k in range(len(direction)):
        px, py, seen, p_open = x, y, 0.0, 1.0
        for s in range(len(area)):
            px += direction[k, 0]
            py += direction[k, 1]
            cx, cy = math.floor(px), math.floor(py)
            if cx < origin_x or cy < origin_y or cx >= origin_x + n or cy >= origin_y + n:
                break
            cx, cy = cx % n, cy % n
            if raw[cy, cx] >= OCCUPIED or near[cy, cx] & ~ZONE >= CROWDED:
                break
            if raw[cy, cx] == UNSEEN:
                p_open *= decay
                seen += p_open * area[s]
        out[k] = seen
        total += seen
    return total


@jit
def gains(layers, origin_x, origin_y, inv_res, xy, indices, n, direction, area, decay, ray, out):
    """Compute the area of each place for `InformationGain.around`; `ray` is scratch."""
    for j in range(n):
        i = indices[j]
        out[i] = cast(
            layers, origin_x, origin_y, xy[i, 0] * inv_res, xy[i, 1] * inv_res, direction, area,
            decay, ray,
        )  # fmt: skip


def _offsets_rad(ahead_rad: float) -> np.ndarray:
    """Return the angle of each ray from the direction `ahead_rad`, (RAYS,), in [-pi, pi)."""
    rays_rad = 2.0 * math.pi / RAYS * np.arange(RAYS)
    return (rays_rad - ahead_rad + math.pi) % (2.0 * math.pi) - math.pi


def best_sweep(
    ray_m2: np.ndarray, looked: np.ndarray, fov_rad: float, ahead_rad: float
) -> tuple[float, float, float]:
    """Find the shorter turn, left or right, over all unseen rays that show enough.

    Args:
        ray_m2: (RAYS,) float64, area that each ray shows.
        looked: (RAYS,) bool, True for rays that the camera has seen from near here.
        fov_rad: field of view.
        ahead_rad: direction of the camera.

    Returns:
        (turn to the next view, angle of the entire turn, area in m²). Angles are in radians; a turn
        to the right is negative. The turn to the next view is at most 120 degrees, so that no
        controller takes the other way round.
    """
    unseen = (ray_m2 >= RAY_LEAST_M2) & ~looked
    if not unseen.any():
        return 0.0, 0.0, 0.0
    # To bring every ray into view from either side.
    offset_rad, area_m2 = _offsets_rad(ahead_rad)[unseen], float(ray_m2[unseen].sum())
    left_rad, right_rad = (
        max(float((side * offset_rad % (2.0 * math.pi)).max()) - 0.5 * fov_rad, 0.0)
        for side in (1.0, -1.0)
    )
    max_turn_rad = 2.0 * math.pi / 3.0
    if left_rad <= right_rad:
        return min(left_rad, max_turn_rad), left_rad, area_m2
    return -min(right_rad, max_turn_rad), right_rad, area_m2

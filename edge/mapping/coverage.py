"""Detector coverage: how often the detector saw each place, and the best view of unseen places.

A place is a square of about a quarter of a metre. Along a ray, the camera sees the places over free
cells, up to and including the first occupied cell. The search for views uses the same rule, so a
view shows the places that the search expected.
"""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import SE2, Grid, optical_yaw_rad
from edge.jit import jit
from edge.mapping.layers import OCCUPIED, UNSEEN, Layers, bit_get
from edge.mapping.reach_kernels import STRAIGHT
from edge.mapping.travel_cost import TravelCostField
from edge.mapping.window import Window
from edge.types import Observation

PLACE_M = 0.25
"""Side of a place; rounded to a power of two of the map's cells."""
NEAR_M = 0.8
"""Places nearer than this are outside the image."""
MIN_VIEW_M2 = 0.5
"""Smallest area that makes a view worth a goal."""
START_M = 2.0
"""Fixed cost of a goal in metres of path: turning, stopping and looking."""
SAFE_SHARE = 0.85
"""Share of the field of view and range that is used to plan a view.

The robot stops slightly off the planned pose.
"""
WORK_PER_STEP = 100_000
"""Work of one search step. The search tests one cell of each place, the lattice points. The unit of
work is one visit of such a point, some 10 ns."""
_REACHED_WORK = 64  # work of counting the unseen places around a lattice point
_CAST_WORK = 2048  # work of casting rays from a lattice point
MAX_RAYS = 512
"""Largest number of rays of a full circle."""
# A place's byte holds its number of looks up to `MOST_LOOKS`, and a flag. A kernel sets the flag on
# places that the current rays have crossed, so that each place counts once, and clears it.
MOST_LOOKS, _FLAG = 127, 128
# Action of `show` on the places that the rays show: only count those that were not seen well, also
# count a look at each, or exclude those that were not seen well from later searches.
KEEP, COUNT, WRITE_OFF = range(3)
# Entries of the best view so far; x and y are a world cell.
_WORTH, _X, _Y, _HEADING = range(4)


class Coverage:
    """Number of looks at each place, one byte per place on the map's torus; memory is fixed.

    Attributes:
        camera_yaw_rad: yaw of the first camera on the robot; 0 if it looks ahead. Turns and views
            are planned for this camera.
        looks: (m, m) uint8 by storage place, number of looks, at most 127.
        view: best of all views that `search` found: the centre of a cell that the robot can reach,
            and the direction of the camera there. None if no view is worth a goal.
    """

    def __init__(self, layers: Layers, window: Window) -> None:
        self.camera_yaw_rad = 0.0
        self.view: SE2 | None = None
        self._layers, self._window = layers, window
        resolution_m, n = window.resolution_m, window.n
        # The window moves by multiples of 64 cells, and so of a place's side.
        # A place has 2**_place_bits cells on a side.
        self._place_bits = min(6, max(0, round(math.log2(PLACE_M / resolution_m))))
        self._min_places = max(1, round(MIN_VIEW_M2 / (resolution_m * 2**self._place_bits) ** 2))
        self.looks = np.zeros((n >> self._place_bits, n >> self._place_bits), np.uint8)
        self._new_places = np.zeros(MAX_RAYS, np.int32)
        self._fov_rad = self._range_m = 0.0
        self._looks_needed = 1
        self._next = 0  # lattice point where the search continues
        self._best = np.zeros(4)  # see `_WORTH` and the entries after it

    def roll(self, axis: int, by: int) -> None:
        """Clear the strip that leaves the window when it moves by `by` cells along x (0) or y."""
        self.looks[self._window.leaving(axis, by, self._place_bits)] = 0

    def reset(self) -> None:
        """Clear all counts, because the detector now looks for other objects."""
        self.looks[:] = 0
        self._window.written[:] = True

    def on_image(self, observation: Observation, range_m: float, looks_needed: int) -> None:
        """Count a look at each place in an image that the detector searched.

        Args:
            observation: the image's observation.
            range_m: range within which detections count.
            looks_needed: number of looks after which a place counts as seen well.
        """
        camera = observation.camera
        if camera is None:
            return
        self._range_m = range_m
        self._looks_needed = min(looks_needed, MOST_LOOKS)
        T = observation.T_map_base @ observation.T_base_camera
        if observation.camera_index == 0:
            self._fov_rad = camera.hfov_rad
            self.camera_yaw_rad = optical_yaw_rad(observation.T_base_camera)
        far = range_m / self._window.resolution_m
        step_rad, rays = sector(camera.hfov_rad, far, self._place_bits)
        first = optical_yaw_rad(T) - 0.5 * (rays - 1) * step_rad
        self._show(T[0, 3], T[1, 3], first, step_rad, rays, far, COUNT)

    def is_worth_visiting(self, view: SE2) -> bool:
        """Return True if a view still shows enough places that were not seen well."""
        return self._unseen_in_view(view, KEEP) >= self._min_places

    def area_m2(self, view: SE2) -> float:
        """Return the area that a view still shows of places that were not seen well."""
        return (
            self._unseen_in_view(view, KEEP)
            * (self._window.resolution_m * 2**self._place_bits) ** 2
        )

    def write_off(self, view: SE2) -> None:
        """Exclude the places of a view that are still not seen well from all later searches."""
        self._unseen_in_view(view, WRITE_OFF)

    def snapshot(self) -> Grid:
        """Return a copy of how well each place was seen; see `Window.copy_of`.

        Returns:
            uint8 cells: 0 = never seen, 255 = seen often enough.
        """

        def plane() -> np.ndarray:
            looks = np.minimum(self.looks & np.uint8(_FLAG - 1), self._looks_needed)
            return (looks.astype(np.uint16) * 255 // self._looks_needed).astype(np.uint8)

        return self._window.copy_of(plane)

    def restart_search(self) -> None:
        """Restart the search: the next `search` begins at the first cell."""
        self._next = 0
        self._best[:] = 0.0

    def search(self, reach: TravelCostField) -> bool:
        """Do one step of the search for the view that shows the most per length of path to it.

        A step tests some of the cells that the robot can reach. It takes at most a few
        milliseconds, for maps of any size.

        Returns:
            True when all cells were tested; `view` then has the best view.
        """
        self.view = None
        if self._fov_rad == 0.0 or reach.generation == 0:
            return True
        res = self._window.resolution_m
        distance, rect = reach.field
        self._next = best_view(
            self._layers, distance, *rect, *self._window.origin, self.looks, self._place_bits,
            self._looks_needed, SAFE_SHARE * self._fov_rad, NEAR_M / res,
            SAFE_SHARE * self._range_m / res, START_M / res, self._min_places, self._new_places,
            self._next, WORK_PER_STEP, self._best,
        )  # fmt: skip
        if self._next > 0:
            return False
        if self._best[_WORTH] > 0.0:
            x, y, heading = self._best[_X:].tolist()
            self.view = SE2((x + 0.5) * res, (y + 0.5) * res, heading)
        self._best[:] = 0.0
        return True

    def _unseen_in_view(self, view: SE2, action: int) -> int:
        """Return the number of places that a view shows and that were not seen well."""
        far = SAFE_SHARE * self._range_m / self._window.resolution_m
        ray_step_rad, width = sector(SAFE_SHARE * self._fov_rad, far, self._place_bits)
        first = view.yaw_rad - 0.5 * (width - 1) * ray_step_rad
        return self._show(view.x_m, view.y_m, first, ray_step_rad, width, far, action)

    def _show(
        self,
        x_m: float,
        y_m: float,
        first: float,
        ray_step_rad: float,
        rays: int,
        far: float,
        action: int,
    ) -> int:
        """Call the kernel `show` with a place in metres of `map`; `far` is in cells."""
        window, res, (ox, oy) = self._window, self._window.resolution_m, self._window.origin
        if action != KEEP:
            x, y = window.cell_of(x_m, y_m)
            reach = math.ceil(far) + 1
            window.mark_written(x - reach, y - reach, x + reach + 1, y + reach + 1)
        return show(
            self._layers.raw, self.looks, self._place_bits, *window.shift,
            x_m / res - ox, y_m / res - oy, first, ray_step_rad, rays, NEAR_M / res, far,
            self._looks_needed, action, self._new_places,
        )  # fmt: skip


@jit
def sector(fov, far, bits):
    """Return (angle between two rays, number of rays) of a field of view of range `far` in cells.

    Two rays are about a place apart at the end, and the angle divides a full circle evenly.
    """
    circle = max(8, min(int(2.0 * math.pi * far / (1 << bits)), MAX_RAYS - 1))
    ray_step_rad = 2.0 * math.pi / circle
    return ray_step_rad, min(max(int(fov / ray_step_rad), 0), circle - 1) + 1


@jit
def show(
    raw, looks, bits, shift_x, shift_y, x, y, first, ray_step_rad, rays, near, far, looks_needed,
    action, new_places,
):  # fmt: skip
    """Cast rays from a camera and update the places that it sees; return the sum of `new_places`.

    - `x`, `y`: window coordinates in cells, with fractions.
    - `first`, `ray_step_rad`: direction of the first ray, and angle to the next, radians.
    - `near`, `far`: range in cells that counts.
    - `action`: COUNT a look, WRITE_OFF places with too few looks, or KEEP everything.
    - `bits`: a place has 2**bits cells on a side.
    - `looks_needed`: number of looks after which a place counts as seen well.
    - `new_places`: (rays,) int32 output: number of places with too few looks that no earlier ray
      showed.
    """
    total = 0
    for k in range(rays):
        angle = first + ray_step_rad * k
        new_places[k] = _ray(
            raw, looks, bits, shift_x, shift_y, x, y, math.cos(angle), math.sin(angle),
            near, far, looks_needed,
        )  # fmt: skip
        total += new_places[k]
    m = looks.shape[0]
    x0, y0, x1, y1 = _square(x, y, far, bits, m)
    for cy in range(y0, y1):
        sy = _stored(cy, shift_y >> bits, m)
        for cx in range(x0, x1):
            sx = _stored(cx, shift_x >> bits, m)
            if looks[sy, sx] < _FLAG:
                continue
            before = looks[sy, sx] - _FLAG
            if action == COUNT and before < MOST_LOOKS:
                before += 1
            elif action == WRITE_OFF and before < looks_needed:
                before = MOST_LOOKS
            looks[sy, sx] = before
    return total


@jit(inline="always")
def _stored(at, shift, n):
    """Return the storage row or column of a window row or column."""
    at += shift
    return at - n if at >= n else at


@jit
def _square(x, y, far, bits, m):
    """Return the half-open range (x0, y0, x1, y1) of places that may be within `far` cells."""
    return (
        max(int(x - far) >> bits, 0),
        max(int(y - far) >> bits, 0),
        min((int(x + far) >> bits) + 1, m),
        min((int(y + far) >> bits) + 1, m),
    )


@jit
def _ray(raw, looks, bits, shift_x, shift_y, x, y, dx, dy, near, far, looks_needed):
    """Flag the places along a ray; return how many of them are new and have too few looks."""
    n = raw.shape[0]
    step = max(1.0, 0.25 * (1 << bits))
    n_new, distance = 0, 0.0
    while distance <= far:
        sx, sy = math.floor(x + distance * dx), math.floor(y + distance * dy)
        if sx < 0 or sy < 0 or sx >= n or sy >= n:
            break
        sx, sy = _stored(sx, shift_x, n), _stored(sy, shift_y, n)
        state = raw[sy, sx]
        if state == UNSEEN:
            break
        if distance >= near:
            before = looks[sy >> bits, sx >> bits]
            if before < _FLAG:
                looks[sy >> bits, sx >> bits] = before + _FLAG
                if before < looks_needed:
                    n_new += 1
        if state >= OCCUPIED:
            break
        distance += step
    return n_new


@jit
def _unseen_around(looks, bits, shift_x, shift_y, x, y, far, looks_needed):
    """Count the places with too few looks in the square around a cell; no view shows more."""
    m = looks.shape[0]
    x0, y0, x1, y1 = _square(x, y, far, bits, m)
    count = 0
    for cy in range(y0, y1):
        sy = _stored(cy, shift_y >> bits, m)
        for cx in range(x0, x1):
            sx = _stored(cx, shift_x >> bits, m)
            count += looks[sy, sx] < looks_needed
    return count


@jit
def _best_sector(new_places, circle, width):
    """Find the best `width` neighbours among the `circle` rays of a full circle.

    Returns:
        (sum of their `new_places`, index of the first ray).
    """
    now = 0
    for k in range(width):
        now += new_places[k]
    best, first = now, 0
    for k in range(1, circle):
        now += new_places[(k + width - 1) % circle] - new_places[k - 1]
        if now > best:
            best, first = now, k
    return best, first


@jit
def best_view(
    layers, distance, x0, y0, x1, y1, origin_x, origin_y, looks, bits, looks_needed, fov, near, far,
    start_cells, least, new_places, at, work, best,
):  # fmt: skip
    """Continue the search over the lattice of reachable cells, one per place, from point `at`.

    The value of a view is the number of places it shows over the length of the path to it plus
    `start_cells`.

    - `distance`: see `Wave.distance`; valid in the world cells `x0`, `y0`, `x1`, `y1`.
    - `bits`, `looks_needed`, `near`, `far`, `new_places`: see `show`.
    - `fov`: field of view in radians.
    - `least`: a view with fewer places has no value.
    - `work`: see `WORK_PER_STEP`.
    - `best`: (4,) float64: value, world cell x and y, heading of the best view so far.

    Returns:
        The point where the search continues, or 0 when all points were tested.
    """
    n, side = layers.raw.shape[0], 1 << bits
    shift_x, shift_y = origin_x % n, origin_y % n
    # Round up to the next place's corner.
    x0, y0 = (x0 + side - 1) >> bits << bits, (y0 + side - 1) >> bits << bits
    columns, rows = (x1 - x0 + side - 1) >> bits, (y1 - y0 + side - 1) >> bits
    ray_step_rad, width = sector(fov, far, bits)
    circle = round(2.0 * math.pi / ray_step_rad)
    # Upper bound of the places in a sector, including those cut by its rim.
    angle = ray_step_rad * width
    most_places = (0.5 * angle * far * far / side + (2.0 + angle) * far) / side
    while at < columns * rows:
        if work <= 0:
            return at
        work -= 1
        wx, wy = x0 + at % columns * side, y0 + at // columns * side
        at += 1
        sx, sy = wx % n, wy % n
        entry = distance[sy, sx]
        if entry == 0 or bit_get(layers.blocked, sy, sx) or not bit_get(layers.known, sy, sx):
            continue
        cost = start_cells + (entry - 1) / STRAIGHT
        if most_places / cost <= best[_WORTH]:
            continue
        work -= _REACHED_WORK
        x, y = wx - origin_x + 0.5, wy - origin_y + 0.5
        limit = min(
            _unseen_around(looks, bits, shift_x, shift_y, x, y, far, looks_needed), most_places
        )
        if limit < least or limit / cost <= best[_WORTH]:
            continue
        work -= _CAST_WORK
        show(
            layers.raw, looks, bits, shift_x, shift_y, x, y, 0.0, ray_step_rad, circle, near, far,
            looks_needed, KEEP, new_places,
        )  # fmt: skip
        places, first = _best_sector(new_places, circle, width)
        if places >= least and places / cost > best[_WORTH]:
            best[_WORTH], best[_X], best[_Y] = places / cost, wx, wy
            best[_HEADING] = (first + 0.5 * (width - 1)) * ray_step_rad
    return 0

"""Rolling occupancy map with its frontiers (VL-Nav III.A, III.B).

Cells have three kinds of coordinates: world, window and storage. `edge.mapping.layers` explains
them. Updates work on a *scratch grid*: a square of cells with the sensor's cell in its centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from weakref import proxy

import cv2
import numpy as np

from edge import config
from edge.geometry import FARTHEST_M, CameraModel, Grid
from edge.host.checkpoint import Arrays, check_arrays
from edge.mapping import clusters as cl
from edge.mapping import layers as ly
from edge.mapping import points, tiles, unknown, update
from edge.mapping.bumps import ROUNDING_CELLS, ContactObstacles
from edge.mapping.compose import FREE, OCCUPIED, UNKNOWN, compose
from edge.mapping.coverage import MOST_LOOKS, Coverage
from edge.mapping.gain import InformationGain
from edge.mapping.results import Frontiers, MapUpdate
from edge.mapping.travel_cost import TravelCostField
from edge.mapping.values import ValueMap
from edge.mapping.window import Window
from edge.mapping.zones import Zones

# An obstacle of this width and height gets two samples across and four up at full range. Its
# lowest sample may look like ground; the highest must still be 0.06 m above that.
_SMALLEST_OBSTACLE_M = 0.1
_SAMPLES_ACROSS, _SAMPLES_UP = 2, 4
_FOOTPRINT_M = 0.3  # unknown cells this near to the robot's centre are free
# The robot's centre may be off its cell's centre: a wall that it touches must stay occupied.
_OFF_CENTRE_CELLS = 0.7
# Weight of a new measurement of the floor's height.
_FLOOR_GAIN = 0.2
# Obstacles that are this near to the robot are never forgotten unseen.
_KEEP_M = 0.5
# Largest side of an obstacle that may be a person.
_PERSON_M = 0.8
# Poses farther apart do not join the trail: the robot was carried, or frames were lost.
_TRAIL_STEP_CELLS = 10
FRONTIER_MIN_CELLS = 6
"""A cluster with fewer cells is not a frontier."""
FRONTIER_LARGE_CELLS, FRONTIER_SPACING_M = 40, 1.0
"""A cluster with at least so many cells has several target points at this spacing."""
MAX_FRONTIERS = 256
"""Largest number of target points."""
REACH_CELLS_PER_TICK = 8000
"""Cells by which the travel-cost field grows per tick.

More cells make a tick slower; fewer make the field older.
"""
CLEAR_AFTER = 2
"""Number of updates in a row that must see through an obstacle to clear it."""
GROUND_SLOPE = 0.3
"""Largest slope of ground that the robot can drive on; see `points.sweep_ground`."""
_DEFAULT_ROBOT = config.RobotConfig()
_VALUE_CELL_M = 0.2  # cell of value maps, rounded to a power of two of the map's cells
_VALUE_BETA = 0.5  # ViTL's edge attenuation factor (IV-B2)
_EMPTY_RECT = (1 << 40, 1 << 40, -(1 << 40), -(1 << 40))  # `layers.grow` extends it


class RollingMap:
    """A square window of the world that follows the robot; memory is fixed at construction.

    Heights are measured from the floor that is seen near the robot, at any z in `map`.

    Args:
        config: settings of the map.
        robot: the robot's shape. Points on the robot itself are ignored, and the cells under it are
            free.

    Attributes:
        frontiers: target points, refreshed in place by every update.
        travel_cost: driving distances from the robot; call its `step` once per tick.
        bumps: obstacles that no sensor shows, but at which the robot was blocked.
        zones: areas that the robot must not enter; set by `set_zones`.
        coverage: places that the detector has seen; call its `on_image` for each searched image.
        gain: unknown area that a view would show.
        values: scores of places; call its `set_targets` before writing to it.
        window: part of the world that is held; only the map moves it.
        layers: arrays that updates write, read-only, by storage cell (see `edge.mapping.layers`).

    Example:
        >>> grid = RollingMap(config.MappingConfig(extent_m=6.0, range_m=2.0))
        >>> camera, T_base_camera = CameraModel.from_hfov(48, 40, 1.6), np.eye(4)
        >>> T_base_camera[:3, :3] = (0, 0, 1), (-1, 0, 0), (0, -1, 0)
        >>> T_base_camera[2, 3] = 0.5
        >>> wall_m = np.full((40, 48), 1.5, np.float32)
        >>> update = grid.update_depth(wall_m, camera, np.eye(4), T_base_camera)
        >>> grid.state_at(1.5, 0.0), grid.state_at(0.0, 0.0), grid.state_at(2.5, 0.0)
        (100, 0, -1)
    """

    def __init__(
        self, config: config.MappingConfig, robot: config.RobotConfig = _DEFAULT_ROBOT
    ) -> None:
        c = self.config = config
        self._robot_config = robot
        res = c.resolution_m
        # An obstacle may be at the rim of its cell, half a cell nearer than the centre.
        self._inflation_cells = c.inflation_m / res + 0.5
        self._disc = ly.disc_half_widths(self._inflation_cells)
        self._body = ly.disc_half_widths(max(self._inflation_cells - ROUNDING_CELLS, 0.0))
        self._footprint = ly.disc_half_widths(max(_FOOTPRINT_M, robot.radius_m) / res)
        self._freed_disc = ly.disc_half_widths(max(robot.radius_m / res - _OFF_CENTRE_CELLS, 0.0))
        self._polar = points.make_polar(c.range_m, res)
        self._half_side = self._polar.bin_of.shape[0] // 2
        # Cells that must lie in the window on each side of the sensor.
        self._reach_cells = self._half_side + len(self._disc) // 2 + 1
        cells = max(math.ceil(c.extent_m / res), 2 * self._reach_cells + 1 + ly.WORD)
        n = ly.WORD * math.ceil(cells / ly.WORD)
        self.window = Window(n, res)
        self._layers = ly.make_layers(n)
        self.layers = ly.Layers(*map(ly.read_only, self._layers))
        self._clusters = cl.make_clusters(n)
        self._n_pending = 0  # frontier cells that wait for a cluster
        self._scan = points.make_scan(self._polar, 1024)
        self._robot_cell: tuple[int, int] | None = None  # its world cell at the last update
        self._lost_rays = np.zeros(self._polar.sectors, np.uint64)
        self._floor, self._levels = np.zeros(3), np.zeros((2, 64))  # see `points.find_floor`
        self._floor_m = math.nan  # height of the floor over the base; NaN until it was seen
        self._base_z_m = math.nan  # height of the base when the floor was last seen
        self._no_floor = False  # True if the ground is far below the base; then no cell is freed
        # Half-open window rectangles: cells changed since the last `_refresh_frontiers`, and all
        # cells ever written.
        self._changed = np.array(_EMPTY_RECT, np.int64)
        self._explored = np.array(_EMPTY_RECT, np.int64)
        self._flipped = np.zeros(self._polar.bin_of.size, np.int32)  # scratch of `apply_scan`
        self._flood = (np.zeros(64, np.uint64), np.zeros(64, np.uint64))  # of `unknown_ratios`
        self._flood_disc = (0.0, ly.disc_half_widths(0.0))  # newest radius [m], and its disc
        self._camera: CameraModel | None = None
        self.frontiers = Frontiers(
            0,
            np.zeros((MAX_FRONTIERS, 2), np.float32),
            np.zeros(MAX_FRONTIERS, np.int32),
            np.zeros(MAX_FRONTIERS, np.int32),
        )
        self.travel_cost = TravelCostField(
            self._layers, self.window, self._inflation_cells, self._body, REACH_CELLS_PER_TICK
        )
        self.coverage = Coverage(self._layers, self.window)
        self.gain = InformationGain(self._layers, self.window, c.range_m)
        self.values = ValueMap(self._layers, self.window, _VALUE_CELL_M, c.range_m, _VALUE_BETA)
        # A weak reference, so that a dropped map is freed at once and not by the garbage collector.
        write = partial(RollingMap._write, proxy(self))
        self.bumps = ContactObstacles(self._layers, self.window, c, write)
        self.zones = Zones(self._layers, self.window, self._inflation_cells)

    def update_depth(
        self,
        depth_m: np.ndarray,
        camera: CameraModel,
        T_map_base: np.ndarray,
        T_base_camera: np.ndarray,
    ) -> MapUpdate:
        """Update the map from a depth image (VL-Nav algorithm 1).

        Args:
            depth_m: (h, w) float32; NaN, 0, inf and values over 1e6 are no returns.
            camera: intrinsics of the depth camera.
            T_map_base: (4, 4), pose of the robot's base at the image's stamp.
            T_base_camera: (4, 4), pose of the optical frame on the base.

        Returns:
            The changed cells, and the floor.

        Raises:
            ValueError: the image has another size than the camera, or a pose is not finite.
        """
        if depth_m.shape != (camera.height_px, camera.width_px):
            raise ValueError(
                f"depth image is {depth_m.shape}, its camera {camera.height_px}x"
                f"{camera.width_px} (height x width): send the matching camera info"
            )
        self._use_camera(camera)
        T, cell, fraction = self._locate(T_map_base, T_base_camera)
        rolled = self._move_window(*cell)
        seen = (
            ly.plain(depth_m), *self._strides, self._column, self._row, T,
            np.float32(self.config.min_range_m),
        )  # fmt: skip
        n_points = points.from_depth(*seen, self._scan.xyz)
        self._lost_rays[:] = 0
        if n_points < self._n_pixels:
            points.lost_rays(*seen, self._polar, self._lost_rays)
        return self._integrate(
            n_points, n_points, T, cell, fraction, T_map_base, T_base_camera, rolled
        )

    def update_cloud(
        self, cloud_m: np.ndarray, T_map_base: np.ndarray, T_base_lidar: np.ndarray
    ) -> MapUpdate:
        """Update the map from a point cloud, like `update_depth`.

        Args:
            cloud_m: (n, 3) float32 in the LiDAR's frame; points that are not finite are dropped. A
                row (x, y, inf) is a ray that hit nothing up to (x, y, 0): it only frees cells.
            T_map_base: (4, 4), pose of the robot's base at the cloud's stamp.
            T_base_lidar: (4, 4), pose of the LiDAR on the base.

        Raises:
            ValueError: the cloud is not (n, 3), or a pose is not finite.
        """
        if cloud_m.ndim != 2 or cloud_m.shape[1] != 3:
            raise ValueError(f"cloud has shape {cloud_m.shape}, expected (n, 3): x, y, z in metres")
        self._reserve(len(cloud_m))
        T, cell, fraction = self._locate(T_map_base, T_base_lidar)
        rolled = self._move_window(*cell)
        hits, n_points = points.from_cloud(
            ly.plain(cloud_m), T, np.float32(self.config.min_range_m), self._scan.xyz
        )
        self._lost_rays[:] = 0
        return self._integrate(n_points, hits, T, cell, fraction, T_map_base, T_base_lidar, rolled)

    def set_zones(
        self, keep_out_m: Sequence[np.ndarray], stay_inside_m: Sequence[np.ndarray]
    ) -> None:
        """Replace the zones; frontiers follow with the next update. See `Zones.set`."""
        self.zones.set(keep_out_m, stay_inside_m, self._changed)

    def forget_arrivals(self, small_too: bool = False) -> bool:
        """Free all cells in which something arrived, such as a person; return True if any was.

        What is still there is occupied again as soon as it is seen. Obstacles next to the robot
        stay whole: the sensor may not see them. The cost grows with the window, so not for each
        tick.

        Args:
            small_too: True: cells of other obstacles that are no larger than a person become
                unknown. Somebody may have stood there when the floor was first seen.
        """
        (ox, oy), n, raw = self.window.origin, self.window.n, self._layers.raw
        arrived = (raw >= ly.ARRIVED) & (raw < ly.BUMPED)
        small = self._small_obstacles() & ~arrived if small_too else np.zeros_like(arrived)
        label, _ = self._components(arrived | small)
        row, column = np.nonzero(label)
        x, y = ox + (column - ox) % n, oy + (row - oy) % n
        if self._robot_cell is not None:
            away_m = self.resolution_m * np.hypot(x - self._robot_cell[0], y - self._robot_cell[1])
            of = label[row, column]
            far = ~np.isin(of, of[away_m <= _KEEP_M])
            x, y = x[far], y[far]
        for cell_x, cell_y in zip(x.tolist(), y.tolist(), strict=True):
            if small[cell_y % n, cell_x % n]:
                self._write(cell_x, cell_y, ly.UNSEEN)
            else:  # what is there has arrived, again
                self._write(cell_x, cell_y, ly.FREE, update.SURELY_FREE)
        return len(x) > 0

    def _small_obstacles(self) -> np.ndarray:
        """Return the cells of obstacles that are no larger than a person, (n, n) bool."""
        raw = self._layers.raw
        label, side_cells = self._components((raw >= ly.OCCUPIED) & (raw < ly.BUMPED))
        is_small = side_cells * self.resolution_m <= _PERSON_M
        is_small[0] = False  # the background
        return is_small[label]

    def _components(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Label the 8-connected parts of a layer's cells, (n, n) bool, from 1; 0 is the rest.

        Returns:
            The label of each cell, (n, n) int32, and the longest side of each part in cells.
        """
        shift_x, shift_y = self.window.shift
        in_window = np.roll(cells.view(np.uint8), (-shift_y, -shift_x), (0, 1))
        _, label, stats, _ = cv2.connectedComponentsWithStats(in_window, connectivity=8)
        side = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
        return np.roll(label, (shift_y, shift_x), (0, 1)), side

    def state_at(self, x_m: float, y_m: float) -> int:
        """Return -1 for unknown or outside the window, 0 for free, 100 for occupied or inflated."""
        x, y = self.window.cell_of(x_m, y_m)
        if not self.window.contains(x, y):
            return UNKNOWN
        n = self.window.n
        if self._layers.near[y % n, x % n]:
            return OCCUPIED
        return FREE if self._layers.raw[y % n, x % n] else UNKNOWN

    @property
    def floor_over_base_m(self) -> float:
        """Height of the floor over the base frame, usually negative; 0 until the floor was seen."""
        return 0.0 if math.isnan(self._floor_m) else self._floor_m

    @property
    def resolution_m(self) -> float:
        """Side of a cell."""
        return self.window.resolution_m

    @property
    def known_m2(self) -> float:
        """Area that was seen. Its cost grows with the map's size, so do not read it in every tick.

        Another thread may read it during an update; some cells are then from before the update.
        """
        return float(unknown.count(self._layers.known)) * self.resolution_m**2

    def snapshot(self, inflated: int = OCCUPIED) -> Grid:
        """Copy the explored part; the cost grows with the map's size, so never in a steady tick.

        Another thread may call it during an update; some cells are then from before the update. If
        the window moves during the copy, the map is read again.

        Args:
            inflated: value of cells that are not occupied, but too near to an occupied cell.
        """
        while True:
            origin = self.window.origin
            if not self.window.placed:
                return Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), self.resolution_m)
            margin, n = len(self._disc) // 2, self.window.n
            x0, y0 = (max(int(v) - margin, 0) for v in self._explored[:2])
            x1, y1 = (min(int(v) + margin, n) for v in self._explored[2:])
            cells = np.empty((max(y1 - y0, 0), max(x1 - x0, 0)), np.int8)
            corner = origin[0] + x0, origin[1] + y0
            # A robot inside a zone gets the map without zones, or its controller could not leave.
            zones = self._robot_cell is None or not self.zones.contains_cell(*self._robot_cell)
            compose(self._layers, self._body, *corner, inflated, zones, cells)
            if self.window.origin == origin:
                corner_m = (corner[0] * self.resolution_m, corner[1] * self.resolution_m)
                return Grid(cells, corner_m, self.resolution_m)

    def unknown_ratio(self, xy_m: np.ndarray, n: int, radius_m: float, out: np.ndarray) -> None:
        """Write the share of unknown cells around points (VL-Nav eq. 6) into out[:n].

        Args:
            xy_m: (n or more, 2) float32 in `map`.
            n: number of points.
            radius_m: radius of the search from each point; at most 31 cells.
            out: (n or more,) float32.

        Raises:
            ValueError: the radius is over 31 cells.
        """
        if self._flood_disc[0] != radius_m:
            if radius_m > config.MAX_RADIUS_CELLS * self.resolution_m:
                finest_m = math.ceil(1000 * radius_m / config.MAX_RADIUS_CELLS) / 1000
                raise ValueError(
                    f"unknown-area radius {radius_m} m: with cells of {self.resolution_m} m at "
                    f"most {config.MAX_RADIUS_CELLS * self.resolution_m:g} m are possible; set "
                    f"mapping.resolution_m to at least {finest_m:.3g}"
                )
            self._flood_disc = (radius_m, ly.disc_half_widths(radius_m / self.resolution_m))
        if not self.window.placed:
            out[:n] = 1.0
            return
        unknown.unknown_ratios(
            self._layers.known, self._layers.blocked, *self.window.shift, *self.window.origin,
            1.0 / self.resolution_m, xy_m, n, self._flood_disc[1], *self._flood, out,
        )  # fmt: skip

    # -- checkpoint -------------------------------------------------------------------------

    @property
    def planes(self) -> tiles.LayerTiles:
        """Layers for the checkpoint, by tile; all other layers can be computed from them."""
        layers, m = self._layers, len(self.window.written)
        saved = (
            layers.raw, layers.top, layers.trail, self.coverage.looks, self.values.value,
            self.values.weight,
        )  # fmt: skip
        return tiles.LayerTiles(*(tiles.tiled(layer, m) for layer in saved))

    @property
    def tiles_of_update(self) -> int:
        """Largest number of tiles that one update writes."""
        return (2 * (self._half_side + 1) // ly.WORD + 2) ** 2

    @property
    def tile_bytes(self) -> int:
        """Size of a tile in bytes without the value maps."""
        return tiles.tile_bytes(self.planes[: -tiles.VALUE_PLANES])

    def state_dict(self) -> Arrays:
        """Return the state outside `planes`.

        A row of `robot` is its world cell (x, y). A row of `floor_m` is (height of the floor over
        the base, height of the base in `map`). They have no row while they are unknown.
        """
        robot = np.array([] if self._robot_cell is None else [self._robot_cell], np.int64)
        floor_m = self._floor_m, self._base_z_m
        known = all(abs(z_m) < FARTHEST_M for z_m in floor_m)
        return {
            "origin": np.array(self.window.origin, np.int64),
            "cells": np.array(self.window.n, np.int64),
            "floor_m": np.array(floor_m if known else ()).reshape(-1, 2),
            "robot": robot.reshape(-1, 2),
            **{f"cluster_{name}": of for name, of in cl.state_dict(self._clusters).items()},
        }

    def load_state_dict(self, state: Arrays, packed: Arrays, tile_bytes: int, values: bool) -> None:
        """Restore a map from a checkpoint; this map must be empty.

        Frontiers keep their clusters if the window has the same size. Otherwise the window lies
        around the robot, and cells outside it are lost.

        Args:
            state: result of `state_dict`.
            packed: state of `tiles.PackedTiles` with the contents of `planes`.
            tile_bytes: unpacked size of a tile.
            values: True to load the value maps too: they have the same targets and cells.

        Raises:
            ValueError: this is not the state of a map.
        """
        layers, window, n = self._layers, self.window, self.window.n
        rows = {tuple(f"cluster_{name}" for name in group): most for group, most in cl.ROWS.items()}
        rows |= {("robot",): 1, ("floor_m",): 1}
        check_arrays(state, self.state_dict(), rows, {"cells": 1 << 16})
        robot = [(x, y) for x, y in state["robot"].tolist()]
        self._robot_cell = robot[0] if robot else None
        for floor_m in state["floor_m"].tolist():
            self._floor_m, self._base_z_m = floor_m
        x, y = state["origin"].tolist()
        if state["cells"] != n and robot:
            x, y = (at - n // 2 for at in robot[0])
        window.origin = (x // ly.WORD * ly.WORD, y // ly.WORD * ly.WORD)
        window.placed = True
        planes = self.planes if values else self.planes[: -tiles.VALUE_PLANES]
        tiles.write_tiles(planes, window, tiles.unpack_tiles(packed, tile_bytes))
        np.minimum(self.coverage.looks, MOST_LOOKS, out=self.coverage.looks)
        seen = layers.raw != ly.UNSEEN
        layers.known[:] = ly.bits_of(seen)
        if seen.any():
            rect, changed = (0, 0, n, n), np.array(_EMPTY_RECT, np.int64)
            ly.inflate_into(layers, *window.shift, rect, rect, self._disc, changed)
            for axis in (0, 1):
                at = (np.flatnonzero(seen.any(axis=axis)) - window.origin[axis]) % n
                self._explored[axis], self._explored[axis + 2] = at.min(), at.max() + 1
        if state["cells"] == n:
            names = (name for group in cl.ROWS for name in group)
            clusters = {name: state[f"cluster_{name}"] for name in names}
            cl.load_state_dict(layers.label, self._clusters, clusters)
            layers.frontier[:] = ly.bits_of(layers.label > 0)
        if self.zones.any:
            self.zones.paint((0, 0, n, n), self._changed)
        self._retest(0, 0, n, n)
        self._refresh_frontiers(True)

    def _use_camera(self, camera: CameraModel) -> None:
        """Precompute arrays that depend only on the intrinsics."""
        if camera == self._camera:
            return
        pixels = _SMALLEST_OBSTACLE_M / self.config.range_m
        self._strides = (
            max(1, int(camera.fx_px * pixels / _SAMPLES_ACROSS)),
            max(1, int(camera.fy_px * pixels / _SAMPLES_UP)),
        )
        u, v = np.arange(camera.width_px), np.arange(camera.height_px)
        self._column = ((u - camera.cx_px) / camera.fx_px).astype(np.float32)
        self._row = ((v - camera.cy_px) / camera.fy_px).astype(np.float32)
        samples = [
            len(range(stride // 2, n, stride))
            for n, stride in zip((camera.width_px, camera.height_px), self._strides, strict=True)
        ]
        self._n_pixels = math.prod(samples)
        self._reserve(self._n_pixels)
        self._camera = camera

    def _reserve(self, n_points: int) -> None:
        """Make the scratch arrays large enough for so many points."""
        if len(self._scan.cell) < n_points:
            self._scan = points.make_scan(self._polar, n_points + n_points // 4)

    def _locate(
        self, T_map_base: np.ndarray, T_base_sensor: np.ndarray
    ) -> tuple[np.ndarray, tuple[int, int], tuple[np.float32, np.float32]]:
        """Return the sensor's pose and place.

        Returns:
            `T_map_sensor` without its last row, (3, 4) float32; the sensor's world cell (x, y); and
            its (x, y) in the scratch grid in cells, with fractions.
        """
        T_map_sensor = T_map_base @ T_base_sensor
        x_m, y_m = T_map_sensor[:2, 3].tolist()
        coordinates = x_m, y_m, *T_map_base[:2, 3].tolist()
        if not np.isfinite(T_map_sensor).all() or not all(abs(v) < FARTHEST_M for v in coordinates):
            raise ValueError(
                f"sensor or robot pose is not finite or beyond {FARTHEST_M:.0e} m: "
                f"x, y of sensor and robot {coordinates}"
            )
        x, y = x_m / self.resolution_m, y_m / self.resolution_m
        cell = (math.floor(x), math.floor(y))
        fraction = (
            np.float32(self._half_side + x - cell[0]),
            np.float32(self._half_side + y - cell[1]),
        )
        return np.ascontiguousarray(T_map_sensor[:3], np.float32), cell, fraction

    def _integrate(
        self,
        n_points: int,
        hits: int,
        T: np.ndarray,
        cell: tuple[int, int],
        fraction: tuple[np.float32, np.float32],
        T_map_base: np.ndarray,
        T_base_sensor: np.ndarray,
        rolled: bool,
    ) -> MapUpdate:
        """Complete an update after `scan.xyz` is filled: first `hits`, then the ends of free rays.

        Args:
            n_points: number of points in `scan.xyz`.
            hits: number of these that are returns; the others are ends of rays that hit nothing.
            T: (3, 4) float32, see `_locate`.
            cell: the sensor's world cell.
            fraction: see `_locate`.
            T_map_base: (4, 4) pose of the base.
            T_base_sensor: (4, 4) pose of the sensor on the base.
            rolled: True if the window moved.
        """
        c, polar, scan, layers = self.config, self._polar, self._scan, self._layers
        sensor_z, robot = float(T[2, 3]), self._robot_config
        if robot.self_filter_m:
            axes = T_map_base[:3, :3].astype(np.float32, order="C")
            sensor_m = T_base_sensor[:3, 3].astype(np.float32)
            n_points, hits = points.drop_self_points(
                n_points,
                hits,
                scan.xyz,
                axes,
                sensor_m,
                T[2, 3],
                robot.self_filter_m,
                robot.height_m,
            )
        n = points.bin_points(
            n_points, hits, T[2, 3], np.float32(c.range_m),
            np.float32(1.0 / self.resolution_m), *fraction, polar, scan,
        )  # fmt: skip
        base_x, base_y, base_z = T_map_base[:3, 3].tolist()
        floor_seen = self._find_floor(sensor_z, base_z)
        if self._no_floor:
            n, scan.reach_m[:] = 0, 0.0
        coded_m = max(c.obstacle_max_m, points.CODED_M)
        points.classify(n, scan, polar, c.obstacle_min_m, c.obstacle_max_m, coded_m)
        if coded_m > c.obstacle_max_m:
            points.extend_obstacles_up(n, scan, polar, c.obstacle_max_m, coded_m)
        shift, origin = self.window.shift, self.window.origin
        corner = (cell[0] - self._half_side - origin[0], cell[1] - self._half_side - origin[1])
        update.apply_scan(
            layers, *shift, *corner, scan, polar, self._lost_rays, sensor_z, c.obstacle_min_m,
            c.obstacle_max_m, coded_m, CLEAR_AFTER, self._disc, self._changed, self._explored,
            self._flipped,
        )  # fmt: skip
        robot_cell = self.window.cell_of(base_x, base_y)
        update.free_footprint(
            layers, *shift, robot_cell[0] - origin[0], robot_cell[1] - origin[1],
            self._footprint, self._freed_disc, self._disc, self._changed, self._explored,
        )  # fmt: skip
        self._extend_trail(robot_cell)
        self.bumps.clear_under_robot(robot_cell)
        self.bumps.open_seen_free()
        self._mark_tiles(cell, robot_cell)
        changed = self._refresh_frontiers(rolled)
        return MapUpdate(changed, rolled, base_z + self._floor_m, floor_seen, self._no_floor)

    def _find_floor(self, sensor_z: float, base_z: float) -> bool:
        """Follow the ground from the floor under the robot; return True if the floor was seen.

        The floor keeps its height below the base, also in a lift. The search for it goes on until
        it is found. It starts again if the base suddenly moves up or down, because the robot may
        have crouched.
        """
        c, polar, scan, floor = self.config, self._polar, self._scan, self._floor
        step_m = c.obstacle_min_m
        floor_z, below_m2 = base_z + self._floor_m, 0.0  # area [m²] of ground below the base
        if not abs(base_z - self._base_z_m) <= 0.5 * step_m:
            near_m = points.search_range_m(sensor_z - base_z, c.min_range_m)
            search = scan.lowest_m, polar, sensor_z, base_z, step_m
            found_z, below_m2 = points.find_floor(*search, near_m, self._levels)
            if math.isnan(found_z):
                found_z, below_m2 = points.find_floor(*search, c.range_m, self._levels)
            if not abs(found_z - floor_z) <= step_m:
                # Without a visible floor, assume it is at least two steps below the sensor.
                heights_z = found_z, floor_z, min(base_z, sensor_z - 2.0 * step_m)
                floor_z = next(z for z in heights_z if math.isfinite(z))
        floor[0], floor[1], floor[2] = floor_z, 0.0, 0.0  # height, slope along x and y
        sweep = (
            scan, polar, floor, sensor_z, GROUND_SLOPE, step_m, c.range_m,
            1.0 / self.resolution_m,
        )  # fmt: skip
        total, count = points.sweep_ground(*sweep)
        if not count:  # no height near the robot: fit a plane to the ground farther away
            near_m = points.search_range_m(sensor_z - base_z, c.min_range_m)
            fit = scan.lowest_m, polar, sensor_z, step_m
            if any(points.fit_floor(*fit, m, floor) for m in (near_m, 2.0 * near_m)):
                total, count = float(floor[0]), 1
                points.sweep_ground(*sweep)
        if count:
            known = abs(floor_z - base_z - self._floor_m) <= step_m
            floor_z += (_FLOOR_GAIN if known else 1.0) * (total / count - floor_z)
            self._floor_m, self._base_z_m = floor_z - base_z, base_z
        self._no_floor = not count and below_m2 > points.LEAST_FLOOR_M2
        return count > 0

    def _write(self, x: int, y: int, state: int, top: int = 0) -> None:
        """Set the state of one world cell, and update the inflation around it."""
        layers, n, (ox, oy) = self._layers, self.window.n, self.window.origin
        sx, sy, x, y = x % n, y % n, x - ox, y - oy
        before, after = layers.raw[sy, sx] >= ly.OCCUPIED, state >= ly.OCCUPIED
        layers.raw[sy, sx], layers.top[sy, sx] = state, top
        ly.bit_set(layers.known, sy, sx, state != ly.UNSEEN)
        if after != before:
            by = 1 if after else -1
            clip = (0, 0, n, n)
            ly.add_disc(layers, *self.window.shift, x, y, by, self._disc, clip, self._changed)
        ly.grow(self._changed, x, y)
        ly.grow(self._explored, x, y)
        self.window.mark_written(x + ox, y + oy, x + ox + 1, y + oy + 1)

    def _extend_trail(self, robot: tuple[int, int]) -> None:
        """Mark the robot's path on the trail, where its body fits; see `layers.on_trail`."""
        before, (ox, oy) = self._robot_cell, self.window.origin
        if before is None or math.dist(before, robot) > _TRAIL_STEP_CELLS:
            before = robot
        ly.mark_trail(
            self._layers, *self.window.shift,
            before[0] - ox, before[1] - oy, robot[0] - ox, robot[1] - oy,
        )  # fmt: skip
        self._robot_cell = robot

    def _mark_tiles(self, sensor: tuple[int, int], robot: tuple[int, int]) -> None:
        """Mark the tiles that one update wrote, around the sensor and around the robot."""
        reach, (x, y), mark = self._half_side + 1, sensor, self.window.mark_written
        mark(x - reach, y - reach, x + reach + 1, y + reach + 1)
        reach, (x, y) = max(len(self._footprint) // 2, _TRAIL_STEP_CELLS) + 1, robot
        mark(x - reach, y - reach, x + reach + 1, y + reach + 1)

    def _refresh_frontiers(self, rolled: bool) -> tuple[int, int, int, int]:
        """Find frontiers in the changed cells, list the target points, return these cells.

        The result is a half-open rectangle of world cells, all zero if none changed.
        """
        layers, window = self._layers, self.window
        x0, y0, x1, y1 = (int(v) for v in self._changed)
        world = (0, 0, 0, 0)
        if x1 > x0:
            self._retest(x0 - 1, y0 - 1, x1 + 1, y1 + 1)
            ox, oy = window.origin
            world = (x0 + ox, y0 + oy, x1 + ox, y1 + oy)
            self._changed[:] = _EMPTY_RECT
        res = self.resolution_m
        any_change = cl.regroup(
            layers, *window.shift, self._clusters, self._n_pending,
            FRONTIER_LARGE_CELLS, FRONTIER_SPACING_M / res,
        )  # fmt: skip
        self._n_pending = 0
        if any_change or rolled:
            f = self.frontiers
            f.n = cl.list_targets(
                window.n, *window.shift, *window.origin, res, self._clusters, FRONTIER_MIN_CELLS,
                f.xy_m, f.cells, f.cluster,
            )  # fmt: skip
        return world

    def _retest(self, x0: int, y0: int, x1: int, y1: int) -> None:
        """Test the frontier cells of a window rectangle again; see `clusters.retest`."""
        self._n_pending = cl.retest(
            self._layers, *self.window.shift, x0, y0, x1, y1, self._clusters, self._n_pending
        )

    def _move_window(self, x: int, y: int) -> bool:
        """Keep the sensor's surroundings inside the window; return True if the window moved."""
        window, n, word = self.window, self.window.n, ly.WORD
        if not window.placed:
            window.origin = ((x - n // 2) // word * word, (y - n // 2) // word * word)
            window.placed = True
            if self.zones.any:
                self.zones.paint((0, 0, n, n), self._changed)
            return False
        rolled = False
        for axis, at in enumerate((x, y)):
            low, high = at - self._reach_cells, at + self._reach_cells + 1
            origin = window.origin[axis]
            shift = 0
            if low < origin:
                shift = (low - origin) // word * word
            elif high > origin + n:
                shift = -((origin + n - high) // word * word)
            if shift:
                self._roll(axis, shift)
                rolled = True
        if rolled:
            self.bumps.follow_window()
        return rolled

    def _roll(self, axis: int, by: int) -> None:
        """Move the window along one axis by a multiple of 64 cells; clear the strip that leaves."""
        window, n, layers, shift = self.window, self.window.n, self._layers, self.window.shift
        margin = len(self._disc) // 2
        strip = min(abs(by), n)
        leaving = (0, strip) if by > 0 else (n - strip, n)
        entering = (n - strip, n) if by > 0 else (0, strip)
        ly.remove_obstacles(layers, *shift, *_band(axis, leaving, n), self._disc, self._changed)
        ly.wipe(layers, *shift, *_band(axis, leaving, n), self._clusters.dirty)
        x0, y0, x1, y1 = _band(axis, leaving, n)
        (ox, oy) = window.origin
        window.mark_written(x0 + ox, y0 + oy, x1 + ox, y1 + oy)
        self.coverage.roll(axis, by)
        self.values.roll(axis, by)
        origin = list(window.origin)
        origin[axis] += by
        window.origin = (origin[0], origin[1])
        for rect, low, high in ((self._changed, 0, n), (self._explored, 0, n)):
            rect[axis] = max(rect[axis] - by, low)
            rect[axis + 2] = min(rect[axis + 2] - by, high)
        if self._explored[axis] >= self._explored[axis + 2]:
            self._explored[:] = _EMPTY_RECT
        if self._changed[axis] >= self._changed[axis + 2]:
            self._changed[:] = _EMPTY_RECT
        edge = (
            (entering[0] - margin, entering[0]) if by > 0 else (entering[1], entering[1] + margin)
        )
        shift = window.shift
        ly.inflate_into(
            layers,
            *shift,
            _band(axis, edge, n),
            _band(axis, entering, n),
            self._disc,
            self._changed,
        )
        if self.zones.any:
            self.zones.paint(_band(axis, entering, n), self._changed)
        self._retest(*_band(axis, (entering[0] - 1, entering[1] + 1), n))
        # The cells at the other border have a neighbour less.
        tail = (0, 1) if by > 0 else (n - 1, n)
        self._retest(*_band(axis, tail, n))


def _band(axis: int, along: tuple[int, int], n: int) -> tuple[int, int, int, int]:
    """Return the window rectangle that spans `along` on one axis and everything on the other."""
    return (along[0], 0, along[1], n) if axis == 0 else (0, along[0], n, along[1])

"""Rolling occupancy map with its frontiers (VL-Nav III.A, III.B).

Cells have three kinds of coordinates: world, window and storage. `edge.mapping.layers` explains
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge import config
from edge.geometry import CameraModel, Grid
from edge.host.checkpoint import Arrays, check_arrays
from edge.mapping import clusters as cl
from edge.mapping import layers as ly
from edge.mapping import tiles, unknown, update
from edge.mapping.arrivals import cells_to_forget
from edge.mapping.bumps import ContactObstacles
from edge.mapping.cells import MapCells, band, strip
from edge.mapping.compose import FREE, OCCUPIED, UNKNOWN
from edge.mapping.coverage import MOST_LOOKS, Coverage
from edge.mapping.footprint import Footprint
from edge.mapping.gain import InformationGain
from edge.mapping.results import MapUpdate
from edge.mapping.scans import ScanReader
from edge.mapping.travel_cost import TravelCostField
from edge.mapping.values import ValueMap
from edge.mapping.zones import Zones

REACH_CELLS_PER_TICK = 8000
"""Cells by which the travel-cost field grows per tick.

More cells make a tick slower; fewer make the field older.
"""
CLEAR_AFTER = 2
"""Number of updates in a row that must see through an obstacle to clear it."""
_DEFAULT_ROBOT = config.RobotConfig()
_VALUE_CELL_M = 0.2  # cell of value maps, rounded to a power of two of the map's cells
_VALUE_BETA = 0.5  # ViTL's edge attenuation factor (IV-B2)


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
        unknown: share of unknown cells around points.
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
        self.config = config
        self._reader = ScanReader(config, robot)
        cells = self._cells = MapCells(config, self._reader.half_side)
        layers, window, range_m = cells.layers, cells.window, config.range_m
        self.window = window
        self.layers = ly.Layers(*map(ly.read_only, layers))
        self._footprint = Footprint(cells, robot.radius_m)
        self._finder = cl.FrontierFinder(layers, window)
        self.frontiers = self._finder.targets
        self.travel_cost = TravelCostField(
            layers, window, cells.inflation_cells, cells.body, REACH_CELLS_PER_TICK
        )
        self.unknown = unknown.UnknownArea(layers, window)
        self.coverage = Coverage(layers, window)
        self.gain = InformationGain(layers, window, range_m)
        self.values = ValueMap(layers, window, _VALUE_CELL_M, range_m, _VALUE_BETA)
        self.bumps = ContactObstacles(layers, window, config, cells.write)
        self.zones = Zones(layers, window, cells.inflation_cells)

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
        self._reader.read_depth(depth_m, camera, T_map_base, T_base_camera)
        return self._integrate(T_map_base)

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
        self._reader.read_cloud(cloud_m, T_map_base, T_base_lidar)
        return self._integrate(T_map_base)

    def set_zones(
        self, keep_out_m: Sequence[np.ndarray], stay_inside_m: Sequence[np.ndarray]
    ) -> None:
        """Replace the zones; frontiers follow with the next update. See `Zones.set`."""
        self.zones.set(keep_out_m, stay_inside_m, self._cells.changed)

    def forget_arrivals(self, small_too: bool = False) -> bool:
        """Free all cells in which something arrived, such as a person; return True if any was.

        What is still there is occupied again as soon as it is seen. Obstacles next to the robot
        stay complete: the sensor may not see them. The cost grows with the window, so not for each
        tick.

        Args:
            small_too: True: cells of other obstacles that are no larger than a person become
                unknown. A person may have stood there when the floor was first seen.
        """
        cells = cells_to_forget(self.layers.raw, self.window, self._footprint.cell, small_too)
        for x, y, arrived in cells:
            if arrived:  # what is there has arrived, again
                self._cells.write(x, y, ly.FREE, update.SURELY_FREE)
            else:
                self._cells.write(x, y, ly.UNSEEN)
        return bool(cells)

    def state_at(self, x_m: float, y_m: float) -> int:
        """Return -1 for unknown or outside the window, 0 for free, 100 for occupied or inflated."""
        x, y = self.window.cell_of(x_m, y_m)
        if not self.window.contains(x, y):
            return UNKNOWN
        n = self.window.n
        if self.layers.near[y % n, x % n]:
            return OCCUPIED
        return FREE if self.layers.raw[y % n, x % n] else UNKNOWN

    def is_floor_between(self, point_m: np.ndarray, other_m: np.ndarray) -> bool:
        """Return True if at least half of the line between two points (x, y, …) is free floor.

        Return False if one of them is outside the window.
        """
        ends = np.stack((point_m[:2], other_m[:2])) / self.window.resolution_m
        if not all(self.window.contains(math.floor(x), math.floor(y)) for x, y in ends):
            return False
        steps = 2 + math.ceil(np.abs(ends[1] - ends[0]).max())
        x, y = np.floor(np.linspace(ends[0], ends[1], steps)).astype(np.int64).T % self.window.n
        return 2 * np.count_nonzero(self.layers.raw[y, x] == ly.FREE) >= steps

    @property
    def floor_over_base_m(self) -> float:
        """Height of the floor over the base frame, usually negative; 0 until the floor was seen."""
        floor_m = self._reader.floor.over_base_m
        return 0.0 if math.isnan(floor_m) else floor_m

    @property
    def resolution_m(self) -> float:
        """Side of a cell."""
        return self.window.resolution_m

    @property
    def known_m2(self) -> float:
        """Area that was seen. Its cost grows with the map's size, so do not read it in every tick.

        Another thread may read it during an update; some cells are then from before the update.
        """
        return float(np.count_nonzero(self._cells.layers.raw)) * self.resolution_m**2

    def snapshot(self, inflated: int = OCCUPIED) -> Grid:
        """Copy the explored part; the cost grows with the map's size, so never in a steady tick.

        Another thread may call it during an update; some cells are then from before the update. If
        the window moves during the copy, the map is read again.

        Args:
            inflated: value of cells that are not occupied, but too near to an occupied cell.
        """
        # A robot inside a zone gets the map without zones, or its controller could not leave.
        robot = self._footprint.cell
        zones = robot is None or not self.zones.contains_cell(*robot)
        return self._cells.snapshot(inflated, zones)

    # -- checkpoint -------------------------------------------------------------------------

    @property
    def planes(self) -> tuple[np.ndarray, ...]:
        """Layers for the checkpoint; all other layers can be computed from them.

        They are views by storage tile: [row of tiles, row, column of tiles, column, …].
        """
        layers, m = self._cells.layers, len(self.window.written)
        saved = (
            layers.raw, layers.top, layers.trail, self.coverage.looks, self.values.value,
            self.values.weight,
        )  # fmt: skip
        return tuple(tiles.tiled(layer, m) for layer in saved)

    @property
    def tiles_of_update(self) -> int:
        """Largest number of tiles that one update writes."""
        return (2 * (self._reader.half_side + 1) // ly.WORD + 2) ** 2

    @property
    def tile_bytes(self) -> int:
        """Size of a tile in bytes without the value maps."""
        return tiles.tile_bytes(self.planes[: -tiles.VALUE_PLANES])

    def state_dict(self) -> Arrays:
        """Return the state outside `planes`.

        A row of `robot` is its world cell (x, y). A row of `floor_m` is (height of the floor over
        the base, height of the base in `map`). They have no row while they are unknown.
        """
        robot = [] if self._footprint.cell is None else [self._footprint.cell]
        return {
            "origin": np.array(self.window.origin, np.int64),
            "cells": np.array(self.window.n, np.int64),
            "floor_m": self._reader.floor.state(),
            "robot": np.array(robot, np.int64).reshape(-1, 2),
            **{f"cluster_{name}": of for name, of in self._finder.state_dict().items()},
        }

    def load_state_dict(self, state: Arrays, packed: Arrays, tile_bytes: int, values: bool) -> None:
        """Restore a map from a checkpoint; this map must be empty.

        Frontiers keep their clusters if the window has the same size. Otherwise the window is
        around the robot, and cells outside it are lost.

        Args:
            state: result of `state_dict`.
            packed: state of `tiles.PackedTiles` with the contents of `planes`.
            tile_bytes: unpacked size of a tile.
            values: True to load the value maps too: they have the same targets and cells.

        Raises:
            ValueError: this is not the state of a map.
        """
        window, n = self.window, self.window.n
        rows = {tuple(f"cluster_{name}" for name in group): most for group, most in cl.ROWS.items()}
        rows |= {("robot",): 1, ("floor_m",): 1}
        check_arrays(state, self.state_dict(), rows, {"cells": 1 << 16})
        robot = [(x, y) for x, y in state["robot"].tolist()]
        self._footprint.cell = robot[0] if robot else None
        self._reader.floor.load_state(state["floor_m"])
        x, y = state["origin"].tolist()
        if state["cells"] != n and robot:
            x, y = (at - n // 2 for at in robot[0])
        window.origin = (x // ly.WORD * ly.WORD, y // ly.WORD * ly.WORD)
        window.placed = True
        planes = self.planes if values else self.planes[: -tiles.VALUE_PLANES]
        tiles.write_tiles(planes, window, tiles.unpack_tiles(packed, tile_bytes))
        np.minimum(self.coverage.looks, MOST_LOOKS, out=self.coverage.looks)
        self._cells.inflate_all()
        if state["cells"] == n:
            names = (name for group in cl.ROWS for name in group)
            self._finder.load_state_dict({name: state[f"cluster_{name}"] for name in names})
        if self.zones.any:
            self.zones.paint((0, 0, n, n), self._cells.changed)
        self._finder.retest(0, 0, n, n)
        self._refresh_frontiers(True)

    def _integrate(self, T_map_base: np.ndarray) -> MapUpdate:
        """Write the newest scan into the layers; `T_map_base` is (4, 4)."""
        c, reader, cells, window = self.config, self._reader, self._cells, self.window
        half, (x, y) = reader.half_side, reader.sensor_cell
        rolled = self._move_window(x, y)
        update.apply_scan(
            cells.layers, *window.shift, x - half - window.origin[0], y - half - window.origin[1],
            reader.scan, reader.polar, reader.lost_rays, reader.sensor_z_m, c.obstacle_min_m,
            c.obstacle_max_m, reader.coded_m, CLEAR_AFTER, cells.disc, cells.changed,
            cells.explored,
        )  # fmt: skip
        window.mark_written(x - half - 1, y - half - 1, x + half + 2, y + half + 2)
        base_x, base_y, base_z = T_map_base[:3, 3].tolist()
        robot = window.cell_of(base_x, base_y)
        self._footprint.move_to(robot)
        self.bumps.clear_under_robot(robot)
        self.bumps.open_seen_free()
        changed, floor = self._refresh_frontiers(rolled), reader.floor
        floor_z_m = base_z + floor.over_base_m
        return MapUpdate(changed, rolled, floor_z_m, floor.is_seen, floor.is_missing)

    def _refresh_frontiers(self, rolled: bool) -> tuple[int, int, int, int]:
        """Find frontiers in the changed cells, list the target points, return these cells.

        The result is a half-open rectangle of world cells, all zero if none changed.
        """
        world, changed = (0, 0, 0, 0), self._cells.take_changed()
        if changed is not None:
            (x0, y0, x1, y1), (ox, oy) = changed, self.window.origin
            self._finder.retest(x0 - 1, y0 - 1, x1 + 1, y1 + 1)
            world = (x0 + ox, y0 + oy, x1 + ox, y1 + oy)
        self._finder.update(rolled)
        return world

    def _move_window(self, x: int, y: int) -> bool:
        """Keep the sensor's surroundings inside the window; return True if the window moved."""
        window, n, word = self.window, self.window.n, ly.WORD
        if not window.placed:
            window.origin = ((x - n // 2) // word * word, (y - n // 2) // word * word)
            window.placed = True
            if self.zones.any:
                self.zones.paint((0, 0, n, n), self._cells.changed)
            return False
        rolled = False
        reach = self._cells.reach_cells
        for axis, at in enumerate((x, y)):
            low, high = at - reach, at + reach + 1
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
        """Move the window along one axis by a multiple of 64 cells."""
        n = self.window.n
        self.coverage.roll(axis, by)
        self.values.roll(axis, by)
        self._cells.roll(axis, by, self._finder.clusters.dirty)
        start, end = entering = strip(by, n)
        if self.zones.any:
            self.zones.paint(band(axis, entering, n), self._cells.changed)
        self._finder.retest(*band(axis, (start - 1, end + 1), n))
        # The cells at the other border have a neighbour less.
        self._finder.retest(*band(axis, (0, 1) if by > 0 else (n - 1, n), n))

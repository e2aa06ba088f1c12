"""World of boxes, cylinders and ellipsoids: rendered, scanned by LiDAR, and rearranged.

Houses and streets are built as such worlds. The ray caster is `edge.lab.sim.kernels` (numba).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from edge.geometry import SE2, CameraModel, Grid
from edge.lab.sim import kernels, shading
from edge.lab.sim.base import FLOOR_CLEARANCE_M, FloorPlan, LidarRays, Room, WorldError, WorldObject

CELL_M = 0.025  # side of a cell of the floor plan
_MARGIN_M = 0.5  # free border of the floor plan around all primitives
_SLAB_M = 0.1  # thickness of floor and ceiling
_CEILING = (244.0, 243.0, 240.0)  # its colour
_SKY = np.array([205, 222, 238], np.uint8)  # colour of pixels that show nothing


@dataclass(frozen=True, slots=True)
class Primitive:
    """One solid of a simple shape; part of an object or of the building.

    Attributes:
        shape: `kernels.BOX`, `CYLINDER` or `ELLIPSOID`.
        center_m: centre, in the frame of the object that it is part of, or in `map`.
        size_m: full extents along its own axes.
        color: r, g, b in 0..255.
        texture: one of `shading.PLAIN` … `PICTURE`.
        yaw_rad: yaw in the same frame as the centre.
    """

    shape: int
    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    color: tuple[float, float, float]
    texture: int = shading.PLAIN
    yaw_rad: float = 0.0

    def placed(self, x_m: float, y_m: float, z_m: float, yaw_rad: float) -> Primitive:
        """Return this primitive moved from the object's frame to `map`, for an object at a pose."""
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        x, y, z = self.center_m
        center = (x_m + c * x - s * y, y_m + s * x + c * y, z_m + z)
        return replace(self, center_m=center, yaw_rad=self.yaw_rad + yaw_rad)


class BoxWorld:
    """World of primitives (see `edge.lab.sim.base.World`), whose objects can move.

    It is made from the primitives of the building, and each object with its own, in `map`. The
    floor plan has all that is lower than `robot_height_m`. The camera measures depths in
    `depth_range_m`.

    All arrays have one entry for each of the p primitives, in the same order.

    Attributes:
        owner: (p,) uint16, id of the object that the primitive is part of, 0 = structure.
        shape: (p,) uint8, see `Primitive`.
        texture: (p,) uint8, see `Primitive`.
        color: (p, 3) float32, see `Primitive`.
        geometry: (p, 8) float64, centre, half extents, cosine and sine of the yaw; see `kernels`
            for the columns.
    """

    def __init__(
        self,
        name: str,
        structure: list[Primitive],
        furniture: list[tuple[WorldObject, list[Primitive]]],
        start: SE2,
        robot_height_m: float,
        depth_range_m: tuple[float, float],
        rooms: tuple[Room, ...] = (),
        room_kinds: tuple[str, ...] = (),
    ) -> None:
        self.name = name
        self.rooms, self.room_kinds = rooms, room_kinds
        self.objects = [item for item, _ in furniture]
        self.start = start
        self._robot_height_m = robot_height_m
        self._depth_range_m = depth_range_m
        owned = [(0, part) for part in structure]
        owned += [(item.id, part) for item, parts in furniture for part in parts]
        if not owned:
            raise WorldError(f"world {name}: has no walls and no objects; add some")
        parts = [part for _, part in owned]
        self.owner = np.array([owner for owner, _ in owned], np.uint16)
        self.shape = np.array([part.shape for part in parts], np.uint8)
        self.texture = np.array([part.texture for part in parts], np.uint8)
        self.color = np.array([part.color for part in parts], np.float32)
        self.geometry = np.array([geometry_row(part) for part in parts])
        self.plan = self._floor_plan()
        self._hit_primitive = np.empty((0, 0), np.int32)  # (h, w), made at the first image

    def render(
        self,
        camera: CameraModel,
        T_map_camera: np.ndarray,
        out_rgb: np.ndarray | None,
        out_depth_m: np.ndarray,
        out_ids: np.ndarray,
    ) -> None:
        if self._hit_primitive.shape != out_depth_m.shape:
            self._hit_primitive = np.empty(out_depth_m.shape, np.int32)
        hit = self._hit_primitive
        lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
        kernels.render_depth(self.shape, self.geometry, T_map_camera, *lens, out_depth_m, hit)
        if out_rgb is not None:
            shading.shade(
                self.shape, self.geometry, self.color, self.texture, T_map_camera, *lens,
                out_depth_m, hit, self.plan.clearance_m, np.array(self.plan.grid.origin_xy_m),
                CELL_M, _SKY, out_rgb,
            )  # fmt: skip
        kernels.write_object_ids(hit, self.owner, *self._depth_range_m, out_depth_m, out_ids)

    def cast(self, fan: LidarRays, T_map_lidar: np.ndarray, out_ranges_m: np.ndarray) -> None:
        rays = (fan.directions, fan.el_min_rad, fan.el_step_rad)
        kernels.cast_fan(self.shape, self.geometry, T_map_lidar, *rays, out_ranges_m)
        out_ranges_m[out_ranges_m > fan.range_m] = np.nan

    def move(self, object_id: int, x_m: float, y_m: float) -> None:
        """Move an object's centre to another place on the floor.

        Raises:
            KeyError: no such object.
        """
        k = next((k for k, item in enumerate(self.objects) if item.id == object_id), None)
        if k is None:
            raise KeyError(f"world {self.name}: no object has the id {object_id}")
        item = self.objects[k]
        moving = self.owner == object_id
        self.geometry[moving, kernels.X] += x_m - item.center_m[0]
        self.geometry[moving, kernels.Y] += y_m - item.center_m[1]
        self.objects[k] = replace(item, center_m=(x_m, y_m, item.center_m[2]))
        grid = self.plan.grid
        grid.cells[:] = 0
        self._rasterise(grid.cells, np.array(grid.origin_xy_m))
        self.plan.update()

    def _floor_plan(self) -> FloorPlan:
        """Return the plan of all primitives; the grid ends `_MARGIN_M` beyond them."""
        center_x, center_y = self.geometry[:, (kernels.X, kernels.Y)].T
        half_x, half_y = self.geometry[:, (kernels.HALF_X, kernels.HALF_Y)].T
        c, s = np.abs(self.geometry[:, (kernels.COS, kernels.SIN)]).T
        # Half of the extents along x and y of `map`: those of the turned rectangle.
        reach = np.stack([c * half_x + s * half_y, c * half_y + s * half_x], axis=1)
        center = np.stack([center_x, center_y], axis=1)
        low = (center - reach).min(axis=0) - _MARGIN_M
        high = (center + reach).max(axis=0) + _MARGIN_M
        cols, rows = np.ceil((high - low) / CELL_M).astype(int)
        occupied = np.zeros((rows, cols), np.uint8)
        self._rasterise(occupied, low)
        return FloorPlan(Grid(occupied, (float(low[0]), float(low[1])), CELL_M))

    def _rasterise(self, occupied: np.ndarray, origin_m: np.ndarray) -> None:
        """Set the cells to 1 that a primitive covers at the height of the robot."""
        heights = (FLOOR_CLEARANCE_M, self._robot_height_m)
        kernels.rasterise(self.shape, self.geometry, *heights, origin_m, CELL_M, occupied)


def room_slabs(
    rect: tuple[float, float, float, float],
    color: tuple[float, float, float],
    texture: int,
    ceiling_m: float | None,
) -> list[Primitive]:
    """Return the floor of a rectangle (x0, y0, x1, y1), and its ceiling if that has a height."""
    x0, y0, x1, y1 = rect
    center, size = (0.5 * (x0 + x1), 0.5 * (y0 + y1)), (x1 - x0, y1 - y0, _SLAB_M)
    parts = [Primitive(kernels.BOX, (*center, -0.5 * _SLAB_M), size, color, texture)]
    if ceiling_m is not None:
        above = (*center, ceiling_m + 0.5 * _SLAB_M)
        parts.append(Primitive(kernels.BOX, above, size, _CEILING, shading.PAINT))
    return parts


def geometry_row(part: Primitive) -> list[float]:
    """Return a row of `BoxWorld.geometry`."""
    half = [0.5 * extent for extent in part.size_m]
    return [*part.center_m, *half, math.cos(part.yaw_rad), math.sin(part.yaw_rad)]

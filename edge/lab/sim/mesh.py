"""World made of a scanned or modelled house: a textured mesh and a list of its objects.

It needs the extra `worlds`: trimesh reads the file, and embreex casts the rays of a LiDAR.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from edge import names
from edge.config import Config, WorldMesh
from edge.geometry import SE2, CameraModel, Grid
from edge.host import resources
from edge.host.files import read_regular
from edge.lab.sim import kernels, mesh_kernels, raster_kernels
from edge.lab.sim.base import FLOOR_CLEARANCE_M, FloorPlan, LidarRays, Room, WorldError, WorldObject
from edge.lab.sim.mesh_faces import Faces, read_faces

CELL_M = 0.025  # side of a cell of the floor plan
_CLUSTER_FACES = 64  # see `raster_kernels`
_MARGIN_M = 0.5  # free border of the floor plan around the mesh
# Such houses often have no ceiling: the sky gets a ceiling's colour.
_SKY = np.array([236, 236, 233], np.uint8)
# The building itself: visible and solid, but never a target.
STRUCTURE = frozenset({"wall", "floor", "house wall", "room wall", "ceiling"})


def load_mesh(section: WorldMesh, config: Config) -> MeshWorld:
    """Load a mesh (z up, metres) and the list of its objects.

    Raises:
        WorldError: the extra is not installed, or a file is missing or invalid.
    """
    require_packages(config)
    import trimesh

    path = resources.expand(section.mesh)
    if not path.is_file():
        raise WorldError(f"{config.locate('sim.world.mesh')}: no file {path}; correct the path")
    try:
        scene = trimesh.load_scene(path)
        faces = read_faces(scene)
    except (ValueError, KeyError, IndexError, OSError) as error:
        raise WorldError(f"{path}: not a readable mesh: {error}") from None
    items = read_objects(resources.expand(section.objects))
    return MeshWorld(path.stem, faces, *objects_of(faces, items, config.robot.height_m), config)


def require_packages(config: Config) -> None:
    """Raise WorldError if a package that a world of triangles needs is not installed."""
    try:
        import trimesh  # noqa: F401

        if config.sensors.lidar is not None:
            import embreex  # noqa: F401
    except ImportError as error:
        raise WorldError(
            f"{config.locate('sim.world.kind')}: {config.sim.world.kind} needs {error.name}, which "
            "is not installed; run: pip install 'edge-vln[worlds]' (a LiDAR in it: x86_64 only), "
            "or choose another kind, such as house"
        ) from None


def read_objects(path: Path) -> list[dict[str, Any]]:
    """Read the list of objects: each has name, category, yaw, aabb_min and aabb_max.

    The last two are the lowest and the highest corner of its axis-parallel box, x, y, z in `map`.

    Raises:
        WorldError: the file is missing or not JSON, or an entry lacks a field or has an invalid
            category.
    """
    try:
        items = json.loads(read_regular(path))
        for k, item in enumerate(items):
            for key in ("name", "category", "yaw", "aabb_min", "aabb_max"):
                if key not in item:
                    raise WorldError(
                        f"{path}: object {k} (counted from 0): the field {key!r} is missing"
                    )
            try:
                names.normalise(item["category"])
            except names.NotANameError as error:
                raise WorldError(
                    f"{path}: object {k} (counted from 0): category: {error}"
                ) from None
    except OSError as error:
        raise WorldError(
            f"{path}: cannot be read: {error.strerror}; correct sim.world.objects"
        ) from None
    except (ValueError, TypeError) as error:
        raise WorldError(f"{path}: not a JSON list of objects: {error}") from None
    return items


class MeshWorld:
    """World of a textured mesh; see `edge.lab.sim.base.World`.

    `owner` is (n,) uint16: the id of the object that each triangle belongs to; 0 for the building.
    """

    def __init__(
        self,
        name: str,
        faces: Faces,
        objects: list[WorldObject],
        owner: np.ndarray,
        config: Config,
        rooms: tuple[Room, ...] = (),
        room_kinds: tuple[str, ...] = (),
    ) -> None:
        self.name = name
        self.rooms, self.room_kinds = rooms, room_kinds
        self._faces = faces
        self._depth_range_m = (config.sensors.camera.depth_min_m, config.sensors.camera.depth_max_m)
        count = len(faces.triangles)
        self._first = np.append(np.arange(0, count, _CLUSTER_FACES), count)
        self._boxes = np.empty((len(self._first) - 1, 6))
        raster_kernels.bound_clusters(faces.triangles, self._first, self._boxes)
        self._lidar_scene: Any = None
        self.objects, self._owner = objects, owner
        self.plan = self._floor_plan(config.robot.height_m)
        self.start = self._roomiest_pose()
        # The last camera, and the rays through its pixels.
        self._rays: tuple[CameraModel | None, np.ndarray] = (None, np.empty((0, 3)))
        # (thread, shape of the image or of the rays) -> arrays that are used again.
        self._buffers: dict[tuple[int, tuple[int, ...]], Any] = {}

    def render(
        self,
        camera: CameraModel,
        T_map_camera: np.ndarray,
        out_rgb: np.ndarray | None,
        out_depth_m: np.ndarray,
        out_ids: np.ndarray,
    ) -> None:
        height, width = out_depth_m.shape
        inverse, face, weights, origins, rays = self._buffers_of(
            out_depth_m.shape,
            lambda: (
                np.empty((height, width)), np.empty((height, width), np.int32),
                np.empty((2, height, width), np.float32),
                *np.empty((2, height * width, 3), np.float32),
            ),
        )  # fmt: skip
        faces = self._faces
        raster_kernels.rasterise_view(
            faces.triangles, self._first, self._boxes, np.linalg.inv(T_map_camera),
            camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px,
            inverse, face, weights, out_depth_m,
        )  # fmt: skip
        if out_rgb is not None:
            mesh_kernels.aim(self._pixel_rays(camera), T_map_camera, origins, rays)
            mesh_kernels.shade_hits(
                face.reshape(-1), *weights.reshape(2, -1), out_depth_m.reshape(-1), rays,
                camera.fx_px, faces.normals, faces.uvs, faces.tint, faces.texels, faces.levels,
                faces.first_level, faces.level_count, faces.texel_density, _SKY,
                out_rgb.reshape(-1, 3),
            )  # fmt: skip
        kernels.write_object_ids(
            face, self._owner, *self._depth_range_m, out_depth_m.reshape(-1), out_ids.reshape(-1)
        )

    def cast(self, fan: LidarRays, T_map_lidar: np.ndarray, out_ranges_m: np.ndarray) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        if self._lidar_scene is None:
            self._lidar_scene = EmbreeScene()
            TriangleMesh(self._lidar_scene, self._faces.triangles)
        directions = fan.directions.reshape(-1, 3)
        origins, rays = self._buffers_of(
            directions.shape, lambda: np.empty((2, len(directions), 3), np.float32)
        )
        mesh_kernels.aim(directions, T_map_lidar, origins, rays)
        hit = self._lidar_scene.run(origins, rays, output=True)
        ranges = np.where(hit["primID"] >= 0, hit["tfar"], np.nan)
        ranges[ranges > fan.range_m] = np.nan
        out_ranges_m[:] = ranges.reshape(out_ranges_m.shape)

    def _buffers_of(self, shape: tuple[int, ...], make: Callable[[], Any]) -> Any:
        """Return this thread's arrays for a shape: camera and LiDAR run in different threads."""
        key = (threading.get_ident(), shape)
        if key not in self._buffers:
            self._buffers[key] = make()
        return self._buffers[key]

    def _pixel_rays(self, camera: CameraModel) -> np.ndarray:
        """Return (h * w, 3) float32 directions with z = 1 in the optical frame."""
        if self._rays[0] != camera:
            u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
            x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
            rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
            self._rays = (camera, rays.astype(np.float32))
        return self._rays[1]

    def _floor_plan(self, robot_height_m: float) -> FloorPlan:
        triangles = self._faces.triangles
        flat = triangles.reshape(-1, 3)
        low, high = flat[:, :2].min(axis=0) - _MARGIN_M, flat[:, :2].max(axis=0) + _MARGIN_M
        cols, rows = np.ceil((high - low) / CELL_M).astype(int)
        occupied = np.zeros((rows, cols), np.uint8)
        heights = (FLOOR_CLEARANCE_M, robot_height_m)
        mesh_kernels.rasterise_triangles(triangles, *heights, low, CELL_M, occupied)
        return FloorPlan(Grid(occupied, (float(low[0]), float(low[1])), CELL_M))

    def _roomiest_pose(self) -> SE2:
        """Return the place inside the house that is farthest from all obstacles."""
        plan = self.plan
        floor = np.zeros(plan.grid.cells.shape, np.uint8)
        heights = (-2 * FLOOR_CLEARANCE_M, FLOOR_CLEARANCE_M)
        mesh_kernels.rasterise_triangles(
            self._faces.triangles,
            *heights,
            np.array(plan.grid.origin_xy_m, np.float32),
            CELL_M,
            floor,
        )
        inside = plan.clearance_m * floor
        row, col = np.unravel_index(int(np.argmax(inside)), inside.shape)
        return SE2(*plan.grid.centres_m(row, col).tolist(), 0.0)


def objects_of(
    faces: Faces, items: list[dict[str, Any]], reach_m: float
) -> tuple[list[WorldObject], np.ndarray]:
    """Return the objects, and the id of the object that each face belongs to (0 = structure).

    An object has the faces of the nodes with its name; a node's name may go on after a dot. If no
    node has its name, it has the faces in its box. A face in several boxes belongs to the smallest.
    """
    owner = np.zeros(len(faces.node), np.uint16)
    centers = faces.triangles.mean(axis=1)
    named_nodes = {node.partition(".")[0] for node in faces.node_names}
    objects: list[tuple[Any, ...]] = []  # (item, label, low, high): arguments of `_object`
    boxed = []  # objects without a node: (volume, id, lowest corner, highest corner)
    for item in items:
        label = names.canonical(item["category"])
        if label in STRUCTURE:
            continue
        low, high = np.array(item["aabb_min"], float), np.array(item["aabb_max"], float)
        object_id = len(objects) + 1
        if item["name"] in named_nodes:
            is_own = np.array([n.partition(".")[0] == item["name"] for n in faces.node_names])
            owner[is_own[faces.node]] = object_id  # the faces of the nodes with its name
        else:
            boxed.append((float(np.prod(high - low + 0.01)), object_id, low - 0.01, high + 0.01))
        objects.append((item, label, low, high))
    named = owner > 0  # faces that belong to an object by name
    # Largest box first, so that smaller boxes overwrite it.
    for _, object_id, low, high in sorted(boxed, key=lambda entry: -entry[0]):
        owner[((centers > low) & (centers < high)).all(axis=1) & ~named] = object_id
    return [
        _object(k + 1, *fields, faces.triangles[owner == k + 1], reach_m)
        for k, fields in enumerate(objects)
    ], owner


def _object(
    object_id: int,
    item: dict[str, Any],
    label: str,
    low: np.ndarray,
    high: np.ndarray,
    triangles: np.ndarray,
    reach_m: float,
) -> WorldObject:
    """Return an object with its footprint: the cells under its triangles up to `reach_m`.

    `low` and `high` are the lowest and the highest corner of its box; see `objects_of`.
    """
    center, size = 0.5 * (low + high), high - low
    # The grid has a margin of 0.1 m around the box.
    cols, rows = np.ceil((size[:2] + 0.2) / CELL_M).astype(int)
    grid, corner = np.zeros((rows, cols), np.uint8), low[:2] - 0.1
    # If no part of it is at the robot's height (a lamp, a picture), all of it counts.
    for top in (reach_m, math.inf):
        if not grid.any():
            mesh_kernels.rasterise_triangles(triangles, -1.0, top, corner, CELL_M, grid)
    row, col = np.nonzero(grid)
    footprint = (np.stack([col, row], axis=1) + 0.5) * CELL_M + corner
    return WorldObject(
        id=object_id,
        name=item["name"],
        label=label,
        category=item["category"],
        center_m=tuple(map(float, center)),
        size_m=tuple(map(float, size)),
        yaw_rad=0.0,  # the box is axis-parallel, for any yaw of the object
        footprint_m=footprint.astype(np.float32) if len(footprint) else None,
    )

"""World made of a scanned or modelled house: a textured mesh and a list of its objects.

It needs the extra `worlds`: trimesh reads the file, and embreex casts the rays of a LiDAR.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
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

CELL_M = 0.025  # side of a cell of the floor plan
_CLUSTER_FACES = 64  # see `raster_kernels`
_MARGIN_M = 0.5  # free border of the floor plan around the mesh
# Such houses often have no ceiling: the sky gets a ceiling's colour.
_SKY = np.array([236, 236, 233], np.uint8)
# The building itself: visible and solid, but never a target.
STRUCTURE = frozenset({"wall", "floor", "house wall", "room wall", "ceiling"})


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """All triangles of a scene in the map frame, with the arrays that `shade_hits` needs.

    Attributes:
        triangles: (n, 3, 3) float32, corners [m].
        normals: (n, 3, 3) float32, normals at the corners, of any length.
        uvs: (n, 3, 2) float32, texture coordinates of the corners.
        tint: (n, 3) float32, factors on red, green and blue.
        first_level: (n,) int64, row of `levels` with the largest copy of the face's texture.
        level_count: (n,) int64, number of copies of this texture; they follow in `levels`.
        texel_density: (n,) float32, texels per metre of the largest copy of the texture.
        node: (n,) int32, index into `node_names`.
        node_names: names of the nodes (placed parts) of the scene.
        texels: (t, 3) uint8, colours of all textures and their smaller copies, one after another.
        levels: (m, 3) int64, for each copy: index of its first texel, its height and its width.
    """

    triangles: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    tint: np.ndarray
    first_level: np.ndarray
    level_count: np.ndarray
    texel_density: np.ndarray
    node: np.ndarray
    node_names: list[str]
    texels: np.ndarray
    levels: np.ndarray

    @classmethod
    def join(
        cls, parts: list[tuple[np.ndarray, ...]], node_names: list[str], atlas: Atlas
    ) -> Faces:
        """Return the triangles of several results of `face_arrays` with the same atlas."""
        return cls(
            *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)),
            node_names=node_names,
            texels=np.concatenate(atlas.texels),
            levels=np.array(atlas.levels, np.int64),
        )


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


class Atlas:
    """Textures one after another, each with its smaller copies (mipmap levels).

    Attributes:
        texels: one (k, 3) uint8 array of colours for each copy.
        levels: for each copy: index of its first texel (in all arrays joined), height, width.
    """

    def __init__(self) -> None:
        self.texels: list[np.ndarray] = []
        self.levels: list[tuple[int, int, int]] = []
        self._next = 0  # index of the next texel
        self._added: dict[int, tuple[int, int]] = {}  # id of an image -> result of `add`

    def add(self, image: Any) -> tuple[int, int]:
        """Add an image (PIL), or plain white for None; return (first level, level count)."""
        key = id(image)  # faces of several geometries share an image
        if key in self._added:
            return self._added[key]
        pixels = np.full((1, 1, 3), 255.0) if image is None else np.asarray(image.convert("RGB"))
        first = len(self.levels)
        while True:
            height, width = pixels.shape[:2]
            self.levels.append((self._next, height, width))
            self.texels.append(np.asarray(pixels, np.uint8).reshape(-1, 3))
            self._next += height * width
            if height == width == 1:
                break
            pixels = _halve(np.asarray(pixels, np.float32))
        self._added[key] = (first, len(self.levels) - first)
        return self._added[key]


def _halve(pixels: np.ndarray) -> np.ndarray:
    """Average 2x2 pixels; an odd last row or column is dropped."""
    for axis in (0, 1):
        size = pixels.shape[axis]
        if size > 1:  # add the odd rows (columns) to the even ones
            even = np.take(pixels, range(0, size - size % 2, 2), axis)
            pixels = 0.5 * (even + np.take(pixels, range(1, size, 2), axis))
    return pixels


def read_faces(scene: Any) -> Faces:
    """Return all triangles of a trimesh scene, in `map`; a geometry may be placed several times.

    Raises:
        ValueError: the scene has no triangles.
    """
    atlas, parts, node_names = Atlas(), [], []
    for node_name in scene.graph.nodes_geometry:
        T, geometry_name = scene.graph[node_name]
        parts.append(face_arrays(scene.geometry[geometry_name], T, atlas, len(node_names)))
        node_names.append(node_name)
    if not parts:
        raise ValueError("the file has no triangles")
    return Faces.join(parts, node_names, atlas)


def face_arrays(mesh: Any, T: np.ndarray, atlas: Atlas, node: int) -> tuple[np.ndarray, ...]:
    """Return the arrays of `Faces` from `triangles` to `node`, in this order, for one geometry.

    Args:
        mesh: the geometry (trimesh).
        T: (4, 4) transform from the geometry's frame to `map`.
        atlas: the geometry's texture is added to it.
        node: index of the geometry's node.
    """
    count = len(mesh.faces)
    corners = mesh.vertices @ T[:3, :3].T + T[:3, 3]
    triangles = corners[mesh.faces]
    normals = _vertex_normals(triangles, mesh.faces, len(corners))[mesh.faces]
    material = getattr(mesh.visual, "material", None)
    image, uv = getattr(material, "baseColorTexture", None), getattr(mesh.visual, "uv", None)
    if image is None or uv is None:
        image, uv = None, np.zeros((len(mesh.vertices), 2))
    first, levels = atlas.add(image)
    # trimesh flips glTF's t, so that it counts upwards.
    uvs = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)[mesh.faces]
    factor = getattr(material, "baseColorFactor", None)
    tint = np.ones(3) if factor is None else np.asarray(factor[:3]) / 255.0
    _, height, width = atlas.levels[first]
    # Square root of the face's area in texels by its area in m².
    density = np.sqrt(
        _twice_area_2d(uvs * (width, height)) / np.maximum(_twice_area_3d(triangles), 1e-12)
    )
    return (
        np.ascontiguousarray(triangles, np.float32),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(uvs, np.float32),
        np.tile(tint.astype(np.float32), (count, 1)),
        np.full(count, first, np.int64),
        np.full(count, levels, np.int64),
        density.astype(np.float32),
        np.full(count, node, np.int32),
    )


def _vertex_normals(triangles: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Return (count, 3) sums of the normals around each vertex, weighted by area.

    trimesh's own function needs scipy to be fast, and the extra does not install scipy.
    """
    # (faces, 3), each as long as twice the face's area.
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    corner = faces.ravel()
    return np.stack(
        [np.bincount(corner, np.repeat(across[:, j], 3), minlength=count) for j in range(3)], axis=1
    )


def _twice_area_2d(t: np.ndarray) -> np.ndarray:
    a, b = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _twice_area_3d(t: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)


class MeshWorld:
    """World of a textured mesh; see `edge.lab.sim.base.World`.

    Args:
        name: of the world.
        faces: all triangles.
        objects: the objects.
        owner: (n,) uint16, id of the object that each triangle belongs to; 0 for the building.
        config: robot and camera.
        rooms: see `edge.lab.sim.base.World`.
        room_kinds: see `edge.lab.sim.base.World`.
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
        """See `edge.lab.sim.base.World`."""
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
        """See `edge.lab.sim.base.World`."""
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

    Args:
        faces: all triangles.
        items: the objects as `read_objects` returns them.
        reach_m: height of the robot; only lower parts of an object are in its footprint.
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

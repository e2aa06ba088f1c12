"""Scenes of a map: regions of its free ground, and its objects as a scene shows them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from edge import names
from edge.geometry import SE2, Grid, invert
from edge.mapping.grid import RollingMap
from edge.mapping.layers import ZONE
from edge.mapping.view import MapView
from edge.tasks.scene import terrain
from edge.tasks.scene.captions import caption_with_place
from edge.tasks.scene.frames import areas_px2, contours_of, transformed
from edge.tasks.scene.ground import reachable
from edge.tasks.scene.ground_votes import GroundVotes
from edge.tasks.scene.objects import SAME_SHARE, MapObject, ObjectMap, box_around, overlap_share
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.scene.value_map import IN_ZONE, open_cells
from edge.types import Detections, Instance, Observation

_FLOOR = "floor"  # label of free ground without another name
_INFLATED_VALUE = 50  # of inflated cells in a copy of the map; occupied ones have 100


def scene_of_map(
    view: MapView,
    observation: Observation,
    instances: Iterable[Instance],
    radius_m: float,
    found: Detections | None = None,
    object_map: ObjectMap | None = None,
    ground: GroundVotes | None = None,
) -> Scene:
    """Build a scene from the service's map and instances; each piece of free floor is one region.

    Votes name the kind of free ground. They neither open nor close cells.

    Args:
        view: the map.
        observation: the newest frame.
        instances: they become the objects, with their own ids.
        radius_m: see `SceneBuilder`.
        found: boxes of the same picture. A box around an instance's centre is its contour.
        object_map: object map of the same objects. A tracker keeps only a few points of an
            instance, and may have several instances of a large object.
        ground: votes for kinds of ground; None: all free ground is "floor".
    """
    objects = _with_all_points(
        [instance for instance in instances if len(instance.points_m)], object_map or ObjectMap()
    )
    contours = {} if found is None else _contours_by_object(objects, found)
    occupancy = terrain.with_blind_spot(uninflated(view, observation.pose), observation.pose)
    kind, labels = None, (_FLOOR,)
    if ground is not None:
        labels = (*ground.kinds, _FLOOR)
        kind = ground.classify(occupancy, observation.pose)
        kind[kind == 0] = len(labels)
        kind[~_free_ground(occupancy, observation.pose)] = 0
    return build_scene(observation, occupancy, kind, labels, objects, contours, radius_m)


def _free_ground(occupancy: Grid, pose: SE2) -> np.ndarray:
    """Return the free cells that the robot could drive to, (h, w) bool."""
    return reachable(occupancy.cells == 0, occupancy, pose)


def _with_all_points(instances: Sequence[Instance], object_map: ObjectMap) -> list[MapObject]:
    """Return the instances with all points that were seen of them, and with their captions.

    Instances of one object are merged, under the first of their ids.
    """
    objects: dict[int, MapObject] = {}
    for instance in sorted(instances, key=lambda instance: instance.id):
        # Key of the result: the id in the object map, or minus the id of an instance without one.
        points_m, key, captions = instance.points_m, -instance.id, Counter[str]()
        same_name = [
            obj for obj in object_map.objects.values() if names.same_name(obj.label, instance.label)
        ]
        share = [overlap_share(instance.points_m, obj.points_m) for obj in same_name]
        if share and max(share) >= SAME_SHARE:
            obj = same_name[int(np.argmax(share))]
            points_m, key = object_map.confirmed_points_m(obj), obj.id
            captions = obj.captions.get(obj.label, captions)
        merged = MapObject(
            instance.id,
            {instance.label: instance.score},
            points_m,
            {instance.label: captions},
            score=instance.score,
            hits=instance.hits,
        )
        objects.setdefault(key, merged)
    return list(objects.values())


def _contours_by_object(
    objects: Iterable[MapObject], found: Detections
) -> dict[int, list[np.ndarray]]:
    """Return the contours of each object in a picture.

    They come from the smallest box with the object's name that contains the median of its points.
    """
    observation, camera = found.observation, found.observation.camera
    if camera is None:
        return {}
    T = invert(observation.T_map_base @ observation.T_base_camera)
    area = areas_px2(found)
    contours = {}
    for obj in objects:
        x, y, z = transformed(T, np.median(obj.points_m, axis=0)[None])[0]
        if z <= 0.0:
            continue
        u, v = camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px
        x0, y0, x1, y1 = found.xyxy_px.T
        around = (x0 <= u) & (u <= x1) & (y0 <= v) & (v <= y1)
        around &= np.array([found.prompts[k] == obj.label for k in found.class_id], np.bool_)
        if around.any():
            indices = np.flatnonzero(around)[np.argmin(area[around])]
            contours[obj.id] = contours_of(found, int(indices))
    return contours


def build_scene(
    observation: Observation,
    occupancy: Grid,
    kind: np.ndarray | None,
    labels: Sequence[str],
    objects: Iterable[MapObject],
    contours: dict[int, list[np.ndarray]],
    radius_m: float,
) -> Scene:
    """Build the scene: regions of each kind of ground, and points of them nearest to each object.

    `kind` is (h, w) uint8, index into `labels` plus 1; 0: not drivable. If it is None, the ground
    is free ground that the robot could drive to, all of the first label.
    """
    pose = observation.pose
    if kind is None:
        kind = _free_ground(occupancy, pose).astype(np.uint8)
    regions, cells = terrain.regions_of(occupancy, kind, labels)
    allowed = reachable(open_cells(occupancy, cells, radius_m), occupancy, pose)
    described = {obj.id: scene_object(obj, pose, cells, allowed) for obj in objects}
    pictured = observation.rgb is not None and observation.camera is not None
    return Scene(
        observation.stamp_ns, pose, described, regions, occupancy, cells,
        rgb=observation.rgb if pictured else None,
        camera=observation.camera if pictured else None,
        T_map_camera=observation.T_map_base @ observation.T_base_camera if pictured else None,
        contours=contours,
    )  # fmt: skip


def scene_object(obj: MapObject, pose: SE2, regions: Grid, allowed: np.ndarray) -> SceneObject:
    """Return an object as a scene shows it, with the allowed points nearest to it."""
    position, size, heading = box_around(obj.points_m)
    return SceneObject(
        obj.id, obj.label, caption_with_place(obj.caption, position, size, pose), position,
        size,
        heading, obj.points_m, terrain.nearest_points(obj.points_m, regions, allowed),
    )  # fmt: skip


def uninflated(view: RollingMap | MapView, pose: SE2) -> Grid:
    """Return a map without inflation: inflated cells become free or unknown, as observed.

    Cells that zones close are `IN_ZONE`, unless the robot itself is in a zone: it must get out.
    """
    grid, n = view.snapshot(_INFLATED_VALUE), view.window.n
    corner = np.rint(np.array(grid.origin_xy_m) / grid.resolution_m).astype(np.int64)
    height, width = grid.cells.shape
    at = np.ix_((np.arange(height) + corner[1]) % n, (np.arange(width) + corner[0]) % n)
    inflated = grid.cells == _INFLATED_VALUE
    grid.cells[inflated] = np.where(view.layers.raw[at][inflated] > 0, 0, -1)
    closed, robot = view.layers.near[at] & ZONE != 0, grid.cell_of(pose.x_m, pose.y_m)
    if robot is not None and not closed[robot]:
        grid.cells[closed & (grid.cells <= 0)] = IN_ZONE
    return grid

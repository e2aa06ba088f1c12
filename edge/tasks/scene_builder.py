"""Building of a scene from sensor data: objects, occupancy, regions (OpenNav III-B).

`SceneBuilder` accumulates frames of a camera with LiDAR or depth. `scene_of_map` describes the
data that the service has already: its rolling map and its instances. A *frame* is one observation;
its *picture* is the camera's image.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from edge import config, names
from edge.geometry import SE2, Grid, invert
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.perception.detection.detector import check_rgb
from edge.tasks import terrain
from edge.tasks.captions import caption_with_place
from edge.tasks.ground import reachable
from edge.tasks.ground_votes import GroundVotes
from edge.tasks.objects import (
    MapObject,
    ObjectMap,
    box_around,
    main_clusters,
    overlap_share,
)
from edge.tasks.pipeline import (
    CaptionedDetections,
    GroundKinds,
    PerceptionPipeline,
    run_pipeline,
)
from edge.tasks.projection import in_picture, points_of_masks
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.value_map import open_cells
from edge.types import Detections, Instance, Observation

OFF_GROUND_M = 0.15
"""Points lower than this are ground, or show too little of an object."""
MARGIN_SHARE = 0.05
"""A point is clearly outside a box at this share of the box's size plus one pixel from it."""
MAX_RANGE_M = 300.0
"""Points beyond this are an error of the sensor or the file."""
MAX_DEPTH_POINTS = 60_000  # of a depth image; a larger one is thinned
MASK_SCALE = 4
"""Factor by which masks are enlarged before contours are drawn, for finer corners."""

_INFLATED_VALUE = 50  # of inflated cells in a copy of the map; occupied ones have 100

OUTDOORS = config.MappingConfig(
    input="cloud", resolution_m=0.2, extent_m=110.0, range_m=50.0, min_range_m=3.0,
    inflation_m=0.1, obstacle_min_m=0.25, obstacle_max_m=2.0,
)  # fmt: skip
"""Map for a 64-ring LiDAR on a car's roof; points within `min_range_m` are the car itself."""


class SceneBuilder:
    """Builds a scene from frames of a run, through a perception pipeline (OpenNav eq. 1-2).

    Call `add` for each frame, then `scene`.

    Args:
        pipeline: the pipeline.
        mapping: settings of the occupancy map.
        radius_m: clearance of the trajectories; at least the robot's radius.
        ground_labels: kinds of drivable ground, if they are known for points; empty: those of
            `pipeline.ground` in the picture and "ground" outside it, or without it free ground that
            is connected to the robot.

    Attributes:
        objects: the 3-D object map.
        map: the occupancy map.
    """

    def __init__(
        self,
        pipeline: PerceptionPipeline,
        mapping: config.MappingConfig = OUTDOORS,
        radius_m: float = 0.5,
        ground_labels: Sequence[str] = (),
    ) -> None:
        self.objects, self.map = ObjectMap(), RollingMap(mapping)
        self._pipeline, self._radius_m = pipeline, radius_m
        if pipeline.ground is not None and not ground_labels:
            ground_labels = (*pipeline.ground.kinds, terrain.GROUND)
        self._mapping, self._ground = mapping, GroundVotes(ground_labels)
        self._newest: Observation | None = None
        self._contours: dict[int, list[np.ndarray]] = {}

    def add(self, observation: Observation, ground_kind: np.ndarray | None = None) -> None:
        """Add a frame.

        Args:
            observation: the frame.
            ground_kind: (n,) uint8 for the points of its cloud, index into `ground_labels` plus 1;
                0: not drivable, or unknown. None: as `pipeline.ground` says.

        Raises:
            ValueError: the frame has no camera, no image, or neither cloud nor depth, or
                `ground_kind` has another number of points.
        """
        cloud_m, T_base_cloud = cloud_of(observation)
        if ground_kind is not None and len(ground_kind) != len(cloud_m):
            raise ValueError(
                f"ground_kind: expected {len(cloud_m)} values, one a point, got {len(ground_kind)}"
            )
        is_plausible = plausible_points(cloud_m)
        if not is_plausible.all():
            cloud_m = cloud_m[is_plausible]
            ground_kind = None if ground_kind is None else ground_kind[is_plausible]
        T_map_base, pose = observation.T_map_base, observation.pose
        T_map_cloud = T_map_base @ T_base_cloud
        points_m = _moved(T_map_cloud, cloud_m)
        self.map.update_cloud(cloud_m, T_map_base, T_base_cloud)
        base_z_m = float(T_map_base[2, 3])
        ground = terrain.estimate_ground(
            points_m, pose.x_m, pose.y_m, base_z_m, self._mapping.range_m
        )
        above = terrain.height_above(ground, points_m)
        if ground_kind is None and self._pipeline.ground is not None:
            ground_kind = _kinds_in_picture(
                self._pipeline.ground, observation, cloud_m, T_base_cloud, above
            )
        if ground_kind is not None:
            votes = _may_vote(cloud_m, above, self._mapping)
            self._ground.add(points_m[votes, :2], ground_kind[votes])
        result = run_pipeline(self._pipeline, observation)
        self._newest, self._contours = observation, {}
        for i, obj in _add_result(self.objects, result, cloud_m, points_m, above):
            self._contours.setdefault(obj.id, []).extend(contours_of(result.found, i))

    def scene(self) -> Scene:
        """Return the scene around the pose of the newest frame.

        Raises:
            ValueError: no frame was added.
        """
        if self._newest is None:
            raise ValueError("no frame was added; call SceneBuilder.add first")
        occupancy = terrain.with_blind_spot(uninflated(self.map), self._newest.pose)
        kind, labels = None, self._ground.kinds
        if labels:
            kind = self._ground.classify(occupancy, self._newest.pose)
        contours = {i: lines for i, lines in self._contours.items() if i in self.objects.objects}
        return _scene(
            self._newest, occupancy, kind, labels or (terrain.GROUND,),
            self.objects.objects.values(), contours, self._radius_m,
        )  # fmt: skip


def add_ground(
    votes: GroundVotes, ground: GroundKinds, observation: Observation, mapping: config.MappingConfig
) -> None:
    """Add the kinds of ground that one picture shows to votes of these kinds.

    Points outside the picture do not vote: a turn of the robot takes no name from the ground.

    Args:
        votes: the votes.
        ground: names the kind in each pixel.
        observation: the frame, with a camera and a cloud or depth.
        mapping: settings of the occupancy map.

    Raises:
        ValueError: the frame has no usable image, or see `cloud_of`.
        ModelError: the network failed.
    """
    cloud_m, T_base_cloud = cloud_of(observation)
    cloud_m = cloud_m[np.linalg.norm(cloud_m, axis=1) <= mapping.range_m]
    points_m = _moved(observation.T_map_base @ T_base_cloud, cloud_m)
    x_m, y_m, z_m = observation.T_map_base[:3, 3].tolist()
    height = terrain.estimate_ground(points_m, x_m, y_m, z_m, mapping.range_m)
    above = terrain.height_above(height, points_m)
    kind = _kinds_in_picture(ground, observation, cloud_m, T_base_cloud, above)
    keep = _may_vote(cloud_m, above, mapping) & (kind <= len(ground.kinds))
    votes.add(points_m[keep, :2], kind[keep])


def _may_vote(
    cloud_m: np.ndarray, above_m: np.ndarray, mapping: config.MappingConfig
) -> np.ndarray:
    """Return the points that vote for the kind of ground, (n,) bool.

    Nearer points are the robot's own body. Higher points are over the robot: the crown of a tree
    does not hide the ground below it.
    """
    is_body = np.linalg.norm(cloud_m, axis=1) < mapping.min_range_m
    return ~is_body & ~(above_m > mapping.obstacle_max_m)


def add_detections(objects: ObjectMap, found: Detections, range_m: float) -> None:
    """Add the objects in the boxes of one picture to an object map (OpenNav eq. 2).

    The box of an object also shows things in front of it, such as the chair before a desk. If the
    detector reports other objects, points in a smaller box do not count for the larger one.
    Background is outside the object's box in pictures from other places, and those vote against it.

    Args:
        objects: the object map.
        found: detections with their context, of a picture with a camera and a cloud or depth.
        range_m: points beyond this show too little of an object.

    Raises:
        ValueError: see `cloud_of`.
    """
    observation = found.observation
    cloud_m, T_base_cloud = cloud_of(observation)
    cloud_m = cloud_m[np.linalg.norm(cloud_m, axis=1) <= range_m]
    points_m = _moved(observation.T_map_base @ T_base_cloud, cloud_m)
    pose, base_z_m = observation.pose, float(observation.T_map_base[2, 3])
    ground = terrain.estimate_ground(points_m, pose.x_m, pose.y_m, base_z_m, range_m)
    above = terrain.height_above(ground, points_m)
    around, sensor_m = found.context_detections(), (observation.T_map_base @ T_base_cloud)[:3, 3]
    keep = above > OFF_GROUND_M
    smallest_px2 = np.full(len(points_m), np.inf)  # area of another object's box around the point
    if around is not None:
        for indices, area_px2 in _in_boxes(around, cloud_m, T_base_cloud, keep):
            smallest_px2[indices] = np.minimum(smallest_px2[indices], area_px2)
    for i, (indices, area_px2) in enumerate(_in_boxes(found, cloud_m, T_base_cloud, keep)):
        label, is_own = found.prompts[found.class_id[i]], smallest_px2[indices] >= area_px2
        points = points_m[indices[is_own]]
        points = points[main_clusters(points, sensor_m, _has_mask(found, i))]
        obj = objects.add(label, points, score=float(found.score[i]), picture=observation.seq)
        objects.vote(label, points, 1)
        objects.vote(label, points_m[indices[~is_own]], -1)
        if obj is not None:
            objects.vote_against(obj, points_m[_outside_boxes(found, label, cloud_m, T_base_cloud)])


def with_detected(
    scene: Scene, result: CaptionedDetections, radius_m: float, range_m: float
) -> Scene:
    """Return a scene with more objects: those in the boxes of a picture, under new ids.

    Args:
        scene: the scene.
        result: boxes of a frame with a camera and a cloud or depth.
        radius_m: see `SceneBuilder`.
        range_m: the ground is estimated up to this distance.

    Raises:
        ValueError: see `cloud_of`.
    """
    observation, pose = result.found.observation, scene.pose
    cloud_m, T_base_cloud = cloud_of(observation)
    cloud_m = cloud_m[plausible_points(cloud_m)]
    points_m = _moved(observation.T_map_base @ T_base_cloud, cloud_m)
    x_m, y_m, z_m = observation.T_map_base[:3, 3].tolist()
    ground = terrain.estimate_ground(points_m, x_m, y_m, z_m, range_m)
    above, newest = terrain.height_above(ground, points_m), max(scene.objects, default=0)
    allowed = reachable(
        open_cells(scene.occupancy, scene.regions_grid, radius_m), scene.occupancy, pose
    )
    objects, contours = dict(scene.objects), dict(scene.contours)
    for i, obj in _add_result(ObjectMap(), result, cloud_m, points_m, above):
        new = replace(_scene_object(obj, pose, scene.regions_grid, allowed), id=newest + obj.id)
        objects[new.id] = new
        contours.setdefault(new.id, []).extend(contours_of(result.found, i))
    return replace(scene, objects=objects, contours=contours)


def _add_result(
    objects: ObjectMap,
    result: CaptionedDetections,
    cloud_m: np.ndarray,
    points_m: np.ndarray,
    above_m: np.ndarray,
) -> Iterator[tuple[int, MapObject]]:
    """Add the objects of a pipeline's result to an object map; yield (box, object) for each.

    Args:
        objects: the object map.
        result: n boxes.
        cloud_m: (n, 3) points of the frame.
        points_m: the same points in `map`.
        above_m: (n,) their height over the ground.
    """
    found, seen = result.found, result.found.observation
    _, T_base_cloud = cloud_of(seen)
    sensor_m = (seen.T_map_base @ T_base_cloud)[:3, 3]
    in_boxes = _in_boxes(found, cloud_m, T_base_cloud, above_m > OFF_GROUND_M)
    for i, (indices, _) in enumerate(in_boxes):
        points = points_m[indices]
        points = points[main_clusters(points, sensor_m, _has_mask(found, i))]
        obj = objects.add(
            found.prompts[found.class_id[i]], points, result.caption[i], float(found.score[i]),
            None if result.embedding is None else result.embedding[i], seen.seq,
        )  # fmt: skip
        if obj is not None:
            yield i, obj


def _kinds_in_picture(
    ground: GroundKinds,
    observation: Observation,
    cloud_m: np.ndarray,
    T_base_cloud: np.ndarray,
    above_m: np.ndarray,
) -> np.ndarray:
    """Return the kind of ground of each point: index into (*`ground.kinds`, "ground") plus 1.

    A point that is not low is no ground (0), as is one in the picture whose pixel is none. Low
    points outside the picture are "ground": nothing names their kind.

    Args:
        ground: names the kind in each pixel.
        observation: the frame.
        cloud_m: (n, 3) points of the frame.
        T_base_cloud: (4, 4) their pose.
        above_m: (n,) their height over the ground.
    """
    T_camera_cloud = invert(observation.T_base_camera) @ T_base_cloud
    at_px, shown = in_picture(cloud_m, T_camera_cloud, observation.camera)
    kind = np.full(len(cloud_m), len(ground.kinds) + 1, np.uint8)
    column, row = at_px[shown].astype(np.intp).T
    kind[shown] = ground.classify(check_rgb(observation))[row, column]
    return np.where(np.abs(above_m) <= OFF_GROUND_M, kind, 0).astype(np.uint8)


def _has_mask(found: Detections, i: int) -> bool:
    return found.mask is not None and bool(found.mask[i].any())


def scene_of_map(
    view: MapView,
    observation: Observation,
    instances: Iterable[Instance],
    radius_m: float,
    found: Detections | None = None,
    floor: str = "floor",
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
        floor: label of free ground without another name.
        object_map: object map of the same objects. A tracker keeps only a few points of an
            instance, and may have several instances of a large object.
        ground: votes for kinds of ground; None: all free ground is `floor`.
    """
    objects = _with_all_points(
        [instance for instance in instances if len(instance.points_m)], object_map or ObjectMap()
    )
    contours = {} if found is None else _contours_by_object(objects, found)
    occupancy = terrain.with_blind_spot(uninflated(view), observation.pose)
    kind, labels = None, (floor,)
    if ground is not None:
        labels = (*ground.kinds, floor)
        kind = ground.classify(occupancy, observation.pose)
        kind[kind == 0] = len(labels)
        kind[~_free_ground(occupancy, observation.pose)] = 0
    return _scene(observation, occupancy, kind, labels, objects, contours, radius_m)


def _free_ground(occupancy: Grid, pose: SE2) -> np.ndarray:
    """Return the free cells that the robot could drive to, (h, w) bool."""
    return reachable(occupancy.cells == 0, occupancy, pose)


def _with_all_points(instances: Sequence[Instance], object_map: ObjectMap) -> list[MapObject]:
    """Return the instances with all points that were seen of them.

    Instances of one object are merged, under the first of their ids.
    """
    objects: dict[int, MapObject] = {}
    for instance in sorted(instances, key=lambda instance: instance.id):
        # Key of the result: the id in the object map, or minus the id of an instance without one.
        points_m, key = instance.points_m, -instance.id
        same_name = [
            obj for obj in object_map.objects.values() if names.same_name(obj.label, instance.label)
        ]
        share = [overlap_share(instance.points_m, obj.points_m) for obj in same_name]
        if share and max(share) > 0.0:
            obj = same_name[int(np.argmax(share))]
            points_m, key = object_map.confirmed_points_m(obj), obj.id
        merged = MapObject(
            instance.id,
            {instance.label: instance.score},
            points_m,
            score=instance.score,
            hits=instance.hits,
        )
        objects.setdefault(key, merged)
    return list(objects.values())


def _outside_boxes(
    found: Detections, label: str, cloud_m: np.ndarray, T_base_cloud: np.ndarray
) -> np.ndarray:
    """Return the points in the picture that are clearly outside every box of a label, (n,) bool."""
    observation, camera = found.observation, found.observation.camera
    x, y, z = _moved(invert(observation.T_base_camera) @ T_base_cloud, cloud_m).T
    ahead = z > 0.0
    z = np.where(ahead, z, 1.0)
    u, v = camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px
    outside = ahead & (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
    for box_px, k in zip(found.xyxy_px, found.class_id, strict=True):
        if found.prompts[k] == label:
            x0, y0, x1, y1 = box_px.tolist()
            mx, my = MARGIN_SHARE * (x1 - x0) + 1.0, MARGIN_SHARE * (y1 - y0) + 1.0
            outside &= (u < x0 - mx) | (u > x1 + mx) | (v < y0 - my) | (v > y1 + my)
    return outside


def _in_boxes(
    found: Detections, cloud_m: np.ndarray, T_base_cloud: np.ndarray, keep: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield the points of each box's object, as indices into the cloud, and the area of the box.

    `keep` is (n,) bool, the points to use.
    """
    observation = found.observation
    T_camera_cloud = invert(observation.T_base_camera) @ T_base_cloud
    in_boxes = points_of_masks(
        cloud_m, T_camera_cloud, observation.camera, found.xyxy_px, found.mask, keep
    )
    return zip(in_boxes, _areas_px2(found).tolist(), strict=True)


def _areas_px2(found: Detections) -> np.ndarray:
    """Return the area of each box, (n,) float32."""
    return np.prod(found.xyxy_px[:, 2:] - found.xyxy_px[:, :2], axis=1)


def uninflated(view: RollingMap | MapView) -> Grid:
    """Return a map without inflation: inflated cells become free or unknown, as observed."""
    grid, n = view.snapshot(_INFLATED_VALUE), view.window.n
    rows, columns = np.nonzero(grid.cells == _INFLATED_VALUE)
    corner = np.rint(np.array(grid.origin_xy_m) / grid.resolution_m).astype(np.int64)
    seen = view.layers.raw[(rows + corner[1]) % n, (columns + corner[0]) % n] > 0
    grid.cells[rows, columns] = np.where(seen, 0, -1)
    return grid


def cloud_of(observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Return the observation's points (n, 3) float32 and their pose T_base_cloud.

    The points are those of the LiDAR, else of the depth image.

    Raises:
        ValueError: it has neither, or the depth image does not fit its camera.
    """
    if observation.cloud_m is not None:
        return observation.cloud_m, observation.T_base_lidar
    depth, camera = observation.depth_m, observation.camera
    if depth is None or camera is None or depth.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"observation {observation.seq}: it has neither a cloud nor a depth image of the same "
            "size as the camera's"
        )
    stride = max(1, int(np.ceil(np.sqrt(depth.size / MAX_DEPTH_POINTS))))
    z = depth[::stride, ::stride]
    v, u = np.nonzero((z > 0.0) & np.isfinite(z))
    z = z[v, u]
    x = (u * stride - camera.cx_px) / camera.fx_px * z
    y = (v * stride - camera.cy_px) / camera.fy_px * z
    return np.stack((x, y, z), axis=1).astype(np.float32), observation.T_base_camera


def plausible_points(cloud_m: np.ndarray) -> np.ndarray:
    """Return the points (n, 3) of a scan that are finite and not absurdly far, (n,) bool."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.linalg.norm(cloud_m, axis=1) <= MAX_RANGE_M


def contours_of(found: Detections, i: int) -> list[np.ndarray]:
    """Return the outlines of box i's mask, or of the box if it has none: (k, 2) int32 polygons."""
    x0, y0, x1, y1 = found.xyxy_px[i]
    if found.mask is None or not found.mask[i].any():
        return [np.rint([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]).astype(np.int32)]
    mask = np.kron(found.mask[i], np.ones((MASK_SCALE, MASK_SCALE), np.bool_)).astype(np.uint8)
    lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    scale = np.array([(x1 - x0) / mask.shape[1], (y1 - y0) / mask.shape[0]])
    corner = np.array([x0, y0])
    return [np.rint(corner + line[:, 0] * scale).astype(np.int32) for line in lines]


def _moved(T: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Transform points to another frame, (n, 3) float32."""
    return points_m @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)


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
    area = _areas_px2(found)
    contours = {}
    for obj in objects:
        x, y, z = _moved(T, np.median(obj.points_m, axis=0)[None])[0]
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


def _scene(
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
    described = {obj.id: _scene_object(obj, pose, cells, allowed) for obj in objects}
    pictured = observation.rgb is not None and observation.camera is not None
    return Scene(
        observation.stamp_ns, pose, described, regions, occupancy, cells,
        rgb=observation.rgb if pictured else None,
        camera=observation.camera if pictured else None,
        T_map_camera=observation.T_map_base @ observation.T_base_camera if pictured else None,
        contours=contours,
    )  # fmt: skip


def _scene_object(obj: MapObject, pose: SE2, regions: Grid, allowed: np.ndarray) -> SceneObject:
    position, size, heading = box_around(obj.points_m)
    return SceneObject(
        obj.id, obj.label, caption_with_place(obj.caption, position, size, pose), position,
        size,
        heading, obj.points_m, terrain.nearest_points(obj.points_m, regions, allowed),
    )  # fmt: skip

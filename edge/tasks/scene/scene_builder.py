"""Building of a scene from sensor data: objects, occupancy, regions (OpenNav III-B).

`SceneBuilder` accumulates frames of a camera with LiDAR or depth. A *frame* is one observation; its
*picture* is the camera's image. `map_scene` describes the data that the service has
already: its rolling map and its instances.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge import config
from edge.geometry import invert
from edge.mapping.grid import RollingMap
from edge.perception.detection.detector import check_rgb
from edge.tasks.scene import terrain
from edge.tasks.scene.captions import compose_captions
from edge.tasks.scene.frames import (
    MAX_RANGE_M,
    cloud_of,
    contours_of,
    has_mask,
    outside_boxes,
    points_in_boxes,
    points_within,
    transformed,
)
from edge.tasks.scene.ground import reachable
from edge.tasks.scene.ground_votes import GroundVotes
from edge.tasks.scene.map_scene import build_scene, scene_object, uninflated
from edge.tasks.scene.objects import MapObject, ObjectMap, main_clusters
from edge.tasks.scene.pipeline import (
    CaptionedDetections,
    GroundKinds,
    PerceptionPipeline,
    run_pipeline,
)
from edge.tasks.scene.projection import in_picture
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.value_map import open_cells
from edge.types import Detections, Observation

OFF_GROUND_M = 0.15
"""Points lower than this are ground, or show too little of an object."""

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
        points = _points_of(observation, self._mapping.range_m, MAX_RANGE_M)
        if ground_kind is not None:
            if len(ground_kind) != len(points.kept):
                raise ValueError(
                    f"ground_kind: expected {len(points.kept)} values, one a point, got "
                    f"{len(ground_kind)}"
                )
            ground_kind = ground_kind[points.kept]
        self.map.update_cloud(points.cloud_m, observation.T_map_base, points.T_base_cloud)
        if ground_kind is None and self._pipeline.ground is not None:
            ground_kind = _kinds_in_picture(self._pipeline.ground, observation, points)
        if ground_kind is not None:
            votes = _may_vote(points, self._mapping)
            self._ground.add(points.points_m[votes, :2], ground_kind[votes])
        result = run_pipeline(self._pipeline, observation)
        self._newest, self._contours = observation, {}
        for i, obj in _add_result(self.objects, result, points):
            self._contours.setdefault(obj.id, []).extend(contours_of(result.found, i))

    def scene(self) -> Scene:
        """Return the scene around the pose of the newest frame.

        Raises:
            ValueError: no frame was added.
        """
        if self._newest is None:
            raise ValueError("no frame was added; call SceneBuilder.add first")
        occupancy = terrain.with_blind_spot(
            uninflated(self.map, self._newest.pose), self._newest.pose
        )
        kind, labels = None, self._ground.kinds
        if labels:
            kind = self._ground.classify(occupancy, self._newest.pose)
        contours = {i: lines for i, lines in self._contours.items() if i in self.objects.objects}
        return build_scene(
            self._newest, occupancy, kind, labels or (terrain.GROUND,),
            self.objects.objects.values(), contours, self._radius_m,
        )  # fmt: skip


def add_ground(
    votes: GroundVotes, ground: GroundKinds, observation: Observation, mapping: config.MappingConfig
) -> None:
    """Add the kinds of ground that one picture shows to votes of these kinds.

    Points outside the picture do not vote: a turn of the robot takes no name from the ground.

    Raises:
        ValueError: the frame has no usable image, or see `cloud_of`.
        ModelError: the network failed.
    """
    points = _points_of(observation, mapping.range_m, mapping.range_m)
    kind = _kinds_in_picture(ground, observation, points)
    keep = _may_vote(points, mapping) & (kind <= len(ground.kinds))
    votes.add(points.points_m[keep, :2], kind[keep])


class _Points(NamedTuple):
    """The points of a frame.

    Attributes:
        kept: (m,) bool, the points of the observation that are here.
        cloud_m: (n, 3) float32.
        T_base_cloud: (4, 4) their pose.
        sensor_m: (3,) their sensor in `map`.
        points_m: (n, 3) float32, the same points in `map`.
        above_m: (n,) float32, their height over the ground; NaN where it is not known.
    """

    kept: np.ndarray
    cloud_m: np.ndarray
    T_base_cloud: np.ndarray
    sensor_m: np.ndarray
    points_m: np.ndarray
    above_m: np.ndarray


def _points_of(observation: Observation, ground_range_m: float, range_m: float) -> _Points:
    """Return the points of a frame up to `range_m`; the ground is known up to `ground_range_m`."""
    cloud_m, T_base_cloud = cloud_of(observation)
    kept = points_within(cloud_m, range_m)
    cloud_m, T_map_cloud = cloud_m[kept], observation.T_map_base @ T_base_cloud
    points_m = transformed(T_map_cloud, cloud_m)
    x_m, y_m, z_m = observation.T_map_base[:3, 3].tolist()
    ground = terrain.estimate_ground(points_m, x_m, y_m, z_m, ground_range_m)
    above_m = terrain.height_above(ground, points_m)
    return _Points(kept, cloud_m, T_base_cloud, T_map_cloud[:3, 3], points_m, above_m)


def _may_vote(points: _Points, mapping: config.MappingConfig) -> np.ndarray:
    """Return the points that vote for the kind of ground, (n,) bool.

    Nearer points are the robot's own body. Higher points are over the robot: the crown of a tree
    does not hide the ground below it.
    """
    is_body = np.linalg.norm(points.cloud_m, axis=1) < mapping.min_range_m
    return ~is_body & ~(points.above_m > mapping.obstacle_max_m)


def _kinds_in_picture(ground: GroundKinds, observation: Observation, points: _Points) -> np.ndarray:
    """Return the kind of ground of each point: index into (*`ground.kinds`, "ground") plus 1.

    A point that is not low is no ground (0), as is one in the picture whose pixel is none. Low
    points outside the picture are "ground": nothing names their kind.
    """
    T_camera_cloud = invert(observation.T_base_camera) @ points.T_base_cloud
    at_px, shown = in_picture(points.cloud_m, T_camera_cloud, observation.camera)
    kind = np.full(len(points.cloud_m), len(ground.kinds) + 1, np.uint8)
    column, row = at_px[shown].astype(np.intp).T
    kind[shown] = ground.classify(check_rgb(observation))[row, column]
    return np.where(np.abs(points.above_m) <= OFF_GROUND_M, kind, 0).astype(np.uint8)


def add_detections(objects: ObjectMap, found: Detections, range_m: float) -> None:
    """Add the objects in the boxes of one picture to an object map (OpenNav eq. 2).

    The box of an object also shows objects in front of it, such as the chair before a desk. If the
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
    _, cloud_m, T_base_cloud, sensor_m, points_m, above_m = _points_of(
        observation, range_m, range_m
    )
    around, caption = found.context_detections(), compose_captions(found)
    keep = above_m > OFF_GROUND_M
    smallest_px2 = np.full(len(points_m), np.inf)  # area of another object's box around the point
    if around is not None:
        for indices, area_px2 in points_in_boxes(around, cloud_m, T_base_cloud, keep):
            smallest_px2[indices] = np.minimum(smallest_px2[indices], area_px2)
    for i, (indices, area_px2) in enumerate(points_in_boxes(found, cloud_m, T_base_cloud, keep)):
        label, is_own = found.prompts[found.class_id[i]], smallest_px2[indices] >= area_px2
        points = points_m[indices[is_own]]
        points = points[main_clusters(points, sensor_m, has_mask(found, i))]
        obj = objects.add(label, points, caption[i], float(found.score[i]), picture=observation.seq)
        objects.vote(label, points, 1)
        objects.vote(label, points_m[indices[~is_own]], -1)
        if obj is not None:
            objects.vote_against(obj, points_m[outside_boxes(found, label, cloud_m, T_base_cloud)])


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
    points = _points_of(result.found.observation, range_m, MAX_RANGE_M)
    pose, newest = scene.pose, max(scene.objects, default=0)
    allowed = reachable(
        open_cells(scene.occupancy, scene.regions_grid, radius_m), scene.occupancy, pose
    )
    objects, contours = dict(scene.objects), dict(scene.contours)
    for i, obj in _add_result(ObjectMap(), result, points):
        new = replace(scene_object(obj, pose, scene.regions_grid, allowed), id=newest + obj.id)
        objects[new.id] = new
        contours.setdefault(new.id, []).extend(contours_of(result.found, i))
    return replace(scene, objects=objects, contours=contours)


def _add_result(
    objects: ObjectMap, result: CaptionedDetections, points: _Points
) -> Iterator[tuple[int, MapObject]]:
    """Add the objects of a pipeline's result to an object map; yield (box, object) for each."""
    found = result.found
    keep = points.above_m > OFF_GROUND_M
    in_boxes = points_in_boxes(found, points.cloud_m, points.T_base_cloud, keep)
    for i, (indices, _) in enumerate(in_boxes):
        own_m = points.points_m[indices]
        own_m = own_m[main_clusters(own_m, points.sensor_m, has_mask(found, i))]
        obj = objects.add(
            found.prompts[found.class_id[i]], own_m, result.caption[i], float(found.score[i]),
            found.observation.seq,
        )  # fmt: skip
        if obj is not None:
            yield i, obj

"""Back-projection of 2-D boxes to 3-D points in `map`, by depth or LiDAR cloud (VL-Nav III.C).

`BackProjector` is the stage between the detector and the trackers.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from edge import config
from edge.geometry import CameraModel, invert
from edge.perception.tracking import back_projection_kernels as kernels
from edge.perception.tracking.sample_kernels import SIDE, cloud_raster
from edge.types import MASK_SIDE, Detections, Observation

log = logging.getLogger(__name__)

POINTS = 32
"""Number of surface points kept of each box."""
_RASTER_COLUMNS = 320  # most columns of the raster of a cloud
# Placeholders for inputs that are not used.
_NO_DEPTH = np.zeros((1, 1), np.float32)
_NO_RASTER = np.full((1, 1), -1, np.int32)
_NO_POINTS = np.zeros((1, 3), np.float32)
_NO_MASKS = np.zeros((0, MASK_SIDE, MASK_SIDE), np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class BackProjectedBoxes:
    """Positions of the boxes of `detections`, as arrays parallel to them.

    Attributes:
        center_m: (n, 3) float32 in `map`, median of the surface points.
        points_m: (n, POINTS, 3) float32 in `map`; the first `n_points[i]` of row i count.
        n_points: (n,) int32, number of surface points of each box.
        valid: (n,) bool; False if the object gave too few returns.
    """

    detections: Detections
    center_m: np.ndarray
    points_m: np.ndarray
    n_points: np.ndarray
    valid: np.ndarray

    def __len__(self) -> int:
        return len(self.valid)

    def surface_m(self, i: int) -> np.ndarray:
        """Return the surface points of box i, (k, 3) float32 in `map`."""
        return self.points_m[i, : self.n_points[i]]


class BackProjector:
    """Back-projects boxes with the depth or cloud, and the pose, of their own observation.

    A box also shows what is in front of and behind the object. In the inner part of the box, the
    surface is chosen that fits the box best (`back_projection_kernels.choose_surface`), without
    the floor under the object. If the detections have masks, only samples on the mask count.

    Attributes:
        skipped: number of observations with boxes but without the camera, depth or cloud needed.
    """

    def __init__(self, perception: config.PerceptionConfig) -> None:
        self.config = perception
        self.skipped = 0
        side = SIDE
        self._scratch = (  # see `back_projection_kernels.back_project_boxes`
            np.empty((side * side, 3), np.float32),
            np.empty((4, side * side, 3), np.float32),
            np.empty(4, np.int32),
            np.empty(kernels.BINS, np.int32),
            np.empty((kernels.BINS, 3), np.float32),
            np.empty((3, side * side), np.float32),
        )
        self._raster = _NO_RASTER
        self._cloud_points = _NO_POINTS

    def back_project(
        self, detections: Detections, floor_over_base_m: float = 0.0
    ) -> tuple[BackProjectedBoxes, BackProjectedBoxes | None]:
        """Back-project all boxes; those without enough returns are marked invalid, never left out.

        If the observation lacks the camera, depth or cloud (such as from a LiDAR that stopped), it
        is counted in `skipped`, and all its boxes are invalid.

        Args:
            detections: boxes of targets and of the context.
            floor_over_base_m: height of the floor over the base frame.

        Returns:
            The targets' boxes, and the boxes of context words (None: the detector does not look for
            them). All are processed together, since one object may hide much of another.
        """
        observation, context = detections.observation, detections.context_detections()
        k, boxes, word = len(detections), detections.xyxy_px, detections.class_id
        if context is not None:
            # One array for all: the context's class numbers follow those of the targets.
            boxes = np.concatenate((boxes, context.xyxy_px))
            word = np.concatenate((word, context.class_id + np.int32(len(detections.prompts))))
        n = len(boxes)
        out = (  # in the order of `BackProjectedBoxes`
            np.zeros((n, 3), np.float32),
            np.zeros((n, POINTS, 3), np.float32),
            np.zeros(n, np.int32),
            np.zeros(n, np.bool_),
        )
        if n and self._can_back_project(observation):
            camera, by_cloud = observation.camera, self.config.back_projection == "cloud"
            masks = _NO_MASKS if detections.mask is None else detections.mask
            cell_px = self._project(observation, camera) if by_cloud else 0
            view = (
                _NO_DEPTH if by_cloud else observation.depth_m, self._raster, self._cloud_points,
                float(cell_px), camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px,
            )  # fmt: skip
            floor_z_m = float(observation.T_map_base[2, 3]) + floor_over_base_m + kernels.FLOOR_M
            kernels.back_project_boxes(
                view, boxes, masks, word, observation.T_map_base @ observation.T_base_camera,
                floor_z_m, self.config.back_projection_max_range_m,
                self.config.back_projection_min_points, self._scratch, out,
            )  # fmt: skip
        others = (
            None if context is None else BackProjectedBoxes(context, *(array[k:] for array in out))
        )
        return BackProjectedBoxes(detections, *(array[:k] for array in out)), others

    def _can_back_project(self, observation: Observation) -> bool:
        """Return True if the observation can be back-projected; log the first that cannot."""
        if missing := self._missing_input(observation):
            self.skipped += 1
            if self.skipped == 1:
                log.warning("observation %d: %s; its boxes get no position in the map (further "
                            "ones are only counted)", observation.seq, missing)  # fmt: skip
        return not missing

    def _missing_input(self, observation: Observation) -> str:
        """Return the input that the observation lacks for back-projection, or ""."""
        camera, depth = observation.camera, observation.depth_m
        if camera is None:
            return "no camera model"
        if self.config.back_projection == "cloud":
            missing = observation.cloud_m is None
            return "no cloud (perception.back_projection: cloud)" if missing else ""
        if depth is None:
            return "no depth (perception.back_projection: depth)"
        if depth.shape != (camera.height_px, camera.width_px):
            return (
                f"depth {depth.shape} does not fit the {camera.height_px}x{camera.width_px} camera"
            )
        return ""

    def _project(self, observation: Observation, camera: CameraModel) -> int:
        """Project the cloud into the raster; return the side of a raster cell in pixels."""
        cell_px = max(1, -(-camera.width_px // _RASTER_COLUMNS))  # -(-a // b): a / b rounded up
        shape = (-(-camera.height_px // cell_px), -(-camera.width_px // cell_px))
        if self._raster.shape != shape:
            self._raster = np.empty(shape, np.int32)
        if len(self._cloud_points) < len(observation.cloud_m):
            self._cloud_points = np.empty((len(observation.cloud_m), 3), np.float32)
        cloud_raster(
            observation.cloud_m, invert(observation.T_base_camera) @ observation.T_base_lidar,
            camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, float(cell_px),
            self._raster, self._cloud_points,
        )  # fmt: skip
        return cell_px

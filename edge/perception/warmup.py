"""Compilation of the perception kernels, before the first image needs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from edge import config
from edge.geometry import CameraModel
from edge.perception.detection import kernels
from edge.perception.tracking import instance_kernels, look_kernels, place_index
from edge.perception.tracking.fusion import InstanceFusion
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.lift import BackProjector
from edge.perception.tracking.sightings import ObjectTracker
from edge.perception.tracking.track import MAX_POINTS
from edge.types import Detections, Observation


def warmup(lifts: Sequence[str] = ("depth", "cloud")) -> None:
    """Run every kernel once, with the types of its calls; the disk caches the result.

    Args:
        lifts: sources of 3-D points to warm up, as in `perception.back_projection`.
    """
    rgb = np.zeros((16, 16, 3), np.uint8)
    kernels.to_planes(rgb, np.float32(1 / 255), 0, 0, np.zeros((3, 16, 16), np.float32))
    boxes = np.array([[0, 0, 8, 8], [1, 1, 9, 9]], np.float32)
    scores = np.array([[0.9, 0.1], [0.5, 0.8]], np.float32)
    anchor, label, keep = np.zeros(2, np.int32), np.zeros(2, np.int32), np.zeros(2, np.int32)
    score, top, tau = np.zeros(2, np.float32), np.zeros(2, np.float32), np.float32(0.05)
    found, _ = kernels.candidates(boxes, scores, 1, tau, 1e3, anchor, label, score, top)
    kernels.best_per_class(scores, np.arange(2, dtype=np.int32), np.zeros((2, 2), np.float32))
    n = kernels.suppress(boxes, anchor, label, score, found, 0, 1, False, 0.5, keep)
    xyxy, cut = np.zeros((2, 4), np.float32), np.zeros(2, np.bool_)
    n = kernels.to_image(boxes, anchor, keep, n, 1.0, 0, 0, 16, 16, xyxy, cut)
    kernels.competing_scores(
        boxes, scores, np.ones((2, 1, 2), np.bool_), tau, top, anchor, label, keep, n, cut, 0.5,
        np.zeros(2, np.float32),
    )  # fmt: skip
    kernels.object_boxes(
        np.ones((16, 16), np.uint16), np.ones((16, 16), np.float32), np.zeros((1, 4), np.int32),
        np.zeros(1, np.int32), np.zeros(1, np.float32),
    )  # fmt: skip
    _warm_up_tracking(lifts)


def _warm_up_tracking(lifts: Sequence[Literal["depth", "cloud"]]) -> None:
    """Run the kernels of back-projection and of both trackers; see `warmup`."""
    seen = Observation(
        seq=0,
        stamp_ns=0,
        T_map_base=np.eye(4),
        depth_m=np.ones((16, 16), np.float32),
        camera=CameraModel.from_hfov(16, 16, 1.3),
        cloud_m=np.ones((4, 3), np.float32),
    )
    detections = Detections(
        observation=seen,
        xyxy_px=np.array([[0, 0, 16, 16]], np.float32),
        score=np.ones(1, np.float32),
        class_id=np.zeros(1, np.int32),
        prompts=("chair",),
    )
    for source in lifts:
        perception = config.PerceptionConfig(back_projection=source, detector=config.DetectorSim())
        lifted, _ = BackProjector(perception).back_project(detections)
    clear = replace(lifted, valid=np.ones(1, np.bool_), n_points=np.ones(1, np.int32))
    sightings = ObjectTracker(perception)
    sightings.update(clear, clear)
    sightings.has_competing_object("chair", np.ones((1, 3), np.float32), 0.1)
    sightings.clear()
    index = place_index.make_index(1)
    place_index.insert(index, 0, 0.0, 0.0)
    place_index.remove(index, 0)
    fusion = InstanceFusion(InstanceTracker(perception))
    fusion.update(lifted, 0)
    fusion.expire(seen, detections.prompts)
    # Kernels for an instance that is seen again. The detection above is too weak to make one, so
    # they are called directly.
    points_m = np.zeros((1, 3), np.float32)
    support = np.ones(1, np.int32)
    instance_kernels.merge_points(points_m, support, points_m, perception.voxel_m, MAX_POINTS)
    instance_kernels.core_points(points_m, support)
    instance_kernels.nearest(points_m, 0.0, 0.0)
    instance_kernels.least_gap(points_m, points_m)
    view = look_kernels.view_of(seen.camera)
    look_kernels.visibility(0.0, 0.0, 1.0, points_m, 1, np.eye(4), view, seen.depth_m, 6.0)

"""One target's object with its evidence: the scores and viewpoints that decide about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from edge import config
from edge.geometry import FARTHEST_M, SE2, wrap_angle
from edge.perception.tracking import instance_kernels as kernels
from edge.types import Instance

MAX_POINTS = 64  # surface points of an instance
VOXEL_M = 0.1  # spacing of an object's points
# Weights of a new score in the running score. A good view counts more than a bad one, since most
# views are from afar or from the side.
RISE = 0.5  # if the new score is above the running one
FALL = 0.15  # if it is below
FORGET_VIEWS = 100
"""After this many views the counts for confirmation are halved, so that old views fade."""
VIEWPOINT_M, VIEWPOINT_RAD = 0.5, math.radians(20)
"""Two views are from different viewpoints if the robot has moved, or turned around the object, by
this much."""


@dataclass(slots=True, eq=False)
class InstanceTrack:
    """An instance with the evidence that decides about its state.

    Attributes:
        instance: the instance, as other modules see it.
        name: canonical form of the label.
        evidence_ns: newest stamp of any detection of the instance, weak ones included.
        good_hits: number of frames from near by whose score confirms (`confirm_score_of`).
        other_hits: number of these from another viewpoint than the first one.
        first_x_m, first_y_m: the robot's position at the first of these frames; far away if it is
            unknown.
        views: number of views from near by that should show the instance; a partial view counts
            less than 1.
        good_ns: stamp of the newest frame in `good_hits`; -1: there is none.
        target_sum: sum of the target's scores in these views, weighted as in `views`.
        competing_sum: such a sum of the scores of the target's best competing class.
        now_target, now_competing: these two scores in the current frame.
        x_m, y_m, z_m: the centre in `map`, as plain numbers.
        radius_m: largest planar distance of a surface point from the centre.
        points_m: (k, 3) float32 in `map`, all surface points. `instance` has only the
            well-supported ones (`core_points`).
        support: (k,) int32, number of views that support each of these points.
        contested: True if another object explains the place better (see `InstanceFusion`).
    """

    instance: Instance
    name: str
    evidence_ns: int
    good_hits: int = 0
    other_hits: int = 0
    first_x_m: float = FARTHEST_M
    first_y_m: float = FARTHEST_M
    views: float = 0.0
    good_ns: int = -1
    target_sum: float = 0.0
    competing_sum: float = 0.0
    now_target: float = 0.0
    now_competing: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    radius_m: float = 0.0
    points_m: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.float32))
    support: np.ndarray = field(default_factory=lambda: np.empty(0, np.int32))
    contested: bool = False

    def distance_m(self, x_m: float, y_m: float) -> float:
        return math.hypot(self.x_m - x_m, self.y_m - y_m)

    def is_other_viewpoint(self, pose: SE2) -> bool:
        """Return True if a pose is another viewpoint than that of the first good hit."""
        first = math.atan2(self.first_y_m - self.y_m, self.first_x_m - self.x_m)
        now = math.atan2(pose.y_m - self.y_m, pose.x_m - self.x_m)
        moved_m = pose.distance_to(self.first_x_m, self.first_y_m)
        return moved_m >= VIEWPOINT_M or abs(wrap_angle(now - first)) >= VIEWPOINT_RAD

    def has_two_viewpoints(self, confirm_hits: int) -> bool:
        """Return True if half of `confirm_hits` are from another viewpoint than the first one."""
        return self.other_hits >= confirm_hits // 2

    def only_viewpoint(self, confirm_hits: int) -> tuple[float, float] | None:
        """Return where the robot was at the first good hit, if it was confirmed from there alone.

        None if the instance is not confirmed, or has enough hits from another viewpoint.
        """
        if not self.instance.is_confirmed or self.has_two_viewpoints(confirm_hits):
            return None
        return self.first_x_m, self.first_y_m

    def overlaps(self, other: InstanceTrack, near_m: float) -> bool:
        """Return True if one centre is nearer than `near_m` to the other instance's points."""
        if self.distance_m(other.x_m, other.y_m) > near_m + max(self.radius_m, other.radius_m):
            return False
        to_other = kernels.nearest(self.instance.points_m, other.x_m, other.y_m)
        return min(to_other, kernels.nearest(other.instance.points_m, self.x_m, self.y_m)) < near_m

    def merge(
        self, points: np.ndarray, score: float, stamp_ns: int, c: config.PerceptionConfig
    ) -> None:
        """Merge a detection into the instance; into a rejected one, only its stamp."""
        self.evidence_ns = max(self.evidence_ns, stamp_ns)
        instance = self.instance
        if instance.state == "rejected":
            return
        weight = RISE if score > instance.score else FALL
        instance.score += weight * (score - instance.score)
        if score > c.tau_det:
            instance.hits += 1
            instance.last_seen_ns = max(instance.last_seen_ns, stamp_ns)
            self.grow(points)

    def grow(self, points: np.ndarray) -> None:
        """Add surface points: one per voxel, at most MAX_POINTS, spread over all voxels.

        A rejected instance keeps its points.
        """
        if self.instance.state != "rejected":
            self.set_points(
                *kernels.merge_points(self.points_m, self.support, points, VOXEL_M, MAX_POINTS)
            )

    def set_points(self, points_m: np.ndarray, support: np.ndarray) -> None:
        """Replace all points; update the instance's points, centre and radius."""
        self.points_m, self.support = points_m, support
        instance = self.instance
        instance.points_m, instance.center_m, self.radius_m = kernels.core_points(points_m, support)
        self.x_m, self.y_m, self.z_m = instance.center_m.tolist()

    def count_good_hit(self, pose: SE2, stamp_ns: int) -> bool:
        """Count a good hit; return False if one of this image was counted before."""
        if self.good_ns == stamp_ns:
            return False
        self.good_ns = stamp_ns
        if self.good_hits == 0:
            self.first_x_m, self.first_y_m = pose.x_m, pose.y_m
        self.good_hits += 1
        self.other_hits += self.is_other_viewpoint(pose)
        return True

    def note_scores(self, target: float, competing: float, stamp_ns: int) -> None:
        """Note the scores of a box; of several in one frame, the best target counts."""
        self.evidence_ns = max(self.evidence_ns, stamp_ns)
        if target > self.now_target:
            self.now_target, self.now_competing = target, competing

    def count_view(self, weight: float) -> None:
        """Add the scores of the current frame to the evidence, with a weight of up to 1."""
        self.views += weight
        self.target_sum += weight * self.now_target
        self.competing_sum += weight * self.now_competing
        if self.views >= FORGET_VIEWS:
            self.views *= 0.5
            self.good_hits //= 2
            self.other_hits //= 2
            self.target_sum *= 0.5
            self.competing_sum *= 0.5

    def absorb(self, newer: InstanceTrack) -> None:
        """Add the evidence of a newer track of the same object, without its points."""
        a, b = self.instance, newer.instance
        a.score = max(a.score, b.score)
        a.hits += b.hits
        a.last_seen_ns = max(a.last_seen_ns, b.last_seen_ns)
        self.evidence_ns = max(self.evidence_ns, newer.evidence_ns)
        if newer.good_hits > self.good_hits:  # with the viewpoint that they are counted from
            self.good_hits, self.other_hits = newer.good_hits, newer.other_hits
            self.first_x_m, self.first_y_m = newer.first_x_m, newer.first_y_m
        self.views += newer.views
        self.target_sum += newer.target_sum
        self.competing_sum += newer.competing_sum

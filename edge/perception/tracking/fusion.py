"""Fusion: merges the detections of each image into the instances (VL-Nav III.C).

It decides which of them is confirmed as the target, and which is rejected. Here

- a strong detection has a score above `tau_det`; all others are weak;
- a view is from near by if the robot is within `confirm_range_m` of the object;
- a competing class is another class that may explain a box (`Detections.competing_score`);
- an instance is contested if another object of the map explains its place better.

Names such as `tau_det` and `merge_m` are keys of `perception` in the configuration.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from edge import names
from edge.geometry import invert
from edge.perception.tracking import instance_kernels as kernels
from edge.perception.tracking.back_projection import BackProjectedBoxes
from edge.perception.tracking.back_projection_kernels import INNER
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.look_kernels import (
    AT_EDGE,
    HIDDEN,
    IN_PART,
    LOOK_RIM,
    NO_DEPTH,
    WHOLE,
    view_of,
    visibility,
)
from edge.perception.tracking.object_kernels import PARTIAL
from edge.perception.tracking.object_tracker import ObjectTracker
from edge.perception.tracking.track import InstanceTrack
from edge.types import Instance, Observation

APART_M = 0.1
"""Two boxes of a name in one image are of two objects if there is such a gap between them."""
APART_IMAGES = 3  # images that must show the gap
DECAY = 0.9
"""Factor on the score of an instance for each view that should show it and does not."""
FORGET_SHARE = 0.5
"""An instance that is not confirmed is forgotten if its score is below this share of `tau_det`."""
REJECT_VIEWS = 30
"""After this many views an instance is rejected if its mean competing score exceeds its mean score.
"""
SURER = 1.6
"""A confirmed instance is contested only by an object with this multiple of its confidence.

From near by the instance is only partly in view, and an object in front of it fills the image. The
same counts for an instance that was seen from afar only: it is worth a view from near by."""
_HIGH_VIEW = 1.25
"""An object that hangs high is looked at from up to this multiple of the least distance from which
its centre is well in view."""


class InstanceFusion:
    """The fusion of the targets' detections into one `Instance` per object.

    A detection with a score above the running score raises it by `RISE` times the difference. A
    detection below lowers it by `FALL` times the difference. Weak detections (below `tau_det`)
    count at a known place, but never start a new instance. Each view without a detection multiplies
    the score by `DECAY` (`expire`).

    Args:
        tracker: the instances.
        objects: all objects seen, updated with the newest image first; None: no evidence of other
            objects.
    """

    def __init__(self, tracker: InstanceTracker, objects: ObjectTracker | None = None) -> None:
        self._tracker, self._objects = tracker, objects
        self._seen_apart: Counter[tuple[int, int]] = Counter()  # images, by the ids of both

    def update(self, boxes: BackProjectedBoxes, stamp_ns: int) -> None:
        """Merge the detections of one image, strongest first."""
        c, tracker, detections = self._tracker.config, self._tracker, boxes.detections
        name_of_class = [names.canonical(prompt) for prompt in detections.prompts]
        unsuppressed, competing = detections.not_suppressed(), detections.competing_score
        hit: dict[int, int] = {}  # instances with a strong detection in this image: their box
        for i in np.flatnonzero(boxes.valid).tolist():
            class_id, score = int(detections.class_id[i]), float(detections.score[i])
            strong = score > c.tau_det and bool(unsuppressed[i])
            points = boxes.surface_m(i)
            track = self._match(boxes, i, name_of_class[class_id], hit if strong else {})
            if track is None:
                if not strong:
                    continue
                track = tracker.create(detections.prompts[class_id], points, score, stamp_ns)
            elif track.instance.id in hit:  # a second box of one object: only its points count
                if strong:
                    track.grow(points)
                continue
            elif unsuppressed[i]:
                track.merge(points, score, stamp_ns, c)
            track.note_scores(score, 0.0 if competing is None else float(competing[i]), stamp_ns)
            if strong:
                hit[track.instance.id] = i
                self._count_good_hit(track, points, score, detections.observation, stamp_ns)
        self._note_gaps(hit, boxes)
        for instance_id in hit:
            self._merge_overlapping(instance_id)
        tracker.limit()

    def _match(
        self, boxes: BackProjectedBoxes, i: int, name: str, hit: Mapping[int, int]
    ) -> InstanceTrack | None:
        """Return the instance that a box belongs to, or None.

        Args:
            boxes: boxes of the image.
            i: the box.
            name: canonical name of its class.
            hit: instances that have a box of this image already. If there is a gap between that
                box and this one, this one belongs to another instance.
        """
        x_m, y_m, _ = boxes.center_m[i].tolist()
        track = self._tracker.match(name, x_m, y_m)
        if track is None or track.instance.state == "rejected":
            return track
        first = hit.get(track.instance.id)
        if first is None or not _are_apart(boxes, i, first):
            return track
        return self._tracker.match(name, x_m, y_m, excluded=hit)

    def _note_gaps(self, hit: Mapping[int, int], boxes: BackProjectedBoxes) -> None:
        """Note the pairs of objects between whose boxes an image shows a gap."""
        tracks = self._tracker.tracks
        for pair in [pair for pair in self._seen_apart if not tracks.keys() >= {*pair}]:
            del self._seen_apart[pair]
        left = [tracks[i] for i in hit if i in tracks]  # others were rejected
        for track, other in combinations(left, 2):
            one, two = track.instance, other.instance
            if track.name == other.name and _are_apart(boxes, hit[one.id], hit[two.id]):
                pair = min(one.id, two.id), max(one.id, two.id)
                self._seen_apart[pair] += 1
                if self._seen_apart[pair] >= APART_IMAGES:
                    one.apart, two.apart = one.apart | {two.id}, two.apart | {one.id}

    def expire(self, observation: Observation, prompts: Sequence[str]) -> list[int]:
        """Lower the score of instances that this observation should show and does not.

        Call it after `update` with the same observation. Rejected and reached instances stay, and
        so do those of labels that the detector did not look for.

        Args:
            observation: an image's camera, pose and depth.
            prompts: names that the detector looked for in this image.

        Returns:
            Ids of instances that were forgotten.
        """
        camera = observation.camera
        c, tracks = self._tracker.config, self._tracker.tracks
        if camera is None or not tracks:
            return []
        T = invert(observation.T_map_base @ observation.T_base_camera)
        view = view_of(camera)
        depth = NO_DEPTH if observation.depth_m is None else observation.depth_m
        # Farther than this, a missing detection is no evidence.
        far_m = min(1.5 * c.confirm_range_m, c.back_projection_max_range_m)
        asked = {names.canonical(prompt) for prompt in prompts}
        gone = []
        for track in list(tracks.values()):
            instance = track.instance
            if instance.state in ("rejected", "reached") or track.name not in asked:
                continue
            points = instance.points_m
            shown = visibility(
                track.x_m, track.y_m, track.z_m, points, len(points), T, view, depth, far_m
            )
            if shown == HIDDEN and track.evidence_ns >= observation.stamp_ns:
                shown = IN_PART  # it was detected, so only its centre is hidden
            if shown != HIDDEN:
                self._count_view(track, shown, observation)
            track.now_target = track.now_competing = 0.0
            if shown in (HIDDEN, AT_EDGE) or track.evidence_ns >= observation.stamp_ns:
                continue
            if instance.state == "rejected":  # by this view; it stays, so that none starts there
                continue
            instance.score *= DECAY
            # A few misses do not undo a confirmation: the object may be hidden, or too near.
            if instance.score < FORGET_SHARE * c.tau_det and not instance.is_confirmed:
                gone.append(instance.id)
        for instance_id in gone:
            tracks.pop(instance_id, None)
        return gone

    def _count_view(self, track: InstanceTrack, shown: int, observation: Observation) -> None:
        """Count a view that should show the instance, if it is from near by."""
        self._update_contested(track)
        pose, c = observation.pose, self._tracker.config
        near_m = near_range_m(c.confirm_range_m, track.z_m, observation) + track.radius_m
        if track.distance_m(pose.x_m, pose.y_m) <= near_m:
            # A partial view is weaker evidence, for and against.
            track.count_view(1.0 if shown == WHOLE else PARTIAL)
            self._update_state(track)

    def promote_context(self, labels: Sequence[str]) -> None:
        """Make instances from the objects of the map that these labels name, with their evidence.

        A new target that was already seen as context (an object that was no target) then need not
        be found again. Objects that would be forgotten at once, and known ones, are skipped.
        """
        if self._objects is None:
            return
        c, tracker = self._tracker.config, self._tracker
        least = FORGET_SHARE * c.tau_det
        for label in labels:
            name = names.canonical(label)
            for obj in self._objects.named(label):
                known = tracker.match(name, *obj.center_m[:2].tolist())
                is_doubtful = obj.confidence < least or obj.hits < c.min_hits
                if is_doubtful or known is not None:
                    continue
                track = tracker.create(label, obj.points_m, obj.confidence, obj.last_seen_ns)
                track.instance.hits = obj.hits
                track.good_hits = track.other_hits = obj.near_hits
                track.views, track.target_sum = obj.weight, obj.total
                self._update_contested(track)
                self._update_state(track)
        tracker.limit()

    def _count_good_hit(
        self,
        track: InstanceTrack,
        points: np.ndarray,
        score: float,
        observation: Observation,
        stamp_ns: int,
    ) -> None:
        """Count a detection as a good hit if it is good enough and from near by."""
        c, pose = self._tracker.config, observation.pose
        near_m = near_range_m(c.confirm_range_m, track.z_m, observation)
        is_good = (
            track.instance.state not in ("rejected", "reached")
            and score >= c.confirm_score_of(track.name)
            and kernels.nearest(points, pose.x_m, pose.y_m) <= near_m
        )
        if is_good and track.count_good_hit(pose, stamp_ns):
            self._update_state(track)

    def _update_state(self, track: InstanceTrack) -> None:
        """Update the state from the evidence.

        An instance is confirmed if all of these hold:
        - it had at least `confirm_hits` good hits;
        - its mean score over all near views is at least `confirm_mean`;
        - its mean score is at least `confirm_lead` times that of its competing classes;
        - it is not contested (`_update_contested`).

        So neither a rare false positive nor a bed that is also a fair sofa is confirmed. A
        confirmed instance needs no lead to stay confirmed: from near by the object is only partly
        in view, and the lead shrinks.
        """
        c, instance = self._tracker.config, track.instance
        if instance.state not in ("tentative", "confirmed"):
            return
        lead = 1.0 if instance.state == "confirmed" else c.confirm_lead  # over competing classes
        is_confirmed = (
            track.good_hits >= c.confirm_hits
            and track.target_sum >= c.confirm_mean * track.views
            and track.target_sum >= lead * track.competing_sum
            and not self._update_contested(track)
        )
        instance.state = "confirmed" if is_confirmed else "tentative"
        if track.views >= REJECT_VIEWS and track.competing_sum > track.target_sum:
            self._tracker.reject(instance.id)

    def _update_contested(self, track: InstanceTrack) -> bool:
        """Update and return `contested`: True if another object explains the place better."""
        if self._objects is not None:
            instance = track.instance
            surer = SURER if instance.state == "confirmed" or not track.views else 1.0
            track.contested = self._objects.has_competing_object(
                track.name, instance.points_m, track.radius_m, surer
            )
        return track.contested

    def _merge_overlapping(self, instance_id: int) -> None:
        """Merge an instance with those of its name that overlap it; the oldest one stays."""
        tracks, c = self._tracker.tracks, self._tracker.config
        track = tracks.get(instance_id)
        if track is None or track.instance.state in ("rejected", "reached"):
            return
        for other in list(tracks.values()):
            if other is track or other.name != track.name:
                continue
            if other.instance.id not in tracks:  # a merge before has rejected and removed it
                continue
            if other.instance.state in ("rejected", "reached"):
                continue
            if not track.overlaps(other, 0.5 * c.merge_m):
                continue
            if other.instance.id in track.instance.apart:
                continue
            older = other.instance.id < track.instance.id
            old, new = (other, track) if older else (track, other)
            del tracks[new.instance.id]
            old.absorb(new)
            self._update_state(old)
            old.grow(new.instance.points_m)
            self._keep_gaps(old.instance, new.instance)
            track = old

    def _keep_gaps(self, old: Instance, new: Instance) -> None:
        """Keep what is apart from an instance that was merged into another one."""
        old.apart |= new.apart
        for track in self._tracker.tracks.values():
            apart = track.instance.apart
            if new.id in apart and track.instance is not old:
                track.instance.apart = apart - {new.id} | {old.id}


def _are_apart(boxes: BackProjectedBoxes, i: int, j: int) -> bool:
    """Return True if there is a gap between the objects of two boxes."""
    one_m, other_m = boxes.surface_m(i), boxes.surface_m(j)
    gap_m, _, _ = kernels.least_gap(one_m, other_m)
    # The surfaces are of the inner part of each box, so boxes that touch have a gap, too.
    extents_m = sum(float(np.ptp(points_m[:, :2], axis=0).max()) for points_m in (one_m, other_m))
    return gap_m >= APART_M + 0.5 * (1.0 / INNER - 1.0) * extents_m


def near_range_m(confirm_range_m: float, z_m: float, observation: Observation) -> float:
    """Return the distance up to which a view of an object at height `z_m` is from near by.

    It is `confirm_range_m`, or more if the camera cannot see the object from there, because it
    hangs too high.
    """
    camera = observation.camera
    if camera is None:
        return confirm_range_m
    T = observation.T_map_base @ observation.T_base_camera
    up = (camera.cy_px - LOOK_RIM * camera.height_px) / camera.fy_px  # at the rim of the view
    x, y, z = (T[:3, 2] - up * T[:3, 1]).tolist()
    above_m = z_m - float(T[2, 3])
    if z <= 0 or above_m <= 0:
        return confirm_range_m
    return max(confirm_range_m, _HIGH_VIEW * above_m * math.hypot(x, y) / z)

"""Instances: objects that may be the target, merged over time (VL-Nav III.C).

`InstanceTracker` decides which of them is confirmed as the target, and which is rejected. Here

- a strong detection has a score above `tau_det`; all others are weak;
- a view is from near by if the robot is within `confirm_range_m` of the object;
- a competing class is another class that may explain a box (`Detections.competing_score`);
- an instance is contested if another object of the map explains its place better.

Names such as `tau_det` and `merge_m` are keys of `perception` in the configuration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol, get_args

import numpy as np

from edge import config, names
from edge.geometry import FARTHEST_M, SE2, invert, wrap_angle
from edge.host.checkpoint import Arrays, check_arrays
from edge.perception.tracking import instance_kernels as kernels
from edge.perception.tracking.lift import BackProjectedBoxes
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
from edge.perception.tracking.sighting_kernels import PARTIAL
from edge.perception.tracking.sightings import ObjectTracker
from edge.types import Instance, InstanceState, Observation

MAX_POINTS = 64  # surface points of an instance
MAX_INSTANCES = 128
# Weights of a new score in the running score. A good view counts more than a bad one, since most
# views are from afar or from the side.
RISE = 0.5  # if the new score is above the running one
FALL = 0.15  # if it is below
DECAY = 0.9
"""Factor on the score of an instance for each view that should show it and does not."""
FORGET_SHARE = 0.5
"""An instance that is not confirmed is forgotten if its score is below this share of `tau_det`."""
FORGET_VIEWS = 100
"""After this many views the counts for confirmation are halved, so that old views fade."""
REJECT_VIEWS = 30
"""After this many views an instance is rejected if its mean competing score exceeds its mean score.
"""
VIEWPOINT_M, VIEWPOINT_RAD = 0.5, math.radians(20)
"""Two views are from different viewpoints if the robot has moved, or turned around the object, by
this much."""
SURER = 1.6
"""A confirmed instance is contested only by an object with this multiple of its confidence.

From near by the instance is only partly in view, and an object in front of it fills the image. The
same counts for an instance that was seen from afar only: it is worth a view from near by."""
_HIGH_VIEW = 1.25
"""An object that hangs high is looked at from up to this multiple of the least distance from which
its centre is well in view."""
_PROTECTED = ("confirmed", "rejected", "reached")  # states that `_limit` never drops
_STATES: tuple[InstanceState, ...] = get_args(InstanceState)
# Attributes that a checkpoint saves: of an instance, and of the evidence of its track.
_COLUMNS = (
    ("id", np.int64), ("score", np.float64), ("hits", np.int64), ("first_seen_ns", np.int64),
    ("last_seen_ns", np.int64),
)  # fmt: skip
_EVIDENCE = (
    ("evidence_ns", np.int64), ("good_hits", np.int64), ("other_hits", np.int64),
    ("first_x_m", np.float64), ("first_y_m", np.float64), ("views", np.float64),
    ("good_ns", np.int64), ("target_sum", np.float64), ("competing_sum", np.float64),
    ("contested", np.bool_),
)  # fmt: skip


class LabelResolver(Protocol):
    """Finds the instances of labels that describe an object by others, as "chair next to desk"."""

    def resolve(
        self, label: str, of: Callable[[str], Sequence[Instance]], last: bool
    ) -> list[Instance] | None:
        """Return the instances of a label, best first; None if the label is a plain name.

        Args:
            label: name or description of a target.
            of: returns the instances of a plain name ("chair"), best first.
            last: True if the search is over, so that the best instance is accepted even if it is
                doubtful.
        """

    def reason_for(
        self, label: str, instance: Instance, of: Callable[[str], Sequence[Instance]]
    ) -> str:
        """Return why a label means this instance; "" for a plain name."""


@dataclass(slots=True, eq=False)
class _Track:
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
        contested: True if another object explains the place better (see `_update_contested`).
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


class InstanceTracker:
    """Fuses detections of the targets into one `Instance` per object.

    A detection with a score above the running score raises it by `RISE` times the difference. A
    detection below lowers it by `FALL` times the difference. Weak detections (below `tau_det`)
    count at a known place, but never start a new instance. Each view without a detection multiplies
    the score by `DECAY` (`expire`).

    Args:
        sightings: all objects seen, updated with the newest image first; None: no evidence of other
            objects.

    Attributes:
        dropped: number of instances removed over `MAX_INSTANCES`.
        resolver: finds the instances of labels such as "chair next to desk"; may be set. None: all
            labels are plain names.
    """

    def __init__(
        self, perception: config.PerceptionConfig, sightings: ObjectTracker | None = None
    ) -> None:
        self.config = perception
        self.dropped = 0
        self.resolver: LabelResolver | None = None
        self._objects = sightings
        self._tracks: dict[int, _Track] = {}
        self._next_id = 1

    def __len__(self) -> int:
        return len(self._tracks)

    @property
    def all(self) -> list[Instance]:
        """All instances, rejected ones included, oldest first."""
        return [track.instance for track in self._tracks.values()]

    def get(self, instance_id: int) -> Instance | None:
        track = self._tracks.get(instance_id)
        return track.instance if track else None

    def of(self, label: str, only_confirmed: bool = False, doubted: bool = True) -> list[Instance]:
        """Return the instances of a label (or a synonym) that are worth driving to, best first.

        These were detected in at least `min_hits` images and are not rejected.

        Args:
            label: name or description of a target.
            only_confirmed: True: leave out instances that are not confirmed.
            doubted: True: keep contested instances, whose place another object explains better.
        """
        if self.resolver is not None:
            plain = partial(self._with_name, only_confirmed=only_confirmed, doubted=doubted)
            # `last` has the meaning of `doubted`: accept doubtful instances, too.
            if (found := self.resolver.resolve(label, plain, last=doubted)) is not None:
                return found
        return self._with_name(label, only_confirmed, doubted)

    def reason_for(self, label: str, instance: Instance) -> str:
        """Return why a label means this instance; "" for a plain name."""
        plain = partial(self._with_name, only_confirmed=False, doubted=True)
        return "" if self.resolver is None else self.resolver.reason_for(label, instance, plain)

    def _with_name(self, label: str, only_confirmed: bool, doubted: bool) -> list[Instance]:
        name = names.canonical(label)
        found = [
            track.instance
            for track in self._tracks.values()
            if track.name == name
            and track.instance.state != "rejected"
            and track.instance.hits >= self.config.min_hits
            and (not only_confirmed or self.confirmed(track.instance))
            and (doubted or not track.contested)
        ]
        return sorted(found, key=lambda instance: (-instance.score, instance.id))

    def update(self, boxes: BackProjectedBoxes, stamp_ns: int) -> None:
        """Merge the detections of one image, strongest first."""
        seen = boxes.detections
        pose = seen.observation.pose
        name_of_class = [names.canonical(prompt) for prompt in seen.prompts]
        unsuppressed = seen.not_suppressed()
        hit: set[int] = set()  # instances with a strong detection in this image
        for i in np.flatnonzero(boxes.valid).tolist():
            class_id, score = int(seen.class_id[i]), float(seen.score[i])
            strong = score > self.config.tau_det and bool(unsuppressed[i])
            points = boxes.surface_m(i)
            x_m, y_m, _ = boxes.center_m[i].tolist()
            track = self._match(name_of_class[class_id], x_m, y_m)
            if track is None:
                if not strong:
                    continue
                track = self._create(seen.prompts[class_id], points, score, stamp_ns)
            elif track.instance.id in hit:  # a second box of one object: only its points count
                if strong:
                    self._grow(track, points)
                continue
            elif unsuppressed[i]:
                self._merge(track, points, score, stamp_ns)
            track.evidence_ns = max(track.evidence_ns, stamp_ns)
            if score > track.now_target:
                track.now_target = score
                track.now_competing = (
                    0.0 if seen.competing_score is None else float(seen.competing_score[i])
                )
            if strong:
                hit.add(track.instance.id)
                near_m = self._near_m(track, seen.observation)
                self._count_good_hit(track, points, score, pose, stamp_ns, near_m)
        for instance_id in hit:
            self._merge_overlapping(instance_id)
        self._limit()

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
        if camera is None or not self._tracks:
            return []
        T = invert(observation.T_map_base @ observation.T_base_camera)
        view = view_of(camera)
        depth = NO_DEPTH if observation.depth_m is None else observation.depth_m
        # Farther than this, a missing detection is no evidence.
        far_m = min(1.5 * self.config.confirm_range_m, self.config.back_projection_max_range_m)
        pose = observation.pose
        asked = {names.canonical(prompt) for prompt in prompts}
        gone = []
        for track in list(self._tracks.values()):
            instance = track.instance
            if instance.state in ("rejected", "reached") or track.name not in asked:
                continue
            points = instance.points_m
            shown = visibility(
                track.x_m, track.y_m, track.z_m, points, len(points), T, view, depth, far_m
            )
            if shown == HIDDEN and track.evidence_ns >= observation.stamp_ns:
                shown = IN_PART  # it was detected, so only its centre is hidden
            if shown == HIDDEN:
                track.now_target = track.now_competing = 0.0
                continue
            self._update_contested(track)
            near_m = self._near_m(track, observation) + track.radius_m
            if track.distance_m(pose.x_m, pose.y_m) <= near_m:
                # A partial view is weaker evidence, for and against.
                self._count_view(track, 1.0 if shown == WHOLE else PARTIAL)
            track.now_target = track.now_competing = 0.0
            if shown == AT_EDGE or track.evidence_ns >= observation.stamp_ns:
                continue
            instance.score *= DECAY
            # A few misses do not undo a confirmation: the object may be hidden, or too near.
            if instance.score < FORGET_SHARE * self.config.tau_det and not self.confirmed(instance):
                gone.append(instance.id)
        for instance_id in gone:
            self._tracks.pop(instance_id, None)
        return gone

    def _near_m(self, track: _Track, observation: Observation) -> float:
        """Return the distance up to which a view of an instance is from near by.

        It is `confirm_range_m`, or more if the camera cannot see the object from there, because it
        hangs too high.
        """
        near_m, camera = self.config.confirm_range_m, observation.camera
        if camera is None:
            return near_m
        T = observation.T_map_base @ observation.T_base_camera
        up = (camera.cy_px - LOOK_RIM * camera.height_px) / camera.fy_px  # at the rim of the view
        x, y, z = (T[:3, 2] - up * T[:3, 1]).tolist()
        above_m = track.z_m - float(T[2, 3])
        if z <= 0 or above_m <= 0:
            return near_m
        return max(near_m, _HIGH_VIEW * above_m * math.hypot(x, y) / z)

    def confirmed(self, instance: Instance) -> bool:
        """Return True if the instance is confirmed as the target, or was reached."""
        return instance.state in ("confirmed", "reached")

    def verified(self, instance: Instance, pose: SE2) -> bool:
        """Return True if a confirmed instance also had good hits from another viewpoint.

        Images of one viewpoint repeat the same mistake, so half of `confirm_hits` must be from
        another one than the first good hit.

        Args:
            instance: an instance.
            pose: the robot's pose. If it is still at the first viewpoint, there was no other.
        """
        track = self._tracks.get(instance.id)
        if track is None or not self.confirmed(instance):
            return False
        enough = track.other_hits >= self.config.confirm_hits // 2
        return enough or not track.is_other_viewpoint(pose)

    def reject(self, instance_id: int) -> None:
        """Reject an instance: it is not the target and is never chased again.

        Instances of the same name within `reject_radius_m` are removed, and no new one starts
        there.
        """
        track = self._tracks.get(instance_id)
        if track is None:
            return
        track.instance.state = "rejected"
        for other in list(self._tracks.values()):
            if (
                other is not track
                and other.instance.state != "reached"
                and other.name == track.name
                and other.distance_m(track.x_m, track.y_m) <= self.config.reject_radius_m
            ):
                del self._tracks[other.instance.id]

    def mark_reached(self, instance_id: int) -> None:
        if track := self._tracks.get(instance_id):
            track.instance.state = "reached"

    def state_dict(self) -> Arrays:
        """Return all instances and their evidence, one row each, oldest first.

        The points of all instances are concatenated.
        """
        tracks = list(self._tracks.values())
        found = [track.instance for track in tracks]
        points = [track.points_m for track in tracks]
        return {
            **{name: np.array([getattr(i, name) for i in found], t) for name, t in _COLUMNS},
            **{name: np.array([getattr(t, name) for t in tracks], d) for name, d in _EVIDENCE},
            "label": np.array([i.label for i in found], np.str_),
            "state": np.array([_STATES.index(i.state) for i in found], np.int8),
            "n_points": np.array([len(each) for each in points], np.int32),
            "points_m": np.concatenate(points) if points else np.zeros((0, 3), np.float32),
            "support": np.concatenate([np.zeros(0, np.int32), *(t.support for t in tracks)]),
            "next_id": np.array(self._next_id),
        }

    def add(self, instance: Instance) -> None:
        """Add an instance that was found elsewhere, under its own id."""
        self._adopt(instance, instance.points_m, np.ones(len(instance.points_m), np.int32))

    def load_state_dict(self, state: Arrays, later_ns: int) -> None:
        """Load a `state_dict` into an empty tracker.

        Args:
            state: from `state_dict`.
            later_ns: added to all stamps, since the sensors' clock may have started again.

        Raises:
            ValueError: the state is invalid.
        """
        each = tuple(name for name, _ in (*_COLUMNS, *_EVIDENCE))
        # Most rows of each group of arrays, and largest values: a file may be damaged.
        rows = {(*each, "label", "state", "n_points"): 1 << 13}
        rows[("points_m", "support")] = MAX_POINTS << 13
        most = {"state": len(_STATES) - 1, "n_points": MAX_POINTS, "score": 2}
        most |= dict.fromkeys(("views", "target_sum", "competing_sum"), FARTHEST_M)
        check_arrays(state, self.state_dict(), rows, most, ("id",))
        n_points, end = state["n_points"], np.cumsum(state["n_points"])
        if (n_points == 0).any() or n_points.sum() != len(state["points_m"]):
            raise ValueError("n_points: the sum is not the number of points, or an object has none")
        for row, label in enumerate(state["label"].tolist()):
            rows_of_points = slice(end[row] - n_points[row], end[row])
            points_m = state["points_m"][rows_of_points].copy()
            instance = Instance(
                label=label, center_m=points_m[0], points_m=points_m,  # `_adopt` sets both
                state=_STATES[state["state"][row]],
                **{name: state[name][row].item() for name, _ in _COLUMNS},
            )  # fmt: skip
            instance.first_seen_ns += later_ns
            instance.last_seen_ns += later_ns
            track = self._adopt(instance, points_m, state["support"][rows_of_points].copy())
            for name, _ in _EVIDENCE:
                setattr(track, name, state[name][row].item())
            track.evidence_ns += later_ns
        self._next_id = max(self._next_id, int(state["next_id"]))
        self._limit()

    @property
    def newest_id(self) -> int:
        """Highest id given so far; 0: none."""
        return self._next_id - 1

    def promote_context(self, labels: Sequence[str]) -> None:
        """Make instances from the objects of the map that these labels name, with their evidence.

        A new target that was already seen as context (an object that was no target) then need not
        be found again. Objects that would be forgotten at once, and known ones, are skipped.
        """
        if self._objects is None:
            return
        least = FORGET_SHARE * self.config.tau_det
        for label in labels:
            name = names.canonical(label)
            for seen in self._objects.named(label):
                known = self._match(name, *seen.center_m[:2].tolist())
                is_doubtful = seen.confidence < least or seen.hits < self.config.min_hits
                if is_doubtful or known is not None:
                    continue
                track = self._create(label, seen.points_m, seen.confidence, seen.last_seen_ns)
                track.instance.hits = seen.hits
                track.good_hits = track.other_hits = seen.near_hits
                track.views, track.target_sum = seen.weight, seen.total
                self._update_contested(track)
                self._update_state(track)
        self._limit()

    def clear(self) -> None:
        """Forget every instance; ids continue, so that later instances have higher ids."""
        self._tracks.clear()

    def forget_verdicts(self) -> None:
        """Reset the verdicts of the last mission.

        A reached instance becomes a confirmed one; a rejected one is forgotten and may be found
        again.
        """
        for track in list(self._tracks.values()):
            if track.instance.state == "reached":
                track.instance.state = "confirmed"
            elif track.instance.state == "rejected":
                del self._tracks[track.instance.id]

    def forget_rejected(self, label: str) -> None:
        """Forget the rejected instances of a label (or a synonym): they may be found again."""
        name = names.canonical(label)
        for track in list(self._tracks.values()):
            if track.name == name and track.instance.state == "rejected":
                del self._tracks[track.instance.id]

    def _match(self, name: str, x_m: float, y_m: float) -> _Track | None:
        """Return the instance that a detection belongs to, or None.

        A rejected instance near the detection comes first.
        """
        best, best_m = None, self.config.merge_m
        for track in self._tracks.values():
            if track.name != name:
                continue
            apart_m = track.distance_m(x_m, y_m)
            if track.instance.state == "rejected":
                if apart_m <= self.config.reject_radius_m:
                    return track
                continue
            if apart_m - track.radius_m >= best_m:  # no surface point can be nearer
                continue
            apart_m = min(apart_m, kernels.nearest(track.instance.points_m, x_m, y_m))
            if apart_m < best_m:
                best, best_m = track, apart_m
        return best

    def _create(self, label: str, points: np.ndarray, score: float, stamp_ns: int) -> _Track:
        """Start a new instance from its first strong detection."""
        instance = Instance(
            id=self._next_id,
            label=label,
            center_m=np.zeros(3, np.float32),
            points_m=np.empty((0, 3), np.float32),
            score=score,
            hits=1,
            first_seen_ns=stamp_ns,
            last_seen_ns=stamp_ns,
        )
        track = _Track(instance, names.canonical(label), stamp_ns)
        self._grow(track, points)
        self._tracks[self._next_id] = track
        self._next_id += 1
        return track

    def _merge(self, track: _Track, points: np.ndarray, score: float, stamp_ns: int) -> None:
        """Merge a detection into a known instance; into a rejected one, only its stamp."""
        track.evidence_ns = max(track.evidence_ns, stamp_ns)
        if track.instance.state == "rejected":
            return
        instance = track.instance
        weight = RISE if score > instance.score else FALL
        instance.score += weight * (score - instance.score)
        if score > self.config.tau_det:
            instance.hits += 1
            instance.last_seen_ns = max(instance.last_seen_ns, stamp_ns)
            self._grow(track, points)

    def _grow(self, track: _Track, points: np.ndarray) -> None:
        """Add surface points: one per voxel, at most MAX_POINTS, spread over all voxels.

        A rejected instance keeps its points.
        """
        if track.instance.state != "rejected":
            track.points_m, track.support = kernels.merge_points(
                track.points_m, track.support, points, self.config.voxel_m, MAX_POINTS
            )
            self._update_outline(track)

    def _adopt(self, instance: Instance, points_m: np.ndarray, support: np.ndarray) -> _Track:
        """Add an existing instance with its id and all its points."""
        track = _Track(instance, names.canonical(instance.label), instance.last_seen_ns)
        track.points_m, track.support = points_m, support
        self._update_outline(track)
        self._tracks[instance.id] = track
        self._next_id = max(self._next_id, instance.id + 1)
        return track

    def _update_outline(self, track: _Track) -> None:
        """Update the instance's points, centre and radius from the well-supported points."""
        instance = track.instance
        instance.points_m, instance.center_m, track.radius_m = kernels.core_points(
            track.points_m, track.support
        )
        track.x_m, track.y_m, track.z_m = instance.center_m.tolist()

    def _count_good_hit(
        self,
        track: _Track,
        points: np.ndarray,
        score: float,
        pose: SE2,
        now_ns: int,
        near_m: float,
    ) -> None:
        """Count a detection as a good hit if it is good enough and from at most `near_m` away."""
        c, instance = self.config, track.instance
        if instance.state in ("rejected", "reached") or score < c.confirm_score_of(track.name):
            return
        if kernels.nearest(points, pose.x_m, pose.y_m) > near_m:
            return
        if track.good_ns != now_ns:  # at most one good hit for each image
            track.good_ns = now_ns
            if track.good_hits == 0:
                track.first_x_m, track.first_y_m = pose.x_m, pose.y_m
            track.good_hits += 1
            track.other_hits += track.is_other_viewpoint(pose)
            self._update_state(track)

    def _count_view(self, track: _Track, weight: float) -> None:
        """Add the scores of the current frame to the evidence, with a weight of up to 1."""
        track.views += weight
        track.target_sum += weight * track.now_target
        track.competing_sum += weight * track.now_competing
        if track.views >= FORGET_VIEWS:
            track.views *= 0.5
            track.good_hits //= 2
            track.other_hits //= 2
            track.target_sum *= 0.5
            track.competing_sum *= 0.5
        self._update_state(track)

    def _update_state(self, track: _Track) -> None:
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
        c, instance = self.config, track.instance
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
            self.reject(instance.id)

    def _update_contested(self, track: _Track) -> bool:
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
        track = self._tracks.get(instance_id)
        if track is None or track.instance.state in ("rejected", "reached"):
            return
        for other in list(self._tracks.values()):
            if other is track or other.name != track.name:
                continue
            if other.instance.id not in self._tracks:  # a merge before has rejected and removed it
                continue
            if other.instance.state in ("rejected", "reached") or not self._overlap(track, other):
                continue
            older = other.instance.id < track.instance.id
            old, new = (other, track) if older else (track, other)
            del self._tracks[new.instance.id]
            self._absorb(old, new)
            track = old

    def _overlap(self, a: _Track, b: _Track) -> bool:
        """Return True if one centre is within half of `merge_m` of the other instance's points."""
        near_m = 0.5 * self.config.merge_m
        if a.distance_m(b.x_m, b.y_m) > near_m + max(a.radius_m, b.radius_m):
            return False
        a_to_b = kernels.nearest(a.instance.points_m, b.x_m, b.y_m)
        return min(a_to_b, kernels.nearest(b.instance.points_m, a.x_m, a.y_m)) < near_m

    def _absorb(self, old: _Track, new: _Track) -> None:
        """Add the evidence and points of a removed track to an older one."""
        a, b = old.instance, new.instance
        a.score = max(a.score, b.score)
        a.hits += b.hits
        a.last_seen_ns = max(a.last_seen_ns, b.last_seen_ns)
        old.evidence_ns = max(old.evidence_ns, new.evidence_ns)
        if new.good_hits > old.good_hits:  # with the viewpoint that they are counted from
            old.good_hits, old.other_hits = new.good_hits, new.other_hits
            old.first_x_m, old.first_y_m = new.first_x_m, new.first_y_m
        old.views += new.views
        old.target_sum += new.target_sum
        old.competing_sum += new.competing_sum
        self._update_state(old)
        self._grow(old, b.points_m)

    def _limit(self) -> None:
        """Drop the weakest instances over `MAX_INSTANCES`; of equal ones, those longest unseen."""
        excess = len(self._tracks) - MAX_INSTANCES
        if excess <= 0:
            return
        free = [t.instance for t in self._tracks.values() if t.instance.state not in _PROTECTED]
        free.sort(key=lambda instance: (instance.score, instance.last_seen_ns))
        for instance in free[:excess]:
            del self._tracks[instance.id]
            self.dropped += 1

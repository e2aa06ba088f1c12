"""Instances: objects that may be the target, merged over time (VL-Nav III.C).

Use them for what the robot drives to and verifies; use `object_tracker` for all other objects, and
`edge.tasks.scene.objects` for the extent of an object that a trajectory passes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Protocol, get_args

import numpy as np

from edge import config, names
from edge.geometry import FARTHEST_M, SE2
from edge.host.checkpoint import Arrays, check_arrays
from edge.perception.tracking import instance_kernels as kernels
from edge.perception.tracking.track import MAX_POINTS, InstanceTrack
from edge.types import Instance, InstanceState

MAX_INSTANCES = 128
REJECT_RADIUS_M = 0.6
"""An object of the same name within this distance of a rejected one is rejected, too."""
_PROTECTED = ("confirmed", "rejected", "reached")  # states that `limit` never drops
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


class InstanceTracker:
    """The instances of the targets: finds them by name, and keeps the verdicts about them.

    `InstanceFusion` merges the detections of each image into them.

    Attributes:
        tracks: the instances with their evidence, by id, oldest first.
        newest_id: highest id given so far; 0: none.
        resolver: finds the instances of labels such as "chair next to desk"; may be set. None: all
            labels are plain names.
    """

    def __init__(self, perception: config.PerceptionConfig) -> None:
        self.config = perception
        self.newest_id = 0
        self.resolver: LabelResolver | None = None
        self.tracks: dict[int, InstanceTrack] = {}

    def __len__(self) -> int:
        return len(self.tracks)

    @property
    def all(self) -> list[Instance]:
        """All instances, rejected ones included, oldest first."""
        return [track.instance for track in self.tracks.values()]

    def get(self, instance_id: int) -> Instance | None:
        track = self.tracks.get(instance_id)
        return track.instance if track else None

    def of(
        self, label: str, only_confirmed: bool = False, with_contested: bool = True
    ) -> list[Instance]:
        """Return the instances of a label (or a synonym) that are worth driving to, best first.

        These were detected in at least `min_hits` images and are not rejected.

        Args:
            label: name or description of a target.
            only_confirmed: True: leave out instances that are not confirmed.
            with_contested: True: keep instances whose place another object explains better.
        """
        if self.resolver is not None:
            plain = partial(
                self._with_name, only_confirmed=only_confirmed, with_contested=with_contested
            )
            # Contested instances count only when the search is over, as doubtful ones do here.
            if (found := self.resolver.resolve(label, plain, last=with_contested)) is not None:
                return found
        return self._with_name(label, only_confirmed, with_contested)

    def reason_for(self, label: str, instance: Instance) -> str:
        """Return why a label means this instance; "" for a plain name."""
        plain = partial(self._with_name, only_confirmed=False, with_contested=True)
        return "" if self.resolver is None else self.resolver.reason_for(label, instance, plain)

    def _with_name(self, label: str, only_confirmed: bool, with_contested: bool) -> list[Instance]:
        name = names.canonical(label)
        found = [
            track.instance
            for track in self.tracks.values()
            if track.name == name
            and track.instance.state != "rejected"
            and track.instance.hits >= self.config.min_hits
            and (not only_confirmed or track.instance.is_confirmed)
            and (with_contested or not track.contested)
        ]
        return sorted(found, key=lambda instance: (-instance.score, instance.id))

    def verified(self, instance: Instance, pose: SE2) -> bool:
        """Return True if a confirmed instance also had good hits from another viewpoint.

        Images of one viewpoint repeat the same mistake, so half of `confirm_hits` must be from
        another one than the first good hit.

        Args:
            instance: an instance.
            pose: the robot's pose. If it is still at the first viewpoint, there was no other.
        """
        track = self.tracks.get(instance.id)
        if track is None or not instance.is_confirmed:
            return False
        has_two_viewpoints = track.has_two_viewpoints(self.config.confirm_hits)
        return has_two_viewpoints or not track.is_other_viewpoint(pose)

    def verified_now(self, instance: Instance, pose: SE2) -> bool:
        """Return True if an instance is `verified` and not doubtful since.

        It is doubtful if there was only one viewpoint, and the score has fallen below that of a
        good hit.
        """
        track = self.tracks.get(instance.id)
        if track is None or not self.verified(instance, pose):
            return False
        is_sure = instance.score >= self.config.confirm_score_of(track.name)
        return is_sure or track.has_two_viewpoints(self.config.confirm_hits)

    def reject(self, instance_id: int) -> None:
        """Reject an instance: it is not the target and is never chased again.

        Instances of the same name within `REJECT_RADIUS_M` are removed, and no new one starts
        there.
        """
        track = self.tracks.get(instance_id)
        if track is None:
            return
        track.instance.state = "rejected"
        for other in list(self.tracks.values()):
            if (
                other is not track
                and other.instance.state != "reached"
                and other.name == track.name
                and other.distance_m(track.x_m, track.y_m) <= REJECT_RADIUS_M
            ):
                del self.tracks[other.instance.id]

    def mark_reached(self, instance_id: int) -> None:
        if track := self.tracks.get(instance_id):
            track.instance.state = "reached"

    def state_dict(self) -> Arrays:
        """Return all instances and their evidence, one row each, oldest first.

        The points of all instances are concatenated.
        """
        tracks = list(self.tracks.values())
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
            "apart": np.array(
                [(one.id, other) for one in found for other in one.apart], np.int64
            ).reshape(-1, 2),
            "next_id": np.array(self.newest_id + 1),
        }

    def load_state_dict(self, state: Arrays, later_ns: int) -> None:
        """Load a `state_dict` into an empty tracker.

        Args:
            state: from `state_dict`.
            later_ns: added to all stamps, since the sensors' clock may have started again.

        Raises:
            ValueError: the state is invalid.
        """
        state = {"apart": np.zeros((0, 2), np.int64), **state}  # older checkpoints have none
        each = tuple(name for name, _ in (*_COLUMNS, *_EVIDENCE))
        # Most rows of each group of arrays, and largest values: a file may be damaged.
        rows = {(*each, "label", "state", "n_points"): 1 << 13}
        rows[("points_m", "support")], rows["apart",] = MAX_POINTS << 13, 1 << 13
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
                label=label, center_m=points_m[0], points_m=points_m,  # `add` sets both
                state=_STATES[state["state"][row]],
                **{name: state[name][row].item() for name, _ in _COLUMNS},
            )  # fmt: skip
            instance.first_seen_ns += later_ns
            instance.last_seen_ns += later_ns
            track = self.add(instance, state["support"][rows_of_points].copy())
            for name, _ in _EVIDENCE:
                setattr(track, name, state[name][row].item())
            track.evidence_ns += later_ns
        for one, other in state["apart"].tolist():
            if one in self.tracks:
                self.tracks[one].instance.apart |= {other}
        self.newest_id = max(self.newest_id, int(state["next_id"]) - 1)
        self.limit()

    def clear(self) -> None:
        """Forget every instance; ids continue, so that later instances have higher ids."""
        self.tracks.clear()

    def forget_verdicts(self, rejected: bool = True) -> None:
        """Reset the verdicts of the last mission, or of the last round of a mission.

        A reached instance becomes a confirmed one; a rejected one is forgotten and may be found
        again, unless `rejected` is False.
        """
        for track in list(self.tracks.values()):
            if track.instance.state == "reached":
                track.instance.state = "confirmed"
            elif rejected and track.instance.state == "rejected":
                del self.tracks[track.instance.id]

    def forget_rejected(self, label: str) -> None:
        """Forget the rejected instances of a label (or a synonym): they may be found again."""
        name = names.canonical(label)
        for track in list(self.tracks.values()):
            if track.name == name and track.instance.state == "rejected":
                del self.tracks[track.instance.id]

    def match(
        self, name: str, x_m: float, y_m: float, excluded: Collection[int] = ()
    ) -> InstanceTrack | None:
        """Return the instance that a detection belongs to, or None.

        A rejected instance near the detection comes first. `excluded`: ids of instances that it
        does not belong to.
        """
        best, best_m = None, self.config.merge_m
        for track in self.tracks.values():
            if track.name != name or track.instance.id in excluded:
                continue
            apart_m = track.distance_m(x_m, y_m)
            if track.instance.state == "rejected":
                if apart_m <= REJECT_RADIUS_M:
                    return track
                continue
            if apart_m - track.radius_m >= best_m:  # no surface point can be nearer
                continue
            apart_m = min(apart_m, kernels.nearest(track.instance.points_m, x_m, y_m))
            if apart_m < best_m:
                best, best_m = track, apart_m
        return best

    def create(self, label: str, points: np.ndarray, score: float, stamp_ns: int) -> InstanceTrack:
        """Start a new instance from its first strong detection."""
        self.newest_id += 1
        instance = Instance(
            id=self.newest_id,
            label=label,
            center_m=np.zeros(3, np.float32),
            points_m=np.empty((0, 3), np.float32),
            score=score,
            hits=1,
            first_seen_ns=stamp_ns,
            last_seen_ns=stamp_ns,
        )
        track = InstanceTrack(instance, names.canonical(label), stamp_ns)
        track.grow(points)
        self.tracks[instance.id] = track
        return track

    def add(self, instance: Instance, support: np.ndarray | None = None) -> InstanceTrack:
        """Add an existing instance with its id and all its points.

        `support` is (k,) int32, number of views that support each point; None: one.
        """
        points_m = instance.points_m
        track = InstanceTrack(instance, names.canonical(instance.label), instance.last_seen_ns)
        track.set_points(points_m, np.ones(len(points_m), np.int32) if support is None else support)
        self.tracks[instance.id] = track
        self.newest_id = max(self.newest_id, instance.id)
        return track

    def limit(self) -> None:
        """Drop the weakest instances over `MAX_INSTANCES`; of equal ones, those longest unseen."""
        excess = len(self.tracks) - MAX_INSTANCES
        if excess <= 0:
            return
        free = [t.instance for t in self.tracks.values() if t.instance.state not in _PROTECTED]
        free.sort(key=lambda instance: (instance.score, instance.last_seen_ns))
        for instance in free[:excess]:
            del self.tracks[instance.id]

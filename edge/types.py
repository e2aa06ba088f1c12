"""Data types that packages exchange. Arrays are shared, not copied.

All are frozen except `Instance`, which its tracker updates at each frame.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np

from edge.geometry import SE2, CameraModel, se2_of

CAMERAS = ("camera", "camera2")
"""First part of the topics of each camera, by `Observation.camera_index`."""


class Slot(Protocol):
    """A reference-counted slot in a frame pool (see `edge.sources.pool`)."""

    def hold(self) -> None:
        """Add a reference, so that the slot is not reused."""

    def release(self) -> None:
        """Remove a reference; without references, the slot may be reused."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Images or a point cloud of one instant, with the robot's pose at that time.

    Attributes:
        seq: Number of the observation in its source, from 0.
        stamp_ns: Capture time of the image or cloud.
        T_map_base: (4, 4) float64, pose of the robot at `stamp_ns`.
        rgb: (h, w, 3) uint8, or None.
        depth_m: (h, w) float32, registered to `rgb`; NaN or 0 = no return; or None.
        camera: Intrinsics of `rgb` and `depth_m`; None if there is no image.
        T_base_camera: (4, 4) float64, maps the optical frame into `base`.
        cloud_m: (n, 3) float32 in the LiDAR frame, or None. A row (x, y, inf) is not a point, but
            a beam of a planar scan that hit nothing between the sensor and (x, y, 0).
        T_base_lidar: (4, 4) float64, maps the LiDAR frame into `base`.
        slot: Pool slot that owns the arrays; None if they are not pooled.
        pose_age_ns: Largest age, relative to `stamp_ns`, of the pose and of the transforms behind
            the pose and the mounts. 0 if all are interpolated at the stamp.
        distortion: Distortion of the lens. `none`: it has none; `rectified`: the source removed
            it; `ignored`: the images are distorted, but used as if they were rectified.
        camera_index: Which of the robot's cameras took the images: 0, or 1 for the second.
        lag_ns: Time from `stamp_ns` to the robot's newest pose; 0 in lockstep (`loop.lockstep`: one
            tick for each observation).
    """

    seq: int
    stamp_ns: int
    T_map_base: np.ndarray
    rgb: np.ndarray | None = None
    depth_m: np.ndarray | None = None
    camera: CameraModel | None = None
    T_base_camera: np.ndarray = field(default_factory=lambda: np.eye(4))
    cloud_m: np.ndarray | None = None
    T_base_lidar: np.ndarray = field(default_factory=lambda: np.eye(4))
    slot: Slot | None = None
    pose_age_ns: int = 0
    distortion: Literal["none", "rectified", "ignored"] = "none"
    lag_ns: int = 0
    camera_index: int = 0

    @property
    def pose(self) -> SE2:
        """Pose of the robot in the plane at `stamp_ns`."""
        return se2_of(self.T_map_base)

    def hold(self) -> None:
        """Protect the arrays from reuse until a matching call of `release`."""
        if self.slot is not None:
            self.slot.hold()

    def release(self) -> None:
        """Allow the reuse of the arrays again; see `hold`."""
        if self.slot is not None:
            self.slot.release()


@dataclass(frozen=True, slots=True, eq=False)
class ContextBoxes:
    """Boxes of objects other than the targets, as parallel arrays, highest score first.

    Attributes:
        xyxy_px: (m, 4) float32 in pixels of the observation's image.
        score: (m,) float32 in [0, 1].
        class_id: (m,) int32, index into `words`.
        words: Canonical names of the classes that were searched in addition to the targets. None
            names a target or a kind of target.
    """

    xyxy_px: np.ndarray
    score: np.ndarray
    class_id: np.ndarray
    words: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.score)


MASK_SIDE = 48
"""Rows and columns of a mask. A mask is a raster over its box."""


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Boxes of one image, as parallel arrays, highest score first.

    Attributes:
        observation: The observation of the image, held until the boxes are back-projected.
        xyxy_px: (n, 4) float32 in pixels of `observation.rgb`.
        score: (n,) float32 in [0, 1].
        class_id: (n,) int32, index into `prompts`.
        prompts: Text classes that the detector searched for.
        competing_score: (n,) float32, the best score of a competing class (a background prompt) at
            the same place; None if there are no competing classes.
        context: Boxes of other objects; None if the detector does not return them.
        model: Card name of the model.
        latency_ns: Time from the image to the boxes and masks.
        mask: (n, MASK_SIDE, MASK_SIDE) bool, a raster over each box (row = y); True where the
            object is visible. A box whose cells are all False has no mask. None if no masks were
            made.

    Example:
        >>> observation = Observation(seq=0, stamp_ns=0, T_map_base=np.eye(4))
        >>> boxes = np.array([[0, 0, 20, 20], [5, 5, 9, 9]], np.float32)
        >>> score, class_id = np.array([0.9, 0.3], np.float32), np.zeros(2, np.int32)
        >>> found = Detections(observation, boxes, score, class_id, ("chair",))
        >>> len(found), len(found.above(0.5))
        (2, 1)
    """

    observation: Observation
    xyxy_px: np.ndarray
    score: np.ndarray
    class_id: np.ndarray
    prompts: tuple[str, ...]
    competing_score: np.ndarray | None = None
    context: ContextBoxes | None = None
    model: str = ""
    latency_ns: int = 0
    mask: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.score)

    def context_detections(self) -> Detections | None:
        """Return the context boxes as detections, with `context.words` as prompts.

        Return None if there is no context.
        """
        if self.context is None:
            return None
        c = self.context
        return replace(
            self, xyxy_px=c.xyxy_px, score=c.score, class_id=c.class_id, prompts=c.words,
            competing_score=None, context=None, mask=None,
        )  # fmt: skip

    def not_suppressed(self) -> np.ndarray:
        """Return (n,) bool: True for boxes whose competing class does not score higher."""
        if self.competing_score is None:
            return np.ones(len(self), np.bool_)
        return self.score >= self.competing_score

    def without_suppressed(self) -> Detections:
        """Return only the boxes whose competing class does not score higher."""
        return replace(self.only(self.not_suppressed()), competing_score=None)

    def above(self, score: float) -> Detections:
        """Return only the boxes with at least this score."""
        return self.only(self.score >= score)

    def only(self, chosen: np.ndarray) -> Detections:
        """Return only the boxes that `chosen` selects, as (n,) bool or indices.

        The context is kept.
        """
        return replace(
            self,
            xyxy_px=self.xyxy_px[chosen],
            score=self.score[chosen],
            class_id=self.class_id[chosen],
            competing_score=None if self.competing_score is None else self.competing_score[chosen],
            mask=None if self.mask is None else self.mask[chosen],
        )


InstanceState = Literal["tentative", "confirmed", "rejected", "reached"]


@dataclass(slots=True, eq=False)
class Instance:
    """An object in the map that may be a target, merged over time (VL-Nav III.C).

    Attributes:
        id: Number, unique within a run.
        label: Prompt that the object matches.
        center_m: (3,) float32 in `map`, median of its surface points.
        points_m: (k, 3) float32 in `map`, voxel-filtered surface points. Points that only a few
            views show are left out.
        score: Running confidence in [0, 1].
        hits: Number of frames with a detection of the object.
        first_seen_ns: Stamp of the first of these frames.
        last_seen_ns: Stamp of the newest of these frames.
        state: `tentative` until enough detections confirm it; `confirmed`; `rejected`: it is not
            the target, and the robot does not drive to it; `reached`: the mission reached it.
        apart: Ids of other objects of its name that images showed next to it, with a gap.
    """

    id: int
    label: str
    center_m: np.ndarray
    points_m: np.ndarray
    score: float
    hits: int
    first_seen_ns: int
    last_seen_ns: int
    state: InstanceState = "tentative"
    apart: frozenset[int] = frozenset()

    @property
    def is_confirmed(self) -> bool:
        """True if the object is confirmed as the target, or was reached."""
        return self.state in ("confirmed", "reached")

    def copied(self) -> Instance:
        """Return a copy that shares the arrays, which are replaced but never written to."""
        return copy(self)

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Return the planar distance from a point to the nearest known surface point."""
        d = self.points_m[:, :2] - np.array([x_m, y_m], dtype=np.float32)
        return float(np.sqrt((d * d).sum(axis=1).min()))


# "spin": one of four goals, because recordings and metrics know no other kind:
#   - a spin candidate, which has a `candidate_id`; the others have 0;
#   - a turn on the spot, after the last candidate;
#   - a viewpoint for a better look (`TrackedGoal.view`);
#   - a hold goal: the robot stands still (`GoalTracker.hold_position`).
# "trajectory": a task's goal, which moves ahead of the robot on its trajectory, or turns it on the
# spot. "place": a named place that the mission goes to. "zone_exit": a place outside the zone that
# the robot is in.
CandidateKind = Literal["frontier", "instance", "spin", "trajectory", "place", "zone_exit"]


@dataclass(frozen=True, slots=True)
class Goal:
    """The pose that the robot should drive to.

    Attributes:
        stamp_ns: Time of the choice. It identifies the goal in messages.
        pose: Position to stand at and heading to face. For a frontier or an instance it is a free,
            reachable cell, and the heading faces the candidate.
        kind: Kind of candidate that the goal is for.
        candidate_id: Id of the frontier, instance or spin candidate; 0 if the goal is for none, as
            with other kinds of goals, and with turns and views after the last candidate.
        candidate_xy_m: Position of the candidate; the position of `pose` if there is none.
        score: Score of the candidate; 0 if there is none.
        target: Active target of the mission.
    """

    stamp_ns: int
    pose: SE2
    kind: CandidateKind
    candidate_id: int
    candidate_xy_m: tuple[float, float]
    score: float
    target: str


@dataclass(frozen=True, slots=True)
class GoalStatus:
    """Status of one goal, as reported by the motion controller.

    Attributes:
        stamp_ns: Stamp of the goal.
        state: Latest state of the goal.
        reason: Reason of a failure; may be empty.
        blocked: Place (x, y) in `map` where the robot is blocked now; None if it is not blocked.
    """

    stamp_ns: int
    state: Literal["accepted", "reached", "failed"]
    reason: str = ""
    blocked: tuple[float, float] | None = None


MissionPhase = Literal[
    "idle", "searching", "approaching", "verifying", "waiting", "paused", "stopped", "reached",
    "failed",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class MissionStatus:
    """Status of the mission.

    Attributes:
        target: Active target; after the end, the last one.
        phase: `reached` (fulfilled) and `failed` are final. `idle`: no mission was given yet.
        reason: Reason of the phase, for people; while the mission runs, what the robot does.
        elapsed_s: Time that the mission has taken.
        path_m: Distance that the robot has driven for it.
        instruction: Instruction as one line (`edge.text.one_line`).
    """

    target: str
    phase: MissionPhase
    reason: str = ""
    elapsed_s: float = 0.0
    path_m: float = 0.0
    instruction: str = ""

    @property
    def done(self) -> bool:
        """True if the mission has ended."""
        return self.phase in ("reached", "failed")


MissionEventKind = Literal[
    "start",
    "target",
    "seen",
    "reached",
    "failed",
    "nothing",
    "warning",
    "trajectory",
    "round",
    "end",
]


@dataclass(frozen=True, slots=True)
class MissionEvent:
    """One entry of the mission log.

    Attributes:
        stamp_ns: Loop time of the entry.
        kind: `start`, `end`: of the mission. `target`: the plan now goes to `label`. `seen`,
            `reached`, `failed`: result for `label`. `nothing`: a step of the formula in which no
            target is reached; `label` is then the failure of a target, or "". `round`: start of
            the next round of a mission that repeats. `warning`: the goal is next to something that
            must not be reached now, or a note at the start of the mission. `trajectory`: progress
            of a task's trajectory.
        label: Target of the entry.
        state: State of the automaton after the entry.
        text: Text for people.
    """

    stamp_ns: int
    kind: MissionEventKind
    label: str
    state: int
    text: str

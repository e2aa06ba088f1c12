"""What more than one package hands on or takes. Arrays are shared, not copied.

Frozen but for `Instance`, which its tracker changes from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np

from edge.geometry import SE2, CameraModel, se2_of


class Slot(Protocol):
    """A reference-counted place in a frame pool (see `edge.sources.pool`)."""

    def hold(self) -> None: ...

    def release(self) -> None: ...


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What the robot saw at one instant, and where it stood then.

    Attributes:
        seq: counts observations of this source from 0.
        stamp_ns: capture time of the image or cloud.
        T_map_base: (4, 4) float64, the pose at `stamp_ns`.
        rgb: (h, w, 3) uint8, or None.
        depth_m: (h, w) float32 registered to `rgb`; NaN or 0 = no return; or None.
        camera: intrinsics of `rgb` and `depth_m`; None when there is no image.
        distortion: of the lens: `none`; `rectified`: by the source; `ignored`: the images are taken
            for rectified.
        T_base_camera: (4, 4) float64, base from optical frame.
        cloud_m: (n, 3) float32 in the LiDAR's frame, or None. A row (x, y, inf) is no point but a
            beam of a planar scan that met nothing up to (x, y, 0).
        T_base_lidar: (4, 4) float64.
        slot: the pool slot that owns the arrays; None when nothing is pooled.
        pose_age_ns: how much older than `stamp_ns` the pose is, or a transform that it or a mount
            is made of; 0: all are interpolated at the stamp.
        lag_ns: how much newer the newest pose of the robot is; 0 in lockstep.
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

    @property
    def pose(self) -> SE2:
        return se2_of(self.T_map_base)

    def hold(self) -> None:
        """Keep the arrays from being overwritten until `release` is called as often."""
        if self.slot is not None:
            self.slot.hold()

    def release(self) -> None:
        if self.slot is not None:
            self.slot.release()


@dataclass(frozen=True, slots=True, eq=False)
class ContextBoxes:
    """Boxes of what stands around the targets, as parallel arrays, highest score first.

    Attributes:
        xyxy_px: (m, 4) float32 in pixels of the observation's image.
        score: (m,) float32 in [0, 1].
        class_id: (m,) int32, index into `words`.
        words: canonical names of all that was looked for besides the targets; none is a target's,
            nor of a kind of one.
    """

    xyxy_px: np.ndarray
    score: np.ndarray
    class_id: np.ndarray
    words: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.score)


MASK_SIDE = 48
"""Rows and columns of the raster that a mask is, over its box."""


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Boxes of one image, as parallel arrays, highest score first.

    Attributes:
        observation: the observation they were found in (held until they are lifted).
        xyxy_px: (n, 4) float32 in pixels of `observation.rgb`.
        score: (n,) float32 in [0, 1].
        class_id: (n,) int32, index into `prompts`.
        prompts: what was asked for.
        rival: (n,) float32, the best score of anything else on the same place (a background
            prompt); None where nothing else was asked for.
        context: what else was found, in boxes of its own; None where the detector does not tell.
        model: card name of the model.
        latency_ns: time from image to boxes, and masks.
        mask: (n, MASK_SIDE, MASK_SIDE) bool, which cells of a raster over each box show the thing
            itself (row = y); a box without any such cell has no mask. None: no masks are made.
    """

    observation: Observation
    xyxy_px: np.ndarray
    score: np.ndarray
    class_id: np.ndarray
    prompts: tuple[str, ...]
    rival: np.ndarray | None = None
    context: ContextBoxes | None = None
    model: str = ""
    latency_ns: int = 0
    mask: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.score)

    def around(self) -> Detections | None:
        """The context's boxes as detections of their own, its words as prompts; None: there is
        no context."""
        if self.context is None:
            return None
        c = self.context
        return replace(
            self, xyxy_px=c.xyxy_px, score=c.score, class_id=c.class_id, prompts=c.words,
            rival=None, context=None, mask=None,
        )  # fmt: skip

    def unrivalled(self) -> np.ndarray:
        """(n,) bool: the boxes that nothing else explains better."""
        if self.rival is None:
            return np.ones(len(self), np.bool_)
        return self.score >= self.rival

    def without_rivals(self) -> Detections:
        """Only the boxes that nothing else explains better."""
        return replace(self.only(self.unrivalled()), rival=None)

    def above(self, score: float) -> Detections:
        """Only the boxes with at least that score."""
        return self.only(self.score >= score)

    def only(self, chosen: np.ndarray) -> Detections:
        """Only the boxes that `chosen`, (n,) bool or indices, names."""
        return replace(
            self,
            xyxy_px=self.xyxy_px[chosen],
            score=self.score[chosen],
            class_id=self.class_id[chosen],
            rival=None if self.rival is None else self.rival[chosen],
            mask=None if self.mask is None else self.mask[chosen],
        )


InstanceState = Literal["seen", "confirmed", "refuted", "reached"]


@dataclass(slots=True, eq=False)
class Instance:
    """A thing in the map that may be the target (VL-Nav III.C), merged over time.

    Attributes:
        id: unique within a run.
        label: the prompt it answers to.
        center_m: (3,) float32 in `map`, median of its surface points.
        points_m: (k, 3) float32 in `map`, voxel-filtered surface points, without those that
            only few views show.
        score: running confidence in [0, 1].
        hits: frames it was detected in.
        last_seen_ns: stamp of the newest of them.
        state: `refuted` ones are never chased again.
    """

    id: int
    label: str
    center_m: np.ndarray
    points_m: np.ndarray
    score: float
    hits: int
    first_seen_ns: int
    last_seen_ns: int
    state: InstanceState = "seen"

    def copied(self) -> Instance:
        """As it stands now; the arrays are shared, since they are replaced and never written to."""
        return Instance(
            self.id, self.label, self.center_m, self.points_m, self.score, self.hits,
            self.first_seen_ns, self.last_seen_ns, self.state,
        )  # fmt: skip

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Planar distance from a point to the nearest known surface point."""
        d = self.points_m[:, :2] - np.array([x_m, y_m], dtype=np.float32)
        return float(np.sqrt((d * d).sum(axis=1).min()))


# "look": there was nothing to go to, so the robot turns on the spot, or goes to where the camera
# sees what it saw badly before. "trajectory": a task's, which moves ahead of the robot, or its turn
# on the spot.
# "place": a named place that the mission goes to.
CandidateKind = Literal["frontier", "instance", "look", "trajectory", "place"]


@dataclass(frozen=True, slots=True)
class Goal:
    """Where the robot should go next.

    Attributes:
        stamp_ns: when it was chosen; its identity on the wire.
        pose: a free, reachable cell of the map that faces the candidate.
        candidate_xy_m: the frontier or instance that it is for.
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
    """The motion controller's answer to one goal (`stamp_ns` is the goal's).

    Attributes:
        blocked: where, x and y in `map`, the robot was held up just now; None: it was not.
    """

    stamp_ns: int
    state: Literal["accepted", "reached", "failed"]
    reason: str = ""
    blocked: tuple[float, float] | None = None


MissionPhase = Literal[
    "idle", "searching", "approaching", "verifying", "paused", "reached", "failed"
]


@dataclass(frozen=True, slots=True)
class MissionStatus:
    """How the mission stands; `reached` (fulfilled) and `failed` are final, `idle` is before any.

    Attributes:
        target: what is pursued now; at the end, what was pursued last.
        instruction: what was asked for, as one line (`edge.text.one_line`).
    """

    target: str
    phase: MissionPhase
    reason: str = ""
    elapsed_s: float = 0.0
    path_m: float = 0.0
    instruction: str = ""

    @property
    def done(self) -> bool:
        return self.phase in ("reached", "failed")


StepKind = Literal[
    "start", "target", "seen", "reached", "failed", "nothing", "warning", "trajectory", "end"
]


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that happened to a mission.

    Attributes:
        kind: `target`: the plan now goes to `label`; `seen`, `reached`, `failed`: what became of
            it; `nothing`: a step in which nothing is reached, as the formula asks; `warning`: the
            robot is about to stop beside something that must not be reached now; `trajectory`: of
            a task, how its trajectory comes about.
        state: of the automaton, after it.
        text: for people.
    """

    stamp_ns: int
    kind: StepKind
    label: str
    state: int
    text: str

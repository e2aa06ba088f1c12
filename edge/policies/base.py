"""The interface of a policy: its input (`PolicyInput`, `Candidates`) and its methods (`Policy`)."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from edge.geometry import SE2
from edge.mapping.layers import read_only
from edge.mapping.view import MapView
from edge.perception.scoring.choice.question import FrontierChoice
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.types import Detections, Observation

FRONTIER, INSTANCE, SPIN = 0, 1, 2
"""Kinds of candidates, as in `Candidates.kind`."""
SNAP_M = np.array([0.6, 1.5, 0.0])
"""Largest distance of a goal cell from its candidate in metres, by kind. A frontier borders free
space. The surface of an instance is behind inflated cells, and often on a table. A spin turns on
the spot."""


class Candidates:
    """Candidate goals as parallel arrays of which the first `n` entries are valid.

    Frontiers come first, then instances (known objects of the target's name), then at most one spin
    (a turn on the spot).

    Attributes:
        stamp_ns: stamp of the observation from which the candidates were gathered.
        xy_m: (capacity, 2) float32 in `map`. The position of a spin is one metre from the robot,
            in the direction that the robot should face.
        kind: (capacity,) int8, `FRONTIER`, `INSTANCE` or `SPIN`.
        id: (capacity,) int64. A frontier's id is never used again after the frontier is gone. An
            instance's id is the id of the instance; a frontier may have the same id.
        first_seen_ns: (capacity,) int64, on the clock of `stamp_ns`.
        confidence: (capacity,) float32 in [0, 1], from the detector; 0 for frontiers.
        confirmed: (capacity,) bool, True for instances that the detector has confirmed.
        blocked: (capacity,) bool, True while a candidate is discarded.
        path_m: (capacity,) float32, driving distance from the robot, inf if unreachable. For a
            spin, its turn as metres (`edge.loop.goals.candidates.TURN_M_PER_RAD`).
        gain_m2: (capacity,) float32, unknown area that a frontier or a spin is expected to show
            (`edge.mapping.gain`); 0 for instances. A frontier's value may be some ticks old.
    """

    def __init__(self, capacity: int) -> None:
        self.n = self.stamp_ns = 0
        self.xy_m = np.zeros((capacity, 2), np.float32)
        self.kind = np.zeros(capacity, np.int8)
        self.id = np.zeros(capacity, np.int64)
        self.first_seen_ns = np.zeros(capacity, np.int64)
        self.confidence = np.zeros(capacity, np.float32)
        self.confirmed = np.zeros(capacity, np.bool_)
        self.blocked = np.zeros(capacity, np.bool_)
        self.path_m = np.zeros(capacity, np.float32)
        self.gain_m2 = np.zeros(capacity, np.float32)

    def read_only(self) -> Candidates:
        """Return a view of the same arrays that cannot be written.

        The counts `n` and `stamp_ns` are copied: the owner sets them in the view, too.
        """
        shown = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(shown, name, read_only(value))
        return shown

    def index_of(self, kind: int, candidate_id: int) -> int:
        """Return the index of a candidate, or -1 if it is gone."""
        n = self.n
        found = np.flatnonzero((self.id[:n] == candidate_id) & (self.kind[:n] == kind))
        return int(found[0]) if len(found) else -1

    def nearest(self, kind: int, xy_m: tuple[float, float], within_m: float) -> int:
        """Return the index of the nearest candidate of a kind within a range of a point, or -1."""
        n = self.n
        apart = np.hypot(self.xy_m[:n, 0] - xy_m[0], self.xy_m[:n, 1] - xy_m[1])
        apart[self.kind[:n] != kind] = np.inf
        if n == 0 or apart.min() > within_m:
            return -1
        return int(apart.argmin())


@dataclass(frozen=True, slots=True, eq=False)
class ImageSimilarity:
    """Similarity of one image to each target of the mission.

    Attributes:
        stamp_ns: stamp of the observation.
        pose: pose of the robot at that observation.
        targets: the targets that were compared.
        score: (n,) float32, one for each target; see `SimilarityScorer.score` for the scale.
    """

    stamp_ns: int
    pose: SE2
    targets: tuple[str, ...]
    score: np.ndarray


@dataclass(frozen=True, slots=True)
class ScorerOutputs:
    """The newest outputs of the scorers for this map and mission; None if there is none yet.

    An output may be seconds old, or never come.

    Attributes:
        similarity: similarity of the entire field of view to each target, used by VLFM.
        choice: probability of each frontier, used by ViTL. `FrontierChoice.ids` are candidate ids.
            Some of these candidates may be gone.
    """

    similarity: ImageSimilarity | None = None
    choice: FrontierChoice | None = None


class TargetPrior(Protocol):
    """An estimate of where a target may be, given the objects seen so far."""

    def likelihood_ratio(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """Write the likelihood ratio of the target near each position into out[:n].

        The ratio is P(target near position | objects seen) / P(target near an average position).

        Args:
            target: name of the target.
            xy_m: (n or more, 2) float32 in `map`.
            n: number of positions.
            out: (n or more,) float32; 1 means that the prior has no information.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PolicyInput:
    """The input of a policy for one observation.

    Policies only read it. Arrays that outlive the call are read-only.

    Attributes:
        observation: the newest observation, with image, depth or cloud, and camera. Its arrays are
            valid until `score` returns.
        pose: pose of the robot at that observation.
        map: the current map. `snapshot` and `known_m2` are too expensive for every tick.
        changed: half-open rectangle (x0, y0, x1, y1) of the world cells whose state this
            observation changed; cell (x, y) begins at (x, y) * `map.resolution_m`. All zero if no
            cell changed.
        candidates: frontiers, and instances of the active target.
        detections: new boxes of targets, without those that another class fits better, and the
            observation in which they were found. `class_id` indexes `targets`;
            `detections.context` has the boxes of all other objects. None if there are no new
            detections.
        answers: newest outputs of the scorers, which run in the background.
        targets: all targets of the mission.
        target: the active target.
        now_ns: time of the loop.
        objects: positions of all objects seen so far, targets and others; None if they are not
            recorded.
        prior: estimate of where a target may be; None if none is configured.
    """

    observation: Observation
    pose: SE2
    map: MapView
    changed: tuple[int, int, int, int]
    candidates: Candidates
    detections: Detections | None
    answers: ScorerOutputs
    targets: tuple[str, ...]
    target: str
    now_ns: int
    objects: TrackedObjects | None = None
    prior: TargetPrior | None = None

    @property
    def active(self) -> int:
        """Index of the active target in `targets`."""
        return self.targets.index(self.target)


def distances_m(context: PolicyInput, how: Literal["path", "straight"]) -> np.ndarray:
    """Return the distance in metres from the robot to each candidate.

    Args:
        context: the input of the policy.
        how: "path" for driving distance, "straight" for the straight line.

    Returns:
        (n,) float32; inf if there is no path.
    """
    candidates, pose, n = context.candidates, context.pose, context.candidates.n
    if how == "path":
        return candidates.path_m[:n]
    xy_m = candidates.xy_m[:n]
    return np.hypot(xy_m[:, 0] - np.float32(pose.x_m), xy_m[:, 1] - np.float32(pose.y_m))


Why = Literal["mission", "pose", "map rolled"]
"""Reason for `Policy.reset`."""


class Policy(Protocol):
    """Interface that scores candidates; `edge.policies.select` picks one by the scores.

    Example:
        >>> class Nearest:
        ...     def score(self, context):
        ...         return 1.0 / (1.0 + context.candidates.path_m)
        ...     def reset(self, why):
        ...         pass
    """

    def score(self, context: PolicyInput) -> np.ndarray:
        """Return a score for each candidate; higher is better.

        Called for every observation, and again for the same one if the plan has changed the target.
        It must not block; its time counts as the stage `score`.

        Returns:
            At least n finite float32 scores, one for each candidate. The caller reads them until
            the next call. Instances are compared with instances only, frontiers with frontiers.
        """
        ...

    def reset(self, why: Why) -> None:
        """Forget or move what was stored.

        Args:
            why: "mission": the targets changed; map and candidates stay. "pose": the pose jumped
                and the map starts empty. "map rolled": `map.window` moved, and cells outside are
                lost; candidates keep their ids.
        """
        ...


@runtime_checkable
class StatefulPolicy(Protocol):
    """A policy whose state is saved in the checkpoint: any policy with these two methods."""

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return the state as copied numeric arrays, a few megabytes at most."""
        ...

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Restore a `state_dict` of the same policy class and the same targets.

        Candidates have the same ids as before.

        Raises:
            ValueError: the state is invalid.
        """
        ...


def scores_of(policy: Policy, context: PolicyInput) -> np.ndarray:
    """Return a policy's scores for the current candidates, checked, (n,) float32.

    Raises:
        ValueError: the policy did not return one finite number for each candidate.
    """
    score, n = np.asarray(policy.score(context), np.float32), context.candidates.n
    if score.ndim != 1 or len(score) < n or not np.isfinite(score[:n]).all():
        raise ValueError(
            f"policy {type(policy).__name__}: scores of shape {score.shape} for {n} candidates; "
            "score() must return one finite number for each"
        )
    return score[:n]

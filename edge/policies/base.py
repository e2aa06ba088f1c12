"""What a policy is, and what it sees."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from edge.geometry import SE2
from edge.mapping.layers import read_only
from edge.mapping.view import MapView
from edge.perception.scoring.choice.question import Choice
from edge.perception.tracking.sightings import Sightings
from edge.types import Detections, Observation

FRONTIER, INSTANCE, LOOK = 0, 1, 2
SNAP_M = np.array([0.6, 1.5, 0.0])
"""How far from a candidate of each kind its goal cell may lie: a frontier borders free space, an
instance's surface is behind inflation and often on a table, and a look is from where one stands."""


class Candidates:
    """Where to go, parallel arrays of which the first `n` entries count: frontiers first, then
    instances, then at most one look, which is a turn on the spot.

    Attributes:
        stamp_ns: of the observation that they were gathered from.
        xy_m: (capacity, 2) float32 in `map`; a look's lies a metre from the robot, where the robot
            is to face.
        kind: (capacity,) int8, `FRONTIER`, `INSTANCE` or `LOOK`.
        id: (capacity,) int64. A frontier's is never given again once it is gone; an instance's is
            that of the instance, and may be a frontier's as well.
        first_seen_ns: (capacity,) int64, on the clock of `stamp_ns`.
        confidence: (capacity,) float32 in [0, 1], the detector's; 0 for frontiers.
        sure: (capacity,) bool, instances that the detector has confirmed.
        blocked: (capacity,) bool, discarded for a while.
        path_m: (capacity,) float32, driving distance from the robot, inf where it does not get
            to; of a look what its turn is worth as way (`edge.loop.candidates.TURN_M_PER_RAD`).
        gain_m2: (capacity,) float32, unknown area that frontiers and looks are expected to show
            (`edge.mapping.gain`); 0 for instances. A frontier's may be some ticks old.
    """

    def __init__(self, capacity: int) -> None:
        self.n = self.stamp_ns = 0
        self.xy_m = np.zeros((capacity, 2), np.float32)
        self.kind = np.zeros(capacity, np.int8)
        self.id = np.zeros(capacity, np.int64)
        self.first_seen_ns = np.zeros(capacity, np.int64)
        self.confidence = np.zeros(capacity, np.float32)
        self.sure = np.zeros(capacity, np.bool_)
        self.blocked = np.zeros(capacity, np.bool_)
        self.path_m = np.zeros(capacity, np.float32)
        self.gain_m2 = np.zeros(capacity, np.float32)

    def read_only(self) -> Candidates:
        """The same arrays, for those who may not write there; whoever writes renews the counts."""
        shown = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(shown, name, read_only(value))
        return shown

    def index_of(self, kind: int, candidate_id: int) -> int:
        """Where a candidate stands now, or -1 when it is gone."""
        n = self.n
        found = np.flatnonzero((self.id[:n] == candidate_id) & (self.kind[:n] == kind))
        return int(found[0]) if len(found) else -1

    def nearest(self, kind: int, xy_m: tuple[float, float], within_m: float) -> int:
        """The candidate of a kind that is nearest to a point, or -1 when none is so near."""
        n = self.n
        apart = np.hypot(self.xy_m[:n, 0] - xy_m[0], self.xy_m[:n, 1] - xy_m[1])
        apart[self.kind[:n] != kind] = np.inf
        if n == 0 or apart.min() > within_m:
            return -1
        return int(apart.argmin())


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """How well one image goes with each target of the mission.

    Attributes:
        stamp_ns: of the observation, `pose` is where the robot stood then.
        score: (n,) float32, one for each target; see `SimilarityScorer.score` for the scale.
    """

    stamp_ns: int
    pose: SE2
    targets: tuple[str, ...]
    score: np.ndarray


@dataclass(frozen=True, slots=True)
class Answers:
    """What the scorers last said of this map and mission; None: nothing yet.

    VLFM goes by `similarity`, over the whole field of view, and ViTL by `choice`, by frontier:
    `Choice.ids` are ids of candidates, and those that are no candidates any more are stale.
    Either may be seconds old, or never come.
    """

    similarity: Similarity | None = None
    choice: Choice | None = None


class Prior(Protocol):
    """Where a target may be, by what was seen."""

    def lift(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """P(target near a place | what was seen) / P(target near an average place), into out[:n].

        Args:
            xy_m: (n or more, 2) float32 in `map`.
            out: (n or more,) float32; 1: no opinion.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """All that a policy may go by at one moment, to be read: what lasts is read-only.

    Attributes:
        observation: the newest, with image, depth or cloud, and camera. Its arrays are good until
            `score` returns.
        pose: of the robot at that observation.
        map: as it is now; its `snapshot` and `known_m2` are too dear for every tick.
        changed: half-open rectangle (x0, y0, x1, y1) of the world cells whose state this
            observation changed; cell (x, y) begins at (x, y) * `map.resolution_m`. All zero where
            none did.
        candidates: frontiers, and instances of the active target.
        detections: what the detector found meanwhile, boxes of targets that nothing else explains
            better, with the observation they were found in; `class_id` counts `targets`, and
            `context` has the boxes of all else. None where nothing new came.
        answers: of the scorers that run beside the loop.
        targets: all of the mission's; `target` is the active one.
        now_ns: the loop's time.
        sightings: what was seen where so far, targets and all else; None: nobody keeps it.
        prior: tells where a target may be; None: none is configured.
    """

    observation: Observation
    pose: SE2
    map: MapView
    changed: tuple[int, int, int, int]
    candidates: Candidates
    detections: Detections | None
    answers: Answers
    targets: tuple[str, ...]
    target: str
    now_ns: int
    sightings: Sightings | None = None
    prior: Prior | None = None

    @property
    def active(self) -> int:
        """Index of the active target in `targets`."""
        return self.targets.index(self.target)


def distances_m(context: Context, how: Literal["path", "straight"]) -> np.ndarray:
    """Metres from the robot to each candidate, along the path or as the crow flies.

    Returns:
        (n,) float32; inf where no path leads.
    """
    candidates, pose, n = context.candidates, context.pose, context.candidates.n
    if how == "path":
        return candidates.path_m[:n]
    xy_m = candidates.xy_m[:n]
    return np.hypot(xy_m[:, 0] - np.float32(pose.x_m), xy_m[:, 1] - np.float32(pose.y_m))


Why = Literal["mission", "pose", "map rolled"]


class Policy(Protocol):
    """Scores candidates; `edge.policies.select` picks among them by that."""

    def score(self, context: Context) -> np.ndarray:
        """How good it would be to go to each candidate; more is better.

        Called for every observation, and again for the same one when the plan has turned to
        another target. It may not block, and is timed as the stage `score`.

        Returns:
            (n,) float32 or more than `n`, all finite, one for each candidate; read until the next
            call. Instances are compared with instances only, and frontiers with frontiers.
        """
        ...

    def reset(self, why: Why) -> None:
        """What was remembered is void, or moved.

        Args:
            why: "mission": there are other targets; map and candidates stay. "pose": the pose
                jumped, and the map begins anew. "map rolled": `map.window` moved, and what fell
                out of it is forgotten; candidates keep their ids.
        """
        ...


@runtime_checkable
class Remembers(Protocol):
    """A policy whose memory is in the checkpoint: one that has these is asked."""

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return what it remembers, in arrays of its own of numbers; some megabytes at most."""
        ...

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Go on with a `state_dict` of the same kind of policy for the same targets; candidates
        have the ids that they had.

        Raises:
            ValueError: it is no such memory.
        """
        ...


def scores_of(policy: Policy, context: Context) -> np.ndarray:
    """What a policy makes of the candidates there are.

    Returns:
        (n,) float32.

    Raises:
        ValueError: the policy did not give one finite number for each candidate.
    """
    score, n = np.asarray(policy.score(context), np.float32), context.candidates.n
    if score.ndim != 1 or len(score) < n or not np.isfinite(score[:n]).all():
        raise ValueError(
            f"policy {type(policy).__name__}: scores of shape {score.shape} for {n} candidates, "
            "expected one finite number for each"
        )
    return score[:n]

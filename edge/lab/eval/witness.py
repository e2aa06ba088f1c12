"""What truly happened in an episode, by the simulator's ground truth, seen tick by tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from edge import names
from edge.config import Config
from edge.lab.eval.legs import Legs
from edge.lab.eval.metrics import REACHED_M
from edge.lab.sim.base import World, WorldObject
from edge.loop.result import TickResult
from edge.types import Goal, Instance, MissionStatus, Observation

TRAIL_M = 0.25
MIN_PX = 40  # of a thing in the picture for it to be seen
SURE = ("confirmed", "reached")
SAME_M = 0.5  # an instance this near a thing is that thing
STANDING_M, STANDING_S = 1.0, 60.0  # within this for so long, the robot was stuck


class Truth(NamedTuple):
    """The simulator's account of one instant.

    Attributes:
        ids: (h, w) uint16 object ids of the picture, 0 = none.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    path_m: float
    collisions: int
    ids: np.ndarray


@dataclass
class Sight:
    """When a target was first to be seen."""

    seconds: float
    path_m: float


class Witness:
    """A sink that compares what the service says with what is so.

    Args:
        truth: of the instant of an observation, by its stamp (ns).

    Attributes:
        fault: what went wrong in the witness itself: a service outlives its sinks' errors.
        things: of each target of the mission, the world's.
        now: the last instant; None before the first.
        sights: of each target that was seen, when.
        stops: of each thing that was declared reached: its label, and how far it truly was [m].
        confirmed: of each target, the ids of instances that are such a thing and were confirmed;
            `mistaken` of those that are not.
        revisited_m2: floor that a search saw again though an earlier leg of the mission had seen
            it; None: of one target.
    """

    def __init__(self, config: Config, world: World, truth: Callable[[int], Truth]) -> None:
        self._world, self._truth = world, truth
        visible_px(
            np.zeros((1, 1), np.uint16), np.zeros((1, 1), np.float32), np.zeros(1, bool), 0.0
        )
        detector = config.perception.detector
        simulated = detector.kind == "sim"
        self._range_m = detector.max_range_m if simulated else config.perception.lift_max_range_m
        self.fault: Exception | None = None
        self.now: Truth | None = None
        self.seconds = 0.0
        self.things: dict[str, list[WorldObject]] = {}
        self._mine: dict[str, np.ndarray] = {}
        self.trail: list[list[float]] = []
        self.goals: list[Goal] = []
        self.status: MissionStatus | None = None
        self.sights: dict[str, Sight] = {}
        self.stops: list[tuple[str, float]] = []
        self.confirmed: dict[str, set[int]] = {}
        self.mistaken: set[int] = set()
        self.revisited_m2: float | None = None
        self._legs = Legs(config, world, self._range_m)
        self._began_ns = 0
        self._anchor = (0.0, 0.0, 0.0)

    def tick(self, result: TickResult) -> None:
        """See `edge.loop.result.Sink`."""
        try:
            self.goals += result.goals
            self.status = result.status
            if result.observation is not None:
                self._look(result, result.observation)
        except Exception as error:
            self.fault = self.fault or error
            raise

    def _look(self, result: TickResult, observation: Observation) -> None:
        truth = self._truth(observation.stamp_ns)
        if self.now is None:
            self._begin(result.targets, truth, observation.stamp_ns)
        self.now, self.seconds = truth, 1e-9 * (observation.stamp_ns - self._began_ns)
        self._follow(truth)
        self._see(truth, observation.depth_m)
        if result.events:
            self._judge_steps(result, truth)
        instances = result.instances()
        self._judge_instances(instances)
        if len(result.targets) > 1:
            self._follow_leg(result.status.target, instances, truth)

    def _begin(self, targets: Sequence[str], truth: Truth, stamp_ns: int) -> None:
        self.things = {target: named(self._world, target) for target in targets}
        most = max((thing.id for thing in self._world.objects), default=0)
        self._mine = {target: mask_of(things, most) for target, things in self.things.items()}
        self.confirmed = {target: set() for target in targets}
        self._began_ns, self._anchor = stamp_ns, (0.0, truth.x_m, truth.y_m)

    def close(self) -> None:
        """Nothing to let go."""

    def _follow(self, truth: Truth) -> None:
        place = [round(truth.x_m, 3), round(truth.y_m, 3)]
        if not self.trail or math.dist(self.trail[-1], place) >= TRAIL_M:
            self.trail.append(place)
        if math.dist(self._anchor[1:], (truth.x_m, truth.y_m)) > STANDING_M:
            self._anchor = (self.seconds, truth.x_m, truth.y_m)

    def _see(self, truth: Truth, depth_m: np.ndarray | None) -> None:
        for target, mine in self._mine.items():
            if target in self.sights or depth_m is None or not len(self.things[target]):
                continue
            if visible_px(truth.ids, depth_m, mine, self._range_m) >= MIN_PX:
                self.sights[target] = Sight(self.seconds, truth.path_m)

    def _judge_steps(self, result: TickResult, truth: Truth) -> None:
        steps = result.mission().steps
        reached = [step.label for step in steps if step.kind == "reached"]
        for label in reached[len(self.stops) :]:
            self.stops.append((label, self.away_m(label, truth.x_m, truth.y_m)))

    def _judge_instances(self, instances: Sequence[Instance]) -> None:
        for instance in instances:
            if instance.state not in SURE:
                continue
            known = self.confirmed.get(instance.label)
            if known is None or instance.id in known or instance.id in self.mistaken:
                continue
            x, y = instance.center_m[:2].tolist()
            right = self.away_m(instance.label, x, y) <= SAME_M
            (known if right else self.mistaken).add(instance.id)

    def _follow_leg(self, target: str, instances: Sequence[Instance], truth: Truth) -> None:
        """A leg ends where the target turns, or is reached: then the same may be next again."""
        known = [i.center_m[:2] for i in instances if i.label == target and i.state in SURE]
        where = truth.x_m, truth.y_m, truth.yaw_rad
        turn, known_xy_m = (target, len(self.stops)), np.reshape(known, (-1, 2))
        self._legs.update(turn, target, known_xy_m, *where)
        self.revisited_m2 = self._legs.again_m2

    # -- the verdict ------------------------------------------------------------------------------

    def away_m(self, target: str, x_m: float, y_m: float) -> float:
        """From a place to the nearest footprint of a target; inf where there is none."""
        things = self.things.get(target, [])
        return min((thing.distance_m(x_m, y_m) for thing in things), default=math.inf)

    @property
    def wrong_stops(self) -> list[tuple[str, float]]:
        """Of `stops`, those that were too far from any such thing."""
        return [stop for stop in self.stops if stop[1] > REACHED_M]

    @property
    def standing_s(self) -> float:
        """How long the robot has not got away from one place."""
        return self.seconds - self._anchor[0]

    def first_sight(self) -> Sight | None:
        """Of whichever target was seen first."""
        return min(self.sights.values(), key=lambda sight: sight.seconds, default=None)

    def failure(self, pursued: str) -> str | None:
        """Which kind of failure it was, of `edge.lab.eval.outcome.FAILURES`; None for a success.

        Something declared reached that was not: `wrong thing`. The robot in one place for the last
        minute: `stuck`. Else by what it was after: to be seen, but never confirmed: `seen, not
        confirmed`; time or path at an end, before it was seen or on the way to it: `budget`; given
        up though confirmed: `stuck`; given up and never to be seen: `never seen`.

        Args:
            pursued: the target at the end.
        """
        if self.wrong_stops:
            return "wrong thing"
        if self.status is not None and self.status.phase == "reached":
            return None
        out_of = self.status is None or not self.status.done or "limit of" in self.status.reason
        if self.standing_s >= STANDING_S:
            return "stuck"
        if pursued in self.sights and not self.confirmed.get(pursued):
            return "seen, not confirmed"
        if out_of:
            return "budget"
        return "never seen" if pursued not in self.sights else "stuck"


def named(world: World, target: str) -> list[WorldObject]:
    """The world's things that a target means: by that very name, else by its noun."""
    exact = [item for item in world.objects if names.same(item.label, target)]
    return exact or [item for item in world.objects if names.same(item.label, _noun(target))]


def _noun(target: str) -> str:
    known = (noun for noun in names.head_nouns(target) if names.is_known(noun))
    return next(known, target)


def mask_of(things: Sequence[WorldObject], most: int) -> np.ndarray:
    """(most + 1,) bool by object id."""
    mask = np.zeros(most + 1, np.bool_)
    mask[[thing.id for thing in things]] = True
    return mask


@njit(nogil=True, cache=True)
def visible_px(ids: np.ndarray, depth_m: np.ndarray, mine: np.ndarray, range_m: float) -> int:
    """How many pixels show one of the things within a range.

    Args:
        ids: (h, w) uint16; `depth_m` (h, w) float32, NaN = no return; `mine` (n,) bool by id.
    """
    count = 0
    for v in range(ids.shape[0]):
        for u in range(ids.shape[1]):
            if mine[ids[v, u]] and depth_m[v, u] <= range_m:
                count += 1
    return count

"""Ground-truth logger: the true course of an episode, recorded tick by tick from the simulator.

Here an object is one of the simulated world, and an instance is an object in the service's map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge import names
from edge.config import Config
from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.recall import RecallCounter, visible_boxes
from edge.lab.eval.true_rooms import distance_to_room_m
from edge.lab.eval.zone_entries import ZoneEntryCounter
from edge.lab.sim.base import World, WorldObject
from edge.loop.result import TickResult
from edge.memory import Site
from edge.mission.destinations import destination_of
from edge.mission.run import PROBABLY
from edge.types import Goal, Instance, MissionStatus, Observation

TRAIL_M = 0.25  # least distance between two points of the saved trail
MIN_PX = 40  # pixels of an object from which it counts as seen
CONFIRMED_STATES = ("confirmed", "reached")
SAME_M = 0.5  # an instance within this distance of an object of its name is that object
STUCK_RADIUS_M = 1.0  # a robot that stays within this radius …
STUCK_AFTER_S = 60.0  # … for this time is stuck


class GroundTruth(NamedTuple):
    """The simulator's ground truth of one instant.

    Attributes:
        x_m: x of the robot in `map`.
        y_m: y of the robot in `map`.
        path_m: length of the path driven so far.
        collisions: number of collisions so far.
        ids: (h, w) uint16 object ids of the picture, 0 = none.
        person_contacts: number of the collisions that were with a person.
        ghost_s: longest time that a cell stayed occupied in view after a person left it; None if
            it is not measured.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    path_m: float
    collisions: int
    ids: np.ndarray
    person_contacts: int = 0
    ghost_s: float | None = None


@dataclass
class FirstSight:
    """The first time that a target was in view.

    Attributes:
        seconds: since the start.
        path_m: driven until then.
    """

    seconds: float
    path_m: float


class GroundTruthLogger:
    """Sink that compares the service's results with ground truth.

    Args:
        world: the simulated world.
        truth: returns the ground truth of an observation's stamp [ns].
        keep_out_m: polygons of keep-out zones, each (n, 2) float64.

    Attributes:
        fault: the first error in this sink. The service ignores errors of its sinks.
        now: the latest ground truth; None before the first.
        seconds: time of `now` since the first observation [s].
        objects: by target, the objects of the world.
        trail: [x, y] of the robot [m], `TRAIL_M` apart.
        status: the newest status of the mission.
        first_sights: by target, the first time that it was seen; no entry if it never was.
        stops: for each `reached` report, the label and the true distance [m]. Reports of which
            the service was not sure are left out.
        probable: True if there was such a report, or a person did not confirm one.
        confirmed: by target, the ids of instances that were confirmed correctly.
        false_confirmed: ids of instances that were confirmed but are not the target.
        answers: see `EpisodeOutcome`; the caller sets them.
        recall: counts the views of targets that the detector found.
    """

    def __init__(
        self,
        config: Config,
        world: World,
        truth: Callable[[int], GroundTruth],
        keep_out_m: Sequence[np.ndarray] = (),
    ) -> None:
        self._world, self._truth = world, truth
        self._people = config.sim.people  # their ids follow those of the objects
        # Compile now, not in a timed tick.
        visible_boxes(np.zeros((1, 1), np.uint16), np.zeros((1, 1), np.float32), 0.0, 1)
        detector = config.perception.detector
        simulated = detector.kind == "sim"
        self._range_m = (
            detector.max_range_m if simulated else config.perception.back_projection_max_range_m
        )
        self.fault: Exception | None = None
        self.now: GroundTruth | None = None
        self.seconds = 0.0
        self.objects: dict[str, list[WorldObject]] = {}
        self._target_masks: dict[str, np.ndarray] = {}
        self._n_ids = 1  # number of object ids, with 0 for none
        self.trail: list[list[float]] = []
        self.goals: list[Goal] = []
        self.status: MissionStatus | None = None
        self.first_sights: dict[str, FirstSight] = {}
        self.stops: list[tuple[str, float]] = []
        self.probable = False
        self.confirmed: dict[str, set[int]] = {}
        self.false_confirmed: set[int] = set()
        self.answers: dict[str, str] = {}
        self.recall = RecallCounter(config.perception.tau_det)
        radius_m = config.robot.radius_m
        self._zones = ZoneEntryCounter(keep_out_m, radius_m) if len(keep_out_m) else None
        self._began_ns = 0
        # Time [s] and place [m] at which the robot began to stay within STUCK_RADIUS_M.
        self._anchor = (0.0, 0.0, 0.0)

    def tick(self, result: TickResult) -> None:
        try:
            self.goals += result.goals
            self.status = result.status
            if result.observation is not None:
                self._on_observation(result, result.observation)
        except Exception as error:
            self.fault = self.fault or error
            raise

    def _on_observation(self, result: TickResult, observation: Observation) -> None:
        truth = self._truth(observation.stamp_ns)
        if self.now is None:
            self._begin(result.targets, truth, observation.stamp_ns)
        self.now, self.seconds = truth, 1e-9 * (observation.stamp_ns - self._began_ns)
        self._extend_trail(truth)
        if self._zones is not None:
            self._zones.update(truth.x_m, truth.y_m)
        found = result.detections
        if observation.depth_m is not None:
            boxes = visible_boxes(truth.ids, observation.depth_m, self._range_m, self._n_ids)
            self._record_sights(boxes, truth.path_m)
            if found is not None and found.observation is observation:
                self.recall.update(found, boxes, self._target_masks)
        if result.events:
            self._judge_reports(result, truth)
        self._judge_instances(result.instances())

    def _begin(self, targets: Collection[str], truth: GroundTruth, stamp_ns: int) -> None:
        self.objects = {target: objects_meant_by(self._world, target) for target in targets}
        max_id = max((item.id for item in self._world.objects), default=0) + self._people
        self._n_ids = max_id + 1
        self._target_masks = {
            target: object_mask(objects, self._n_ids) for target, objects in self.objects.items()
        }
        self.confirmed = {target: set() for target in targets}
        self._began_ns, self._anchor = stamp_ns, (0.0, truth.x_m, truth.y_m)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _extend_trail(self, truth: GroundTruth) -> None:
        place = [round(truth.x_m, 3), round(truth.y_m, 3)]
        if not self.trail or math.dist(self.trail[-1], place) >= TRAIL_M:
            self.trail.append(place)
        if math.dist(self._anchor[1:], (truth.x_m, truth.y_m)) > STUCK_RADIUS_M:
            self._anchor = (self.seconds, truth.x_m, truth.y_m)

    def _record_sights(self, boxes: np.ndarray, path_m: float) -> None:
        for target, mask in self._target_masks.items():
            if target not in self.first_sights and boxes[mask, 4].sum() >= MIN_PX:
                self.first_sights[target] = FirstSight(self.seconds, path_m)

    def _judge_reports(self, result: TickResult, truth: GroundTruth) -> None:
        """Add to `stops` each object that the mission log newly reports as reached."""
        events = result.mission().log
        self.probable |= any(f"({PROBABLY}" in e.text for e in events)
        reached = [
            e.label
            for e in events
            if e.kind == "reached" and self._is_judged(e.label) and f"({PROBABLY}" not in e.text
        ]
        for label in reached[len(self.stops) :]:
            self.stops.append((label, self.distance_to_target_m(label, truth.x_m, truth.y_m)))

    def _is_judged(self, label: str) -> bool:
        """Return True for an object or a kind of room, not for a place or a wait."""
        return label in self._world.room_kinds or destination_of(label, Site()) is None

    def _judge_instances(self, instances: Sequence[Instance]) -> None:
        for instance in instances:
            if instance.state not in CONFIRMED_STATES:
                continue
            right_ids = self.confirmed.get(instance.label)  # None: not the name of a target
            if right_ids is None or instance.id in right_ids | self.false_confirmed:
                continue
            x, y = instance.center_m[:2].tolist()
            is_right = self.distance_to_target_m(instance.label, x, y) <= SAME_M
            (right_ids if is_right else self.false_confirmed).add(instance.id)

    # -- the outcome ------------------------------------------------------------------------------

    def distance_to_target_m(self, target: str, x_m: float, y_m: float) -> float:
        """Return the distance to the nearest footprint of a target; inf if there is none.

        The footprint of a kind of room is its floor.
        """
        if target in self._world.room_kinds:
            return distance_to_room_m(self._world, target, x_m, y_m)
        objects = self.objects.get(target, [])
        return min((item.distance_m(x_m, y_m) for item in objects), default=math.inf)

    @property
    def wrong_stops(self) -> list[tuple[str, float]]:
        """The entries of `stops` that were too far from any such object, or in no such room."""
        kinds = self._world.room_kinds
        return [(name, m) for name, m in self.stops if m > (0.0 if name in kinds else REACHED_M)]

    @property
    def zone_entries(self) -> int | None:
        """Number of entries of the robot's footprint into zones; None without zones."""
        return None if self._zones is None else self._zones.entries

    @property
    def stuck_s(self) -> float:
        """Time for which the robot has stayed within `STUCK_RADIUS_M` [s]."""
        return self.seconds - self._anchor[0]

    def first_sight(self) -> FirstSight | None:
        """Return the first time that any target was seen; None: never."""
        return min(self.first_sights.values(), key=lambda sight: sight.seconds, default=None)

    def failure(self, pursued: str) -> str | None:
        """Return the kind of failure, one of `edge.lab.eval.outcome.FAILURES`; None for a success.

        The first that holds:

        - `wrong thing`: a `reached` report was wrong.
        - `probable`: the robot stopped at an object that it was not sure of (`mission.probable`).
        - `stuck`: the robot stayed in one place for the last minute.
        - `seen, not confirmed`: the target was in view but never confirmed.
        - `budget`: time or path ran out.
        - `never seen`: the mission was abandoned, and the target was never in view.
        - `stuck`: the mission was abandoned although the target was confirmed.
        """
        if self.wrong_stops:
            return "wrong thing"
        if self.probable:
            return "probable"
        if self.status is not None and self.status.phase == "reached":
            return None
        over_budget = (
            self.status is None or not self.status.done or "limit of" in self.status.reason
        )
        if self.stuck_s >= STUCK_AFTER_S:
            return "stuck"
        if pursued in self.first_sights and not self.confirmed.get(pursued):
            return "seen, not confirmed"
        if over_budget:
            return "budget"
        return "never seen" if pursued not in self.first_sights else "stuck"


def objects_meant_by(world: World, target: str) -> list[WorldObject]:
    """Return the world's objects that a target means: those of its name, else of its noun.

    As for the service, narrower kinds count: an armchair is a chair, a desk is a table.
    """
    exact = [item for item in world.objects if names.is_kind_of(item.label, target)]
    noun = _noun(target)
    return exact or [item for item in world.objects if names.is_kind_of(item.label, noun)]


def _noun(target: str) -> str:
    """Return the first known head noun of a target's name, else the name itself."""
    known = (noun for noun in names.head_nouns(target) if names.is_known(noun))
    return next(known, target)


def object_mask(objects: Sequence[WorldObject], n_ids: int) -> np.ndarray:
    """Return (n_ids,) bool by object id: True for these objects."""
    mask = np.zeros(n_ids, np.bool_)
    mask[[item.id for item in objects]] = True
    return mask

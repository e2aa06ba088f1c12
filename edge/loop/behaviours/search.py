"""Search behaviour: explore, find the active target and go to it (VL-Nav alg. 2, ViTL alg. 1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from edge.config import Config
from edge.loop.behaviours.pursuits import (
    CheckPursuit,
    ExplorePursuit,
    PlacePursuit,
    Pursuit,
    WaitPursuit,
)
from edge.loop.behaviours.room_pursuits import (
    CheckRoomPursuit,
    ExploreRoomPursuit,
    RoomPursuit,
    SearchRoomPursuit,
)
from edge.loop.behaviours.room_targets import close_forbidden, known_targets, positions_of_target
from edge.loop.behaviours.tours import (
    EveryObjectInRoomPursuit,
    EveryObjectPursuit,
    EveryRoomPursuit,
)
from edge.loop.goals.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.memory import parse_description
from edge.mission.destinations import (
    CheckTarget,
    EveryObjectTarget,
    EveryRoomTarget,
    ExploreTarget,
    FailureTarget,
    PlaceTarget,
    RoomTarget,
    WaitTarget,
)
from edge.mission.run import MissionRun
from edge.mission.travel_cost import TravelCostEstimator
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import PolicyInput
from edge.tasks.scene.pipeline import GroundKinds
from edge.types import Goal, Instance


def _make_explore_pursuit(destination: ExploreTarget, *others: Any) -> Pursuit:
    pursuit_class = ExploreRoomPursuit if destination.room else ExplorePursuit
    return pursuit_class(destination, *others)


def _make_check_pursuit(destination: CheckTarget, *others: Any) -> Pursuit:
    pursuit_class = CheckRoomPursuit if destination.room else CheckPursuit
    return pursuit_class(destination, *others)


def _make_every_object_pursuit(destination: EveryObjectTarget, *others: Any) -> Pursuit:
    pursuit_class = EveryObjectInRoomPursuit if destination.room else EveryObjectPursuit
    return pursuit_class(destination, *others)


def _make_object_pursuit(_: None, mission: MissionRun, *others: Any) -> Pursuit:
    """Return the pursuit of an object; one with a fallback is not searched for outside its room."""
    described = parse_description(mission.target)
    has_fallback = FailureTarget(mission.target) in mission.destinations.values()
    if described is not None and described.room and has_fallback:
        return SearchRoomPursuit(described, mission, *others)
    return Pursuit(None, mission, *others)


PURSUITS: dict[type | None, Callable[..., Pursuit]] = {
    None: _make_object_pursuit,
    PlaceTarget: PlacePursuit,
    ExploreTarget: _make_explore_pursuit,
    WaitTarget: WaitPursuit,
    CheckTarget: _make_check_pursuit,
    RoomTarget: RoomPursuit,
    EveryRoomTarget: EveryRoomPursuit,
    EveryObjectTarget: _make_every_object_pursuit,
}
"""Pursuit by the class of the destination; `None` is for an object, which has no destination."""


class SearchBehaviour:
    """A behaviour that pursues the active target: an object to search for, or a destination.

    Args:
        travel_costs: Estimates travel costs between targets; None if the planner does not use them.
    """

    searching = True

    def __init__(
        self,
        mission: MissionRun,
        config: Config,
        semantic_map: SemanticMap,
        goals: GoalTracker,
        travel_costs: TravelCostEstimator | None,
    ) -> None:
        self._mission, self._config = mission, config
        self._map, self._goals, self._travel_costs = semantic_map, goals, travel_costs
        self._object_targets = tuple(
            t for t in mission.spec.targets if t not in mission.destinations
        )
        self._round = mission.progress.round
        # `MissionRun.retargets` when the pursuit began, and the pursuit.
        self._pursued: tuple[int, Pursuit] | None = None

    @property
    def _pursuit(self) -> Pursuit:
        """The pursuit of the active target, a new one whenever another target becomes active."""
        if self._pursued is None or self._pursued[0] != self._mission.retargets:
            mission = self._mission
            destination = mission.destinations.get(mission.target)
            make_pursuit = PURSUITS[None if destination is None else type(destination)]
            pursuit = make_pursuit(destination, mission, self._map, self._goals)
            self._pursued = (mission.retargets, pursuit)
        return self._pursued[1]

    def target_objects(self) -> Sequence[Instance]:
        """Return the objects that are candidates for the active target."""
        return () if self._mission.done else self._pursuit.target_objects()

    def plan(self, context: PolicyInput, images: int) -> None:
        """Check the goal; fail the target if the search for it is exhausted."""
        mission, grid, goals = self._mission, self._map.grid, self._goals
        pose, now_ns = context.pose, context.now_ns
        self._forget_last_round()
        only_confirmed = not self._config.policy.instances
        newest = newest_ids(self._map.tracker, self._object_targets, only_confirmed)
        mission.on_detections(newest | known_targets(mission, self._map), now_ns)
        close_forbidden(mission, self._map)
        if self._travel_costs is not None:
            positions_of = partial(positions_of_target, mission, self._map)
            self._travel_costs.step(mission, grid, positions_of, pose, now_ns)
        if goals.follows(mission) and mission.active:
            self._pursuit.check_progress(context, images)
            self._forget_last_round()

    def _forget_last_round(self) -> None:
        """Forget which objects the last round reached, since a new round counts them again."""
        if self._mission.progress.round != self._round:
            self._round = self._mission.progress.round
            self._map.tracker.forget_verdicts(rejected=False)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Return the goal that the pursuit of the active target chooses."""
        return self._pursuit.select(context, scores, images)

    def task_status(self) -> None:
        """Return None, since there is no trajectory."""

    def reconfigure(self, config: Config, ground: GroundKinds | None) -> None:
        self._config = config

    def on_pose_jump(self) -> None:
        """Start the pursuit of the target again: a tour knows places in the old frame."""
        self._pursued = None

    def close(self) -> None:
        """Do nothing: the estimator of travel costs belongs to the service."""


def newest_ids(
    tracker: InstanceTracker,
    targets: Sequence[str],
    only_confirmed: bool,
    with_contested: bool = True,
) -> dict[str, int]:
    """Return the highest object id of each target that has a known object.

    Args:
        tracker: The instance tracker.
        targets: The targets.
        only_confirmed: Count only confirmed objects.
        with_contested: Count objects that were more often detected as another class, too.
    """
    known = {label: tracker.of(label, only_confirmed, with_contested) for label in targets}
    return {label: max(i.id for i in found) for label, found in known.items() if found}

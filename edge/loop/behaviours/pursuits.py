"""Pursuits: how the robot pursues one target of a mission, by the kind of the target.

`PURSUITS` has one class for each kind of destination. Another kind needs a class and a line there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.memory import known_objects
from edge.mission.destinations import (
    CheckTarget,
    Destination,
    ExploreTarget,
    PlaceTarget,
    WaitTarget,
    shown_s,
)
from edge.mission.run import MissionRun
from edge.policies.base import PolicyInput
from edge.types import Goal, Instance

_MOST_NAMED = 12
Kind = TypeVar("Kind", bound="Destination | None")


class Pursuit(Generic[Kind]):
    """Pursuit of a thing: search for it, and go to it. Base class of the others.

    Args:
        destination: The active target; None for a thing.
        mission: The mission.
        here: The semantic map.
        goals: The goal tracker.
    """

    def __init__(
        self, destination: Kind, mission: MissionRun, here: SemanticMap, goals: GoalTracker
    ) -> None:
        self._destination, self._mission, self._map, self._goals = destination, mission, here, goals

    def gather(self) -> Sequence[Instance]:
        """Return the objects that are candidates for this target."""
        prompt = self._mission.brief.prompt_for(self._mission.target)
        sure, doubted = not self._map.config.policy.instances, self._goals.searched
        return self._map.tracker.of(prompt, sure, doubted=doubted)

    def judge(self, context: PolicyInput, images: int) -> None:
        """Check the goal, then the end of the target; see `Behaviour.plan`."""
        turns = self._mission.turns
        self._goals.judge(
            self._map.grid, context.pose, self._mission, images, context.now_ns, self._is_reached
        )
        if self._mission.turns == turns and not self._mission.done and self._goals.exhausted:
            self.finish(context.now_ns)

    def _is_reached(self, instance: Instance) -> bool:
        """Return True if the robot, which stands next to it, has reached this object."""
        return self._map.tracker.confirmed(instance)

    def finish(self, now_ns: int) -> None:
        """End the target: no candidate is left."""
        self._mission.give_up(self._goals.failure_reason(self._mission, self._map.grid), now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Return the goal of this tick; see `Behaviour.select`."""
        return self._goals.choose(context, self._map.grid, scores, images)


class PlacePursuit(Pursuit[PlaceTarget]):
    """Pursuit of a place: go to its pose."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        place = self._mission.destinations[self._mission.target]
        assert isinstance(place, PlaceTarget)
        assert place.pose is not None  # set by `locate`
        target = self._mission.target
        return self._goals.go_to_place(context, self._map.grid, place.pose, target, images)


class ExplorePursuit(Pursuit[ExploreTarget]):
    """Exploration until no frontier is left, or for some time."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def judge(self, context: PolicyInput, images: int) -> None:
        mission, limit_s = self._mission, self._destination.limit_s
        if limit_s is not None:
            left_s = limit_s - mission.pursued_now_s
            if left_s <= 0:
                self.finish(context.now_ns)
                return
            mission.activity = f"exploring, {_left(left_s)}"
        super().judge(context, images)

    def finish(self, now_ns: int) -> None:
        known = f"{self._map.grid.known_m2:.0f} m² are known"
        self._mission.on_reached(known, now_ns, f"{known}, {self._found()}")

    def _found(self) -> str:
        """Return the names of the objects in the map, the most frequent first."""
        least = self._map.config.perception.min_hits
        objects = known_objects(self._map.sightings.shown, 0, least)
        numbers = Counter(one.name for one in objects).most_common()
        named = [f"{name} ({n})" if n > 1 else name for name, n in numbers[:_MOST_NAMED]]
        more = len(numbers) - len(named)
        named += [f"{more} more kinds"] if more else []
        return f"found: {', '.join(named)}" if named else "found no objects"


class WaitPursuit(Pursuit[WaitTarget]):
    """Wait where the robot is."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def judge(self, context: PolicyInput, images: int) -> None:
        mission, seconds = self._mission, self._destination.seconds
        self._goals.phase = "waiting"
        if seconds is None:
            mission.activity = "waiting until told to go on"
            return
        left_s = seconds - mission.pursued_now_s
        mission.activity = f"waiting, {_left(left_s)}"
        if left_s <= 0:
            mission.on_reached(f"waited {shown_s(seconds)}", context.now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        self._goals.rest()
        return None


class CheckPursuit(Pursuit[CheckTarget]):
    """A look if a thing is there: at where it was before, then everywhere.

    The answer is yes if the thing is confirmed and detected during the pursuit. It is no if the
    search for it ends; the target counts as reached with either answer.
    """

    _since_ns: int | None = None  # stamp of the first observation of the pursuit

    def judge(self, context: PolicyInput, images: int) -> None:
        mission, tracker = self._mission, self._map.tracker
        if self._since_ns is None:
            self._since_ns = context.observation.stamp_ns
        prompt = mission.brief.prompt_for(mission.target)
        seen = [one for one in tracker.of(prompt, sure=True) if one.last_seen_ns >= self._since_ns]
        if seen:
            self._answer_yes(seen, context)
            return
        mission.activity = f"checking for the {self._destination.name}"
        limit_s = mission.config.search_limit_s
        if limit_s is not None and mission.pursued_now_s > limit_s:
            self._answer_no(f"not found within {shown_s(limit_s)}", context.now_ns)
            return
        super().judge(context, images)

    def finish(self, now_ns: int) -> None:
        reason = self._goals.failure_reason(self._mission, self._map.grid)
        self._answer_no(reason, now_ns)

    def _is_reached(self, instance: Instance) -> bool:
        """Return False: only a new detection counts, and `judge` handles those."""
        return False

    def _answer_yes(self, seen: Sequence[Instance], context: PolicyInput) -> None:
        pose = context.pose
        at = min(seen, key=lambda one: one.distance_m(pose.x_m, pose.y_m))
        x_m, y_m, _ = at.center_m.tolist()
        others = f"; {len(seen)} in all" if len(seen) > 1 else ""
        where = f"at ({x_m:.1f}, {y_m:.1f}), {at.distance_m(pose.x_m, pose.y_m):.1f} m away{others}"
        answer = f"yes, there is a {self._destination.name} {where}"
        self._mission.on_reached(answer, context.now_ns, answer)

    def _answer_no(self, reason: str, now_ns: int) -> None:
        answer = f"no, there is no {self._destination.name}: {reason}"
        self._mission.on_reached(answer, now_ns, answer)


PURSUITS: dict[type | None, type[Pursuit]] = {
    None: Pursuit,
    PlaceTarget: PlacePursuit,
    ExploreTarget: ExplorePursuit,
    WaitTarget: WaitPursuit,
    CheckTarget: CheckPursuit,
}
"""The pursuit of each kind of destination; that of `None` is for things."""


def _left(left_s: float) -> str:
    return f"{shown_s(math.ceil(max(0.0, left_s)))} left"

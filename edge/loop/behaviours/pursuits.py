"""Pursuits: the way to one kind of target, and the rule that says when the robot is done.

`SearchBehaviour` makes a pursuit for each active target and calls it in each tick. A target is an
*object*, such as "chair", or a destination: a place, an exploration, a wait, a check, a room
(`room_pursuits`) or a tour of rooms (`tours`).

`PURSUITS` in `search` has a class, or a function that chooses one, for each kind of destination.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.loop.goals.goal import GoalTracker
from edge.loop.goals.known_goals import goal_at_place, goal_at_point, scores_towards
from edge.loop.goals.search_state import ProbableObject
from edge.loop.semantic_map import SemanticMap
from edge.memory import MappedRoom, describe_location, known_objects
from edge.mission.destinations import (
    CheckTarget,
    Destination,
    ExploreTarget,
    PlaceTarget,
    WaitTarget,
)
from edge.mission.language.words.spans import shown_s
from edge.mission.run import PROBABLY, MissionRun
from edge.policies.base import PolicyInput
from edge.text import one_line
from edge.types import Goal, Instance

_MAX_NAMES = 12  # object names in the report of an exploration
_SPEED_SHARE = 0.5  # mean speed of the robot on a way back, as a share of its largest speed
_RESERVE_M = 2.0  # path that is left for a way back that is longer than it looks
_ASK_S = 60.0  # time for a person to confirm a probable object
# If the place in front of a probable object has no path, these offsets from it are tried, for some
# time: odometry drifts, and a person may stand in the way.
_AROUND_M = np.array([(x, y) for x in (-0.4, 0.0, 0.4) for y in (-0.4, 0.0, 0.4)])
_NO_PATH_NS = 10_000_000_000
DestinationType = TypeVar("DestinationType", bound="Destination | None")


class Pursuit(Generic[DestinationType]):
    """Pursuit of an object: search for it, and go to it. Base class of the others.

    Args:
        destination: The active target; None for an object.
    """

    def __init__(
        self,
        destination: DestinationType,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        self._destination, self._mission = destination, mission
        self._map, self._goals, self._chooser = semantic_map, goals, goals.chooser
        self._since_ns: int | None = None  # stamp of the first observation of the pursuit
        self._probable: ProbableObject | None = None  # the object that the robot goes back to
        self._no_path_since_ns: int | None = None  # None: there is a path to this object
        self._last_look = False  # True: the limits just suffice to look at a contested object
        self._asked_at_s = 0.0  # `pursued_now_s` of the mission when the robot asked about it

    @property
    def _target_label(self) -> str:
        """The object to go to: a name, or a description by a relation."""
        return self._mission.target

    def target_objects(self) -> Sequence[Instance]:
        """Return the objects that are candidates for this target."""
        return self._known_objects()

    def _known_objects(self) -> Sequence[Instance]:
        """Return the known objects that the target may mean."""
        only_confirmed = not self._map.config.policy.instances
        # Objects that probably are another object come last, when nothing else is left.
        with_contested = self._chooser.search.exhausted or self._last_look
        return self._map.tracker.of(
            self._target_label, only_confirmed, with_contested=with_contested
        )

    def check_progress(self, context: PolicyInput, images: int) -> None:
        """Check the goal, then the end of the target; see `Behaviour.plan`."""
        self._begin(context)
        if not self._follow_goal(context, images):
            return
        if self._probable is not None:
            self._check_probable(self._probable, context)
        elif self._chooser.exhausted:
            self.finish(context.now_ns)
        elif self._goals.phase == "searching":
            self._mind_limits(context.now_ns)

    def _follow_goal(self, context: PolicyInput, images: int) -> bool:
        """Handle the progress of the goal; return True if the target is still active."""
        mission, retargets_before = self._mission, self._mission.retargets
        self._goals.check_progress(
            self._map.grid, context.pose, mission, images, context.now_ns, self._is_reached
        )
        return mission.retargets == retargets_before and not mission.done

    def _begin(self, context: PolicyInput) -> None:
        """Note the time of the first observation: an object must be seen after it."""
        if self._since_ns is None:
            self._since_ns = context.observation.stamp_ns

    def _mind_limits(self, now_ns: int) -> None:
        """Go to the object that may be the target while the limits just suffice for that."""
        probable, travel_cost = self._chooser.search.probable, self._map.grid.travel_cost
        if probable is not None and self._mission.config.probable != "refuse":
            if self._is_late(travel_cost.distance_m(*probable.stop_m)):
                self.finish(now_ns)
        elif not self._last_look:
            for contested in self._map.tracker.of(self._target_label)[:1]:
                reach_m = self._mission.config.reach_m
                stop = travel_cost.stopping_point(contested.points_m, reach_m)
                self._last_look = stop is not None and self._is_late(stop[2])

    def _is_late(self, path_m: float) -> bool:
        """Return True if the limits just suffice for a path of this length."""
        mission, c = self._mission, self._mission.config
        elapsed_s, driven_m = mission.meter.limited
        left_s = min(
            c.time_limit_s - elapsed_s, (c.search_limit_s or math.inf) - mission.pursued_now_s
        )
        speed_mps = _SPEED_SHARE * self._map.config.robot.max_speed_mps
        left_m = min(c.path_limit_m - driven_m, left_s * speed_mps)
        return math.isfinite(path_m) and path_m + _RESERVE_M >= left_m

    def _is_reached(self, instance: Instance, pose: SE2) -> bool:
        """Return True if the robot, which stands next to it, has reached this object.

        A remembered object must be seen again: it may have been moved.
        """
        seen_again = self._since_ns is not None and instance.last_seen_ns >= self._since_ns
        return seen_again and self._map.tracker.verified_now(instance, pose)

    def finish(self, now_ns: int) -> None:
        """End the target, or go back to a probable object: no candidate is left."""
        if self._mission.config.probable != "refuse":
            self._probable = self._chooser.search.probable
        if self._probable is None:
            self._mission.abandon_target(self._failure_reason(), now_ns)

    def _failure_reason(self) -> str:
        return self._chooser.failure_reason(self._mission, self._map.grid)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Return the goal of this tick; see `Behaviour.select`."""
        grid, target = self._map.grid, self._mission.target
        if self._probable is None:
            return self._chooser.choose(context, grid, scores, images)
        if self._mission.question:
            self._goals.idle()
            return None
        stop_m = np.array([self._probable.stop_m])
        for points_m in (stop_m, stop_m + _AROUND_M):
            goal = goal_at_point(self._goals.goal, context, grid, points_m, target, keep=True)
            if goal is not None:
                self._no_path_since_ns = None
                return self._chooser.drive_to(goal, ends_on_arrival=False)
        self._no_path_since_ns = self._no_path_since_ns or context.now_ns
        return None

    def _check_probable(self, probable: ProbableObject, context: PolicyInput) -> None:
        """Accept the probable object when the robot is at it, or ask a person."""
        mission, goals, now_ns = self._mission, self._goals, context.now_ns
        if self._chooser.search.probable is not probable:  # the frame has changed: search again
            self._probable, mission.question = None, ""
            return
        no_path_since_ns = self._no_path_since_ns
        if no_path_since_ns is not None and now_ns - no_path_since_ns >= _NO_PATH_NS:
            mission.abandon_target(self._failure_reason(), now_ns)
            return
        goal = goals.goal
        arrived = goals.arrived and goal is not None and goal.kind == "place"
        if not (mission.question or arrived):
            mission.activity = f"going back to what may be the {mission.target}"
            return
        text = mission.question or self._describe(probable)
        if mission.config.probable == "accept":
            self._chooser.abandon()
            mission.on_reached(text, now_ns, text)
            return
        if not mission.question:
            mission.question, self._asked_at_s = text, mission.pursued_now_s
            mission.log_event(now_ns, "warning", mission.target, f"not sure: {text}")
        goals.phase = "waiting"
        left_s = self._asked_at_s + _ASK_S - mission.pursued_now_s
        mission.activity = f"{text}; waiting for `edge mission confirm`, {time_left(left_s)}"
        if left_s <= 0:
            mission.abandon_target(f"{text}; not confirmed within {_ASK_S:g} s", now_ns)

    def _describe(self, probable: ProbableObject) -> str:
        """Return the score of an object and its possible names: "probably, 0.31: sofa or bench"."""
        shown, target = self._map.objects.read_only, self._mission.target
        near_m = self._map.config.perception.merge_m
        near = np.hypot(*(shown.xyz_m[: shown.n, :2] - probable.xy_m).T) <= near_m
        rows = sorted(np.flatnonzero(near).tolist(), key=lambda at: -shown.confidence[at])
        words = (shown.words[shown.word[at]] for at in rows)
        other = next((word for word in words if not names.is_kind_of(word, target)), None)
        is_it = target if other is None else f"{target} or {other}"
        return one_line(f"{PROBABLY}, {probable.score:.2f}: {is_it}")


class PlacePursuit(Pursuit[PlaceTarget]):
    """Pursuit of a place: go to its pose."""

    def target_objects(self) -> Sequence[Instance]:
        return ()

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        goals, grid, target = self._goals, self._map.grid, self._mission.target
        place = self._mission.destinations[target]
        assert isinstance(place, PlaceTarget)
        assert place.pose is not None  # set by `locate`
        goal = goal_at_place(goals.goal, context, grid, place.pose, target)
        if goal is not None:
            return self._chooser.drive_to(goal)
        scores = scores_towards(context, (place.pose.x_m, place.pose.y_m))
        return self._chooser.choose(context, grid, scores, images)


class ExplorePursuit(Pursuit[ExploreTarget]):
    """Exploration until no frontier is left, or for some time."""

    def target_objects(self) -> Sequence[Instance]:
        return ()

    def check_progress(self, context: PolicyInput, images: int) -> None:
        mission, limit_s = self._mission, self._destination.limit_s
        if limit_s is not None:
            left_s = limit_s - mission.pursued_now_s
            if left_s <= 0:
                self.finish(context.now_ns)
                return
            mission.activity = f"exploring, {time_left(left_s)}"
        super().check_progress(context, images)

    def finish(self, now_ns: int) -> None:
        known = f"{self._map.grid.known_m2:.0f} m² are known"
        self._mission.on_reached(known, now_ns, f"{known}, {objects_found(self._map)}")


class WaitPursuit(Pursuit[WaitTarget]):
    """Wait where the robot is."""

    def target_objects(self) -> Sequence[Instance]:
        return ()

    def check_progress(self, context: PolicyInput, images: int) -> None:
        mission, wait, now_ns = self._mission, self._destination, context.now_ns
        self._goals.phase = "waiting"
        if wait.until is not None:
            ends_ns = mission.meter.end_of_wait_ns(mission.target, wait.until, now_ns)
            left_s = (ends_ns - now_ns) * 1e-9
            mission.activity = f"waiting {wait.shown}, {_long_time_left(left_s)}"
        elif wait.seconds is not None:
            left_s = wait.seconds - mission.pursued_now_s
            mission.activity = f"waiting, {time_left(left_s)}"
        else:
            mission.activity = f"waiting {wait.shown}"
            return
        if left_s <= 0:
            mission.on_reached(f"waited {wait.shown}", now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        self._goals.idle()
        return None


class CheckAnswer:
    """Answers a check: yes for an object that is confirmed and seen during the pursuit, else no."""

    def __init__(self, check: CheckTarget, mission: MissionRun, semantic_map: SemanticMap) -> None:
        self.label = check.name
        self._room = f"in the {check.room}" if check.room else ""
        self._mission, self._map = mission, semantic_map
        self._since_ns: int | None = None  # stamp of the first observation of the pursuit
        self._known_before = ""  # text about the object from earlier sightings

    def new_detections(self, context: PolicyInput) -> list[Instance]:
        """Return the confirmed objects that were detected since the first call."""
        if self._since_ns is None:
            self._since_ns = context.observation.stamp_ns
            self._known_before = self._remembered(context)
        confirmed = self._map.tracker.of(self.label, only_confirmed=True)
        return [one for one in confirmed if one.last_seen_ns >= self._since_ns]

    def answer_yes(self, found: Sequence[Instance], context: PolicyInput) -> None:
        """Answer that these objects are there."""
        pose = context.pose
        at = min(found, key=lambda one: one.distance_m(pose.x_m, pose.y_m))
        x_m, y_m, _ = at.center_m.tolist()
        others = f"; {len(found)} in all" if len(found) > 1 else ""
        where = f"at ({x_m:.1f}, {y_m:.1f}), {at.distance_m(pose.x_m, pose.y_m):.1f} m away{others}"
        room = self._map.rooms.room_phrase(x_m, y_m) or self._room
        answer = " ".join(filter(None, ("yes, there is a", self.label, room, where)))
        self._mission.on_reached(answer, context.now_ns, answer)

    def answer_no(self, reason: str, now_ns: int) -> None:
        """Answer that there is none."""
        before = f"; seen before: {self._known_before}" if self._known_before else ""
        none = " ".join(filter(None, ("no, there is no", self.label, self._room)))
        answer = f"{none}: {reason}{before}"
        self._mission.on_reached(answer, now_ns, answer)

    def _remembered(self, context: PolicyInput) -> str:
        """Return where and when the object was seen before, for people; "" if never."""
        shown, least = self._map.objects.read_only, self._map.config.perception.min_hits
        found = known_objects(shown, context.observation.stamp_ns, least, self.label)[:1]
        if not found:
            return ""
        return describe_location(self.label, found, context.pose, True, self._map.rooms.room_phrase)

    def time_is_over(self, now_ns: int) -> bool:
        """Answer no and return True if the search limit is over."""
        limit_s = self._mission.config.search_limit_s
        if limit_s is None or self._mission.pursued_now_s <= limit_s:
            return False
        self.answer_no(f"not found within {shown_s(limit_s)}", now_ns)
        return True


class CheckPursuit(Pursuit[CheckTarget]):
    """Pursuit that checks if an object is there: first where it was seen before, then everywhere.

    The target counts as reached with either answer.
    """

    @cached_property
    def _answer(self) -> CheckAnswer:
        return CheckAnswer(self._destination, self._mission, self._map)

    @property
    def _target_label(self) -> str:
        return self._answer.label

    def check_progress(self, context: PolicyInput, images: int) -> None:
        answer = self._answer
        self._mission.activity = f"checking for the {answer.label}"
        if found := answer.new_detections(context):
            answer.answer_yes(found, context)
        elif not answer.time_is_over(context.now_ns):
            super().check_progress(context, images)

    def finish(self, now_ns: int) -> None:
        reason = self._chooser.failure_reason(self._mission, self._map.grid)
        self._answer.answer_no(reason, now_ns)

    def _is_reached(self, instance: Instance, pose: SE2) -> bool:
        """Return False: only a new detection counts, and `check_progress` handles those."""
        return False


def time_left(left_s: float) -> str:
    """Return a time as text: "5 min left"."""
    return f"{shown_s(math.ceil(max(0.0, left_s)))} left"


def _long_time_left(left_s: float) -> str:
    """Return a time of up to a day as text: "3 h 20 min left", "45 s left"."""
    if left_s <= 60:
        return time_left(left_s)
    hours, minutes = divmod(math.ceil(left_s / 60), 60)
    shown = (f"{hours} h" * (hours > 0), f"{minutes} min" * (minutes > 0))
    return f"{' '.join(filter(None, shown))} left"


def objects_found(semantic_map: SemanticMap, room: MappedRoom | None = None) -> str:
    """Return the names of the objects in the map, or in a room, the most frequent first."""
    objects = known_objects(
        semantic_map.objects.read_only, 0, semantic_map.config.perception.min_hits
    )
    if room is not None:
        xy_m = np.array([one.xyz_m[:2] for one in objects], np.float32).reshape(-1, 2)
        ids = semantic_map.rooms.survey.ids[semantic_map.rooms.survey.regions.at(xy_m)]
        objects = [one for one, at in zip(objects, ids.tolist(), strict=True) if at == room.id]
    numbers = Counter(one.name for one in objects).most_common()
    named = [f"{name} ({n})" if n > 1 else name for name, n in numbers[:_MAX_NAMES]]
    more = len(numbers) - len(named)
    named += [f"{more} more kinds"] if more else []
    return f"found: {', '.join(named)}" if named else "found no objects"

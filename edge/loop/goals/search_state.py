"""Search when no candidate is left: turns on the spot, retries and viewpoints.

`GoalChooser` uses it. `SearchState` belongs to one target, `NextBestView` to the mission.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from edge.geometry import SE2
from edge.host.checkpoint import Arrays
from edge.loop.goals.candidates import CandidatePool
from edge.mapping.grid import RollingMap
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import PolicyInput
from edge.types import Goal, Instance

# Time without a candidate after which the robot turns on the spot.
TURN_AFTER_NS = 1_000_000_000
# Number of turns that make a full circle.
TURNS = 3
# Seen from afar, the border of known space flickers. A frontier that appears after the search was
# exhausted must exist for this time.
LASTING_NS = 2_000_000_000
# Shortest time of a retry of blocked places. A new frontier appears there a tick or two after the
# opening, and is used only after `LASTING_NS`.
_RETRY_NS = LASTING_NS + 1_000_000_000
# Largest number of retries of blocked places.
_RETRIES = 2
# Shortest time between two retries: a person in the way may leave in this time.
_PAUSE_NS = 10_000_000_000
# Largest number of retries of cells in which something arrived, when no candidate is left: a door
# may stay closed.
_WAITS = 10
# Number of these retries after which any small obstacle may have been a person.
_SMALL_FROM = 2
# Number of these retries that the search waits for even if all candidates are in reach: a person
# may stand in a door that was not seen yet.
_LEAST_WAITS = 3
# A frontier is unreliable if it was left this many times (for another, or because it vanished)
# before the robot arrived: it is visible only from afar, or farther than it looks. The robot then
# either drives all the way to it or ignores it.
_OFTEN_LEFT = 3
_SAME_FRONTIER_M = 0.6  # frontiers that were left this near to each other count as the same
MAX_PLACES = 64  # largest number of remembered frontiers that were left, and of places out of reach
_SAME_PLACE_M = 0.3  # two goals this near to each other count as the same place


class ProbableObject(NamedTuple):
    """An object that was rejected although the detector saw it: it was never sure.

    Attributes:
        score: Score of the object at its rejection.
        stop_m: Place (x, y) of the robot's goal there.
        xy_m: Place of the object.
    """

    score: float
    stop_m: tuple[float, float]
    xy_m: tuple[float, float]


@dataclass(slots=True, eq=False)
class SearchState:
    """The state of the search for one target.

    Attributes:
        exhausted: True if no candidate was left and turns on the spot showed nothing new. Later
            candidates are used, but the robot does not turn again.
        left: Places of frontiers that were left before the robot arrived.
        has_moved: True if a confirmed object was not seen again at its place. A checkpoint does
            not save this.
        probable: The rejected object with the best score; None if there is none. A checkpoint does
            not save this.
        waiting: True if the map has just forgotten people and doors, and they may still go. The
            search does not end then. A checkpoint does not save this.
    """

    exhausted: bool = False
    left: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MAX_PLACES))
    has_moved: bool = False
    probable: ProbableObject | None = None
    waiting: bool = False
    _turns: int = 0  # since there was a candidate
    _idle_since_ns: int | None = None  # time since which there is no candidate and no turn
    _second_chance: bool = False  # True if discarded candidates had their second chance
    # Instances that were out of reach: id, and the place (x, y) of the goal that was reached.
    _missed: deque[tuple[int, tuple[float, float]]] = field(
        default_factory=lambda: deque(maxlen=MAX_PLACES)
    )
    _failures: Counter[int] = field(default_factory=Counter)  # of goals, by instance; not saved
    _jumps: Counter[int] = field(default_factory=Counter)  # likewise; see `count_jump`
    # Places of frontiers whose goals ended; not saved.
    _visited: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MAX_PLACES))
    _retry: tuple[int, int] | None = None  # generation of the travel-cost field and time of its end
    _retries: int = 0
    _waits: int = 0
    _next_retry_ns: int = 0
    _next_opening_ns: int = 0

    def state_dict(self) -> Arrays:
        """Return the failed attempts by place, but no state that lasts only seconds."""
        missed = [(instance_id, *at_m) for instance_id, at_m in self._missed]
        return {
            "exhausted": np.array(self.exhausted),
            "turns": np.array(self._turns),
            "second_chance": np.array(self._second_chance),
            "left_m": np.array(self.left, np.float64).reshape(-1, 2),
            "missed": np.array(missed, np.float64).reshape(-1, 3),
        }

    @classmethod
    def of_state_dict(cls, state: Arrays) -> SearchState:
        """Return the search of a `state_dict` that was checked."""
        search = cls(bool(state["exhausted"]))
        search.left.extend((x, y) for x, y in state["left_m"].tolist())
        search._turns, search._second_chance = int(state["turns"]), bool(state["second_chance"])
        for i, x, y in state["missed"].tolist():
            search._missed.append((int(i), (x, y)))
        return search

    def often_left(self, xy_m: tuple[float, float]) -> bool:
        """Return True if a frontier here was left too often before the robot arrived."""
        return sum(math.dist(xy_m, left) < _SAME_FRONTIER_M for left in self.left) >= _OFTEN_LEFT

    def mark_missed(self, instance_id: int, at_m: tuple[float, float]) -> bool:
        """Record an instance as out of reach from a place; return True if it was one before."""
        before = self.missed_from(instance_id, at_m)
        self._missed.append((instance_id, at_m))
        return before

    def missed_from(self, instance_id: int, at_m: tuple[float, float]) -> bool:
        """Return True if an instance was out of reach from a place."""
        return any(
            missed_id == instance_id and math.dist(place_m, at_m) <= _SAME_PLACE_M
            for missed_id, place_m in self._missed
        )

    def has_failed(self, instance_id: int) -> bool:
        """Return True if a goal at an instance failed."""
        return self._failures[instance_id] > 0

    def count_failure(self, instance_id: int) -> int:
        """Count a failed goal at an instance; return the number of failures before, at most 6."""
        self._failures[instance_id] += 1
        del self._jumps[instance_id]
        return min(self._failures[instance_id] - 1, 6)

    def count_visit(self, xy_m: tuple[float, float]) -> int:
        """Count a frontier whose goal ended; return the number of such goals before, at most 6."""
        n = sum(math.dist(xy_m, visited) < _SAME_FRONTIER_M for visited in self._visited)
        self._visited.append(xy_m)
        return min(n, 6)

    def count_jump(self, instance_id: int) -> int:
        """Count a goal at an instance that moved far; return the number since its last failure."""
        self._jumps[instance_id] += 1
        return self._jumps[instance_id]

    def note_probable(self, goal: Goal, instance: Instance, least_score: float) -> None:
        """Remember the object of a goal before its rejection, if it is the best so far."""
        if instance.score > (least_score if self.probable is None else self.probable.score):
            x_m, y_m, _ = instance.center_m.tolist()
            stop_m = (goal.pose.x_m, goal.pose.y_m)
            self.probable = ProbableObject(instance.score, stop_m, (x_m, y_m))

    def on_candidate(self) -> None:
        """Record that there is a candidate."""
        self._idle_since_ns = None
        if not self.exhausted:
            self._turns = 0

    def may_turn(self, turning: bool, now_ns: int) -> bool:
        """Return True if the robot should turn on the spot to see the space behind it.

        Args:
            turning: True if the robot is already turning.
            now_ns: Loop time.
        """
        if self.exhausted:
            return False
        if self._idle_since_ns is None:
            self._idle_since_ns = now_ns
        if turning:
            return True
        if now_ns - self._idle_since_ns < TURN_AFTER_NS:
            return False
        if self._turns == TURNS:
            self.exhausted = True
            return False
        self._turns += 1
        return True

    def on_turn_ended(self, now_ns: int) -> None:
        """Record the end of a turn, done or failed."""
        self._idle_since_ns = now_ns

    def retry(
        self, context: PolicyInput, grid: RollingMap, pool: CandidatePool, tracker: InstanceTracker
    ) -> bool:
        """Retry discarded candidates and blocked places; return True while that may help.

        Discarded candidates and rejected objects get one more chance. Blocked places are opened in
        the map, up to twice. So are cells in which something arrived, up to `_WAITS` times: a
        person who was seen there may have gone. From the third time on, any small obstacle may
        have been a person.
        """
        is_first, self._second_chance = not self._second_chance, True
        if is_first:
            pool.discarded.clear()
            tracker.forget_rejected(context.target)
        if self._retry is not None:
            generation, until_ns = self._retry
            if grid.travel_cost.generation < generation or context.now_ns < until_ns:
                return True
            self._retry = None
        may_open = self._retries < _RETRIES and bool(grid.bumps.closed_m)
        if context.now_ns < self._next_retry_ns:
            return is_first or may_open
        self._next_retry_ns = context.now_ns + _PAUSE_NS  # doors open, and people go
        opened = may_open and grid.bumps.open_all()
        self._retries += opened
        c = context.candidates
        has_unreachable = bool(np.isinf(c.path_m[: c.n]).any())
        forgot = self._forget_arrivals(grid, small_too=self._waits >= _SMALL_FROM)
        self.waiting = forgot and (has_unreachable or self._waits <= _LEAST_WAITS)
        if not (forgot or opened):
            return is_first
        pool.discarded.clear()
        self._missed.clear()
        # The travel-cost field that is growing now may have started before the opening. The next
        # one includes the place.
        self._retry = (grid.travel_cost.generation + 2, context.now_ns + _RETRY_NS)
        return True

    def open_path(self, now_ns: int, grid: RollingMap) -> None:
        """Free the cells in which something arrived, at most each ten seconds."""
        if now_ns >= self._next_opening_ns:
            self._next_opening_ns = now_ns + _PAUSE_NS
            self._forget_arrivals(grid)

    def _forget_arrivals(self, grid: RollingMap, small_too: bool = False) -> bool:
        """Free the cells in which something arrived, up to `_WAITS` times; return True if any."""
        forgot = self._waits < _WAITS and grid.forget_arrivals(small_too)
        self._waits += forgot
        return forgot


class NextBestView:
    """The choice of the next viewpoint from which the detector can see objects better.

    The robot goes to one viewpoint after another, until none is worth a goal. Each viewpoint is
    tried once.

    Args:
        images_needed: Number of images that the robot stays at a viewpoint.

    Attributes:
        images_needed: As in `Args`; may be set.
        done: True if no useful viewpoint is left.
        views: Number of viewpoints that are finished: the detector saw enough at the viewpoint, or
            already on the way to it.
    """

    def __init__(self, images_needed: int) -> None:
        self.done = False
        self.views = 0
        self.images_needed = images_needed
        self._view: SE2 | None = None
        self._searching = self._unreachable = False
        self._images_at_arrival: int | None = None  # the detector's number of images at the arrival

    def choose(self, grid: RollingMap, images: int) -> SE2 | None:
        """Return the viewpoint to go to; None after the last one, during the search, or if none.

        Args:
            grid: The map.
            images: Number of images that the detector has processed so far.
        """
        if self._view is not None and (
            self._is_finished(images) or not grid.coverage.is_worth_visiting(self._view)
        ):
            grid.coverage.write_off(self._view)
            self.views += not self._unreachable
            self.abandon()
        elif self._view is None and not self.done:
            self._search(grid)
        return self._view

    def on_arrived(self, images: int) -> None:
        """Record that the robot stands at the current viewpoint."""
        if self._images_at_arrival is None:
            self._images_at_arrival = images

    def mark_unreachable(self) -> None:
        """Record that the robot cannot reach the current viewpoint."""
        self._unreachable = True

    def reset(self) -> None:
        """Start over for another mission."""
        self.abandon()
        self.views = 0

    def abandon(self) -> None:
        """Abandon the current viewpoint. It may be found again."""
        self._view = self._images_at_arrival = None
        self.done = self._searching = self._unreachable = False

    def _is_finished(self, images: int) -> bool:
        """Return True if the robot stayed long enough at the viewpoint, or cannot reach it."""
        stayed = (
            self._images_at_arrival is not None
            and images - self._images_at_arrival >= self.images_needed
        )
        return stayed or self._unreachable

    def _search(self, grid: RollingMap) -> None:
        """Do one step of the search for the next viewpoint; a search takes several ticks."""
        coverage = grid.coverage
        if not self._searching:
            coverage.restart_search()
        self._searching = True
        if not coverage.search(grid.travel_cost):
            return
        view, self._searching = coverage.view, False
        if view is None:
            self.done = True
        elif coverage.is_worth_visiting(view):
            self._view = view
        else:  # its rays just missed the corner of a cell
            coverage.write_off(view)

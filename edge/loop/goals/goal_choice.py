"""Choice of the current goal: candidates, turns on the spot, retries and viewpoints.

Only `GoalChooser` stores the current goal.

An *instance* is an object that was detected as a target, as opposed to a frontier or a place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import partial

import numpy as np

from edge.config import Config
from edge.geometry import SE2, wrap_angle
from edge.host.checkpoint import Arrays, check_arrays
from edge.loop.goals.candidates import CandidatePool
from edge.loop.goals.search_state import LASTING_NS, MAX_PLACES, TURNS, NextBestView, SearchState
from edge.mapping.coverage import START_M
from edge.mapping.grid import RollingMap
from edge.mission.run import MissionRun
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import FRONTIER, INSTANCE, SPIN, PolicyInput
from edge.policies.select import STOP_M, CurrentGoal, InstanceQueries, choose, rank_candidates
from edge.types import CandidateKind, Goal, GoalStatus, Instance

_NEAR_M = 5.0
"""Distance around an object that cannot be reached in which the nearest free cell is looked for."""
_JUMP_M, _JUMPS = 1.5, 3
"""An object is left alone for some time if its goal moves by `_JUMP_M` more than `_JUMPS` times."""
_STOP_SHORT_M = 0.05
"""The robot stops by this distance nearer to an object than it must."""

_KINDS: tuple[CandidateKind, ...] = ("frontier", "instance", "spin")  # kinds that are saved


@dataclass(slots=True, eq=False)
class TrackedGoal:
    """A goal, with the state that ends with it.

    Attributes:
        goal: The goal.
        peak: Best score of its candidate so far.
        view: The viewpoint, if the goal is a viewpoint (see `NextBestView`).
        sent: True if the goal was sent.
        ends_on_arrival: True if a place is reached when the controller says so. False for a room,
            which is reached when the robot is inside.
        status: Newest goal status of the controller; None before the first.
        verifying_since_ns: Time at which the robot was at the goal and near enough to verify the
            instance; None before that.
        images_before: Number of images that the detector had processed at `verifying_since_ns`.
    """

    goal: Goal
    peak: float = 0.0
    view: SE2 | None = None
    sent: bool = False
    ends_on_arrival: bool = True
    status: GoalStatus | None = None
    verifying_since_ns: int | None = None
    images_before: int = 0


class GoalChooser:
    """The choice of the current goal, with the failed attempts at the current target.

    Args:
        config: The configuration.
        pool: Candidates. The chooser discards those that failed.
        tracker: Instances.

    Attributes:
        config: As in `Args`; may be set.
        tracked: The current goal; None if there is none.
        search: Failed attempts at the current target.
        next_view: Viewpoints from which the detector can see objects better.
        place_failures: Number of failed goals at the current target, if it is a place.
    """

    def __init__(self, config: Config, pool: CandidatePool, tracker: InstanceTracker) -> None:
        self.config = config
        self.tracked: TrackedGoal | None = None
        self.search = SearchState()
        self.next_view = NextBestView(config.perception.confirm_hits)
        self.place_failures = 0
        self._pool, self._tracker = pool, tracker
        # State from a checkpoint, and the target that it belongs to.
        self._restored: tuple[str, SearchState, TrackedGoal | None] | None = None

    @property
    def exhausted(self) -> bool:
        """True if no candidate and no viewpoint is left, and waiting is of no use."""
        return self.search.exhausted and self.next_view.done and not self.search.waiting

    def choose(
        self, context: PolicyInput, grid: RollingMap, score: np.ndarray, images: int
    ) -> Goal | None:
        """Choose the goal of this tick from the scored candidates (VL-Nav algorithm 2).

        If no candidate is left, the robot turns on the spot. After that, discarded candidates get
        one more chance, and blocked places are opened again and tried once the travel-cost field
        reaches them. Last, the robot goes to viewpoints of objects that the detector saw badly.
        If a remembered object is gone, it may be anywhere in known space: viewpoints then come
        whenever they show more per metre than the best candidate.

        Args:
            context: Candidates, pose and time of the tick.
            grid: The map. Blocked places are opened in it, and it is searched for viewpoints.
            score: (n,) float32, scores of the context's candidates.
            images: Number of images that the detector has processed so far.

        Returns:
            A goal on a free, reachable cell that faces its candidate, or None. It is the same
            object as before as long as the goal stays.
        """
        self.tracked = self._choose(self.tracked, context, grid, score, images)
        return None if self.tracked is None else self.tracked.goal

    def drive_to(self, goal: Goal, ends_on_arrival: bool = True) -> Goal:
        """Set and return a goal that is for no candidate; see `edge.loop.goals.known_goals`.

        Args:
            goal: The goal. The current goal stays if it is this one.
            ends_on_arrival: See `TrackedGoal`.
        """
        if goal.kind == "place":
            self.next_view.abandon()
            self.search.on_candidate()
        if self.tracked is None or goal is not self.tracked.goal:
            self.tracked = TrackedGoal(goal, ends_on_arrival=ends_on_arrival)
        return goal

    def abandon(self) -> None:
        """Abandon the current goal. Late statuses for it are ignored, its candidate stays."""
        self.tracked = None
        self.next_view.abandon()

    def discard(self, now_ns: int) -> None:
        """Abandon the current goal and ignore its candidate for some time."""
        tracked = self.tracked
        if tracked is not None and tracked.view is not None:
            self.next_view.mark_unreachable()
            return
        if tracked is not None and tracked.goal.kind == "place":
            self.place_failures += 1
        elif tracked is not None and tracked.goal.kind in _KINDS:
            self._discard_candidate(tracked.goal, now_ns)
        self.abandon()

    def begin_target(self, target: str) -> None:
        """Start on another target: forget goal and attempts of the last one."""
        self.abandon()
        self.search, self.place_failures = SearchState(), 0
        restored, self._restored = self._restored, None
        if restored is not None and restored[0] == target:
            _, self.search, self.tracked = restored

    def forget_mission(self) -> None:
        """Forget the goal and the viewpoints of the last mission."""
        self._restored = None
        self.abandon()
        self.next_view.reset()

    def on_pose_jump(self) -> None:
        """Forget the goal and the attempts, which are in the old frame."""
        self.abandon()
        self.search, self._restored = SearchState(), None

    def state_dict(self) -> Arrays:
        """Return the current goal and the failed attempts, but no viewpoint and no task's goal."""
        tracked, goals = self.tracked, []
        if tracked is not None and tracked.view is None and tracked.goal.kind in _KINDS:
            goals = [(tracked.goal, tracked.peak)]
        return {
            **self.search.state_dict(),
            "kind": np.array([_KINDS.index(goal.kind) for goal, _ in goals], np.int8),
            "id": np.array([goal.candidate_id for goal, _ in goals], np.int64),
            # x_m, y_m, yaw_rad of the goal; x_m, y_m of its candidate; score; peak.
            "at": np.array(
                [
                    (*astuple(goal.pose), *goal.candidate_xy_m, goal.score, peak)
                    for goal, peak in goals
                ]
            ).reshape(-1, 7),
        }

    def load_state_dict(self, state: Arrays, target: str, now_ns: int) -> None:
        """Restore a `state_dict` at the next `begin_target`, if that is to this target.

        The goal is sent again with a new stamp, because the result of the old one is unknown.
        """
        tracked, goal_rows = None, ("kind", "id", "at")
        # Largest number of rows of each group of arrays.
        rows = {goal_rows: 1, ("left_m",): MAX_PLACES, ("missed",): MAX_PLACES}
        max_values = {"kind": len(_KINDS) - 1, "turns": 1000}
        check_arrays(state, self.state_dict(), rows, max_values)
        for kind, i, at in zip(state["kind"], state["id"], state["at"].tolist(), strict=True):
            x_m, y_m, yaw_rad, to_x_m, to_y_m, score, peak = at
            pose = SE2(x_m, y_m, yaw_rad)
            goal = Goal(now_ns, pose, _KINDS[kind], int(i), (to_x_m, to_y_m), score, target)
            tracked = TrackedGoal(goal, peak)
        self._restored = (target, SearchState.of_state_dict(state), tracked)

    def failure_reason(self, mission: MissionRun, grid: RollingMap, missing: str = "") -> str:
        """Return why the target was not reached, when all attempts are exhausted.

        `missing` says what was not found, such as "no kitchen"; "": the target.
        """
        target, views = mission.target, self.next_view.views
        if not missing:
            place = _unreached_text(self._tracker.of(target), grid, self.config.mission.reach_m)
            no = "no path to" if target in mission.sets.detected else "no"
            missing = f"{no} {target}{place}"
        looked_again = f", looked again from {views} viewpoint{'s' * (views > 1)}" if views else ""
        blocked = _blocked_text(grid)
        n_left = self._pool.out_of_reach if blocked else 0
        explored = "explored all reachable space"
        if n_left:
            explored = f"no path to the {n_left} remaining frontier{'s' * (n_left > 1)}"
        return f"{explored}{looked_again}, found {missing}{blocked}"

    def _choose(
        self,
        tracked: TrackedGoal | None,
        context: PolicyInput,
        grid: RollingMap,
        score: np.ndarray,
        images: int,
    ) -> TrackedGoal | None:
        """Return the goal to track; see `choose`."""
        search, now_ns = self.search, context.now_ns
        if tracked is not None and self._vanished(tracked.goal, context):
            self._discard_candidate(tracked.goal, now_ns)
            tracked = None
        c = context.candidates
        path_m = c.path_m[: c.n][c.kind[: c.n] == INSTANCE]
        if len(path_m) and np.isinf(path_m).all():  # a person may have stood in the way
            search.open_path(now_ns, grid)
        best = self._best_candidate(tracked, context, score)
        if tracked is not None and best is not None and self._jumps(tracked.goal, best.goal):
            self._discard_candidate(tracked.goal, now_ns)
            tracked = best = None
        if best is not None:
            search.on_candidate()
        best = best or self._spin(tracked, context)
        view_goal = self._find_moved(tracked, context, grid, best, images)
        if view_goal is not None:
            return view_goal
        if best is not None or not search.exhausted:
            if best is not tracked:
                self.next_view.abandon()
            return best
        has_viewpoint = tracked is not None and tracked.view is not None
        if not has_viewpoint and search.retry(context, grid, self._pool, self._tracker):
            self.next_view.abandon()  # the map changes: look for viewpoints again
            return None
        return self._next_viewpoint(tracked, context, grid, images)

    def _discard_candidate(self, goal: Goal, now_ns: int) -> None:
        """Ignore the candidate of a goal for `mission.discard_s`.

        With each failure of the same object, or at the same place, the time doubles, up to 64-fold.
        """
        times = 0
        if goal.kind == "spin":
            kind = SPIN
            self.search.on_turn_ended(now_ns)
        elif goal.kind == "instance":
            kind, times = INSTANCE, self.search.count_failure(goal.candidate_id)
        else:
            kind, times = FRONTIER, self.search.count_visit(goal.candidate_xy_m)
        until_ns = now_ns + int(2**times * self.config.mission.discard_s * 1e9)
        self._pool.discarded.add(kind, goal.candidate_id, goal.candidate_xy_m, until_ns)
        self.next_view.abandon()

    def _vanished(self, goal: Goal, context: PolicyInput) -> bool:
        """Return True if the goal's frontier vanished and is not reliable.

        A frontier that is visible only from afar would otherwise make the robot come and go
        forever.
        """
        if goal.kind != "frontier" or context.candidates.index_of(FRONTIER, goal.candidate_id) >= 0:
            return False
        return self.search.exhausted or self.search.often_left(goal.candidate_xy_m)

    def _best_candidate(
        self, tracked: TrackedGoal | None, context: PolicyInput, score: np.ndarray
    ) -> TrackedGoal | None:
        """Return a goal for the best candidate: the current goal, if it is still valid.

        If that was at a frontier and is given up, the place of the frontier is noted.
        """
        c, policy, search, current = context.candidates, self.config.policy, self.search, None
        min_distance_m, first = policy.delta_reached_m, policy.confirmed_first
        order = rank_candidates(c, score, context.pose, min_distance_m, first)
        if search.exhausted:
            lasting = c.first_seen_ns[order] <= c.stamp_ns - LASTING_NS
            order = order[lasting | (c.kind[order] == INSTANCE)]
        if tracked is not None and tracked.goal.kind in _KINDS:
            often_left = partial(search.often_left, tracked.goal.candidate_xy_m)
            current = CurrentGoal(tracked.goal, tracked.peak, often_left)
        # Near enough to have reached it.
        stop_m = min(self.config.mission.reach_m - _STOP_SHORT_M, STOP_M[-1])
        tracks, hits = self._tracker.tracks, self.config.perception.confirm_hits

        def only_viewpoint(instance_id: int) -> tuple[float, float] | None:
            if search.has_failed(instance_id):
                return None
            return tracks[instance_id].only_viewpoint(hits)

        instances = InstanceQueries(self._tracker.get, search.missed_from, only_viewpoint)
        chosen = choose(context, score, order, current, policy.switch_margin, instances, stop_m)
        goal, peak, unchanged = chosen or (None, 0.0, False)
        if tracked is not None and tracked.goal.kind == "frontier" and not unchanged:
            search.left.append(tracked.goal.candidate_xy_m)
        if goal is None:
            return None
        if tracked is None or goal is not tracked.goal:
            return TrackedGoal(goal, peak)
        tracked.peak = peak
        return tracked

    def _jumps(self, before: Goal, after: Goal) -> bool:
        """Return True if the goal at an object has moved far too often.

        From afar, a free cell behind a wall may seem near to the object. Then the goal changes
        sides, and the robot would drive to and fro until a limit.
        """
        same = before.kind == after.kind == "instance" and before.candidate_id == after.candidate_id
        if not same or before.pose.distance_to(after.pose.x_m, after.pose.y_m) < _JUMP_M:
            return False
        return self.search.count_jump(after.candidate_id) > _JUMPS

    def _spin(self, tracked: TrackedGoal | None, context: PolicyInput) -> TrackedGoal | None:
        """Return a goal that turns the robot on the spot, if it may turn."""
        turning = tracked is not None and tracked.goal.kind == "spin" and tracked.view is None
        if not self.search.may_turn(turning, context.now_ns):
            return None
        if turning:
            return tracked
        at = context.pose
        pose = SE2(at.x_m, at.y_m, at.yaw_rad + 2.0 * math.pi / TURNS)
        return TrackedGoal(goal_without_candidate(pose, context.now_ns, context.target))

    def _next_viewpoint(
        self, tracked: TrackedGoal | None, context: PolicyInput, grid: RollingMap, images: int
    ) -> TrackedGoal | None:
        """Return a goal at the next viewpoint, if there is one."""
        view = self.next_view.choose(grid, images)
        if view is None:
            return None
        if tracked is not None and tracked.view is view:
            return tracked
        yaw_rad = wrap_angle(view.yaw_rad - grid.coverage.camera_yaw_rad)
        pose = SE2(view.x_m, view.y_m, yaw_rad)
        goal = goal_without_candidate(pose, context.now_ns, context.target)
        return TrackedGoal(goal, view=view)

    def _find_moved(
        self,
        tracked: TrackedGoal | None,
        context: PolicyInput,
        grid: RollingMap,
        best: TrackedGoal | None,
        images: int,
    ) -> TrackedGoal | None:
        """Return a goal at a viewpoint if a remembered object is gone and no candidate is better.

        Viewpoints and candidates are compared by the new area that they show per length of path.
        """
        c = context.candidates
        if not self.search.has_moved or (c.kind[: c.n] == INSTANCE).any():
            return None
        view_goal = self._next_viewpoint(tracked, context, grid, images)
        if view_goal is None or best is None or view_goal is tracked:
            return view_goal
        index = c.index_of(FRONTIER, best.goal.candidate_id)
        if best.goal.kind != "frontier" or index < 0:
            return None  # a spin costs little
        assert view_goal.view is not None
        path_m = grid.travel_cost.distance_m(view_goal.goal.pose.x_m, view_goal.goal.pose.y_m)
        value = grid.coverage.area_m2(view_goal.view) / (START_M + path_m)
        candidate_value = float(c.gain_m2[index]) / (START_M + float(c.path_m[index]))
        is_better = value > (1.0 + self.config.policy.switch_margin) * candidate_value
        return view_goal if is_better else None


def goal_without_candidate(pose: SE2, now_ns: int, target: str) -> Goal:
    """Return a goal that is for no candidate: a turn on the spot, a viewpoint, or a stop."""
    return Goal(now_ns, pose, "spin", 0, (pose.x_m, pose.y_m), 0.0, target)


def _unreached_text(found: Sequence[Instance], grid: RollingMap, reach_m: float) -> str:
    """Return the place of the first object if the robot cannot get at it; else ""."""
    for instance in found[:1]:
        x_m, y_m, _ = instance.center_m.tolist()
        cell = grid.travel_cost.nearest(x_m, y_m, _NEAR_M)
        away_m = _NEAR_M if cell is None else instance.distance_m(cell[0], cell[1])
        if away_m > reach_m:
            return f": seen at ({x_m:.1f}, {y_m:.1f}), no way nearer than {away_m:.1f} m"
    return ""


def _blocked_text(grid: RollingMap) -> str:
    """Return the places where the robot was blocked, as the end of a reason; "" if none."""
    places_m = grid.bumps.known_m
    if not places_m:
        return ""
    x, y = places_m[0]
    more = f" and {len(places_m) - 1} more" if len(places_m) > 1 else ""
    return f"; blocked at ({x:.1f}, {y:.1f}){more}"

"""Goal tracking: from the choice of a goal to the controller's status and its consequences.

An *instance* is an object that was detected as a target, as opposed to a frontier or a place.
Only this module stores the current goal and the failed attempts. A controller drives to the last
goal that it received. To abandon a goal, the tracker therefore sends a goal at the robot's own
position.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass
from functools import partial
from typing import Literal

import numpy as np

from edge.config import Config
from edge.geometry import SE2, wrap_angle
from edge.host.checkpoint import Arrays, check_arrays
from edge.loop.candidates import CandidatePool
from edge.loop.goal_client import ARRIVED_M, GoalClient
from edge.loop.search_state import (
    LASTING_NS,
    LEFT,
    TURNS,
    NextBestView,
    ProbableObject,
    SearchState,
)
from edge.loop.standstill import StandstillMonitor
from edge.mapping.coverage import START_M, Viewpoint
from edge.mapping.grid import RollingMap
from edge.mission.run import MissionRun
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import FRONTIER, INSTANCE, SPIN, PolicyInput
from edge.policies.select import STOP_M, CurrentGoal, choose, rank_candidates
from edge.text import one_line
from edge.types import CandidateKind, Goal, GoalStatus, Instance, MissionPhase

MIN_IMAGES = 5
"""Number of images that the detector must process at the goal before an object is rejected. A
detector that hangs must not reject anything."""
GRACE_NS = 300_000_000
"""Time without a goal before the robot is stopped. A new goal usually comes sooner."""
_AT_PLACE_M = 0.5
"""Largest distance of a goal from its place: if the place is blocked, the goal is next to it."""
_PLACE_TRIES = 3
"""Number of failed goals at a place after which the target is abandoned."""
POINT_SNAP_M = np.array([0.08])
"""Largest distance of a goal from a point in a room: the cell of the point, or the next cell. An
array of one radius, because `path_lengths_m` takes one for each kind of point."""
SAME_POINT_M = 0.6
"""A goal is kept if one of the new points is this near: points move as the map grows."""
_NEAR_M = 5.0
"""Distance around an object that cannot be reached in which the nearest free cell is looked for."""
_JUMP_M, _JUMPS = 1.5, 3
"""An object is left alone for some time if its goal moves by `_JUMP_M` more than `_JUMPS` times."""
_STOP_SHORT_M = 0.05
"""The robot stops by this distance nearer to an object than it must."""

_KINDS: tuple[CandidateKind, ...] = ("frontier", "instance", "spin")  # kinds that are saved

Verdict = Literal["reached", "rejected", "out of reach"]
"""Outcome of a goal at an object; see `GoalTracker._judge`."""


@dataclass(slots=True, eq=False)
class _TrackedGoal:
    """The current goal, with the state that ends with it.

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
    view: Viewpoint | None = None
    sent: bool = False
    ends_on_arrival: bool = True
    status: GoalStatus | None = None
    verifying_since_ns: int | None = None
    images_before: int = 0


class GoalTracker:
    """The tracker of the current goal; for one thread.

    Args:
        config: The configuration.
        pool: Candidates. The tracker discards those that failed.
        tracker: Instances. The goal tracker marks those that were reached or rejected.
        send: Transmits a goal.
        event: Reports an event for people, at a loop time.

    Attributes:
        phase: Phase of the goal: searching, approaching or verifying.
        client: Sends the goals and handles the controller's statuses.
    """

    def __init__(
        self,
        config: Config,
        pool: CandidatePool,
        tracker: InstanceTracker,
        send: Callable[[Goal], None],
        event: Callable[[str, int], None],
    ) -> None:
        self.phase: MissionPhase = "searching"
        self.client = GoalClient(config, send)
        self._config, self._pool, self._tracker = config, pool, tracker
        self._event = event
        self._tracked: _TrackedGoal | None = None
        self._search = SearchState()
        self._next_view = NextBestView(config.perception.confirm_hits)
        self._standstill = StandstillMonitor(config, event)
        self._warned_ids: set[int] = set()
        self._reported: tuple[str, int] | None = None  # target and instance of `_report_relation`
        self._n_retargets = -1  # `MissionRun.retargets` of the target that is followed; -1: none
        self._place_failures = 0
        # State from a checkpoint, and the target that it belongs to.
        self._restored: tuple[str, SearchState, _TrackedGoal | None] | None = None
        self._no_goal_since_ns: int | None = None
        self._grace_ns = GRACE_NS

    # -- state for other modules --------------------------------------------------------------

    @property
    def _stop_m(self) -> float:
        """Stopping distance from an object: near enough to have reached it."""
        return min(self._config.mission.reach_m - _STOP_SHORT_M, STOP_M[-1])

    @property
    def goal(self) -> Goal | None:
        """Current goal of the robot, or None."""
        return None if self._tracked is None else self._tracked.goal

    @property
    def goal_status(self) -> GoalStatus | None:
        """Newest status of the current goal from the controller; None before the first."""
        return None if self._tracked is None else self._tracked.status

    @property
    def arrived(self) -> bool:
        """True if the controller says that the robot is at the current goal."""
        return self.goal_status is not None and self.goal_status.state == "reached"

    @property
    def _has_viewpoint(self) -> bool:
        """True if the current goal is a viewpoint."""
        return self._tracked is not None and self._tracked.view is not None

    @property
    def candidates_exhausted(self) -> bool:
        """True if all candidates are used up.

        Instances that were more often detected as another class then count as candidates too.
        """
        return self._search.exhausted

    @property
    def exhausted(self) -> bool:
        """True if no candidate and no viewpoint is left, and waiting is of no use."""
        return self._search.exhausted and self._next_view.done and not self._search.waiting

    @property
    def probable(self) -> ProbableObject | None:
        """The best of the objects that were rejected because the detector was not sure."""
        return self._search.probable

    @property
    def views(self) -> int:
        """Number of viewpoints that the robot has seen in this mission."""
        return self._next_view.views

    def failure_reason(self, mission: MissionRun, grid: RollingMap) -> str:
        """Return why the target was not reached, when all attempts are exhausted."""
        target, views = mission.target, self.views
        seen = target in mission.detected
        found = "found no path to" if seen else "found no"
        looked_again = f", looked again from {views} viewpoint{'s' * (views > 1)}" if views else ""
        blocked = _blocked_text(grid)
        n_left = self._pool.out_of_reach if blocked else 0
        explored = "explored all reachable space"
        if n_left:
            explored = f"no path to the {n_left} remaining frontier{'s' * (n_left > 1)}"
        place = self._unreached_text(target, grid)
        return f"{explored}{looked_again}, {found} {target}{place}{blocked}"

    def _unreached_text(self, target: str, grid: RollingMap) -> str:
        """Return the place of the best object that the robot cannot get at; "" if there is none."""
        for instance in self._tracker.of(target)[:1]:
            x_m, y_m, _ = instance.center_m.tolist()
            cell = grid.travel_cost.nearest(x_m, y_m, _NEAR_M)
            away_m = _NEAR_M if cell is None else instance.distance_m(cell[0], cell[1])
            if away_m > self._config.mission.reach_m:
                return f": seen at ({x_m:.1f}, {y_m:.1f}), no way nearer than {away_m:.1f} m"
        return ""

    # -- choosing ---------------------------------------------------------------------------

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
        self._discard_vanished(context)
        c = context.candidates
        path_m = c.path_m[: c.n][c.kind[: c.n] == INSTANCE]
        if len(path_m) and np.isinf(path_m).all():  # somebody may have stood in the way
            self._search.open_path(context.now_ns, grid)
        new_goal = self._best_candidate(context, score) or self._spin(context)
        view_goal = self._find_moved(context, grid, new_goal, images)
        if view_goal is not None:
            new_goal = view_goal
        elif new_goal is not None or not self._search.exhausted:
            if new_goal is not self._tracked:
                self._next_view.abandon()
        elif not self._has_viewpoint and self._search.retry(
            context, grid, self._pool, self._tracker
        ):
            self._next_view.abandon()  # the map changes: look for viewpoints again
        else:
            new_goal = self._next_viewpoint(context, grid, images)
        self._tracked = new_goal
        return self.goal

    def go_to_place(
        self, context: PolicyInput, grid: RollingMap, place: SE2, target: str, images: int
    ) -> Goal | None:
        """Return a goal at a place; a frontier on the way to it while no path to it is known.

        Args:
            context: input of this tick.
            grid: the map.
            place: position and final heading.
            target: the place's name.
            images: number of images that the detector has processed so far.
        """
        cell = grid.travel_cost.nearest(place.x_m, place.y_m, _AT_PLACE_M)
        if cell is None:
            return self.explore_towards(context, grid, (place.x_m, place.y_m), images)
        self._next_view.abandon()
        self._search.on_candidate()
        goal, place_m = self.goal, (place.x_m, place.y_m)
        if goal is None or goal.kind != "place" or grid.state_at(goal.pose.x_m, goal.pose.y_m):
            pose = SE2(cell[0], cell[1], place.yaw_rad)
            goal = Goal(context.now_ns, pose, "place", 0, place_m, 1.0, target)
            self._tracked = _TrackedGoal(goal)
        return self.goal

    def explore_towards(
        self, context: PolicyInput, grid: RollingMap, at_m: tuple[float, float], images: int
    ) -> Goal | None:
        """Return a goal at a frontier on the way to a point to which no path is known."""
        frontiers, n = context.candidates, context.candidates.n
        left_m = np.hypot(*(frontiers.xy_m[:n] - at_m).T)
        score = 1.0 / (1.0 + frontiers.path_m[:n] + left_m)
        return self.choose(context, grid, score.astype(np.float32), images)

    def go_to_point(
        self, context: PolicyInput, grid: RollingMap, points_m: np.ndarray, target: str, keep: bool
    ) -> Goal | None:
        """Return a goal at the nearest of some points; arriving there does not reach the target.

        Args:
            context: Pose and time of the tick.
            grid: The map.
            points_m: (n, 2) float32 in `map`, n > 0.
            target: Name of the target.
            keep: True if the current goal may stay while it is free and near one of the points.

        Returns:
            None if no path to any of the points is known.
        """
        goal, n = self.goal, len(points_m)
        if (
            keep
            and goal is not None
            and (goal.kind, goal.target) == ("place", target)
            and not grid.state_at(goal.pose.x_m, goal.pose.y_m)
            and math.isfinite(grid.travel_cost.distance_m(goal.pose.x_m, goal.pose.y_m))
            and np.hypot(*(points_m - goal.candidate_xy_m).T).min() <= SAME_POINT_M
        ):
            return goal
        path_m, kind = np.empty(n, np.float32), np.zeros(n, np.int8)  # one kind of points
        grid.travel_cost.path_lengths_m(points_m, kind, POINT_SNAP_M, n, path_m)
        best = int(path_m.argmin())
        at = points_m[best].tolist()
        cell = grid.travel_cost.nearest(at[0], at[1], float(POINT_SNAP_M[0]))
        if cell is None or not math.isfinite(path_m[best]):
            return None
        self._next_view.abandon()
        self._search.on_candidate()
        pose, x_m, y_m = context.pose, cell[0], cell[1]
        yaw_rad = math.atan2(y_m - pose.y_m, x_m - pose.x_m)
        goal = Goal(context.now_ns, SE2(x_m, y_m, yaw_rad), "place", 0, (at[0], at[1]), 1.0, target)
        self._tracked = _TrackedGoal(goal, ends_on_arrival=False)
        return goal

    def override(self, pose: SE2, mission: MissionRun, now_ns: int, apart_m: float) -> Goal:
        """Replace the current goal by a task's goal and return it.

        Args:
            pose: Wanted pose.
            mission: The mission.
            now_ns: Loop time.
            apart_m: The current goal of the task is kept while it is at most this far from `pose`.
                0: it is kept only if it equals `pose`.
        """
        goal = self.goal
        if (
            goal is None
            or goal.kind != "trajectory"
            or goal.pose.distance_to(pose.x_m, pose.y_m) > apart_m
            or (not apart_m and goal.pose != pose)
        ):
            goal = Goal(now_ns, pose, "trajectory", 0, (pose.x_m, pose.y_m), 0.0, mission.target)
            self._tracked = _TrackedGoal(goal)
        return goal

    def _best_candidate(self, context: PolicyInput, score: np.ndarray) -> _TrackedGoal | None:
        """Return a goal for the best candidate: the current goal, if it is still valid."""
        c, policy, search = context.candidates, self._config.policy, self._search
        tracked, current = self._tracked, None
        min_distance_m, first = policy.delta_reached_m, policy.confirmed_first
        order = rank_candidates(c, score, context.pose, min_distance_m, first)
        if search.exhausted:
            lasting = c.first_seen_ns[order] <= c.stamp_ns - LASTING_NS
            order = order[lasting | (c.kind[order] == INSTANCE)]
        if tracked is not None:
            often_left = partial(search.often_left, tracked.goal.candidate_xy_m)
            current = CurrentGoal(tracked.goal, tracked.peak, often_left)
        chosen = choose(
            context, score, order, current, policy.switch_margin, self._tracker.get, self._stop_m
        )
        goal, peak, unchanged = chosen or (None, 0.0, False)
        if tracked is not None and tracked.goal.kind == "frontier" and not unchanged:
            search.left.append(tracked.goal.candidate_xy_m)
        if tracked is not None and goal is not None and self._jumps(tracked.goal, goal):
            self._discard(context.now_ns)
            return None
        if goal is None:
            return None
        search.on_candidate()
        if tracked is None or goal is not tracked.goal:
            return _TrackedGoal(goal, peak)
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
        return self._search.count_jump(after.candidate_id) > _JUMPS

    def _spin(self, context: PolicyInput) -> _TrackedGoal | None:
        """Return a goal that turns the robot on the spot, if it may turn."""
        tracked = self._tracked
        turning = tracked is not None and tracked.goal.kind == "spin" and tracked.view is None
        if not self._search.may_turn(turning, context.now_ns):
            return None
        if turning:
            return tracked
        at = context.pose
        yaw_rad = at.yaw_rad + 2.0 * math.pi / TURNS
        return _TrackedGoal(
            _free_goal(SE2(at.x_m, at.y_m, yaw_rad), context.now_ns, context.target)
        )

    def _next_viewpoint(
        self, context: PolicyInput, grid: RollingMap, images: int
    ) -> _TrackedGoal | None:
        """Return a goal at the next viewpoint, if there is one."""
        view, tracked = self._next_view.choose(grid, images), self._tracked
        if view is None:
            return None
        if tracked is not None and tracked.view is view:
            return tracked
        yaw_rad = wrap_angle(view.heading_rad - grid.coverage.camera_yaw_rad)
        pose = SE2(view.x_m, view.y_m, yaw_rad)
        return _TrackedGoal(_free_goal(pose, context.now_ns, context.target), view=view)

    def _find_moved(
        self, context: PolicyInput, grid: RollingMap, chosen: _TrackedGoal | None, images: int
    ) -> _TrackedGoal | None:
        """Return a goal at a viewpoint if a remembered object is gone and no candidate is better.

        Viewpoints and candidates are compared by the new area that they show per length of path.
        """
        c, tracked = context.candidates, self._tracked
        if not self._search.has_moved or (c.kind[: c.n] == INSTANCE).any():
            return None
        view_goal = self._next_viewpoint(context, grid, images)
        if view_goal is None or chosen is None or view_goal is tracked:
            return view_goal
        index = c.index_of(FRONTIER, chosen.goal.candidate_id)
        if chosen.goal.kind != "frontier" or index < 0:
            return None  # a spin costs little
        assert view_goal.view is not None
        path_m = grid.travel_cost.distance_m(view_goal.goal.pose.x_m, view_goal.goal.pose.y_m)
        value = grid.coverage.area_m2(view_goal.view) / (START_M + path_m)
        candidate_value = float(c.gain_m2[index]) / (START_M + float(c.path_m[index]))
        is_better = value > (1.0 + self._config.policy.switch_margin) * candidate_value
        return view_goal if is_better else None

    def _discard_vanished(self, context: PolicyInput) -> None:
        """Discard the goal's frontier if it vanished and is not reliable.

        A frontier that is visible only from afar would otherwise make the robot come and go
        forever.
        """
        goal, search = self.goal, self._search
        if goal is None or goal.kind != "frontier":
            return
        vanished = context.candidates.index_of(FRONTIER, goal.candidate_id) < 0
        if vanished and (search.exhausted or search.often_left(goal.candidate_xy_m)):
            self._discard(context.now_ns)

    # -- sending ----------------------------------------------------------------------------

    def send_pending(self, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Send the current goal if it was not sent yet. Without a goal, make the robot stand."""
        self.client.notice_silence(now_ns)
        if mission.stopped:  # whatever chose a goal
            self.idle()
        tracked = self._tracked
        if tracked is not None:
            self._no_goal_since_ns = None
            if not tracked.sent:
                self._send(tracked.goal, now_ns)
                tracked.sent = True
                self._report_relation(tracked.goal, mission, now_ns)
                self._warn_of_neighbours(tracked.goal, mission, now_ns)
            return
        if self._no_goal_since_ns is None:
            self._no_goal_since_ns = now_ns
        if self.client.driving and now_ns - self._no_goal_since_ns >= self._grace_ns:
            self.hold_position(mission, pose, now_ns)

    def hold_position(self, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Make the robot stand still, with a goal at its own pose that is not tracked."""
        self._tracked = None
        self._send(_free_goal(pose, now_ns, mission.target), now_ns)
        self.client.driving = False

    def on_goal_status(self, status: GoalStatus) -> None:
        """Handle a goal status of the controller, which may be for an old goal."""
        tracked = self._tracked
        if tracked is not None and not tracked.sent:
            tracked = None
        goal = None if tracked is None else tracked.goal
        if self.client.on_goal_status(status, goal) and tracked is not None:
            tracked.status = status

    def _send(self, goal: Goal, now_ns: int) -> None:
        self._grace_ns = GRACE_NS
        self.client.send(goal, now_ns)

    def _report_relation(self, goal: Goal, mission: MissionRun, now_ns: int) -> None:
        """Report once why the goal's object fits the relation that the target describes."""
        instance = self._tracker.get(goal.candidate_id) if goal.kind == "instance" else None
        if instance is None or self._reported == (mission.target, instance.id):
            return
        if why := self._tracker.reason_for(mission.target, instance):
            self._reported = mission.target, instance.id
            self._event(f"{mission.target}: {instance.label} {instance.id} chosen: {why}", now_ns)

    def _warn_of_neighbours(self, goal: Goal, mission: MissionRun, now_ns: int) -> None:
        """Warn if a new goal is next to an object that must not be reached now.

        Each object is reported once, and again after a goal that was not next to it.
        """
        near: set[int] = set()
        for label in mission.forbidden:
            for instance in self._tracker.of(label):
                away_m = instance.distance_m(goal.pose.x_m, goal.pose.y_m)
                if away_m > self._config.mission.reach_m:
                    continue
                near.add(instance.id)
                if instance.id not in self._warned_ids:
                    text = f"goal {away_m:.1f} m from {label}, which must not be reached now"
                    mission.warn(label, text, now_ns)
        self._warned_ids = near

    # -- following up -----------------------------------------------------------------------

    def check_progress(
        self,
        grid: RollingMap,
        pose: SE2,
        mission: MissionRun,
        images: int,
        now_ns: int,
        is_reached: Callable[[Instance, SE2], bool] | None = None,
    ) -> bool:
        """Handle the progress of the current goal. `FollowBehaviour` handles a trajectory's goals.

        Args:
            grid: The map. Cells where the robot is blocked are closed in it.
            pose: Pose of the robot.
            mission: The mission.
            images: Number of images that the detector has processed so far.
            now_ns: Loop time.
            is_reached: Returns True if an instance next to the robot counts as reached, at the
                robot's pose. None: an instance that is confirmed from two viewpoints does.

        Returns:
            True if the robot is stuck: it should drive but stands still.
        """
        tracked = self._tracked
        self._standstill.on_blocked(grid, pose, self.client.take_blocked(), now_ns)
        if tracked is not None and tracked.sent and tracked.status is None:
            tracked.status = self.client.arrived(tracked.goal, pose, now_ns)
        instance = None
        if tracked is not None and tracked.goal.kind == "instance":
            instance = self._tracker.get(tracked.goal.candidate_id)
        verdict = None
        if tracked is None or instance is None:
            # A trajectory or a place is known from the start, so nothing is searched for.
            has_path_goal = tracked is not None and tracked.goal.kind in ("trajectory", "place")
            self.phase = "approaching" if has_path_goal else "searching"
        elif verdict := self._judge(
            tracked, instance, pose, now_ns, images, is_reached or self._tracker.verified
        ):
            self._apply_verdict(verdict, tracked, instance, mission, pose, now_ns)
        if tracked is not None and tracked.goal.kind == "place":
            self._check_place(tracked, pose, mission, now_ns)
        elif tracked is not None and verdict is None:
            self._check_drive(tracked, pose, now_ns, images)
        # If no controller drives the robot, its standstill is not the candidate's fault.
        driven_to = self.goal if self.client.is_driven(pose) else None
        stuck = self._standstill.update(grid, pose, driven_to, now_ns)
        if stuck:
            self._event("stuck: the robot does not move; its goal is discarded", now_ns)
            self._discard(now_ns)
        return stuck

    def _judge(
        self,
        tracked: _TrackedGoal,
        instance: Instance,
        pose: SE2,
        now_ns: int,
        images: int,
        is_reached: Callable[[Instance, SE2], bool],
    ) -> Verdict | None:
        """Return the verdict on the goal's instance, or None while there is none.

        `reached` needs three conditions: the controller reported the goal as reached, the nearest
        surface point of the instance is within `mission.reach_m`, and `is_reached` agrees: the
        detector has confirmed the instance from two viewpoints.
        """
        config = self._config.mission
        if tracked.status is None or tracked.status.state != "reached":
            tracked.verifying_since_ns, self.phase = None, "approaching"
            return None
        if instance.distance_m(pose.x_m, pose.y_m) > config.reach_m:
            return "out of reach"
        self.phase = "verifying"
        if tracked.verifying_since_ns is None:
            tracked.verifying_since_ns, tracked.images_before = now_ns, images
        if is_reached(instance, pose):
            return "reached"
        long_enough = (now_ns - tracked.verifying_since_ns) * 1e-9 > config.verify_s
        if long_enough and images - tracked.images_before >= MIN_IMAGES:
            return "rejected"
        return None

    def _apply_verdict(
        self,
        verdict: Verdict,
        tracked: _TrackedGoal,
        instance: Instance,
        mission: MissionRun,
        pose: SE2,
        now_ns: int,
    ) -> None:
        """Apply the verdict on the goal's instance to tracker, mission and goal."""
        if verdict == "reached" and mission.spec.steps is not None:
            self.abandon()  # a task wanted only the confirmation of this object
            return
        if verdict == "reached":
            self._tracker.mark_reached(instance.id)
            label = mission.target
            mission.on_reached(f"confirmed, seen in {instance.hits} images", now_ns)
            if mission.target == label and not mission.done:
                # The mission visits this target again: use another object, or this one later.
                self._discard(now_ns)
            return
        if verdict == "rejected":
            is_verified = self._tracker.verified(instance, pose)
            self._search.has_moved |= is_verified  # a remembered object that is not seen again
            if not is_verified:
                self._note_probable(tracked.goal, instance)
            self._tracker.reject(instance.id)
            self.abandon()
        else:
            at = tracked.goal.pose
            if not self._search.mark_out_of_reach(instance.id, (at.x_m, at.y_m)):
                self.abandon()  # with the map as it is now, a goal may be nearer to the object
                return
            self._discard(now_ns)
        x, y, _ = instance.center_m
        self._event(f"{verdict}: {instance.label} #{instance.id} at ({x:.1f}, {y:.1f})", now_ns)

    def _note_probable(self, goal: Goal, instance: Instance) -> None:
        """Remember an object before its rejection, if it is the best so far."""
        before, score = self._search.probable, instance.score
        if score > (self._config.perception.tau_det if before is None else before.score):
            x_m, y_m, _ = instance.center_m.tolist()
            stop_m = (goal.pose.x_m, goal.pose.y_m)
            self._search.probable = ProbableObject(score, stop_m, (x_m, y_m))

    def _check_drive(self, tracked: _TrackedGoal, pose: SE2, now_ns: int, images: int) -> None:
        """Handle the controller's status of a goal for a frontier, a turn or a viewpoint."""
        goal, status = tracked.goal, tracked.status
        if goal.kind == "trajectory":
            return
        state = None if status is None else status.state
        if tracked.view is not None:
            if state == "failed":
                self._next_view.mark_unreachable()
            elif state == "reached":
                self._next_view.on_arrived(images)
        elif goal.kind == "spin":
            if state in ("reached", "failed"):
                self._discard(now_ns)
        elif status is not None and state == "failed":
            self._event(f"goal failed: {status.reason or 'no reason given'}", now_ns)
            self._discard(now_ns)
        elif goal.kind == "frontier" and (
            state == "reached"
            or pose.distance_to(*goal.candidate_xy_m) <= self._config.policy.delta_reached_m
        ):
            # The frontier was visited. Algorithm 2 only ignores frontiers that are this near. The
            # robot would turn to another frontier, and back as soon as it is a little farther away.
            self._discard(now_ns)

    def _check_place(
        self, tracked: _TrackedGoal, pose: SE2, mission: MissionRun, now_ns: int
    ) -> None:
        """Handle the controller's status of a goal at a place."""
        goal, status = tracked.goal, tracked.status
        state = None if status is None else status.state
        away_m = pose.distance_to(*goal.candidate_xy_m)
        arrived = state == "reached" and away_m <= _AT_PLACE_M + ARRIVED_M
        if arrived and not tracked.ends_on_arrival:
            return
        if arrived:
            self.abandon()
            mission.on_reached(f"{away_m:.1f} m from the place", now_ns)
        elif status is not None and state in ("reached", "failed"):
            reason = status.reason or f"the controller stopped {away_m:.1f} m from {goal.target}"
            self._event(f"goal failed: {reason}", now_ns)
            self._discard(now_ns)
            if self._place_failures >= _PLACE_TRIES:
                mission.abandon_target(
                    f"found no path to {goal.target}: {one_line(reason)}", now_ns
                )

    # -- abandoning a goal, new targets -------------------------------------------------------

    def abandon(self) -> None:
        """Abandon the current goal. Late statuses for it are ignored, its candidate stays."""
        self._tracked = None
        self._next_view.abandon()

    def idle(self) -> None:
        """Abandon the current goal. Unless a new one comes in this tick, the robot stands still."""
        self.abandon()
        self._grace_ns = 0

    def follows(self, mission: MissionRun) -> bool:
        """Return True if the tracker already works on the mission's active target."""
        return self._n_retargets == mission.retargets

    def retarget(self, mission: MissionRun) -> None:
        """Start on another target: forget goal and attempts of the last one."""
        self._n_retargets = mission.retargets
        self.abandon()
        self._search, self._place_failures = SearchState(), 0
        restored, self._restored = self._restored, None
        if restored is not None and restored[0] == mission.target:
            _, self._search, self._tracked = restored

    def state_dict(self) -> Arrays:
        """Return the current goal and the failed attempts, but no viewpoint and no task's goal."""
        tracked, goals = self._tracked, []
        if tracked is not None and tracked.view is None and tracked.goal.kind in _KINDS:
            goals = [(tracked.goal, tracked.peak)]
        return {
            **self._search.state_dict(),
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
        """Restore a `state_dict` when the tracker starts on `target`, if this is its first target.

        The goal is sent again with a new stamp, because the result of the old one is unknown.
        """
        tracked, goal_rows = None, ("kind", "id", "at")
        # Largest number of rows of each group of arrays.
        rows = {goal_rows: 1, ("left_m",): LEFT, ("missed",): 1}
        max_values = {"kind": len(_KINDS) - 1, "turns": 1000}
        check_arrays(state, self.state_dict(), rows, max_values)
        for kind, i, at in zip(state["kind"], state["id"], state["at"].tolist(), strict=True):
            x_m, y_m, yaw_rad, to_x_m, to_y_m, score, peak = at
            pose = SE2(x_m, y_m, yaw_rad)
            goal = Goal(now_ns, pose, _KINDS[kind], int(i), (to_x_m, to_y_m), score, target)
            tracked = _TrackedGoal(goal, peak)
        self._restored = (target, SearchState.of_state_dict(state), tracked)

    def forget_mission(self) -> None:
        """Forget everything about the last mission."""
        self._warned_ids = set()
        self._restored = None
        self._n_retargets = -1
        self.abandon()
        self._next_view.reset()

    def reconfigure(self, config: Config) -> None:
        """Use another configuration; see `edge.loop.reload.LIVE` for the keys that may differ."""
        self._config = config
        self._next_view.images_needed = config.perception.confirm_hits

    def on_pose_jump(self) -> None:
        """Handle a pose jump. The robot stands still unless the next tick finds a goal."""
        self.idle()
        self.client.on_pose_jump()
        self._search, self._restored = SearchState(), None
        self._standstill.reset()

    def _discard(self, now_ns: int) -> None:
        """Abandon the current goal and ignore its candidate for `mission.discard_s`.

        With each failure of the same object, or at the same place, the time doubles, up to 64-fold.
        """
        tracked = self._tracked
        if tracked is not None and tracked.view is not None:
            self._next_view.mark_unreachable()
            return
        if tracked is not None and tracked.goal.kind == "spin":
            self._search.on_turn_ended(now_ns)
            goal, until_ns = tracked.goal, now_ns + int(self._config.mission.discard_s * 1e9)
            self._pool.discard(SPIN, goal.candidate_id, goal.candidate_xy_m, until_ns)
        elif tracked is not None and tracked.goal.kind == "place":
            self._place_failures += 1
        elif tracked is not None and tracked.goal.kind != "trajectory":
            goal = tracked.goal
            if goal.kind == "instance":
                kind, times = INSTANCE, self._search.count_failure(goal.candidate_id)
            else:
                kind, times = FRONTIER, self._search.count_visit(goal.candidate_xy_m)
            until_ns = now_ns + int(2**times * self._config.mission.discard_s * 1e9)
            self._pool.discard(kind, goal.candidate_id, goal.candidate_xy_m, until_ns)
        self.abandon()


def _blocked_text(grid: RollingMap) -> str:
    """Return the places where the robot was blocked, as the end of a reason; "" if none."""
    places_m = grid.bumps.known_m
    if not places_m:
        return ""
    x, y = places_m[0]
    more = f" and {len(places_m) - 1} more" if len(places_m) > 1 else ""
    return f"; blocked at ({x:.1f}, {y:.1f}){more}"


def _free_goal(pose: SE2, now_ns: int, target: str) -> Goal:
    """Return a goal that is for no candidate: a turn on the spot, a viewpoint, or a stop."""
    return Goal(now_ns, pose, "spin", 0, (pose.x_m, pose.y_m), 0.0, target)

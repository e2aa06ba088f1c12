"""Goal tracking: from the choice of a goal to the controller's status and its consequences.

Only this module stores the current goal. A controller drives to the last goal that it received. To
abandon a goal, the tracker therefore sends a goal at the robot's own position.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple
from typing import Literal

import numpy as np

from edge.config import Config
from edge.geometry import SE2
from edge.host.checkpoint import Arrays, check_arrays
from edge.loop.candidates import CandidatePool
from edge.loop.goal_choice import GoalChooser, TrackedGoal, free_goal
from edge.loop.goal_client import ARRIVED_M, GoalClient
from edge.loop.search_state import LEFT, ProbableObject, SearchState
from edge.loop.standstill import StandstillMonitor
from edge.mapping.grid import RollingMap
from edge.mission.run import MissionRun
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import PolicyInput
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
_KINDS: tuple[CandidateKind, ...] = ("frontier", "instance", "spin")  # kinds that are saved

Verdict = Literal["reached", "rejected", "out of reach"]
"""Outcome of a goal at an object; see `GoalTracker._judge`."""


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
        self._config, self._tracker = config, tracker
        self._event = event
        self._tracked: TrackedGoal | None = None
        self._chooser = GoalChooser(config, pool, tracker)
        self._standstill = StandstillMonitor(config, event)
        self._warned_ids: set[int] = set()
        self._reported: tuple[str, int] | None = None  # target and instance of `_report_relation`
        self._n_retargets = -1  # `MissionRun.retargets` of the target that is followed; -1: none
        self._place_failures = 0
        # State from a checkpoint, and the target that it belongs to.
        self._restored: tuple[str, SearchState, TrackedGoal | None] | None = None
        self._no_goal_since_ns: int | None = None
        self._grace_ns = GRACE_NS

    # -- state for other modules --------------------------------------------------------------

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
    def candidates_exhausted(self) -> bool:
        """True if all candidates are used up.

        Instances that were more often detected as another class then count as candidates too.
        """
        return self._chooser.search.exhausted

    @property
    def exhausted(self) -> bool:
        """True if no candidate and no viewpoint is left, and waiting is of no use."""
        return self._chooser.exhausted

    @property
    def probable(self) -> ProbableObject | None:
        """The best of the objects that were rejected because the detector was not sure."""
        return self._chooser.search.probable

    @property
    def views(self) -> int:
        """Number of viewpoints that the robot has seen in this mission."""
        return self._chooser.next_view.views

    def failure_reason(self, mission: MissionRun, grid: RollingMap) -> str:
        """Return why the target was not reached, when all attempts are exhausted."""
        return self._chooser.failure_reason(mission, grid)

    # -- choosing ---------------------------------------------------------------------------

    def choose(
        self, context: PolicyInput, grid: RollingMap, score: np.ndarray, images: int
    ) -> Goal | None:
        """Choose the goal of this tick from the scored candidates; see `GoalChooser.choose`.

        Returns:
            The same object as before as long as the goal stays; None if there is no goal.
        """
        self._tracked = self._chooser.choose(self._tracked, context, grid, score, images)
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
        self._chooser.next_view.abandon()
        self._chooser.search.on_candidate()
        goal, place_m = self.goal, (place.x_m, place.y_m)
        if goal is None or goal.kind != "place" or grid.state_at(goal.pose.x_m, goal.pose.y_m):
            pose = SE2(cell[0], cell[1], place.yaw_rad)
            goal = Goal(context.now_ns, pose, "place", 0, place_m, 1.0, target)
            self._tracked = TrackedGoal(goal)
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
        self._chooser.next_view.abandon()
        self._chooser.search.on_candidate()
        pose, x_m, y_m = context.pose, cell[0], cell[1]
        yaw_rad = math.atan2(y_m - pose.y_m, x_m - pose.x_m)
        goal = Goal(context.now_ns, SE2(x_m, y_m, yaw_rad), "place", 0, (at[0], at[1]), 1.0, target)
        self._tracked = TrackedGoal(goal, ends_on_arrival=False)
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
            self._tracked = TrackedGoal(goal)
        return goal

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
        self._send(free_goal(pose, now_ns, mission.target), now_ns)
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
        tracked: TrackedGoal,
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
        tracked: TrackedGoal,
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
            if is_verified:  # a remembered object that is not seen again
                self._chooser.search.has_moved = True
            else:
                self._chooser.note_probable(tracked.goal, instance)
            self._tracker.reject(instance.id)
            self.abandon()
        else:
            at = tracked.goal.pose
            if not self._chooser.search.mark_missed(instance.id, (at.x_m, at.y_m)):
                self.abandon()  # with the map as it is now, a goal may be nearer to the object
                return
            self._discard(now_ns)
        x, y, _ = instance.center_m
        self._event(f"{verdict}: {instance.label} #{instance.id} at ({x:.1f}, {y:.1f})", now_ns)

    def _check_drive(self, tracked: TrackedGoal, pose: SE2, now_ns: int, images: int) -> None:
        """Handle the controller's status of a goal for a frontier, a turn or a viewpoint."""
        goal, status = tracked.goal, tracked.status
        if goal.kind == "trajectory":
            return
        state = None if status is None else status.state
        if tracked.view is not None:
            if state == "failed":
                self._chooser.next_view.mark_unreachable()
            elif state == "reached":
                self._chooser.next_view.on_arrived(images)
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
        self, tracked: TrackedGoal, pose: SE2, mission: MissionRun, now_ns: int
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
        self._chooser.next_view.abandon()

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
        self._chooser.search, self._place_failures = SearchState(), 0
        restored, self._restored = self._restored, None
        if restored is not None and restored[0] == mission.target:
            _, self._chooser.search, self._tracked = restored

    def state_dict(self) -> Arrays:
        """Return the current goal and the failed attempts, but no viewpoint and no task's goal."""
        tracked, goals = self._tracked, []
        if tracked is not None and tracked.view is None and tracked.goal.kind in _KINDS:
            goals = [(tracked.goal, tracked.peak)]
        return {
            **self._chooser.search.state_dict(),
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
        rows = {goal_rows: 1, ("left_m",): LEFT, ("missed",): LEFT}
        max_values = {"kind": len(_KINDS) - 1, "turns": 1000}
        check_arrays(state, self.state_dict(), rows, max_values)
        for kind, i, at in zip(state["kind"], state["id"], state["at"].tolist(), strict=True):
            x_m, y_m, yaw_rad, to_x_m, to_y_m, score, peak = at
            pose = SE2(x_m, y_m, yaw_rad)
            goal = Goal(now_ns, pose, _KINDS[kind], int(i), (to_x_m, to_y_m), score, target)
            tracked = TrackedGoal(goal, peak)
        self._restored = (target, SearchState.of_state_dict(state), tracked)

    def forget_mission(self) -> None:
        """Forget everything about the last mission."""
        self._warned_ids = set()
        self._restored = None
        self._n_retargets = -1
        self.abandon()
        self._chooser.next_view.reset()

    def reconfigure(self, config: Config) -> None:
        """Use another configuration; see `edge.loop.reload.LIVE` for the keys that may differ."""
        self._config = self._chooser.config = config
        self._chooser.next_view.images_needed = config.perception.confirm_hits

    def on_pose_jump(self) -> None:
        """Handle a pose jump. The robot stands still unless the next tick finds a goal."""
        self.idle()
        self.client.on_pose_jump()
        self._chooser.search, self._restored = SearchState(), None
        self._standstill.reset()

    def _discard(self, now_ns: int) -> None:
        """Abandon the current goal and ignore its candidate for some time."""
        tracked = self._tracked
        if tracked is not None and tracked.view is not None:
            self._chooser.next_view.mark_unreachable()
            return
        if tracked is not None and tracked.goal.kind == "place":
            self._place_failures += 1
        elif tracked is not None and tracked.goal.kind != "trajectory":
            self._chooser.discard(tracked.goal, now_ns)
        self.abandon()

"""Goal tracking: from a goal that was chosen to the controller's status and its consequences.

A controller drives to the last goal that it received. To abandon a goal, the tracker therefore
sends a goal at the robot's own position.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from edge.config import Config
from edge.geometry import SE2
from edge.loop.goals.candidates import CandidatePool
from edge.loop.goals.goal_choice import GoalChooser, TrackedGoal, goal_without_candidate
from edge.loop.goals.goal_client import ARRIVED_M, GoalClient
from edge.loop.goals.known_goals import AT_PLACE_M
from edge.loop.goals.standstill import StandstillMonitor
from edge.mapping.grid import RollingMap
from edge.mission.destinations import EveryObjectTarget
from edge.mission.run import MissionRun
from edge.perception.tracking.instances import InstanceTracker
from edge.text import one_line
from edge.types import Goal, GoalStatus, Instance, MissionPhase

MIN_IMAGES = 5
"""Number of images that the detector must process at the goal before an object is rejected. A
detector that hangs must not reject anything."""
GRACE_NS = 300_000_000
"""Time without a goal before the robot is stopped. A new goal usually comes sooner."""
_PLACE_TRIES = 3
"""Number of failed goals at a place after which the target is abandoned."""
Verdict = Literal["reached", "rejected", "out of reach"]
"""Outcome of a goal at an object; see `GoalTracker._judge`."""


class GoalTracker:
    """The tracker of the current goal; for one thread.

    Args:
        config: The configuration.
        pool: Candidates. The chooser discards those that failed.
        tracker: Instances. The goal tracker marks those that were reached or rejected.
        send: Transmits a goal.
        event: Reports an event for people, at a loop time.

    Attributes:
        phase: Phase of the goal: searching, approaching or verifying.
        chooser: Chooses and holds the current goal.
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
        self.chooser = GoalChooser(config, pool, tracker)
        self._standstill = StandstillMonitor(config, event)
        self._warned_ids: set[int] = set()
        self._reported: tuple[str, int] | None = None  # target and instance of `_report_relation`
        self._n_retargets = -1  # `MissionRun.retargets` of the target that is followed; -1: none
        self._no_goal_since_ns: int | None = None
        self._grace_ns = GRACE_NS

    # -- state for other modules --------------------------------------------------------------

    @property
    def goal(self) -> Goal | None:
        """Current goal of the robot, or None."""
        return None if self.chooser.tracked is None else self.chooser.tracked.goal

    @property
    def goal_status(self) -> GoalStatus | None:
        """Newest status of the current goal from the controller; None before the first."""
        return None if self.chooser.tracked is None else self.chooser.tracked.status

    @property
    def arrived(self) -> bool:
        """True if the controller says that the robot is at the current goal."""
        return self.goal_status is not None and self.goal_status.state == "reached"

    # -- sending ----------------------------------------------------------------------------

    def send_pending(self, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Send the current goal if it was not sent yet. Without a goal, make the robot stand."""
        self.client.notice_silence(now_ns)
        if mission.stopped:  # whatever chose a goal
            self.idle()
        tracked = self.chooser.tracked
        if tracked is not None:
            self._no_goal_since_ns = None
            if not tracked.sent:
                self.client.send(tracked.goal, now_ns)
                tracked.sent, self._grace_ns = True, GRACE_NS
                self._report_relation(tracked.goal, mission, now_ns)
                self._warn_of_neighbours(tracked.goal, mission, now_ns)
            return
        if self._no_goal_since_ns is None:
            self._no_goal_since_ns = now_ns
        if self.client.driving and now_ns - self._no_goal_since_ns >= self._grace_ns:
            self.hold_position(mission, pose, now_ns)

    def hold_position(self, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Make the robot stand still, with a goal at its own pose that is not tracked."""
        self.chooser.abandon()
        self.client.hold(goal_without_candidate(pose, now_ns, mission.target), now_ns)
        self._grace_ns = GRACE_NS

    def on_goal_status(self, status: GoalStatus) -> None:
        """Handle a goal status of the controller, which may be for an old goal."""
        tracked = self.chooser.tracked
        if tracked is not None and not tracked.sent:
            tracked = None
        goal = None if tracked is None else tracked.goal
        if self.client.on_goal_status(status, goal) and tracked is not None:
            tracked.status = status

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
        for label in mission.progress.forbidden:
            for instance in self._tracker.of(label):
                away_m = instance.distance_m(goal.pose.x_m, goal.pose.y_m)
                if away_m > self._config.mission.reach_m:
                    continue
                near.add(instance.id)
                if instance.id not in self._warned_ids:
                    text = f"goal {away_m:.1f} m from {label}, which must not be reached now"
                    mission.log_event(now_ns, "warning", label, text)
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
                robot's pose. None: see `InstanceTracker.verified_now`.

        Returns:
            True if the robot is stuck: it should drive but stands still.
        """
        tracked = self.chooser.tracked
        self._standstill.on_blocked(grid, pose, self.client.take_blocked(), now_ns)
        if tracked is not None and tracked.sent and tracked.status is None:
            tracked.status = self.client.infer_arrival(tracked.goal, pose, now_ns)
        instance = None
        if tracked is not None and tracked.goal.kind == "instance":
            instance = self._tracker.get(tracked.goal.candidate_id)
        verdict = None
        if tracked is None or instance is None:
            # A trajectory or a place is known from the start, so nothing is searched for.
            known = ("trajectory", "place", "zone_exit")
            has_path_goal = tracked is not None and tracked.goal.kind in known
            self.phase = "approaching" if has_path_goal else "searching"
        elif verdict := self._judge(
            tracked, instance, pose, now_ns, images, is_reached or self._tracker.verified_now
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
            self.chooser.discard(now_ns)
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
        surface point of the instance is within `mission.reach_m`, and `is_reached` agrees.
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
        chooser, at = self.chooser, tracked.goal.pose
        if verdict == "reached" and mission.spec.steps is not None:
            chooser.abandon()  # a task wanted only the confirmation of this object
            return
        if verdict == "reached":
            label, is_new = mission.target, instance.state != "reached"
            self._tracker.mark_reached(instance.id)
            evidence = f"confirmed, seen in {instance.hits} images"
            if not isinstance(mission.destinations.get(label), EveryObjectTarget):
                mission.on_reached(evidence, now_ns)
            elif is_new:  # else it was chosen again before it was marked
                x_m, y_m, _ = instance.center_m
                text = f"found: {instance.label} at ({x_m:.1f}, {y_m:.1f}) ({evidence})"
                mission.log_event(now_ns, "seen", label, text)
            if mission.target == label and not mission.done:
                # The mission goes on to another object of this target, or to this one later.
                chooser.discard(now_ns)
            return
        if verdict == "rejected":
            is_verified = self._tracker.verified(instance, pose)
            if is_verified:  # a remembered object that is not seen again
                chooser.search.has_moved = True
            else:
                least = self._config.perception.tau_det
                chooser.search.note_probable(tracked.goal, instance, least)
            self._tracker.reject(instance.id)
            chooser.abandon()
        else:
            if not chooser.search.mark_missed(instance.id, (at.x_m, at.y_m)):
                # With the map as it is now, a goal may be nearer to the object.
                chooser.abandon()
                return
            chooser.discard(now_ns)
        x, y, _ = instance.center_m
        self._event(f"{verdict}: {instance.label} #{instance.id} at ({x:.1f}, {y:.1f})", now_ns)

    def _check_drive(self, tracked: TrackedGoal, pose: SE2, now_ns: int, images: int) -> None:
        """Handle the controller's status of a goal for a frontier, a turn or a viewpoint."""
        goal, status = tracked.goal, tracked.status
        if goal.kind in ("trajectory", "zone_exit"):
            return
        state = None if status is None else status.state
        if tracked.view is not None:
            if state == "failed":
                self.chooser.next_view.mark_unreachable()
            elif state == "reached":
                self.chooser.next_view.on_arrived(images)
        elif goal.kind == "spin":
            if state in ("reached", "failed"):
                self.chooser.discard(now_ns)
        elif status is not None and state == "failed":
            self._event(f"goal failed: {status.reason or 'no reason given'}", now_ns)
            self.chooser.discard(now_ns)
        elif goal.kind == "frontier" and (
            state == "reached"
            or pose.distance_to(*goal.candidate_xy_m) <= self._config.policy.delta_reached_m
        ):
            # The frontier was visited. Algorithm 2 only ignores frontiers that are this near. The
            # robot would turn to another frontier, and back as soon as it is a little farther away.
            self.chooser.discard(now_ns)

    def _check_place(
        self, tracked: TrackedGoal, pose: SE2, mission: MissionRun, now_ns: int
    ) -> None:
        """Handle the controller's status of a goal at a place."""
        goal, status = tracked.goal, tracked.status
        state = None if status is None else status.state
        away_m = pose.distance_to(*goal.candidate_xy_m)
        arrived = state == "reached" and away_m <= AT_PLACE_M + ARRIVED_M
        if arrived and not tracked.ends_on_arrival:
            return
        if arrived:
            self.chooser.abandon()
            mission.on_reached(f"{away_m:.1f} m from the place", now_ns)
        elif status is not None and state in ("reached", "failed"):
            reason = status.reason or f"the controller stopped {away_m:.1f} m from {goal.target}"
            self._event(f"goal failed: {reason}", now_ns)
            self.chooser.discard(now_ns)
            if self.chooser.place_failures >= _PLACE_TRIES:
                mission.abandon_target(
                    f"found no path to {goal.target}: {one_line(reason)}", now_ns
                )

    # -- new targets and missions -------------------------------------------------------

    def idle(self) -> None:
        """Abandon the current goal. Unless a new one comes in this tick, the robot stands still."""
        self.chooser.abandon()
        self._grace_ns = 0

    def follows(self, mission: MissionRun) -> bool:
        """Return True if the tracker already works on the mission's active target."""
        return self._n_retargets == mission.retargets

    def begin_target(self, mission: MissionRun) -> None:
        """Start on another target: forget goal and attempts of the last one."""
        self._n_retargets = mission.retargets
        self.chooser.begin_target(mission.target)

    def forget_mission(self) -> None:
        """Forget everything about the last mission."""
        self._warned_ids, self._reported = set(), None
        self._n_retargets = -1
        self.chooser.forget_mission()

    def reconfigure(self, config: Config) -> None:
        """Use another configuration; see `edge.loop.reload.LIVE` for the keys that may differ."""
        self._config = self.chooser.config = config
        self.chooser.next_view.images_needed = config.perception.confirm_hits

    def on_pose_jump(self) -> None:
        """Handle a pose jump. The robot stands still unless the next tick finds a goal."""
        self.idle()
        self.client.on_pose_jump()
        self.chooser.on_pose_jump()
        self._standstill.reset()

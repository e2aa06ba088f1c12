"""Follow behaviour: find the objects of a task, then write, refine and drive its trajectory.

A task has steps, such as "pass the van" and "go to the gate". A *written* trajectory is a list of
coarse points; *refining* it makes a path that the robot can drive on the current map. A refined
trajectory consists of legs. If the rules wrote it, a leg that ends a segment ends a step. A *stop*
is the end of a step at objects.

The robot drives as many steps as a trajectory can be written for. The objects of later steps may be
seen during the drive. If no further step can be driven, the robot searches for them.

Writing and refining take from 0.1 s to minutes. They run in the background (`plan_worker.py`), and
the robot stands still until they end. A trajectory is valid only in its frame and from the robot's
place. After a pose jump or a restart, a new one is written for the remaining steps.

A trajectory may refer to objects that were seen only from afar. At each stop the robot therefore
verifies the objects, like a target of a mission. It rejects a wrong object and searches for another
one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from edge.config import Config
from edge.geometry import SE2
from edge.loop.behaviours.driven_trajectory import DrivenTrajectory
from edge.loop.behaviours.plan_worker import (
    PlanRequest,
    PlanResult,
    PlanWorker,
    is_by_model,
    log_line,
)
from edge.loop.behaviours.search import newest_ids
from edge.loop.behaviours.stop_verification import StopVerification
from edge.loop.goals.goal import GoalTracker
from edge.loop.goals.known_goals import goal_at_pose
from edge.loop.input_log import InputLog
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.policies.base import PolicyInput
from edge.tasks.facts import StepState, StepStatus, TaskPhase, TaskStatus
from edge.tasks.scene.pipeline import GroundKinds
from edge.text import one_line
from edge.types import Detections, Goal, GoalStatus, Instance, Observation

RETRY_NS = 2_000_000_000
"""Period of new tries to write a trajectory that was not possible with the objects seen so far."""
TURNS = 3
"""Number of turns in a full circle, which the robot does before a model writes the trajectory."""
SAME_PLACE_M = 0.5
"""If the robot is blocked twice within this distance, a new trajectory is written."""
MAX_BLOCKED = 5
"""If this many trajectories in a row are blocked as soon as they are made, a new one is written."""
_MAX_TEXT_CHARS = 300


@dataclass(slots=True)
class PlanRetry:
    """New tries to write a trajectory that was not possible with the objects seen so far.

    Attributes:
        reason: Reason why no trajectory can be written; "" if one was written.
        ambiguous: Ids of the instances that an ambiguous name may mean.
        tried_ns: Loop time of the newest try.
        is_last: True if the newest try was made with an exhausted search.
    """

    reason: str = ""
    ambiguous: tuple[int, ...] = ()
    tried_ns: int = 0
    is_last: bool = False


class FollowBehaviour:
    """A behaviour that carries out one task; for the loop's thread.

    Args:
        mission: The mission of the task. It has the time, the limits and the log.
        input_log: Input log, which records the worker's results.
        ground: Names the kinds of ground in images; None: all ground is of one kind.

    Attributes:
        phase: Current phase of the task.
    """

    def __init__(
        self,
        mission: MissionRun,
        config: Config,
        semantic_map: SemanticMap,
        goals: GoalTracker,
        input_log: InputLog,
        ground: GroundKinds | None = None,
    ) -> None:
        self._config = config
        self._mission, self._map, self._goals = mission, semantic_map, goals
        self._worker = PlanWorker(config, input_log, ground)
        self._restart()

    def _restart(self) -> None:
        """Reset all state, and begin with the first step that was not driven."""
        self.phase: TaskPhase = "looking"
        self._turns_left = TURNS if is_by_model(self._config) else 0
        self._turning: SE2 | None = None  # goal of a turn on the spot
        self._result = PlanResult()  # of the trajectory that is driven
        self._drive: DrivenTrajectory | None = None
        self._refinements = 0
        self._retry = PlanRetry()
        self._abandon_reason = ""  # reason why an earlier trajectory was abandoned
        self._blocked_at: SE2 | None = None
        self._n_blocked = 0  # number of the newest trajectories that were blocked from the start
        self._stop: StopVerification | None = None  # the present or the last stop

    @property
    def waits_for_target(self) -> bool:
        """True if no step can be driven until another target is seen."""
        return self.phase == "looking" and not _possible_ends(self._mission, self._config)

    @property
    def searching(self) -> bool:
        """True while the robot explores, for a missing target or for space to drive through."""
        return self.waits_for_target or (self.phase == "looking" and bool(self._retry.reason))

    # -- in each tick -----------------------------------------------------------------------

    def target_objects(self) -> Sequence[Instance]:
        """Return the unconfirmed objects that an ambiguous name may mean."""
        found = [self._map.tracker.get(number) for number in self._retry.ambiguous]
        return [one for one in found if one is not None and one.state == "tentative"]

    def plan(self, context: PolicyInput, images: int) -> None:
        """Advance the task. Slow work is started in the background."""
        mission, goals, now_ns = self._mission, self._goals, context.now_ns
        targets, only_confirmed = mission.spec.targets, not self._config.policy.instances
        # An object that the robot drives past may get lost, but is not searched for again.
        newest = newest_ids(self._map.tracker, targets, only_confirmed, with_contested=False)
        mission.on_detections(newest, now_ns, keep=self.phase != "looking")
        if not (goals.follows(mission) and mission.active):
            return
        leaves_zone = goals.goal is not None and goals.goal.kind == "zone_exit"
        stuck = goals.check_progress(self._map.grid, context.pose, mission, images, now_ns)
        status = None if leaves_zone else goals.goal_status
        self._advance(context, stuck and not leaves_zone, status, images)
        if goals.chooser.exhausted and self.waits_for_target:
            mission.abandon_target(goals.chooser.failure_reason(mission, self._map.grid), now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Choose a goal by score during a search; otherwise move the goal along the trajectory."""
        goals, chooser, now_ns = self._goals, self._goals.chooser, context.now_ns
        if self.searching:
            return chooser.choose(context, self._map.grid, scores, images)
        if self.phase == "driving" and self._drive is not None:
            pose, apart_m = self._drive.goal(context.pose)
        else:
            turn = self._turning if self._stop is None else self._stop.turn
            if turn is None:
                goals.idle()
                return None
            pose, apart_m = turn, 0.0
        target = self._mission.target
        goal = goal_at_pose(goals.goal, "trajectory", pose, target, now_ns, apart_m)
        return chooser.drive_to(goal)

    def _advance(
        self, context: PolicyInput, stuck: bool, status: GoalStatus | None, images: int
    ) -> None:
        """Do what the current phase needs in this tick; see `GoalTracker` for the arguments."""
        # Phases: looking (for objects), writing, driving, verifying (the objects of a stop).
        observation, detections = context.observation, context.detections
        pose, now_ns = context.pose, context.now_ns
        turn_ended = stuck or (status is not None and status.state in ("reached", "failed"))
        self._worker.name_ground(observation, now_ns)
        if detections is not None:
            self._worker.add_detections(detections)
        if (answered := self._worker.poll()) is not None:
            self._on_plan(*answered, now_ns)
        if self.phase == "looking" and not self.waits_for_target and not self._mission.done:
            if self._retry.reason:
                self._retry_plan(observation, now_ns)
            elif self._turning is not None and not turn_ended:
                pass  # the turn goes on
            elif self._turns_left:
                self._turns_left -= 1
                self._turning = SE2(pose.x_m, pose.y_m, pose.yaw_rad + math.tau / TURNS)
            else:
                self._turning, self.phase = None, "writing"
        if self.phase == "writing" and self._worker.request is None and not self._mission.done:
            if not is_by_model(self._config):
                self._request_plan(observation, None)
            elif detections is not None:  # with the image of the boxes
                self._request_plan(detections.observation, detections)
        elif self.phase == "driving":
            self._check_drive(observation, stuck, status, now_ns)
        elif self.phase == "verifying" and not self._mission.done:
            self._verify(pose, turn_ended, images, now_ns)

    def reconfigure(self, config: Config, ground: GroundKinds | None) -> None:
        self._config = config
        self._worker.reconfigure(config, ground)

    def on_pose_jump(self) -> None:
        """Begin again after a pose jump. The trajectory is invalid in the new frame."""
        self._worker.on_pose_jump()
        self._restart()

    def close(self) -> None:
        """Drop the running request and stop the worker."""
        self._worker.close()

    def task_status(self) -> TaskStatus:
        """Return the state of the task; see `edge.loop.result.TickResult.task`. For any thread."""
        mission, result, request = self._mission, self._result, self._worker.request
        drive, planner = self._drive, self._config.tasks.planner
        outcome = mission.status("searching").phase
        end = result.n_done if request is None else request.ends[0]  # step of the trajectory's end
        return TaskStatus(
            instruction=mission.spec.translation.instruction,
            phase=outcome if outcome in ("reached", "failed") else self.phase,
            writer=f"{planner.model} at {planner.url}" if planner.kind == "model" else planner.kind,
            missing=mission.plan.steps,
            understood=result.understood,
            prompt=result.prompt,
            rounds=result.rounds if request is None else tuple(request.attempts),
            coarse_m=result.coarse_m,
            refined=result.refined,
            index=0 if drive is None else drive.index,
            refinements=self._refinements,
            notes=() if result.refined is None else result.refined.notes,
            steps=_step_statuses(mission, 0 if self.phase == "looking" else end),
        )

    # -- inside -----------------------------------------------------------------------------

    def _retry_plan(self, observation: Observation, now_ns: int) -> None:
        """Try again every `RETRY_NS` while the map grows, and a last time when it is explored."""
        retry = self._retry
        if self._worker.request is not None:
            return
        if retry.is_last:
            _fail(self._mission, retry.reason, now_ns)
            return
        # The objects in question are confirmed.
        is_settled = retry.ambiguous and not self.target_objects()
        if is_settled or self._goals.chooser.exhausted or now_ns - retry.tried_ns >= RETRY_NS:
            retry.tried_ns, retry.is_last = now_ns, self._goals.chooser.exhausted
            self._request_plan(observation, None)

    def _request_plan(
        self,
        observation: Observation,
        found: Detections | None,
        before: PlanResult | None = None,
        nearer_to: tuple[int, str] | None = None,
    ) -> None:
        """Request a new trajectory, or refine that of `before` again; see `PlanRequest`.

        A model gets copies of image, depth and cloud, so that it does not hold their frame.
        """
        mission, worker = self._mission, self._worker
        rgb = depth_m = cloud_m = None
        if is_by_model(self._config) and before is None:
            arrays = observation.rgb, observation.depth_m, observation.cloud_m
            rgb, depth_m, cloud_m = map(_copied, arrays)
        at_request = replace(observation, rgb=rgb, depth_m=depth_m, cloud_m=cloud_m, slot=None)
        instances = {
            one.id: one.copied()
            for label in mission.spec.targets
            for one in self._map.tracker.of(label, with_contested=False)
        }
        if not self._retry.reason:
            self.phase = "writing"
        request = PlanRequest(
            self._config, mission.spec.translation.instruction, mission.progress.state,
            _possible_ends(mission, self._config), len(mission.spec.steps or ()), self._map.view,
            at_request, tuple(instances.values()), worker.objects, worker.ground_votes,
            None if found is None else replace(found, observation=at_request), before,
            0 if self._drive is None else self._drive.index, self._abandon_reason, nearer_to,
        )  # fmt: skip
        worker.submit(request)

    def _on_plan(self, result: PlanResult, request: PlanRequest, now_ns: int) -> None:
        """Start to drive the new trajectory. If there is none, write another or fail."""
        retry, log = self._retry, partial(_log, self._mission)
        retry.ambiguous = result.ambiguous
        to_verify = self.target_objects()
        for n, attempt in enumerate(result.rounds, start=1):
            if attempt.error and request.before is None:
                log(f"answer {n} of the model: {attempt.error}", now_ns)
        if result.refined is not None:
            refined = result.refined
            if request.nearer_to is not None:  # other facts stay those of the task's trajectory
                result = replace(self._result, refined=refined, stops_at=None)
            n_verified = (
                self._mission.progress.state if self._drive is None else self._drive.n_verified
            )
            steps = self._mission.spec.steps or ()
            self._drive = DrivenTrajectory(result, refined, steps, n_verified)
            self._result = result
            self._refinements += 1
            self.phase, retry.reason = "driving", ""
            log(log_line(result, refined, request), now_ns)
        elif request.nearer_to is not None:
            self._on_stop(now_ns)
        elif request.before is not None:
            self._write_again(result.error, now_ns)
        elif to_verify or not (
            result.hopeless or self._abandon_reason or is_by_model(self._config)
        ):
            if not retry.reason:
                log(f"{result.error}: exploring further", now_ns)
            self.phase, retry.reason, retry.tried_ns = "looking", result.error, now_ns
        else:
            self._result = result
            after = f"{self._abandon_reason}; no new trajectory: " if self._abandon_reason else ""
            _fail(self._mission, f"{after}{result.error}", now_ns)

    def _check_drive(
        self, observation: Observation, stuck: bool, status: GoalStatus | None, now_ns: int
    ) -> None:
        """React if the robot has arrived, is blocked, or has an obstacle ahead."""
        drive, goal = self._drive, self._goals.goal
        assert drive is not None
        pose, state = observation.pose, None if status is None else status.state
        if (driven := drive.n_steps_driven) > self._mission.progress.state:
            self._mission.on_task_steps_driven(driven, now_ns)
        why = ""  # the trajectory must change
        if state == "reached" and goal is not None:
            at_stop = drive.on_arrived(goal.pose)
            nearer_to = self._result.stops_at if drive.stop_is_end else None
            if at_stop and nearer_to is not None:
                # From here the object is seen better: perhaps a stop nearer to it is possible.
                self._request_plan(observation, None, nearer_to=nearer_to)
            elif at_stop:
                self._on_stop(now_ns)
        elif stuck or state == "failed":
            why = "the robot is blocked"
            if status is not None and not stuck:
                why = f"the controller failed: {status.reason}"
            before, self._blocked_at = self._blocked_at, pose
            if before is not None and pose.distance_to(before.x_m, before.y_m) < SAME_PLACE_M:
                self._write_again(why, now_ns)
                return
        # The way out of a zone is not the trajectory, and leads through closed cells.
        elif goal is None or goal.kind != "zone_exit":
            is_new = not drive.checked
            away_m = drive.blocked_ahead_m(self._map.view, now_ns)
            if is_new:
                self._n_blocked = 0 if away_m is None else self._n_blocked + 1
            if away_m is not None:
                why = f"obstacle on the path {away_m:.1f} m ahead"
            if self._n_blocked == MAX_BLOCKED:
                self._n_blocked = 0
                self._write_again(why, now_ns)
                return
        if why:
            _log(self._mission, f"{why}: refining the rest again", now_ns)
            self._request_plan(observation, None, before=self._result)

    def _on_stop(self, now_ns: int) -> None:
        """Handle the arrival at a stop, or at the end of a trajectory: verify the objects there."""
        assert self._drive is not None
        if not self._drive.stop_objects:
            self._continue(now_ns)
            return
        log, objects = partial(_log, self._mission), self._drive.stop_objects
        self._stop = StopVerification(objects, self._map.tracker, log)
        self.phase = "verifying"

    def _verify(self, pose: SE2, turn_ended: bool, images: int, now_ns: int) -> None:
        """Verify the objects of the stop; search for another one if one is rejected."""
        drive = self._drive
        assert self._stop is not None
        assert drive is not None
        result = self._stop.step(pose, turn_ended, images, self._config, now_ns)
        if result == "rejected":
            self._restart()
            self._goals.begin_target(self._mission)
        elif result == "verified" and drive.stop_is_end:
            self._continue(now_ns)
        elif result == "verified":
            drive.leave_stop()
            self.phase = "driving"

    def _continue(self, now_ns: int) -> None:
        """Continue with the remaining steps at the end of a trajectory, if there are any."""
        self._mission.on_task_steps_driven(self._result.n_done, now_ns)
        if not self._mission.done:
            self._restart()
            self._goals.begin_target(self._mission)

    def _write_again(self, why: str, now_ns: int) -> None:
        """Write a new trajectory, once. The second time, the mission fails."""
        if self._abandon_reason:
            _fail(self._mission, why, now_ns)
            return
        self.phase, self._abandon_reason = "writing", why
        _log(self._mission, f"{why}: writing a new trajectory from here", now_ns)


def _possible_ends(mission: MissionRun, config: Config) -> tuple[int, ...]:
    """Return the steps after which a trajectory may end now, counted from the task's start.

    The largest number comes first.
    """
    steps, unseen, first = mission.spec.steps or (), set(mission.plan.steps), mission.progress.state
    if is_by_model(config):
        return (len(steps),)
    blocked = (n for n in range(first, len(steps)) if not unseen.isdisjoint(steps[n].names))
    first_blocked = next(blocked, len(steps))  # first step with an object that was not seen
    # A trajectory must not end just before a step that is driven together with the last one.
    ends = range(first_blocked, first, -1)
    return tuple(n for n in ends if n == len(steps) or not steps[n].joined)


def _step_statuses(mission: MissionRun, end: int) -> tuple[StepStatus, ...]:
    """Return the state of each step of a task; the steps before `end` are under way."""
    missing, statuses = set(mission.plan.steps), []
    for n, step in enumerate(mission.spec.steps or ()):
        state: StepState
        if n < mission.progress.state:
            state = "driven"
        elif mission.done:
            state = "not driven"
        elif n < end:
            state = "under way"
        else:
            state = "to come" if missing.isdisjoint(step.names) else "looked for"
        statuses.append(StepStatus(step.said, state))
    return tuple(statuses)


def _log(mission: MissionRun, text: str, now_ns: int) -> None:
    mission.log_event(now_ns, "trajectory", "", one_line(text, _MAX_TEXT_CHARS))


def _fail(mission: MissionRun, text: str, now_ns: int) -> None:
    mission.finish("failed", one_line(text, _MAX_TEXT_CHARS), now_ns)


def _copied(array: np.ndarray | None) -> np.ndarray | None:
    """Return a copy of an array; None for None."""
    return None if array is None else array.copy()

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
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from edge.config import Config, WriterModel
from edge.geometry import SE2
from edge.host.worker import Worker
from edge.loop.behaviours.plan_worker import (
    GroundUpdate,
    ObjectMapUpdate,
    PlanRequest,
    PlanResult,
    Request,
    log_line,
    release_frame,
    run_request,
)
from edge.loop.behaviours.search import newest_ids
from edge.loop.behaviours.stop_verification import StopVerification
from edge.loop.goal import GoalTracker
from edge.loop.input_log import TASK, InputLog
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.mission.task_step import TaskStep
from edge.policies.base import PolicyInput
from edge.tasks.facts import StepState, StepStatus, TaskPhase, TaskStatus
from edge.tasks.follow import (
    blocked_ahead_m,
    end_of_current_leg,
    end_of_leg,
    goal_ahead,
    index_at_goal,
)
from edge.tasks.ground_votes import GroundVotes
from edge.tasks.objects import ObjectMap
from edge.tasks.pipeline import GroundKinds
from edge.tasks.refine import RefinedTrajectory
from edge.text import one_line
from edge.types import Detections, Goal, Instance, Observation

AHEAD_M = 1.5
"""Distance of the goal ahead of the robot on the trajectory."""
RESEND_M = 0.3
"""The goal is sent again when it has moved by this distance."""
CHECK_PERIOD_NS = 500_000_000
"""Period of the check for obstacles on the path ahead."""
RETRY_NS = 2_000_000_000
"""Period of new tries to write a trajectory that was not possible with the objects seen so far."""
GROUND_PERIOD_NS = 1_000_000_000
"""Least time between two images whose ground is named."""
TURNS = 3
"""Number of turns in a full circle, which the robot does before a model writes the trajectory."""
SAME_PLACE_M = 0.5
"""If the robot is blocked twice within this distance, a new trajectory is written."""
_MAX_TEXT_CHARS = 300


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
        self._config, self._ground = config, ground
        self._mission, self._map, self._goals = mission, semantic_map, goals
        self._inner_worker: Worker[Request, PlanResult] = Worker(
            "task", run_request, inline=config.loop.lockstep, drop=release_frame
        )
        self._worker: Any = input_log.wrap(TASK, self._inner_worker)
        self._forget_surroundings()
        self._restart()

    def _forget_surroundings(self) -> None:
        """Forget the objects and the ground that images showed. Only the worker uses them."""
        self._objects = ObjectMap()
        self._ground_votes = None if self._ground is None else GroundVotes(self._ground.kinds)
        self._ground_ns: int | None = None  # loop time of the newest image for `_ground_votes`

    def _restart(self) -> None:
        """Reset all state, and begin with the first step that was not driven."""
        self.phase: TaskPhase = "looking"
        self._turns_left = TURNS if self._by_model else 0
        self._turning: SE2 | None = None  # goal of a turn on the spot
        self._result = PlanResult()  # the trajectory that is driven
        self._index = 0  # pose of the trajectory that the robot has come to
        self._refinements = 0
        self._request: PlanRequest | None = None  # request that the worker handles
        self._abandon_reason = ""  # reason why an earlier trajectory was abandoned
        # Reason why no trajectory can be written with the objects seen so far.
        self._no_plan_reason = ""
        self._ambiguous: tuple[int, ...] = ()  # instances that an ambiguous name may mean
        self._all_seen = False  # the last try was made with an exhausted search
        self._blocked_at: SE2 | None = None
        self._checked_ns = 0  # newest check of the path, or newest try to write
        self._n_verified = self._mission.state  # number of steps whose stops were verified
        self._next_stop: tuple[int, int] | None = None  # next stop: its step, the index of its pose
        self._stop: StopVerification | None = None  # the present or the last stop

    @property
    def _by_model(self) -> bool:
        """True if a language model writes the trajectory, False if the rules do."""
        return isinstance(self._config.tasks.planner, WriterModel)

    @property
    def missing(self) -> tuple[str, ...]:
        """Targets of the remaining steps that were not seen yet."""
        return self._mission.plan.steps

    @property
    def waits_for_target(self) -> bool:
        """True if no step can be driven until another target is seen."""
        return self.phase == "looking" and not self._possible_ends

    @property
    def searching(self) -> bool:
        """True while the robot explores, for a missing target or for space to drive through."""
        return self.waits_for_target or (self.phase == "looking" and bool(self._no_plan_reason))

    @property
    def _steps(self) -> tuple[TaskStep, ...]:
        return self._mission.spec.steps or ()

    @property
    def _possible_ends(self) -> tuple[int, ...]:
        """Numbers of steps after which a trajectory may end now, counted from the task's start.

        The largest comes first.
        """
        steps, unseen, first = self._steps, set(self.missing), self._mission.state
        if self._by_model:
            return (len(steps),)
        blocked = (n for n in range(first, len(steps)) if not unseen.isdisjoint(steps[n].names))
        first_blocked = next(blocked, len(steps))  # first step with an object that was not seen
        # A trajectory must not end just before a step that is driven together with the last one.
        ends = range(first_blocked, first, -1)
        return tuple(n for n in ends if n == len(steps) or not steps[n].joined)

    # -- in each tick -----------------------------------------------------------------------

    def gather(self) -> Sequence[Instance]:
        """Return the unconfirmed objects that an ambiguous name may mean."""
        found = [self._map.tracker.get(number) for number in self._ambiguous]
        return [one for one in found if one is not None and one.state == "tentative"]

    def plan(self, context: PolicyInput, images: int) -> None:
        """Advance the task. Slow work is started in the background."""
        mission, goals, now_ns = self._mission, self._goals, context.now_ns
        targets, only_confirmed = mission.spec.targets, not self._config.policy.instances
        # An object that the robot drives past may get lost, but is not searched for again.
        seen = newest_ids(self._map.tracker, targets, only_confirmed, doubted=False)
        mission.on_detections(seen, now_ns, keep=self.phase != "looking")
        if not (goals.follows(mission) and mission.active):
            return
        stuck = goals.check_progress(self._map.grid, context.pose, mission, images, now_ns)
        self._advance(context, stuck)
        if goals.exhausted and self.waits_for_target:
            mission.abandon_target(goals.failure_reason(mission, self._map.grid), now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Choose a goal by score during a search; otherwise move the goal along the trajectory."""
        if self.searching:
            return self._goals.choose(context, self._map.grid, scores, images)
        self._set_goal(context.pose, context.now_ns)
        return self._goals.goal

    def _advance(self, context: PolicyInput, stuck: bool) -> None:
        """Do what the current phase needs in this tick."""
        # Phases: looking (for objects), writing, driving, verifying (the objects of a stop).
        observation, detections = context.observation, context.detections
        pose, now_ns = context.pose, context.now_ns
        self._name_ground(observation, now_ns)
        if detections is not None:
            self._add_detections(detections)
            if self._stop is not None:
                self._stop.on_image()
        if (result := self._worker.poll()) is not None and self._request is not None:
            self._on_plan(result, self._request, now_ns)
        if self.phase == "looking" and not self.waits_for_target and not self._mission.done:
            if self._no_plan_reason:
                self._retry_plan(observation, now_ns)
            else:
                self._turn_around(pose, stuck)
        if self.phase == "writing" and self._request is None and not self._mission.done:
            if not self._by_model:
                self._request_plan(observation, None)
            elif detections is not None:  # with the image of the boxes
                self._request_plan(detections.observation, detections)
        elif self.phase == "driving":
            self._check_drive(observation, stuck, now_ns)
        elif self.phase == "verifying" and not self._mission.done:
            self._verify(pose, stuck, now_ns)

    def _set_goal(self, pose: SE2, now_ns: int) -> None:
        """Set the goal ahead on the trajectory, or a turn, or none, so that the robot stands."""
        refined = self._result.refined
        if self.phase == "driving" and refined is not None:
            until = None if self._next_stop is None else self._next_stop[1]
            ahead, self._index = goal_ahead(refined, pose, AHEAD_M, self._index, until)
            ends = (end_of_current_leg(refined, self._index), len(refined.poses) - 1)
            # The ends of legs and of the trajectory are sent exactly, however near they are.
            exact = any(
                _is_at(ahead, refined, end) for end in ends if until is None or end <= until
            )
            apart_m = 0.0 if exact else RESEND_M
            self._goals.override(ahead, self._mission, now_ns, apart_m)
        elif (turn := self._turning if self._stop is None else self._stop.turn) is not None:
            self._goals.override(turn, self._mission, now_ns, 0.0)
        else:
            self._goals.idle()

    def reconfigure(self, config: Config, ground: GroundKinds | None) -> None:
        self._config = config
        if ground is not self._ground:
            self._ground = ground
            self._forget_surroundings()

    def on_pose_jump(self) -> None:
        """Begin again after a pose jump. The trajectory is invalid in the new frame."""
        self._worker.discard_all()
        self._forget_surroundings()
        self._restart()

    def close(self) -> None:
        """Drop the running request and stop the worker."""
        self._worker.discard_all()
        self._worker.stop()

    def facts(self) -> TaskStatus:
        """Return the state of the task; see `edge.loop.result.TickResult.task`."""
        mission, result, planner = self._mission, self._result, self._config.tasks.planner
        outcome = mission.status("searching").phase
        return TaskStatus(
            instruction=mission.spec.translation.instruction,
            phase=outcome if outcome in ("reached", "failed") else self.phase,
            writer=f"{planner.model} at {planner.url}" if planner.kind == "model" else planner.kind,
            missing=self.missing,
            understood=result.understood,
            prompt=result.prompt,
            rounds=result.rounds if self._request is None else tuple(self._request.attempts),
            coarse_m=result.coarse_m,
            refined=result.refined,
            index=self._index,
            refinements=self._refinements,
            notes=() if result.refined is None else result.refined.notes,
            steps=tuple(self.steps()),
        )

    def steps(self) -> Iterator[StepStatus]:
        """Yield the state of each step of the task; for any thread."""
        mission, request, missing = self._mission, self._request, set(self.missing)
        end = self._result.n_done if request is None else request.ends[0]  # step of its end
        for n, step in enumerate(self._steps):
            state: StepState
            if n < mission.state:
                state = "driven"
            elif mission.done:
                state = "not driven"
            elif n < end and self.phase != "looking":
                state = "under way"
            else:
                state = "to come" if missing.isdisjoint(step.names) else "looked for"
            yield StepStatus(step.said, state)

    # -- inside -----------------------------------------------------------------------------

    @property
    def _goal_ended(self) -> bool:
        """True if the controller has reached the current goal or failed."""
        answer = self._goals.goal_status
        return answer is not None and answer.state in ("reached", "failed")

    def _turn_around(self, pose: SE2, stuck: bool) -> None:
        """Turn once on the spot for a model, then start to write. All targets were seen."""
        if self._turning is not None and not (stuck or self._goal_ended):
            return
        if self._turns_left:
            self._turns_left -= 1
            self._turning = SE2(pose.x_m, pose.y_m, pose.yaw_rad + math.tau / TURNS)
        else:
            self._turning, self.phase = None, "writing"

    def _retry_plan(self, observation: Observation, now_ns: int) -> None:
        """Try again every `RETRY_NS` while the map grows, and a last time when it is explored."""
        if self._request is not None:
            return
        if self._all_seen:
            self._fail(self._no_plan_reason, now_ns)
            return
        is_settled = self._ambiguous and not self.gather()  # the objects in question are confirmed
        if is_settled or self._goals.exhausted or now_ns - self._checked_ns >= RETRY_NS:
            self._checked_ns, self._all_seen = now_ns, self._goals.exhausted
            self._request_plan(observation, None)

    def _name_ground(self, seen: Observation, now_ns: int) -> None:
        """Name the ground that the image shows, in the background, at most once a period.

        Nothing waits for the network but the next request, so it gets no image while one waits.
        """
        votes, classifier, newest_ns = self._ground_votes, self._ground, self._ground_ns
        if votes is None or classifier is None or self._request is not None:
            return
        ranged = seen.depth_m is not None or seen.cloud_m is not None
        is_due = newest_ns is None or now_ns - newest_ns >= GROUND_PERIOD_NS
        pictured = seen.rgb is not None and seen.camera is not None
        if is_due and ranged and pictured and self._inner_worker.idle:
            self._ground_ns = now_ns
            seen.hold()
            self._inner_worker.submit(
                GroundUpdate(seen, classifier, votes, self._config.mapping), GroundUpdate
            )

    def _add_detections(self, found: Detections) -> None:
        """Add the detections to the object map, in the background."""
        perception, seen = self._config.perception, found.observation
        found = found.above(perception.tau_det)
        ranged = seen.depth_m is not None or seen.cloud_m is not None
        if len(found) and ranged and seen.camera is not None:
            seen.hold()
            self._inner_worker.submit(
                ObjectMapUpdate(found, self._objects, perception.back_projection_max_range_m),
                ObjectMapUpdate,
            )

    def _request_plan(
        self,
        seen: Observation,
        found: Detections | None,
        before: PlanResult | None = None,
        nearer_to: tuple[int, str] | None = None,
    ) -> None:
        """Request a new trajectory, or refine that of `before` again; see `PlanRequest`.

        A model gets copies of image, depth and cloud, so that it does not hold their frame.
        """
        if self._by_model and before is None:
            rgb, depth_m, cloud_m = map(_copied, (seen.rgb, seen.depth_m, seen.cloud_m))
        else:
            rgb = depth_m = cloud_m = None
        at_request = replace(seen, rgb=rgb, depth_m=depth_m, cloud_m=cloud_m, slot=None)
        instances = {
            one.id: one.copied()
            for label in self._mission.spec.targets
            for one in self._map.tracker.of(label, doubted=False)
        }
        if not self._no_plan_reason:
            self.phase = "writing"
        self._request = PlanRequest(
            self._config,
            self._mission.spec.translation.instruction,
            self._mission.state,
            self._possible_ends,
            len(self._steps),
            self._map.view,
            at_request,
            tuple(instances.values()),
            self._objects,
            self._ground_votes,
            None if found is None else replace(found, observation=at_request),
            before,
            self._index,
            self._abandon_reason,
            nearer_to,
        )
        self._worker.submit(self._request)

    def _on_plan(self, result: PlanResult, request: PlanRequest, now_ns: int) -> None:
        """Start to drive the new trajectory. If there is none, write another or fail."""
        self._request = None
        self._ambiguous = result.ambiguous
        to_verify = self.gather()
        for n, answer in enumerate(result.rounds, start=1):
            if answer.error and request.before is None:
                self._log(f"answer {n} of the model: {answer.error}", now_ns)
        if result.refined is not None:
            refined = result.refined
            if request.nearer_to is not None:  # other facts stay those of the task's trajectory
                result = replace(self._result, refined=refined, stops_at=None)
            self._result, self._index, self._checked_ns = result, 0, 0
            self._refinements += 1
            self._next_stop = self._find_next_stop(refined)
            self.phase, self._no_plan_reason = "driving", ""
            self._log(log_line(result, refined, request), now_ns)
        elif request.nearer_to is not None:
            self._on_stop(now_ns)
        elif request.before is not None:
            self._write_again(result.error, now_ns)
        elif to_verify or not (result.hopeless or self._abandon_reason or self._by_model):
            if not self._no_plan_reason:
                self._log(f"{result.error}: exploring further", now_ns)
            self.phase, self._no_plan_reason, self._checked_ns = "looking", result.error, now_ns
        else:
            self._result = result
            after = f"{self._abandon_reason}; no new trajectory: " if self._abandon_reason else ""
            self._fail(f"{after}{result.error}", now_ns)

    def _check_drive(self, observation: Observation, stuck: bool, now_ns: int) -> None:
        """React if the robot has arrived, is blocked, or has an obstacle ahead."""
        refined, goal, answer = self._result.refined, self._goals.goal, self._goals.goal_status
        assert refined is not None
        pose, state = observation.pose, None if answer is None else answer.state
        if (driven := self._n_steps_driven(refined)) > self._mission.state:
            self._mission.on_task_steps_driven(driven, now_ns)
        last = len(refined.poses) - 1
        until = last if self._next_stop is None else self._next_stop[1]
        if state == "reached" and goal is not None and _is_at(goal.pose, refined, until):
            obj = self._result.stops_at
            if obj is None or until < last:
                self._on_stop(now_ns)
            else:  # from here the object is seen better: perhaps a stop nearer to it is possible
                self._request_plan(observation, None, nearer_to=obj)
        elif state == "reached" and goal is not None:
            self._index = index_at_goal(refined, goal.pose, self._index)
        elif stuck or state == "failed":
            why = "the robot is blocked"
            if answer is not None and not stuck:
                why = f"the controller failed: {answer.reason}"
            before, self._blocked_at = self._blocked_at, pose
            if before is not None and pose.distance_to(before.x_m, before.y_m) < SAME_PLACE_M:
                self._write_again(why, now_ns)
            else:
                self._refine_again(why, observation, now_ns)
        elif now_ns - self._checked_ns >= CHECK_PERIOD_NS:
            self._checked_ns = now_ns
            away_m = blocked_ahead_m(refined, self._map.view, self._index)
            if away_m is not None:
                why = f"obstacle on the path {away_m:.1f} m ahead"
                self._refine_again(why, observation, now_ns)

    def _n_steps_driven(self, refined: RefinedTrajectory) -> int:
        """Return the number of driven steps. The rules write one segment for each step."""
        ahead = refined.legs[refined.leg[self._index] :]  # the present leg and all after it
        driven = max(self._result.n_done - sum(leg.ends_segment for leg in ahead), 0)
        while self._steps[driven].joined:  # this step is one leg with the step before it
            driven -= 1
        return driven

    def _find_next_stop(self, refined: RefinedTrajectory) -> tuple[int, int] | None:
        """Return the next step that stops at objects, and the index of the pose of the stop."""
        last_legs = [k for k, leg in enumerate(refined.legs) if leg.ends_segment]  # of each step
        end, stops = self._result.n_done, self._result.stops
        # `stops` ends with step `end` - 1, so `stops[step - end]` counts from its end.
        for step, leg in zip(range(end - len(last_legs), end), last_legs, strict=True):
            if step >= max(self._n_verified, end - len(stops)) and stops[step - end]:
                return step, end_of_leg(refined, leg)
        return None

    def _on_stop(self, now_ns: int) -> None:
        """Handle the arrival at a stop, or at the end of a trajectory: verify the objects there."""
        if self._next_stop is None:
            self._continue(now_ns)
            return
        objects = self._result.stops[self._next_stop[0] - self._result.n_done]
        self._stop = StopVerification(objects, self._map.tracker, self._log, now_ns)
        self.phase = "verifying"

    def _verify(self, pose: SE2, stuck: bool, now_ns: int) -> None:
        """Verify the objects of the stop; search for another one if one is rejected."""
        assert self._stop is not None
        result = self._stop.step(pose, stuck or self._goal_ended, self._config, now_ns)
        if result == "verified":
            self._leave_stop(now_ns)
        elif result == "rejected":
            self._restart()
            self._goals.retarget(self._mission)

    def _leave_stop(self, now_ns: int) -> None:
        """Drive on after all objects of a stop were verified, or end the trajectory."""
        refined = self._result.refined
        assert refined is not None
        assert self._next_stop is not None
        step, index = self._next_stop
        if index == len(refined.poses) - 1:
            self._continue(now_ns)
            return
        self._n_verified, self._index, self.phase = step + 1, index + 1, "driving"
        self._next_stop = self._find_next_stop(refined)

    def _continue(self, now_ns: int) -> None:
        """Continue with the remaining steps at the end of a trajectory, if there are any."""
        self._mission.on_task_steps_driven(self._result.n_done, now_ns)
        if not self._mission.done:
            self._restart()
            self._goals.retarget(self._mission)

    def _refine_again(self, why: str, observation: Observation, now_ns: int) -> None:
        self._log(f"{why}: refining the rest again", now_ns)
        self._request_plan(observation, None, self._result)

    def _write_again(self, why: str, now_ns: int) -> None:
        """Write a new trajectory, once. The second time, the mission fails."""
        if self._abandon_reason:
            self._fail(why, now_ns)
            return
        self.phase, self._abandon_reason = "writing", why
        self._log(f"{why}: writing a new trajectory from here", now_ns)

    def _log(self, text: str, now_ns: int) -> None:
        self._mission.log_trajectory(one_line(text, _MAX_TEXT_CHARS), now_ns)

    def _fail(self, text: str, now_ns: int) -> None:
        self._mission.fail(one_line(text, _MAX_TEXT_CHARS), now_ns)


def _is_at(pose: SE2, refined: RefinedTrajectory, index: int) -> bool:
    """Return True if a goal is exactly this pose of the trajectory."""
    x_m, y_m, _, yaw_rad = refined.poses[index].tolist()
    return pose == SE2(x_m, y_m, yaw_rad)


def _copied(array: np.ndarray | None) -> np.ndarray | None:
    """Return a copy of an array; None for None."""
    return None if array is None else array.copy()

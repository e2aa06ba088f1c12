"""The sensor loop: observations in, goals out.

`Service.tick` is one pass over the stage table of `edge/stages.py`, top to bottom. It reads no
clock but to time itself: the same observations give the same goals.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from time import perf_counter_ns

import numpy as np

from edge import stages
from edge.candidates import FRONTIER, INSTANCE, CandidatePool
from edge.config import Config
from edge.geometry import SE2
from edge.latency import LatencyRing
from edge.mapping.grid import RollingMap
from edge.mission.target import TargetMission, Verdict
from edge.motion.stuck import StuckDetector
from edge.orders import Orders
from edge.perception.inline import InlineWorker
from edge.perception.instances import InstanceTracker
from edge.perception.lift import Lifter
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy
from edge.policies.select import GoalSelector
from edge.sinks import Sink
from edge.status import status_of
from edge.types import Detections, Goal, GoalStatus, Instance, MissionStatus, Observation

log = logging.getLogger("edge.service")

INGEST, DETECT, MAP, LIFT, CANDIDATES, SCORE, PLAN, SELECT, PUBLISH = range(len(stages.STAGES))
BLIND_S = 1.0  # or three frames, where they come less often


class Service:
    """Everything between a source of observations and the sinks of results.

    Args:
        worker: detects on the side; `submit` and `poll` never wait for the model.
        sinks: take goals, maps, status; their methods never block.
    """

    def __init__(
        self, config: Config, worker: DetectorWorker | InlineWorker, sinks: list[Sink]
    ) -> None:
        self.config = config
        self.grid = RollingMap(config.mapping)
        self.tracker = InstanceTracker(config.perception)
        self.mission = TargetMission(config.mission)
        self.policy = make_policy(config.policy)
        self.selector = GoalSelector(self.policy)
        self.pool = CandidatePool(
            config.mapping.max_frontiers + config.perception.max_instances, config.policy.r_assoc_m
        )
        self.latency = LatencyRing()
        self.goal: Goal | None = None
        self._worker = worker
        self._sinks = sinks
        self._lifter = Lifter(config.perception)
        self._stuck = StuckDetector(config.mission.stuck_s, config.motion.stuck_m)
        self.orders = Orders(self._tell, config.mission.target)
        self._seen: Detections | None = None
        self.pose: SE2 | None = None
        self._second_look = False
        self._looked_ns = 0  # when the last observation came
        self._blind_ns = _blind_ns(config)
        self._newest_seq = self._void_seq = -1

    # -- the tick ---------------------------------------------------------------------------

    def tick(self, observation: Observation, now_ns: int) -> Goal | None:
        """One pass over all stages.

        Args:
            observation: held by its source until the tick returns.
            now_ns: the loop's time, on the clock of the observation's stamp.

        Returns:
            The goal now being driven to, or None.
        """
        pose = self.pose = observation.pose
        self._looked_ns, self._newest_seq = now_ns, observation.seq
        self._worker.submit(observation)
        # In lockstep the model runs inside `submit`; that time is `detect`'s, not the tick's.
        self.latency.resume(perf_counter_ns())

        self._map(observation, pose)
        self._lap(MAP)
        self._lift(self._worker.poll())
        self._lap(LIFT)
        self.pool.update(self.grid.frontiers, self._instances(), observation.stamp_ns, now_ns)
        self._lap(CANDIDATES)
        self.policy.score(self.pool, self.grid, self._seen, pose)
        self._lap(SCORE)
        self._plan(pose, now_ns)
        self._lap(PLAN)
        goal = self._select(pose, now_ns)
        self._lap(SELECT)
        self._publish(goal, observation, now_ns)
        self._lap(PUBLISH)
        return goal

    def _lap(self, stage: int) -> None:
        self.latency.mark(stage, perf_counter_ns())

    def _map(self, observation: Observation, pose: SE2) -> None:
        """Stage 3: fold the depth image or cloud into the map."""
        if self.config.mapping.input == "cloud":
            if observation.cloud_m is not None:
                T = observation.T_map_base @ observation.T_base_lidar
                self.grid.update_cloud(observation.cloud_m, T, pose)
        elif observation.depth_m is not None and observation.camera is not None:
            T = observation.T_map_base @ observation.T_base_camera
            self.grid.update_depth(observation.depth_m, observation.camera, T, pose)
        self.grid.reach.step(pose)

    def _lift(self, detections: Detections | None) -> None:
        """Stage 4: boxes become instances, with the depth and pose they were seen with."""
        self._seen = None
        if detections is None:
            return
        if detections.observation.seq <= self._void_seq:
            detections.observation.release()
            return
        self.latency.span(DETECT, detections.latency_ns)
        lifted = self._lifter.lift(detections)
        self.tracker.update(lifted, detections.observation.stamp_ns)
        self.tracker.expire(detections.observation)
        self._seen = _of_target(detections)
        for sink in self._sinks:
            sink.detections(detections)
        # The arrays are only read through `_seen` in this tick; the frame may be used again.
        detections.observation.release()

    def _instances(self) -> list[Instance]:
        """What stage 5 takes as instance candidates."""
        if not self.policy.uses_instances or self.mission.status.done:
            return []
        return self.tracker.of(self.config.mission.target)

    def _plan(self, pose: SE2, now_ns: int) -> None:
        """Stage 7: what the robot's arrival, or its failure to arrive, means."""
        self.mission.observe(pose, now_ns)
        goal, answer = self.goal, self.orders.answer
        instance = None
        if goal is not None and goal.kind == "instance":
            instance = self.tracker.get(goal.candidate_id)
        confirmed = instance is not None and self.tracker.confirmed(instance)
        looks = self._worker.stats.done
        verdict = self.mission.advance(goal, instance, confirmed, answer, now_ns, looks)
        if verdict is not None:
            self._act_on(verdict, now_ns)
        elif goal is not None and not self.mission.status.done:
            self._follow(goal, answer, pose, now_ns)
        self.mission.check_limits(self.selector.exhausted and not self._look_again())

    def _act_on(self, verdict: Verdict, now_ns: int) -> None:
        instance = verdict.instance
        x, y, _ = instance.center_m
        where = f"{instance.label} #{instance.id} at ({x:.1f}, {y:.1f})"
        if verdict.kind == "reached":
            self.tracker.mark_reached(instance.id)
        elif verdict.kind == "refuted":
            self.tracker.refute(instance.id)
            self._drop_goal()
        else:
            self._discard(now_ns)
        self._event(f"{verdict.kind.replace('_', ' ')}: {where}", now_ns)

    def _follow(self, goal: Goal, answer: GoalStatus | None, pose: SE2, now_ns: int) -> None:
        """Take up the controller's answers about frontiers and turns, and notice standstill.

        Where no controller answers, it is no candidate's fault that the robot stands.
        """
        moving = answer is not None and answer.state == "accepted"
        if goal.kind == "look":
            if answer is not None and answer.state in ("reached", "failed"):
                self.selector.looked(now_ns)
                self._drop_goal()
        elif answer is not None and answer.state == "failed":
            self._event(f"goal failed: {answer.reason}", now_ns)
            self._discard(now_ns)
        elif answer is not None and answer.state == "reached" and goal.kind == "frontier":
            self._discard(now_ns)
        if self._stuck.update(pose, moving and self.goal is not None, now_ns):
            self._event("stuck: goal discarded", now_ns)
            self._discard(now_ns)

    def _discard(self, now_ns: int) -> None:
        """Leave the present goal's candidate alone for a while and choose another."""
        goal = self.goal
        if goal is not None and goal.kind == "look":
            self.selector.looked(now_ns)
        elif goal is not None:
            kind = INSTANCE if goal.kind == "instance" else FRONTIER
            until_ns = now_ns + int(self.config.mission.discard_s * 1e9)
            self.pool.discard(kind, goal.candidate_id, goal.candidate_xy_m, until_ns)
        self._drop_goal()

    def _drop_goal(self) -> None:
        self.selector.drop()
        self.orders.withdraw()
        self.goal = None

    def _look_again(self) -> bool:
        """Before giving up, go once more through the candidates that were discarded."""
        if self._second_look:
            return False
        self._second_look = True
        self.pool.lift_discards()
        self.selector.start_over()
        return True

    def _select(self, pose: SE2, now_ns: int) -> Goal | None:
        """Stage 8: algorithm 2, or nowhere when the mission is over."""
        if self.mission.status.done:
            self.orders.withdraw(at_once=True)
            return None
        by_id = {i.id: i for i in self._instances()}
        return self.selector.select(
            self.pool, self.grid, by_id, pose, now_ns, self.config.mission.target
        )

    def _publish(self, goal: Goal | None, observation: Observation, now_ns: int) -> None:
        """Stage 9: hand results to the sinks, which never block."""
        if goal is None:
            self.orders.give_none(observation.pose, now_ns)
        elif self.orders.give(goal, now_ns):
            self._stuck.reset()
        self.goal = goal
        for sink in self._sinks:
            sink.tick(self, observation, now_ns)

    def _tell(self, goal: Goal) -> None:
        for sink in self._sinks:
            sink.goal(goal)

    # -- what comes from outside --------------------------------------------------------------

    def goal_answered(self, answer: GoalStatus) -> None:
        """The controller said something about a goal; answers to old goals are void."""
        for sink in self._sinks:
            sink.answered(answer)
        self.orders.answered(answer)

    def idle(self, now_ns: int, pose: SE2 | None) -> None:
        """No observation came: limits still hold, status still goes out, no one drives blind.

        Args:
            pose: from the newest odometry; None before there was any.
        """
        blind = self.pose is not None and now_ns - self._looked_ns > self._blind_ns
        if blind and pose is not None:
            self.pose = pose
        self.mission.observe(self.pose, now_ns)
        self.mission.check_limits(False)
        if self.pose is not None and (self.mission.status.done or blind):
            self._stand(self.pose, now_ns)
        for sink in self._sinks:
            sink.tick(self, None, now_ns)

    def _stand(self, pose: SE2, now_ns: int) -> None:
        if self.orders.driving:
            if not self.mission.status.done:
                self._event("nothing to be seen: standing still", now_ns)
            self.orders.stand(pose, now_ns)
        self._drop_goal()

    def forget_places(self, now_ns: int) -> None:
        """The pose jumped: map, instances and goals of the old frame mean nothing now.

        What the detector still finds in images of before is void as well. The robot is told to
        stand, unless the next tick finds a goal in the new frame.
        """
        self._event("pose jumped: map and instances dropped", now_ns)
        self.grid = RollingMap(self.config.mapping)
        self.tracker = InstanceTracker(self.config.perception)
        self.pool.clear()
        self._drop_goal()
        self.orders.withdraw(at_once=True)
        self.selector.start_over()
        self._stuck.reset()
        self._second_look = False
        self._void_seq = self._newest_seq

    def _event(self, text: str, now_ns: int) -> None:
        log.info(text)
        for sink in self._sinks:
            sink.event(text, now_ns)

    # -- what others may ask ------------------------------------------------------------------

    @property
    def status(self) -> MissionStatus:
        return self.mission.status

    def status_dict(self) -> dict[str, object]:
        """The status message; see `edge.status`."""
        return status_of(self, self._worker)


def _blind_ns(config: Config) -> int:
    """How long without an observation is too long to drive on."""
    camera, lidar = config.sensors.camera, config.sensors.lidar
    by_lidar = config.mapping.input == "cloud" and lidar is not None
    return int(1e9 * max(BLIND_S, 3.0 / (lidar.rate_hz if by_lidar else camera.rate_hz)))


def _of_target(detections: Detections) -> Detections:
    """Only the boxes of the first prompt, which is the target, that nothing explains better."""
    mine = np.flatnonzero((detections.class_id == 0) & detections.unrivalled())
    return replace(
        detections,
        xyxy_px=detections.xyxy_px[mine],
        score=detections.score[mine],
        class_id=detections.class_id[mine],
        rival=None,
    )

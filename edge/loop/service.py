"""The service: it takes observations and returns goals.

`Service.tick` runs the stages of `edge/loop/stages.py` from top to bottom. It reads a clock only to
measure latency, so the same observations give the same goals.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from time import perf_counter_ns

from edge.config import Config
from edge.geometry import SE2
from edge.host.calibration import SpeedCalibration
from edge.loop.behaviours.base import Behaviour
from edge.loop.behaviours.follow import FollowBehaviour
from edge.loop.behaviours.search import SearchBehaviour
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.checkpoints.map_checkpoint import MapParts, StampedPose, restore
from edge.loop.checks.plausibility import Plausibility
from edge.loop.error_boundary import ErrorBoundary
from edge.loop.goals.goal import GoalTracker
from edge.loop.goals.zone_exit import ZoneExit
from edge.loop.input_log import FRAME_DECISION, SIGHTED, USE, InputLog
from edge.loop.latency import LatencyRing
from edge.loop.load_shedder import LoadShedder
from edge.loop.mission_control import MissionControl
from edge.loop.perceive import PerceptionStages
from edge.loop.publish import Outbox, ResultPublisher
from edge.loop.result import Event, Sink, TickResult
from edge.loop.scoring.scorers import Scorers
from edge.loop.semantic_map import SemanticMap
from edge.loop.stages import (
    CANDIDATES,
    CHECK,
    INGEST,
    LIFT,
    MAP,
    PLAN,
    PUBLISH,
    SCORE,
    SELECT,
    STAGES,
)
from edge.loop.status import Part, PartsStatus
from edge.memory import START, Place, Site, SiteFile, known_objects
from edge.mission.destinations import RoomTarget
from edge.mission.run import MissionRun, forget_places
from edge.mission.spec import MissionSpec, task_state
from edge.mission.travel_cost import make_travel_cost_estimator
from edge.perception.masks.ground import GroundClassifier
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker
from edge.policies.base import Policy, PolicyInput
from edge.types import Goal, GoalStatus, MissionStatus, Observation

log = logging.getLogger("edge.loop.service")


class Service:
    """All stages between a source of observations and the sinks of results.

    Args:
        spec: First mission. The worker's detector already searches for its targets.
        worker: Runs the detector in the background; `submit` and `poll` never wait for the model.
        policy: Scores the candidates.
        sinks: Receive the results; their methods never block.
        checkpoint: Saves the state, and holds the state to restore.
        scorers: Models that are queried in the background; None if none is configured.
        calibration: Calibration of this computer; None: stages have deadlines only, no budgets.
        idle: Do not start the mission. The robot stands still until a mission is requested.
        input_log: Input log; None: a new one is made.
        site: Places and zones; None: those of this run only.
        ground: Names the kinds of ground in images for tasks (`tasks.ground`); None: all ground is
            of one kind.

    Attributes:
        config: The configuration.
        checkpoint: As in `Args`.
        map: Map, objects, rooms and candidates.
        latency: Duration of each stage in each tick.
        plausibility: Decides if observations may be used.
        site: Places and zones that people gave.
        control: Holds the running mission, and carries out requests of people about it.
        behaviour: Carries out the mission: searches for its targets, or follows a trajectory.
        ground: As in `Args`.
        goals: Tracks the goal that the robot is sent to.
        pose: Newest pose in `map`; None before the first.
        stamp_ns: Stamp of the newest observation that was not refused, on the sensors' clock.
        refused: True if the newest observation must not be used to drive.
        detector_swap: Swaps the detector's model.
        load_shedder: Drops expensive work under load, in the order of
            `perception.load_shedding.levels`. None without levels, and in lockstep, where runs must
            be reproducible.
        parts_status: Collects the status of all parts.
        outbox: Holds goals, goal statuses and events until the next result.
        publisher: Passes results to the sinks.
        error_boundary: Catches and counts the exceptions of stages, sinks and requests.
        perception: The stages from the detector to the scores; it has the policy and the scorers.
        stage: Index of the running stage, or of the stage whose error ended the tick.
    """

    def __init__(
        self,
        config: Config,
        spec: MissionSpec,
        worker: DetectorWorker,
        policy: Policy,
        sinks: Sequence[Sink],
        checkpoint: ServiceCheckpoint | None = None,
        scorers: Scorers | None = None,
        calibration: SpeedCalibration | None = None,
        idle: bool = False,
        input_log: InputLog | None = None,
        site: SiteFile | None = None,
        ground: GroundClassifier | None = None,
    ) -> None:
        self.config, self.ground = config, ground
        self._input_log = input_log = input_log or InputLog()
        self.outbox = Outbox()
        self.checkpoint = checkpoint
        self.map = SemanticMap(config, spec.prompts)
        self.site = site or SiteFile()
        self.map.set_site(self.site.site)
        self.latency = LatencyRing(calibration=calibration)
        send = self.outbox.goals.append
        self.goals = GoalTracker(config, self.map.pool, self.map.tracker, send, self.event)
        self.control = MissionControl(spec, config.mission, self.goals, input_log, self.event)
        self.stamp_ns = 0
        self._travel_costs = make_travel_cost_estimator(
            config.mission.planner, config.loop.lockstep
        )
        self.behaviour = _make_behaviour(self)
        for part in (self._travel_costs, self.map.room_surveyor, scorers):
            if part is not None:
                part.wrap_workers(input_log.wrap)
        self.error_boundary = ErrorBoundary(self.event)
        self.stage = INGEST
        self.detector_swap = DetectorSwap(config.perception, worker, self.event)
        self.load_shedder: LoadShedder | None = None
        if config.perception.load_shedding.levels and not config.loop.lockstep:
            self.load_shedder = LoadShedder(
                config.perception, worker, self.detector_swap, scorers, self.event
            )
        self.plausibility = Plausibility(config, self.event)
        parts: dict[str, Part | None] = {
            "checkpoint": checkpoint,
            "segmenter": worker.masker,
            "ground": ground,
            "swap": self.detector_swap,
            "load_shedding": self.load_shedder,
            "plausibility": self.plausibility,
        }
        self.parts_status = PartsStatus(
            worker, parts, scorers, self.error_boundary, self.event, sinks
        )
        self.publisher = ResultPublisher(
            sinks, self.outbox, self.map, self.site, self.goals, scorers, input_log,
            self.latency, self.parts_status.status,
        )  # fmt: skip
        self.perception = PerceptionStages(
            config, self.map, worker, policy, scorers, self.latency, input_log
        )
        self._zone_exit = ZoneExit(self.goals, self.event)
        self.pose: SE2 | None = None
        self._last_tick_ns = 0  # loop time of the last complete tick of the first camera
        self.refused = False
        if checkpoint is not None:
            checkpoint.resume(self.mission)
        if idle:
            self.mission.set_idle()
            self.goals.client.demand_hold()  # a controller may have a goal of a previous service
        saved, content = None, None
        if checkpoint is not None:
            saved, content = checkpoint.saved, checkpoint.map.loaded
        input_log.note(
            "start", translation=spec.translation, task=task_state(spec),
            mission_checkpoint=saved, map_checkpoint=content, idle=idle, site=self.site.site,
        )  # fmt: skip

    # -- the tick ---------------------------------------------------------------------------

    def tick(self, observation: Observation, now_ns: int) -> Goal | None:
        """Run all stages on one observation; return the goal that the robot drives to, or None.

        A tick that raises counts as no tick. If `refused` is True afterwards, the caller must call
        `idle`.

        Args:
            observation: The observation, held by its source until the tick returns.
            now_ns: Loop time, on the clock of the observation's stamp.
        """
        self._input_log.note("tick", now_ns=now_ns)
        self.stage = CHECK
        pose = self.pose = observation.pose
        self.perception.begin(observation)
        if self.site.start is None:
            self.site.start = Place(START, pose)
        if self.mission.destinations:
            self.mission.locate(self.site.start.pose, pose)
        use = self._check(observation, now_ns)
        self._end_stage(CHECK)
        self.refused = use != ""
        if not self.refused:
            self.stamp_ns = observation.stamp_ns
            self.perception.detect(observation)
        self.stage = MAP
        if not self.refused and self.checkpoint is not None:
            self._restore(self.checkpoint, StampedPose(pose, observation.stamp_ns, now_ns))
        if use != "none":
            update = self.perception.map(observation, now_ns)
            if update is not None:
                self.plausibility.on_mapped(update)
                if update.rolled:
                    self.perception.policy.reset("map rolled")
            self._end_stage(MAP)
        if self.refused:
            return self.goals.goal
        self.perception.lift(self.mission)
        self.map.infer(pose, now_ns)
        self._end_stage(LIFT)
        self.map.update_candidates(self.behaviour.target_objects(), observation, now_ns)
        self._end_stage(CANDIDATES)
        self.perception.ask_scorers(self.mission, observation)
        context = self.perception.score(self.mission, observation, now_ns)
        self._end_stage(SCORE)
        context = self._plan(context)
        self._end_stage(PLAN)
        goal = self._select(context)
        self._end_stage(SELECT)
        self.goals.send_pending(self.mission, pose, now_ns)
        self._report(observation, now_ns)
        self._end_stage(PUBLISH)
        if observation.camera_index == 0:
            self._last_tick_ns = now_ns
        return goal

    def _end_stage(self, stage: int) -> None:
        """End this stage and begin the next."""
        self.latency.mark(stage, perf_counter_ns())
        self.stage = (stage + 1) % len(STAGES)

    def _check(self, observation: Observation, now_ns: int) -> str:
        """Stage `check`: return the permitted use: "" all, "map" for the map only, "none" none."""
        decide_use = partial(self.plausibility.permitted_use, observation, now_ns)
        use = self._input_log.record_decision(USE, decide_use, usual="")
        if observation.camera_index:
            if now_ns - self._last_tick_ns > 1e9 * self.plausibility.blind_s:
                use = use or "map"  # the robot does not drive by its second camera alone
        elif use:
            # If the images are late or frozen, the ticks before this one were blind, too. So
            # `blind_s` counts from the last real picture of the surroundings.
            surroundings_ns = self._input_log.record_decision(
                SIGHTED, lambda: str(self.plausibility.meter.surroundings_ns)
            )
            self._last_tick_ns = min(self._last_tick_ns, int(surroundings_ns))
        return use

    def _restore(self, checkpoint: ServiceCheckpoint, last_pose: StampedPose) -> None:
        """Restore map and objects of a checkpoint, with the first observation."""
        saved = checkpoint.map
        if saved.waiting is None:
            return
        find_mismatch = partial(saved.frame_mismatch, last_pose)
        mismatch = self._input_log.record_decision(FRAME_DECISION, find_mismatch)
        if mismatch and checkpoint.is_resumed(self.mission):
            forget_places(self.mission, last_pose.now_ns)
        restored = saved.take(mismatch)
        if restored is None:
            return
        grid, loaded = restored
        resumed = checkpoint.is_resumed(self.mission, loaded.state.targets)
        with self.error_boundary.contain("restore", last_pose.now_ns):
            parts = MapParts(self.map, self.goals.chooser, self.perception.policy)
            restore(parts, grid, loaded, last_pose, resumed)
        with self.error_boundary.contain("restore pictures", last_pose.now_ns):
            checkpoint.crops.restore(self.map.crops)
        if resumed:
            mission, newest_room = self.mission, self.map.rooms.survey.next_id - 1
            is_room = {n: isinstance(d, RoomTarget) for n, d in mission.destinations.items()}
            mission.sets.mark_stale_before(
                {
                    label: newest_room if is_room.get(label) else self.map.tracker.newest_id
                    for label in mission.sets.failed
                }
            )
        else:
            self._reset_search()
        min_hits = self.config.perception.min_hits
        known = known_objects(self.map.objects.read_only, self.stamp_ns, min_hits)
        content = f"map ({self.map.grid.known_m2:.0f} m²) and {len(known)} objects"
        self.event(f"restored {content} from the checkpoint", last_pose.now_ns)

    def _plan(self, context: PolicyInput) -> PolicyInput:
        """Stage `plan`: count time, let the behaviour advance the mission, and check its limits.

        If the plan changed the active target, the candidates of the new target are scored at once.
        """
        mission, now_ns = self.mission, context.now_ns
        if not mission.started:
            mission.start(now_ns)
        mission.observe(context.pose, now_ns, self.behaviour.searching)
        self.behaviour.plan(context, self.perception.images)
        mission.check_limits(now_ns)
        if self.goals.follows(mission) or mission.done:
            return context
        self.goals.begin_target(mission)  # forgets the goal and the attempts of the last target
        self.map.update_candidates(self.behaviour.target_objects(), context.observation, now_ns)
        return self.perception.score(mission, context.observation, now_ns)

    def _select(self, context: PolicyInput) -> Goal | None:
        """Stage `select`: return the behaviour's goal, or None if no mission is active."""
        if not self.mission.active:
            self.goals.idle()
            return None
        if (exit_goal := self._zone_exit.goal(self.map.grid, self.mission, context)) is not None:
            return exit_goal
        return self.behaviour.select(context, self.perception.scores, self.perception.images)

    def _report(self, observation: Observation | None, now_ns: int) -> None:
        """Write the checkpoint and publish the result to the sinks."""
        try:
            self.parts_status.check(now_ns)
            if self.checkpoint is not None:
                last_pose = (
                    None if self.pose is None else StampedPose(self.pose, self.stamp_ns, now_ns)
                )
                with self.error_boundary.contain("checkpoint", now_ns):
                    parts = MapParts(self.map, self.goals.chooser, self.perception.policy)
                    self.checkpoint.save_if_due(self.mission, self.status, parts, last_pose, now_ns)
            self.publisher.publish(self.result(now_ns, observation), self.error_boundary)
        finally:
            self.perception.release()

    # -- requests and events from outside -----------------------------------------------------

    def begin(self, spec: MissionSpec, now_ns: int, id: str = "") -> None:
        """Replace the mission. Map and instances are kept.

        Raises:
            PromptError: The detector cannot search for a target. Nothing has changed then.
            ModelError: As `PromptError`.
        """
        mission = self.control.make_run(spec, self.config.mission, id)
        self.perception.worker.set_prompts(spec.prompts)
        self.control.replace(mission, now_ns)
        self.behaviour.close()
        self.behaviour = _make_behaviour(self)
        self._reset_search()
        self.perception.begin_mission()
        if self._travel_costs is not None:
            self._travel_costs.discard_pending()
        mission.start(now_ns)

    def _reset_search(self) -> None:
        """Forget what was examined and tried for the previous mission."""
        self.map.begin(self.mission.spec.prompts)
        self.perception.policy.reset("mission")
        self.goals.forget_mission()

    def reconfigure(
        self, config: Config, policy: Policy, ground: GroundClassifier | None = None
    ) -> None:
        """Use another configuration from the next tick on.

        Args:
            config: The new configuration. It differs only in keys of `edge.loop.reload.LIVE`, and
                its detector already runs.
            policy: Policy of this configuration; the current one if its settings did not change.
            ground: As `policy`, what names kinds of ground; None: all ground is of one kind.
        """
        self._input_log.note("config", config=config)
        self.config, self.perception.policy = config, policy
        self.ground = self.parts_status.parts["ground"] = ground
        self.map.reconfigure(config)
        self.detector_swap.perception = config.perception
        if self.load_shedder is not None:
            self.load_shedder.reconfigure(config.perception)
        self.mission.config = config.mission
        self.behaviour.reconfigure(config, ground)
        self.goals.reconfigure(config)
        if self.perception.scorers is not None:
            self.perception.scorers.value_source = config.value_source

    def change_site(self, site: Site, now_ns: int) -> None:
        """Replace places and zones; a zone closes cells from the next tick on."""
        self._input_log.note("site", site=site, now_ns=now_ns)
        self.site.change(site)
        self.map.set_site(site)

    def on_goal_status(self, status: GoalStatus) -> None:
        """Handle a goal status of the controller. A status for an old goal has no effect on it."""
        self._input_log.note("goal_status", goal_status=status)
        status = self.goals.client.with_sent_stamp(status)
        self.outbox.goal_statuses.append(status)
        self.goals.on_goal_status(status)

    def idle(self, now_ns: int, pose: SE2 | None, dropped: Observation | None = None) -> None:
        """Handle a loop cycle without a usable observation.

        The status is still published. The robot stands still after `blind_s`. The mission's time
        runs only after its first observation: a mission whose sensors fail must end, but a mission
        whose sensors have not started yet must not.

        Args:
            now_ns: Loop time.
            pose: Newest pose of the odometry; None before the first.
            dropped: An observation that was refused, or on which a stage failed. It is published
                as handled, because a simulator in lockstep waits for that.
        """
        blind_ns = 1e9 * self.plausibility.blind_s
        blind = self.pose is not None and now_ns - self._last_tick_ns > blind_ns
        if self.pose is not None and not blind:
            pose = None  # that of the newest observation is good enough
        self._input_log.note("idle", now_ns=now_ns, pose=pose)
        hold_at = self.pose if pose is None else pose
        if blind:
            self.pose = hold_at
        try:
            if self.mission.meter.running or dropped is not None:
                self.mission.observe(self.pose, now_ns, self.behaviour.searching and not blind)
            self.mission.check_limits(now_ns)
        finally:  # also if the mission raises
            if hold_at is not None and (blind or not self.mission.active):
                if self.goals.client.driving:
                    if self.mission.active:
                        why = self.plausibility.why("stand")
                        why = f"{why}: " if why else ""
                        self.event(f"no usable observations: {why}standing still", now_ns)
                    self.goals.hold_position(self.mission, hold_at, now_ns)
                self.goals.chooser.abandon()
            self._report(dropped, now_ns)

    def on_pose_jump(self, now_ns: int) -> None:
        """Handle a pose jump: drop map, instances and goals, which are in the old frame.

        Detections in older images are dropped too. The robot is sent a goal to stand still, unless
        the next tick finds a goal in the new frame.
        """
        self._input_log.note("jump", now_ns=now_ns)
        self.event("pose jumped: the map and the objects were cleared", now_ns)
        if not self.config.source.localised:
            self.site.start = None
            forget_places(self.mission, now_ns)
            if self.site.site.items:
                text = "pose jumped: places and zones were removed: they were in the old map frame"
                self.event(text, now_ns)
                self.site.change(Site())
                self.map.set_site(self.site.site)
        self.map.on_pose_jump()
        self.perception.policy.reset("pose")
        self.mission.sets.distance_m = None
        if self._travel_costs is not None:
            self._travel_costs.discard_pending()
        self.behaviour.on_pose_jump()
        self.goals.on_pose_jump()
        self.perception.on_pose_jump()
        if self.checkpoint is not None:
            self.checkpoint.map.on_pose_jump()

    def event(self, text: str, now_ns: int, level: int = logging.INFO) -> None:
        """Report an event, for people, to the log and the sinks."""
        log.log(level, text)
        self.outbox.events.append(Event(now_ns, text))

    def close(self) -> None:
        """Stop all background work. No tick may follow."""
        if self.load_shedder is not None:
            self.load_shedder.close()
        self.detector_swap.close()
        if self._travel_costs is not None:
            self._travel_costs.close()
        self.behaviour.close()
        self.map.close()

    # -- state for other modules --------------------------------------------------------------

    @property
    def mission(self) -> MissionRun:
        """The running mission, or the last one."""
        return self.control.mission

    @property
    def status(self) -> MissionStatus:
        return self.mission.status(self.goals.phase)

    def result(self, now_ns: int = 0, observation: Observation | None = None) -> TickResult:
        """Return the current state, and all events since the last published result."""
        return self.publisher.result(
            now_ns, self.stamp_ns, observation, self.pose, self.mission, self.behaviour.task_status,
            self.perception.detections, self.perception.scores,
        )  # fmt: skip


def _make_behaviour(service: Service) -> Behaviour:
    """Return what carries out the mission of a service."""
    parts = (service.mission, service.config, service.map, service.goals)
    if service.mission.spec.steps is None:
        return SearchBehaviour(*parts, service._travel_costs)
    return FollowBehaviour(*parts, service._input_log, service.ground)

"""The sensor loop: observations in, goals out.

`Service.tick` is one pass over the stage table of `edge/loop/stages.py`, top to bottom. It reads no
clock but to time itself: the same observations give the same goals.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache, partial
from time import perf_counter_ns

import numpy as np

from edge.config import Config
from edge.geometry import SE2, Grid
from edge.host.calibration import Calibration
from edge.loop import stages
from edge.loop.candidates import CandidatePool
from edge.loop.faults import Faults
from edge.loop.goal import GoalTracker
from edge.loop.journal import DETECTOR, ELSEWHERE, Journal
from edge.loop.keeper import Keeper
from edge.loop.latency import LatencyRing
from edge.loop.places import Now, Parts, restore
from edge.loop.prior import make_prior
from edge.loop.publish import Publisher
from edge.loop.result import Event, Sink, TickResult, facts_of, scored
from edge.loop.scorers import Scorers
from edge.loop.status import HealthWatch
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.mission.brief import Brief
from edge.mission.planning.surveyor import make_surveyor
from edge.mission.run import MissionRun
from edge.perception.instances import InstanceTracker
from edge.perception.lift import Lifter
from edge.perception.sightings import SightingTracker
from edge.perception.swap.swapper import Swapper
from edge.perception.worker import DetectorWorker
from edge.policies.base import Answers, Context, Policy, scores_of
from edge.types import Detections, Goal, GoalStatus, Instance, MissionStatus, Observation, Step

log = logging.getLogger("edge.loop.service")

INGEST, DETECT, MAP, LIFT, CANDIDATES, SCORE, PLAN, SELECT, PUBLISH = range(len(stages.STAGES))
NOTHING_CHANGED = (0, 0, 0, 0)
_PAST = 32
BLIND_S = 1.0  # no one drives on for longer, or three frames where they come less often


class Service:
    """Everything between a source of observations and the sinks of results.

    Args:
        brief: the mission to begin with; the worker's detector looks for its targets.
        worker: detects on the side; `submit` and `poll` never wait for the model.
        policy: scores the candidates.
        sinks: take the results; their methods never block.
        keeper: has the mission's state written, and what it read taken up again.
        scorers: models that are asked beside the loop, where any are configured.
        overruns: by what is listened to, how often more came than could be taken.
        calibration: of this computer, for the budgets; None: they are the reference computer's.
        idle: the mission is not begun: the robot stands until one is asked for.
        journal: notes what comes in from beside the loop.

    Attributes:
        mission: the one under way, or the last one.
        past: what became of those before it that had a name, JSON-ready, oldest first.
        goals: what the robot is sent to, and what becomes of it.
        pose: the newest in `map`; None before there was any.
        stamp_ns: of the newest observation, on the sensors' clock.
        swapper: puts another model in the place of the worker's.
        blind_s: so long without an observation no one drives on.
        overruns: by what is listened to, how often more came than could be taken.
        faults: what stages, sinks and requests raised, and the loop outlived.
        stage: the one at work in a tick, or whose error ended it.
        epoch: counts the frames that the map was in.
    """

    def __init__(
        self,
        config: Config,
        brief: Brief,
        worker: DetectorWorker,
        policy: Policy,
        sinks: Sequence[Sink],
        keeper: Keeper | None = None,
        scorers: Scorers | None = None,
        overruns: Callable[[], dict[str, int]] = dict,
        calibration: Calibration | None = None,
        idle: bool = False,
        journal: Journal | None = None,
    ) -> None:
        self.config = config
        self._journal = journal = journal or Journal()
        self.keeper, self.overruns = keeper, overruns
        self.grid = RollingMap(config.mapping)
        self._seen_map = MapView(self.grid)
        self.sightings = SightingTracker(config.perception)
        self.tracker = InstanceTracker(config.perception, self.sightings)
        self.mission = MissionRun(brief, config.mission, self._step_taken)
        self.policy = policy
        self.pool = CandidatePool(
            config.mapping.max_frontiers + config.perception.max_instances,
            config.policy.r_assoc_m,
        )
        self.latency = LatencyRing(calibration=calibration)
        self._publisher = Publisher(sinks)
        self.goals = GoalTracker(config, self.pool, self.tracker, self._tell, self.event)
        self.epoch = 0
        self.stamp_ns = 0
        self._surveyor = make_surveyor(config.mission.planner, config.loop.lockstep)
        self._prior = make_prior(config)
        for part in (self._surveyor, self._prior, scorers):
            if part is not None:
                part.through(journal.beside)
        self.faults = Faults(self.event)
        self.stage = INGEST
        self._worker = journal.beside(DETECTOR, worker)
        self._scorers = scorers
        self.swapper = Swapper(config.perception, worker, self.event)
        self._health = HealthWatch(
            worker, self.swapper, scorers, keeper, self.faults, overruns, self.event, sinks
        )
        self._lifter = Lifter(config.perception)
        self._changed = NOTHING_CHANGED
        self._detections: Detections | None = None  # of this tick, as what follows
        self._context: Context | None = None
        self.scores = np.zeros(0, np.float32)
        self.pose: SE2 | None = None
        self._looked_ns = 0  # when the last observation was dealt with
        self._images = 0  # that were looked for things in, as of this tick
        self.blind_s = max(BLIND_S, 3.0 / config.observed_hz)
        self._newest_seq = self._void_seq = -1
        self.past: deque[dict[str, str]] = deque(maxlen=_PAST)
        if keeper is not None:
            keeper.resume(self.mission)
        if idle:
            self.mission.wait()
            self.goals.driving = True  # a controller may have a goal of a service before this one
        saved, places = (None, None) if keeper is None else (keeper.saved, keeper.places.read)
        journal.note("start", translation=brief.translation, saved=saved, places=places, idle=idle)
        self._keep_values()

    # -- the tick ---------------------------------------------------------------------------

    def tick(self, observation: Observation, now_ns: int) -> Goal | None:
        """One pass over all stages.

        Args:
            observation: held by its source until the tick returns.
            now_ns: the loop's time, on the clock of the observation's stamp.

        Returns:
            The goal now being driven to, or None.

        A tick that raises is as good as none: no one has looked.
        """
        self._journal.note("tick", now_ns=now_ns)
        self.stage = DETECT
        pose = self.pose = observation.pose
        self.stamp_ns = observation.stamp_ns
        self._newest_seq = observation.seq
        self._worker.submit(observation)
        # In lockstep the model runs inside `submit`; that time is `detect`'s, not the tick's.
        self.latency.resume(perf_counter_ns())

        self.stage = MAP
        if self.keeper is not None:
            self._take_up(self.keeper, Now(pose, observation.stamp_ns, now_ns))
        self._map(observation, pose, now_ns)
        self._lap(MAP)
        self._lift(self._worker.poll(), now_ns)
        self._images = self._worker.stats.done
        self._journal.note("images", done=self._images)
        if self._prior is not None:
            self._prior.step(self._seen_map, self.sightings.shown, now_ns)
        self._lap(LIFT)
        self._gather(observation, now_ns)
        self._lap(CANDIDATES)
        if self._scorers is not None:
            self._consult(self._scorers, observation)
        self._score(observation, now_ns)
        self._lap(SCORE)
        self._plan(observation, now_ns)
        self._lap(PLAN)
        goal = self._select()
        self._lap(SELECT)
        self._publish(observation, now_ns)
        self._lap(PUBLISH)
        self._looked_ns = now_ns
        return goal

    def _lap(self, stage: int) -> None:
        """This stage is done, the next begins."""
        self.latency.mark(stage, perf_counter_ns())
        self.stage = (stage + 1) % len(stages.STAGES)

    def _take_up(self, keeper: Keeper, now: Now) -> None:
        """What was mapped and seen before a restart, with the first observation."""
        places = keeper.places
        if places.waiting is None:
            return
        found = places.take(self._journal.decided(ELSEWHERE, partial(places.why_elsewhere, now)))
        if found is None:
            return
        self.grid, kept = found
        self._seen_map = MapView(self.grid)
        goes_on = keeper.goes_on(self.mission, kept["about/targets"].tolist())
        with self.faults.outlived("restore", now.now_ns):
            restore(self._parts, kept, now, goes_on)
        if goes_on:
            self.mission.overlook(self.tracker.newest_id)
        else:
            self._forget_tried()
        self._keep_values()
        known = f"{self.grid.known_m2:.0f} m2 and {len(self.tracker)} things"
        self.event(f"taken up from before the restart: {known}", now.now_ns)

    def _map(self, observation: Observation, pose: SE2, now_ns: int) -> None:
        """Stage 3: fold the depth image or cloud into the map."""
        update = None
        self.grid.bumps.expire(now_ns)
        if self.config.mapping.input == "cloud":
            if observation.cloud_m is not None:
                T = observation.T_map_base @ observation.T_base_lidar
                update = self.grid.update_cloud(observation.cloud_m, T, pose)
        elif observation.depth_m is not None and observation.camera is not None:
            T = observation.T_map_base @ observation.T_base_camera
            update = self.grid.update_depth(observation.depth_m, observation.camera, T, pose)
        self._changed = NOTHING_CHANGED if update is None else update.changed
        if update is not None and update.rolled:
            self.policy.reset("map rolled")
        self.grid.reach.step(pose)

    def _lift(self, detections: Detections | None, now_ns: int) -> None:
        """Stage 4: boxes become instances, with the depth and pose they were seen with."""
        self._detections = None
        if detections is None:
            return
        try:
            void = detections.observation.seq <= self._void_seq
            if not void and detections.prompts == self.mission.brief.targets:
                self._take(detections, now_ns)
        finally:
            # Only this tick reads the arrays; the frame may be used again.
            detections.observation.release()

    def _take(self, detections: Detections, now_ns: int) -> None:
        """Detections of what is looked for, in the map that there is."""
        self.latency.span(DETECT, detections.latency_ns)
        if self._scorers is not None:
            self._scorers.saw(detections, self.grid.values)
        lifted, around = self._lifter.lift(detections)
        self.sightings.look(lifted, around)
        self.tracker.update(lifted, detections.observation.stamp_ns)
        self.tracker.expire(detections.observation, detections.prompts)
        perception = self.config.perception
        self.grid.coverage.look(
            detections.observation, perception.confirm_range_m, perception.confirm_hits
        )
        self._detections = detections.without_rivals()
        self._publisher.saw(self._detections)

    def _instances(self) -> list[Instance]:
        """What stage 5 takes as instance candidates."""
        if self.mission.done:
            return []
        sure = not self.config.policy.instances
        return self.tracker.of(self.mission.target, sure, doubted=self.goals.searched)

    def _gather(self, observation: Observation, now_ns: int) -> None:
        """Stage 5: frontiers, and instances of the active target."""
        self.pool.update(self.grid.frontiers, self._instances(), observation.stamp_ns, now_ns)
        self.pool.measure(self.grid)
        policy, camera = self.config.policy, observation.camera
        if policy.look_round and camera is not None:
            self.pool.add_look(
                self.grid, observation.pose, camera.hfov_rad, policy.turn_m_per_rad, now_ns
            )

    def _consult(self, scorers: Scorers, observation: Observation) -> None:
        """What stage 6 may go by besides detections: answers there are, and the next questions."""
        mission = self.mission
        if not (mission.done or mission.paused):
            targets, candidates = mission.brief.targets, self.pool.candidates
            scorers.ask(
                observation, targets, mission.target, candidates, self.tracker, self.grid.values,
                self._prior, self.sightings.shown,
            )  # fmt: skip
        scorers.take_up(self.grid.values)
        if self.config.loop.lockstep:  # the models ran inside `ask`, beside the tick's time
            self.latency.resume(perf_counter_ns())

    def _score(self, observation: Observation, now_ns: int) -> None:
        """Stage 6: what the policy makes of the candidates, by all that it may go by."""
        self._context = Context(
            observation,
            observation.pose,
            self._seen_map,
            self._changed,
            self.pool.shown,
            self._detections,
            Answers() if self._scorers is None else self._scorers.answers,
            self.mission.brief.targets,
            self.mission.target,
            now_ns,
            self.sightings.shown,
            self._prior,
        )
        self.scores = scores_of(self.policy, self._context)

    def _plan(self, observation: Observation, now_ns: int) -> None:
        """Stage 7: what was seen, the robot's arrival, or its failure to arrive, means."""
        mission, pose = self.mission, observation.pose
        if not mission.started:
            mission.start(now_ns)
        mission.observe(pose, now_ns)
        mission.see(self._newest_ids(), now_ns)
        if self._surveyor is not None:
            self._surveyor.step(mission, self.grid, self.tracker, pose, now_ns)
        if self.goals.follows(mission) and not (mission.done or mission.paused):
            self.goals.judge(self.grid, pose, mission, self._images, now_ns)
            if self.goals.exhausted:
                mission.give_up(self.goals.why_in_vain(mission, self.grid), now_ns)
        mission.check_limits(now_ns)
        if not (self.goals.follows(mission) or mission.done):
            self._turn(observation, now_ns)

    def _newest_ids(self) -> dict[str, int]:
        """For each target of which an instance is known, the highest id of them."""
        sure, targets = not self.config.policy.instances, self.mission.brief.targets
        known = {label: self.tracker.of(label, sure) for label in targets}
        return {label: max(i.id for i in found) for label, found in known.items() if found}

    def _turn(self, observation: Observation, now_ns: int) -> None:
        """The plan set out for a target: choose among its candidates, by its scores, at once."""
        self.goals.set_out(self.mission)
        self._gather(observation, now_ns)
        self._score(observation, now_ns)

    def _select(self) -> Goal | None:
        """Stage 8: algorithm 2, or nowhere when the mission is over or paused."""
        if self.mission.done or self.mission.paused:
            self.goals.rest()
            return None
        return self.goals.choose(self._context, self.grid, self.scores, self._images)

    def _publish(self, observation: Observation, now_ns: int) -> None:
        """Stage 9: hand results to the sinks, which never block."""
        self.goals.tell(self.mission, observation.pose, now_ns)
        self._report(observation, now_ns)

    def _report(self, observation: Observation | None, now_ns: int) -> None:
        """Write the checkpoint, and tell the sinks."""
        try:
            self._health.look(now_ns)
            self._keep(now_ns)
            result = self.result(now_ns, observation)
            self._journal.pending.clear()
            self._publisher.publish(result, self.faults)
        finally:
            self._publisher.let_go()

    def _keep(self, now_ns: int) -> None:
        """Have the checkpoint written, where there is to be one."""
        if self.keeper is not None:
            now = None if self.pose is None else Now(self.pose, self.stamp_ns, now_ns)
            with self.faults.outlived("checkpoint", now_ns):
                self.keeper.note(self.mission, self.status, self._parts, now, now_ns)

    @property
    def _parts(self) -> Parts:
        return Parts(
            self.config, self.grid, self.sightings, self.tracker, self.pool, self.goals, self.policy
        )

    def _tell(self, goal: Goal) -> None:
        self._publisher.goals.append(goal)

    # -- what comes from outside --------------------------------------------------------------

    def begin(self, brief: Brief, now_ns: int, id: str = "") -> None:
        """Put another mission in the place of the present one; map and instances stay.

        Args:
            id: see `MissionRun.id`.

        Raises:
            PlannerError: its automaton is too large for the configured planner.
            PromptError, ModelError: the detector cannot look for one of its targets.

        Nothing has changed when it raises.
        """
        mission = MissionRun(brief, self.config.mission, self._step_taken, id)
        self._worker.set_prompts(brief.targets)
        self._remember(self.mission)
        self._journal.note("mission", translation=brief.translation, id=id, now_ns=now_ns)
        self.mission = mission
        self._keep_values()
        self._forget_tried()
        self._detections = None
        if self._surveyor is not None:
            self._surveyor.forget()
        if self._scorers is not None:
            self._scorers.forget()
        self.mission.start(now_ns)

    def _remember(self, mission: MissionRun) -> None:
        if mission.id:
            status = mission.status(self.goals.phase)
            over = (status.phase, status.reason) if mission.done else ("failed", "replaced")
            self.past.append({"id": mission.id, "phase": over[0], "reason": over[1]})

    def _forget_tried(self) -> None:
        """The mission is another than the one for which things were looked at, and tried."""
        self.tracker.forget_verdicts()
        self.tracker.recall(self.mission.brief.targets)
        self.grid.coverage.forget()
        self.policy.reset("mission")
        self.goals.forget_mission()

    def reconfigure(self, config: Config, policy: Policy) -> None:
        """Go by another configuration from the next tick on.

        Args:
            config: differs from the present one in what `edge.loop.reload.LIVE` names only; its
                detector runs already.
            policy: of this configuration; the present one where its settings are the same.
        """
        self._journal.note("config", config=config)
        if config.value_source != self.config.value_source:
            self.grid.values.begin(())  # what another scorer said means something else
        self.config, self.policy = config, policy
        self.tracker.config = self.sightings.config = self._lifter.config = config.perception
        self.swapper.perception = config.perception
        self.mission.config = config.mission
        self.pool.r_assoc_m = config.policy.r_assoc_m
        self.goals.reconfigure(config)
        if self._scorers is not None:
            self._scorers.feeds = config.value_source
        self._keep_values()

    def pause(self, paused: bool, now_ns: int) -> None:
        """Have the robot stand where it is, or go on."""
        if paused == self.mission.paused:  # who asks a hundred times a second is told of once
            return
        self.mission.pause(paused)
        self._journal.note("pause", paused=paused, now_ns=now_ns)
        self.event(f"mission: {'paused' if paused else 'resumed'}", now_ns)

    def fail(self, reason: str, now_ns: int) -> None:
        """End the mission."""
        self._journal.note("fail", reason=reason, now_ns=now_ns)
        self.mission.fail(reason, now_ns)

    def goal_answered(self, answer: GoalStatus) -> None:
        """The controller said something about a goal; answers to old goals are void."""
        self._journal.note("answer", answer=answer)
        self._publisher.answers.append(answer)
        self.goals.answered(answer)

    def idle(self, now_ns: int, pose: SE2 | None, dropped: Observation | None = None) -> None:
        """No observation came: limits still hold, status still goes out, no one drives blind.

        Args:
            pose: from the newest odometry; None before there was any.
            dropped: the observation that a stage failed on, if one came. It is dealt with, which
                a simulator in lockstep waits to hear.
        """
        blind = self.pose is not None and now_ns - self._looked_ns > 1e9 * self.blind_s
        if blind and pose is not None:
            self.pose = pose
        self._journal.note("idle", now_ns=now_ns, pose=pose if blind else None)
        looking = self.pose is not None and not blind
        try:
            self.mission.observe(self.pose, now_ns, looking)
            self.mission.check_limits(now_ns)
        finally:  # whatever is the matter with the mission
            if self.pose is not None and (self.mission.done or self.mission.paused or blind):
                self._stand(self.pose, now_ns)
            self._report(dropped, now_ns)

    def _stand(self, pose: SE2, now_ns: int) -> None:
        if self.goals.driving:
            if not (self.mission.done or self.mission.paused):
                self.event("nothing to be seen: standing still", now_ns)
            self.goals.stand(self.mission, pose, now_ns)
        self.goals.drop()

    def forget_places(self, now_ns: int) -> None:
        """The pose jumped: map, instances and goals of the old frame mean nothing now.

        What the detector still finds in images of before is void as well. The robot is told to
        stand, unless the next tick finds a goal in the new frame.
        """
        self._journal.note("jump", now_ns=now_ns)
        self.event("pose jumped: map and instances dropped", now_ns)
        self.epoch += 1
        self.grid = RollingMap(self.config.mapping)
        self._seen_map = MapView(self.grid)
        self._context = None
        self._keep_values()
        self.tracker.clear()
        self.sightings.clear()
        self.pool.clear()
        self.policy.reset("pose")
        self.mission.forget_distances()
        if self._surveyor is not None:
            self._surveyor.forget()
        if self._prior is not None:
            self._prior.forget()
        if self._scorers is not None:
            self._scorers.forget()
        self.goals.forget_places()
        self._void_seq = self._newest_seq
        if self.keeper is not None:
            self.keeper.places.jumped()

    def event(self, text: str, now_ns: int) -> None:
        """Tell log and sinks of something that a person would want to know."""
        log.info(text)
        self._publisher.events.append(Event(now_ns, text))

    def close(self) -> None:
        """No tick comes any more."""
        self.swapper.close()
        if self._surveyor is not None:
            self._surveyor.close()
        if self._prior is not None:
            self._prior.close()

    def _keep_values(self) -> None:
        """A value map for each target, where a scorer is to write them."""
        if self.config.value_source is not None:
            self.grid.values.begin(self.mission.brief.targets)

    # -- what others may ask ------------------------------------------------------------------

    def _step_taken(self, step: Step) -> None:
        self.event(step.text, step.stamp_ns)

    @property
    def goal(self) -> Goal | None:
        """Where the robot is sent; None: nowhere."""
        return self.goals.goal

    @property
    def scorers(self) -> Scorers | None:
        return self._scorers

    @property
    def status(self) -> MissionStatus:
        return self.mission.status(self.goals.phase)

    def result(self, now_ns: int = 0, observation: Observation | None = None) -> TickResult:
        """How all stands, and what has happened since the sinks were told.

        Args:
            now_ns: the loop's time, where the loop asks.
            observation: what was dealt with, if anything.
        """
        goals, grid, news = self.goals, self.grid, self._publisher
        targets = self.mission.brief.targets
        return TickResult(
            now_ns=now_ns,
            observation=observation,
            pose=self.pose,
            status=self.status,
            goal=self.goal,
            answer=goals.answer,
            controlled=goals.heard,
            targets=targets,
            goals=tuple(news.goals),
            answers=tuple(news.answers),
            events=tuple(news.events),
            inputs=tuple(self._journal.pending),
            detections=news.detections,
            mission=cache(partial(facts_of, self.mission)),
            instances=cache(
                lambda: [found.copied() for label in targets for found in self.tracker.of(label)]
            ),
            frontiers=cache(lambda: grid.frontiers.xy_m[: grid.frontiers.n].copy()),
            candidates=cache(partial(scored, self.pool.candidates, self.scores)),
            way=cache(self._way),
            choice=None if self._scorers is None else self._scorers.answers.choice,
            known_m2=lambda: grid.known_m2,
            snapshot=grid.snapshot,
            layers=self._layers,
            latency=self.latency.report,
            spans=self.latency.spans,
            health=self._health.status,
        )

    def _way(self) -> np.ndarray:
        """See `TickResult.way`."""
        if self.goal is None:
            return np.zeros((0, 2), np.float32)
        return self.grid.reach.way_m(self.goal.pose.x_m, self.goal.pose.y_m)

    def _layers(self) -> dict[str, Callable[[], Grid]]:
        """See `TickResult.layers`."""
        valued = self.mission.brief.targets if self.config.value_source is not None else ()
        values, coverage = self.grid.values, self.grid.coverage
        of_targets = {f"value of {target}": partial(values.snapshot, target) for target in valued}
        if self._prior is not None and not self.mission.idle:
            layer = self._prior.layer
            of_targets |= {f"likely place of {x}": layer(x) for x in self.mission.brief.targets}
        return {"looked at": coverage.snapshot, **of_targets}

"""The sensor loop: observations in, goals out.

`Service.tick` is one pass over the stage table of `edge/loop/stages.py`, top to bottom. It reads no
clock but to time itself: the same observations give the same goals.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter_ns

import numpy as np

from edge.config import Config
from edge.geometry import SE2
from edge.host.calibration import Calibration
from edge.loop import stages
from edge.loop.checkpoint import ServiceCheckpoint
from edge.loop.faults import Faults
from edge.loop.goal import GoalTracker
from edge.loop.governor import Governor
from edge.loop.journal import DETECTOR, ELSEWHERE, SIGHTED, USE, Journal
from edge.loop.latency import LatencyRing
from edge.loop.map_checkpoint import Parts, Sighted, restore
from edge.loop.plausibility import Plausibility
from edge.loop.publish import Publisher
from edge.loop.result import Event, Sink, TickResult
from edge.loop.scorers import Scorers
from edge.loop.semantic_map import SemanticMap
from edge.loop.source import InputRow
from edge.loop.status import HealthWatch
from edge.loop.task import TaskRun
from edge.mission.brief import Brief, task_of
from edge.mission.planning.surveyor import make_surveyor
from edge.mission.run import MissionRun
from edge.perception.swap.swapper import Swapper
from edge.perception.worker import DetectorWorker
from edge.policies.base import Answers, Context, Policy, scores_of
from edge.types import Detections, Goal, GoalStatus, Instance, MissionStatus, Observation, Step

log = logging.getLogger("edge.loop.service")

INGEST, CHECK, DETECT, MAP, LIFT, CANDIDATES, SCORE, PLAN, SELECT, PUBLISH = range(
    len(stages.STAGES)
)
NOTHING_CHANGED = (0, 0, 0, 0)
_PAST = 32


class Service:
    """Everything between a source of observations and the sinks of results.

    Args:
        brief: the mission to begin with; the worker's detector looks for its targets.
        worker: detects on the side; `submit` and `poll` never wait for the model.
        policy: scores the candidates.
        sinks: take the results; their methods never block.
        checkpoint: saves the state, and holds what is to be restored.
        scorers: models that are asked beside the loop, where any are configured.
        overruns: by what is listened to, how often more came than could be taken.
        calibration: of this computer, for the budgets; None: they are the reference computer's.
        idle: the mission is not begun: the robot stands until one is asked for.
        journal: notes what comes in from beside the loop.
        inputs: the source's table of inputs, for any thread; empty where it has none.

    Attributes:
        map: all that is known of the surroundings.
        mission: the one under way, or the last one.
        task: how the mission comes to a trajectory, and along it; None: it is no task.
        past: what became of those before it that had a name, JSON-ready, oldest first.
        goals: what the robot is sent to, and what becomes of it.
        pose: the newest in `map`; None before there was any.
        stamp_ns: of the newest observation that was not refused, on the sensors' clock.
        plausibility: judges observations, and says which checks fail.
        refused: whether the newest observation shows nothing to drive by.
        swapper: puts another model in the place of the worker's.
        governor: gives up what is dear when the computer cannot keep up, where a ladder says what;
            not in lockstep, where runs replay the same.
        blind_s: so long without an observation no one drives on.
        overruns: by what is listened to, how often more came than could be taken.
        inputs: what each input of the source brings.
        faults: what stages, sinks and requests raised, and the loop outlived.
        stage: the one at work in a tick, or whose error ended it.
    """

    def __init__(
        self,
        config: Config,
        brief: Brief,
        worker: DetectorWorker,
        policy: Policy,
        sinks: Sequence[Sink],
        checkpoint: ServiceCheckpoint | None = None,
        scorers: Scorers | None = None,
        overruns: Callable[[], dict[str, int]] = dict,
        calibration: Calibration | None = None,
        idle: bool = False,
        journal: Journal | None = None,
        inputs: Callable[[], Sequence[InputRow]] = tuple,
    ) -> None:
        self.config = config
        self._journal = journal = journal or Journal()
        self.checkpoint, self.overruns, self.inputs = checkpoint, overruns, inputs
        self.map = SemanticMap(config, brief.targets)
        self.mission = MissionRun(brief, config.mission, self._step_taken)
        self.task = self._task_of(self.mission)
        self.policy = policy
        self.latency = LatencyRing(calibration=calibration)
        self.goals = GoalTracker(config, self.map.pool, self.map.tracker, self._sent, self.event)
        self.stamp_ns = 0
        self._surveyor = make_surveyor(config.mission.planner, config.loop.lockstep)
        for part in (self._surveyor, self.map.prior, scorers):
            if part is not None:
                part.through(journal.beside)
        self.faults = Faults(self.event)
        self.stage = INGEST
        self._worker = journal.beside(DETECTOR, worker)
        self._scorers = scorers
        self.swapper = Swapper(config.perception, worker, self.event)
        self.governor: Governor | None = None
        if config.perception.governor.ladder and not config.loop.lockstep:
            self.governor = Governor(config.perception, worker, self.swapper, scorers, self.event)
        self.blind_s = max(config.loop.blind_s, 3.0 / config.observed_hz)
        self.plausibility = Plausibility(config, self.blind_s, self.event)
        self._health = HealthWatch(
            worker, self.swapper, scorers, checkpoint, self.faults, overruns, self._governed,
            self.event, sinks, inputs, self.plausibility.status,
        )  # fmt: skip
        self._publisher = Publisher(
            sinks, self.map, self.goals, scorers, journal, self.latency, self._health.status
        )
        self._changed = NOTHING_CHANGED
        self._detections: Detections | None = None  # of this tick, as what follows
        self._context: Context | None = None
        self.scores = np.zeros(0, np.float32)
        self.pose: SE2 | None = None
        self._looked_ns = 0  # when the last observation was dealt with
        self._images = 0  # that were looked for things in, as of this tick
        self._newest_seq = self._void_seq = -1
        self.refused = False
        self.past: deque[dict[str, str]] = deque(maxlen=_PAST)
        if checkpoint is not None:
            checkpoint.resume(self.mission)
        if idle:
            self.mission.wait()
            # A controller may have a goal of a service before this one.
            self.goals.client.driving = True
        saved, known = None, None
        if checkpoint is not None:
            saved, known = checkpoint.saved, checkpoint.map.loaded
        journal.note(
            "start", translation=brief.translation, task=task_of(brief), saved=saved, places=known,
            idle=idle,
        )  # fmt: skip

    # -- the tick ---------------------------------------------------------------------------

    def tick(self, observation: Observation, now_ns: int) -> Goal | None:
        """One pass over all stages.

        Args:
            observation: held by its source until the tick returns.
            now_ns: the loop's time, on the clock of the observation's stamp.

        Returns:
            The goal now being driven to, or None.

        A tick that raises is as good as none: no one has looked. After one whose observation was
        `refused` the caller calls `idle`.
        """
        self._journal.note("tick", now_ns=now_ns)
        self.stage = CHECK
        pose = self.pose = observation.pose
        self._newest_seq = observation.seq
        judge = partial(self.plausibility.judge, observation, now_ns)
        use = self._journal.decided(USE, judge, usual="")
        self._lap(CHECK)
        self.refused = use != ""
        if self.refused:
            sighted = self._journal.decided(SIGHTED, lambda: str(self.plausibility.sighted_ns))
            self._looked_ns = min(self._looked_ns, int(sighted))
            if use == "map":
                self.stage = MAP
                self._map(observation, now_ns)
                self._lap(MAP)
            return self.goals.goal
        self.stamp_ns = observation.stamp_ns
        self._worker.submit(observation)
        # In lockstep the model runs inside `submit`; that time is `detect`'s, not the tick's.
        self.latency.resume(perf_counter_ns())

        self.stage = MAP
        if self.checkpoint is not None:
            self._restore(self.checkpoint, Sighted(pose, observation.stamp_ns, now_ns))
        self._map(observation, now_ns)
        self._lap(MAP)
        self._lift(self._worker.poll(), now_ns)
        self._images = self._worker.stats.done
        self._journal.note("images", done=self._images)
        self.map.infer(now_ns)
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

    def _restore(self, checkpoint: ServiceCheckpoint, sighted: Sighted) -> None:
        """Restore what was mapped and seen before a restart, with the first observation."""
        saved = checkpoint.map
        if saved.waiting is None:
            return
        why = partial(saved.why_elsewhere, sighted)
        found = saved.take(self._journal.decided(ELSEWHERE, why))
        if found is None:
            return
        grid, loaded = found
        goes_on = checkpoint.goes_on(self.mission, loaded.state.targets)
        with self.faults.outlived("restore", sighted.now_ns):
            restore(self._parts, grid, loaded, sighted, goes_on)
        if goes_on:
            self.mission.overlook(self.map.tracker.newest_id)
        else:
            self._forget_tried()
        known = f"map ({self.map.grid.known_m2:.0f} m²) and {len(self.map.tracker)} objects"
        self.event(f"restored {known} from the checkpoint", sighted.now_ns)

    def _map(self, observation: Observation, now_ns: int) -> None:
        """Stage 3: fold the depth image or cloud into the map."""
        update = self.map.update(observation, now_ns)
        self._changed = NOTHING_CHANGED if update is None else update.changed
        if update is None:
            return
        self.plausibility.on_mapped(update)
        if update.rolled:
            self.policy.reset("map rolled")

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
            self._scorers.saw(detections, self.map.grid.values)
        self.map.look(detections)
        self._detections = detections.without_rivals()
        self._publisher.saw(self._detections)

    def _gather(self, observation: Observation, now_ns: int) -> None:
        """Stage 5: frontiers, and instances of the active target, or those that a task may mean."""
        instances: list[Instance] = []
        if self.task is not None:
            instances = self.task.unsure(self.map.tracker)
        elif not self.mission.done:
            target, sure = self.mission.target, not self.config.policy.instances
            instances = self.map.tracker.of(target, sure, doubted=self.goals.searched)
        self.map.gather(instances, observation, now_ns)

    def _consult(self, scorers: Scorers, observation: Observation) -> None:
        """What stage 6 may go by besides detections: answers there are, and the next questions."""
        mission, here = self.mission, self.map
        if not (mission.done or mission.paused):
            targets, candidates = mission.brief.targets, here.pool.candidates
            scorers.ask(
                observation, targets, mission.target, candidates, here.tracker, here.grid.values,
                here.prior, here.sightings.shown,
            )  # fmt: skip
        scorers.take_up(here.grid.values, idle=mission.done)
        if self.config.loop.lockstep:  # the models ran inside `ask`, beside the tick's time
            self.latency.resume(perf_counter_ns())

    def _score(self, observation: Observation, now_ns: int) -> None:
        """Stage 6: what the policy makes of the candidates, by all that it may go by."""
        self._context = Context(
            observation,
            observation.pose,
            self.map.view,
            self._changed,
            self.map.pool.shown,
            self._detections,
            Answers() if self._scorers is None else self._scorers.answers,
            self.mission.brief.targets,
            self.mission.target,
            now_ns,
            self.map.sightings.shown,
            self.map.prior,
        )
        self.scores = scores_of(self.policy, self._context)

    def _plan(self, observation: Observation, now_ns: int) -> None:
        """Stage 7: what was seen, the robot's arrival, or its failure to arrive, means."""
        mission, task, pose = self.mission, self.task, observation.pose
        if not mission.started:
            mission.start(now_ns)
        mission.observe(pose, now_ns, self._looking)
        # What is driven past may get out of sight, and is not looked for again.
        mission.see(self._newest_ids(), now_ns, keep=task is not None and task.phase != "looking")
        if self._surveyor is not None and task is None:
            here = self.map
            self._surveyor.step(mission, here.grid, here.tracker, pose, now_ns)
        if self.goals.follows(mission) and not (mission.done or mission.paused):
            stuck = self.goals.judge(self.map.grid, pose, mission, self._images, now_ns)
            if task is not None:
                task.step(self.map, self.goals, observation, self._detections, stuck, now_ns)
            if self.goals.exhausted and (task is None or task.missed):
                mission.give_up(self.goals.why_in_vain(mission, self.map.grid), now_ns)
        mission.check_limits(now_ns)
        if not (self.goals.follows(mission) or mission.done):
            self._turn(observation, now_ns)

    @property
    def _looking(self) -> bool:
        """Whether the active target is searched for: a task that is driven searches for none."""
        return self.task is None or self.task.looking

    def _newest_ids(self) -> dict[str, int]:
        """For each target of which an instance is known, the highest id of them."""
        sure, targets = not self.config.policy.instances, self.mission.brief.targets
        doubted = self.task is None  # nothing makes sure of what a trajectory is written about
        known = {label: self.map.tracker.of(label, sure, doubted) for label in targets}
        return {label: max(i.id for i in found) for label, found in known.items() if found}

    def _turn(self, observation: Observation, now_ns: int) -> None:
        """The plan set out for a target: choose among its candidates, by its scores, at once."""
        self.goals.set_out(self.mission)
        self._gather(observation, now_ns)
        self._score(observation, now_ns)

    def _select(self) -> Goal | None:
        """Stage 8: algorithm 2, along a task's trajectory, or nowhere when the mission is over or
        paused."""
        if self.mission.done or self.mission.paused:
            self.goals.rest()
            return None
        if self.task is not None and not self.task.looking:
            self.task.lead(self.goals, self._context.pose, self._context.now_ns)
            return self.goals.goal
        return self.goals.choose(self._context, self.map.grid, self.scores, self._images)

    def _publish(self, observation: Observation, now_ns: int) -> None:
        """Stage 9: hand results to the sinks, which never block."""
        self.goals.tell(self.mission, observation.pose, now_ns)
        self._report(observation, now_ns)

    def _report(self, observation: Observation | None, now_ns: int) -> None:
        """Write the checkpoint, and tell the sinks."""
        try:
            self._health.look(now_ns)
            self._keep(now_ns)
            self._publisher.publish(self.result(now_ns, observation), self.faults)
        finally:
            self._publisher.let_go()

    def _keep(self, now_ns: int) -> None:
        """Have the checkpoint written, where there is to be one."""
        if self.checkpoint is not None:
            sighted = None if self.pose is None else Sighted(self.pose, self.stamp_ns, now_ns)
            with self.faults.outlived("checkpoint", now_ns):
                self.checkpoint.note(self.mission, self.status, self._parts, sighted, now_ns)

    @property
    def _parts(self) -> Parts:
        return Parts(self.map, self.goals, self.policy)

    # -- what comes from outside --------------------------------------------------------------

    def begin(self, brief: Brief, now_ns: int, id: str = "") -> None:
        """Put another mission in the place of the present one; map and instances stay.

        Args:
            id: see `MissionRun.id`.

        Raises:
            PromptError, ModelError: the detector cannot look for one of its targets.

        Nothing has changed when it raises.
        """
        mission = MissionRun(brief, self.config.mission, self._step_taken, id)
        self._worker.set_prompts(brief.targets)
        self._remember(self.mission)
        self._journal.note(
            "mission", translation=brief.translation, task=task_of(brief), id=id, now_ns=now_ns
        )
        self.mission = mission
        if self.task is not None:
            self.task.close()
        self.task = self._task_of(mission)
        self._forget_tried()
        self._detections = None
        self._forget_asked()
        self.mission.start(now_ns)

    def _task_of(self, mission: MissionRun) -> TaskRun | None:
        if mission.brief.steps is None:
            return None
        return TaskRun(mission, self.config, self._journal)

    def _remember(self, mission: MissionRun) -> None:
        if mission.id:
            status = mission.status(self.goals.phase)
            over = (status.phase, status.reason) if mission.done else ("failed", "replaced")
            self.past.append({"id": mission.id, "phase": over[0], "reason": over[1]})

    def _forget_tried(self) -> None:
        """The mission is another than the one for which things were looked at, and tried."""
        self.map.begin(self.mission.brief.targets)
        self.policy.reset("mission")
        self.goals.forget_mission()

    def _forget_asked(self) -> None:
        """The map or the mission is another: what is being worked out for the last one is void."""
        for beside in (self._surveyor, self._scorers):
            if beside is not None:
                beside.forget()

    def reconfigure(self, config: Config, policy: Policy) -> None:
        """Go by another configuration from the next tick on.

        Args:
            config: differs from the present one in what `edge.loop.reload.LIVE` names only; its
                detector runs already.
            policy: of this configuration; the present one where its settings are the same.
        """
        self._journal.note("config", config=config)
        self.config, self.policy = config, policy
        self.map.reconfigure(config)
        self.swapper.perception = config.perception
        if self.governor is not None:
            self.governor.reconfigure(config.perception)
        self.mission.config = config.mission
        if self.task is not None:
            self.task.config = config
        self.goals.reconfigure(config)
        if self._scorers is not None:
            self._scorers.feeds = config.value_source

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
        answer = self.goals.client.matched(answer)
        self._publisher.answers.append(answer)
        self.goals.answered(answer)

    def idle(self, now_ns: int, pose: SE2 | None, dropped: Observation | None = None) -> None:
        """Handle a beat without an observation: the status still goes out, no one drives blind.

        The mission's time runs on, but only from its first observation on: a mission whose sensors
        have gone must end, one whose sensors are yet to come must not.

        Args:
            pose: from the newest odometry; None before there was any.
            dropped: the observation that was refused, or a stage failed on. It is dealt with, which
                a simulator in lockstep waits to hear.
        """
        blind = self.pose is not None and now_ns - self._looked_ns > 1e9 * self.blind_s
        if blind and pose is not None:
            self.pose = pose
        self._journal.note("idle", now_ns=now_ns, pose=pose if blind else None)
        try:
            if self.mission.observed or dropped is not None:
                self.mission.observe(self.pose, now_ns, self._looking and not blind)
            self.mission.check_limits(now_ns)
        finally:  # whatever is the matter with the mission
            if self.pose is not None and (self.mission.done or self.mission.paused or blind):
                self._stand(self.pose, now_ns)
            self._report(dropped, now_ns)

    def _stand(self, pose: SE2, now_ns: int) -> None:
        if self.goals.client.driving:
            if not (self.mission.done or self.mission.paused):
                why = self.plausibility.why("stand")
                self.event(f"nothing to be seen: {why and f'{why}: '}standing still", now_ns)
            self.goals.stand(self.mission, pose, now_ns)
        self.goals.drop()

    def forget_places(self, now_ns: int) -> None:
        """The pose jumped: map, instances and goals of the old frame mean nothing now.

        What the detector still finds in images of before is void as well. The robot is told to
        stand, unless the next tick finds a goal in the new frame.
        """
        self._journal.note("jump", now_ns=now_ns)
        self.event("pose jumped: map and instances dropped", now_ns)
        self._context = None
        self.map.forget()
        self.policy.reset("pose")
        self.mission.forget_distances()
        self._forget_asked()
        if self.task is not None:
            self.task.forget()
        self.goals.forget_places()
        self._void_seq = self._newest_seq
        if self.checkpoint is not None:
            self.checkpoint.map.jumped()

    def event(self, text: str, now_ns: int, level: int = logging.INFO) -> None:
        """Tell log and sinks of something that a person would want to know.

        Args:
            level: of the log's line.
        """
        log.log(level, text)
        self._publisher.events.append(Event(now_ns, text))

    def _step_taken(self, step: Step) -> None:
        self.event(step.text, step.stamp_ns)

    def _sent(self, goal: Goal) -> None:
        self._publisher.goals.append(goal)

    def close(self) -> None:
        """No tick comes any more."""
        if self.governor is not None:
            self.governor.close()
        self.swapper.close()
        if self._surveyor is not None:
            self._surveyor.close()
        if self.task is not None:
            self.task.close()
        self.map.close()

    def _governed(self) -> dict[str, object] | None:
        return None if self.governor is None else self.governor.status()

    # -- what others may ask ------------------------------------------------------------------

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
        task = (lambda: None) if self.task is None else self.task.facts
        return self._publisher.result(
            now_ns, observation, self.pose, self.mission, task, self.scores
        )

"""A task under way: what it names is looked for, its trajectory is written, refined and driven.

Writing and refining take from a tenth of a second to minutes, so they are done beside the loop; the
robot stands meanwhile. A trajectory means something in the frame in which it was written, and from
where the robot stood then: where the pose jumps, and after a restart, a new one is written.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from edge.config import Config, Tasks, WriterModel
from edge.errors import UserError
from edge.geometry import SE2
from edge.host.worker import Worker
from edge.loop.goal import GoalTracker
from edge.loop.journal import TASK, Journal
from edge.loop.semantic_map import SemanticMap
from edge.mapping.view import MapView
from edge.mission.language.words import TranslationError
from edge.mission.run import MissionRun
from edge.motion.pursuit import MotionLimits, index_ahead
from edge.tasks.facts import TaskFacts, TaskPhase
from edge.tasks.follow import blocked_ahead_m, goal_ahead
from edge.tasks.objects import ObjectMap
from edge.tasks.prompt import prompt, words
from edge.tasks.refine import Refined, refine, refine_again
from edge.tasks.scene import Scene
from edge.tasks.survey import add_found, scene_of_map
from edge.tasks.value_map import Body
from edge.tasks.write import Round, write
from edge.text import one_line
from edge.types import Detections, Instance, Observation

log = logging.getLogger("edge.loop.task")

AHEAD_M = 1.5
"""How far the goal moves ahead of the robot, and `APART_M` from where it was before it is sent."""
APART_M = 0.3
LOOK_NS = 500_000_000
"""How often the path ahead is looked at."""
AGAIN_NS = 2_000_000_000
"""How often it is tried to write a trajectory that what was seen so far did not allow."""
TURNS = 3
"""On the spot, in which a model's robot comes round once before the trajectory is written."""
SAME_PLACE_M = 0.5
"""A robot that is held up twice within this distance is not helped by the same trajectory."""
NEARER_M = 0.15
"""Getting less near to a thing is not worth starting again."""
_REASON_CHARS = 300


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """What came of writing or refining, beside the loop.

    Attributes:
        refined: the trajectory; None: there is none, and `error` says why in one line.
        hopeless: whatever else comes to be known, there will be none.
        coarse_m: (n, 2) float64 in `map`, as it was written; None: it was not.
        speed_mps: that was asked for; None: none was.
        stops_at: see `edge.tasks.write.Written`.
        understood, prompt, rounds: see `edge.tasks.facts.TaskFacts`.
    """

    refined: Refined | None = None
    error: str = ""
    hopeless: bool = False
    coarse_m: np.ndarray | None = None
    speed_mps: float | None = None
    stops_at: int | None = None
    understood: str = ""
    prompt: str = ""
    rounds: tuple[Round, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """A picture with boxes, whose frame is held, for an object map."""

    found: Detections
    objects: ObjectMap
    range_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _Order:
    """What the worker is to do, with all that it needs: the loop goes on.

    Attributes:
        before: what was written before; its trajectory is to be refined again, from `index` on.
            None: one has to be written.
        why: another one has to be written; "" where it is the first.
        nearer_to: the thing that the robot stopped at, which may be got nearer to on the map that
            there is by now; None: it is under way.
        rounds: a model's, as they end.
    """

    config: Config
    instruction: str
    view: MapView
    observation: Observation
    instances: Sequence[Instance]
    objects: ObjectMap
    found: Detections | None
    before: Draft | None = None
    index: int = 0
    why: str = ""
    nearer_to: int | None = None
    rounds: list[Round] = field(default_factory=list)


class TaskRun:
    """One task, from what it names to the end of its trajectory; for one thread, the loop's.

    Args:
        mission: that it is; it keeps time, limits and the story.
        journal: notes what the worker was asked, and what it found.

    Attributes:
        config: for what is begun next; may be set.
        phase: what is done now.
    """

    def __init__(self, mission: MissionRun, config: Config, journal: Journal) -> None:
        self.config = config
        self._mission = mission
        self._side: Worker[_Look | _Order, Draft] = Worker(
            "task", _done, inline=config.loop.lockstep, drop=_let_go
        )
        self._worker: Any = journal.beside(TASK, self._side)
        self._begin()

    def _begin(self) -> None:
        self.phase: TaskPhase = "looking"
        self._turns = TURNS if self._by_model else 0
        self._turning: SE2 | None = None
        self._draft = Draft()
        self._objects = ObjectMap()  # the worker's
        self._index = self._refinements = 0
        self._order: _Order | None = None  # that the worker is at
        self._why = ""  # a trajectory before this one could not be driven on
        self._refused = ""  # why none can be written from what was seen so far
        self._all_seen = False
        self._held_up_at: SE2 | None = None
        self._looked_ns = 0

    @property
    def _by_model(self) -> bool:
        return isinstance(self.config.tasks.planner, WriterModel)

    @property
    def missing(self) -> tuple[str, ...]:
        """What it names and has to be seen yet."""
        return self._mission.plan.steps if self.phase == "looking" else ()

    @property
    def looking(self) -> bool:
        """Whether the robot searches, as for a mission's target: for what it names, or for ground
        that a trajectory can lead over."""
        return self.phase == "looking" and bool(self.missing or self._refused)

    # -- in each tick -----------------------------------------------------------------------

    def step(
        self,
        map: SemanticMap,
        goals: GoalTracker,
        observation: Observation,
        detections: Detections | None,
        stuck: bool,
        now_ns: int,
    ) -> None:
        """What has become of the task; what takes long is begun beside the loop.

        Args:
            detections: that came in this tick, with the picture that a model is shown.
            stuck: the robot was to drive and stands still.
        """
        pose = observation.pose
        if detections is not None:
            self._see(detections)
        if (draft := self._worker.poll()) is not None and self._order is not None:
            self._take(draft, self._order, now_ns)
        if self._refused and self.phase == "looking" and not self.missing:
            self._look_on(map, goals, observation, now_ns)
        elif self.phase == "looking" and not self.missing:
            self._look_round(goals, pose, stuck)
        if self.phase == "writing" and self._order is None and not self._mission.done:
            if not self._by_model:
                self._ask(map, observation, None)
            elif detections is not None:  # with the picture that the boxes are in
                self._ask(map, detections.observation, detections)
        elif self.phase == "driving":
            self._drive(map, goals, observation, stuck, now_ns)

    def lead(self, goals: GoalTracker, pose: SE2, now_ns: int) -> None:
        """Where the robot goes now, in place of a candidate: on the trajectory, or to stand."""
        refined = self._draft.refined
        if self.phase == "driving" and refined is not None:
            ahead, self._index = goal_ahead(refined, pose, AHEAD_M, self._index)
            apart_m = 0.0 if _is_end(ahead, refined) else APART_M
            goals.lead(ahead, self._mission, now_ns, apart_m)
        elif self._turning is not None:
            goals.lead(self._turning, self._mission, now_ns, 0.0)
        else:
            goals.rest()

    def forget(self) -> None:
        """The frame is another: what was written means nothing in it."""
        self._worker.forget()
        self._begin()

    def close(self) -> None:
        """Nobody waits any more for what is under way."""
        self._worker.forget()
        self._worker.stop()

    def facts(self) -> TaskFacts:
        """See `edge.loop.result.TickResult.task`."""
        mission, draft, planner = self._mission, self._draft, self.config.tasks.planner
        outcome = mission.status("searching").phase
        return TaskFacts(
            instruction=mission.brief.translation.instruction,
            phase=outcome if outcome in ("reached", "failed") else self.phase,
            writer=f"{planner.model} at {planner.url}" if self._by_model else planner.kind,
            missing=self.missing,
            understood=draft.understood,
            prompt=draft.prompt,
            rounds=draft.rounds if self._order is None else tuple(self._order.rounds),
            coarse_m=draft.coarse_m,
            refined=draft.refined,
            index=self._index,
            refinements=self._refinements,
            notes=() if draft.refined is None else draft.refined.notes,
        )

    # -- inside -----------------------------------------------------------------------------

    def _look_round(self, goals: GoalTracker, pose: SE2, stuck: bool) -> None:
        """All that has to be seen was seen; before a model writes, the robot turns once."""
        answer = goals.answer
        ended = answer is not None and answer.state in ("reached", "failed")
        if self._turning is not None and not (stuck or ended):
            return
        if self._turns:
            self._turns -= 1
            self._turning = SE2(pose.x_m, pose.y_m, pose.yaw_rad + math.tau / TURNS)
        else:
            self._turning, self.phase = None, "writing"

    def _look_on(
        self, map: SemanticMap, goals: GoalTracker, observation: Observation, now_ns: int
    ) -> None:
        """Try again now and then while the map grows, and once it does no more."""
        if self._order is not None:
            return
        if self._all_seen:
            self._mission.fail(_line(self._refused), now_ns)
        elif goals.exhausted or now_ns - self._looked_ns >= AGAIN_NS:
            self._looked_ns, self._all_seen = now_ns, goals.exhausted
            self._ask(map, observation, None)

    def _see(self, found: Detections) -> None:
        """What the targets look like all round is gathered beside the loop."""
        perception, seen = self.config.perception, found.observation
        found = found.above(perception.tau_det)
        ranged = seen.depth_m is not None or seen.cloud_m is not None
        if len(found) and ranged and seen.camera is not None:
            seen.hold()
            self._side.submit(_Look(found, self._objects, perception.lift_max_range_m), _Look)

    def _ask(
        self,
        map: SemanticMap,
        seen: Observation,
        found: Detections | None,
        before: Draft | None = None,
        nearer_to: int | None = None,
    ) -> None:
        """Have a trajectory written, or `before`'s refined again; see `_Order`.

        A copy of the picture costs less than a frame that is held while a model is asked.
        """
        pictured = self._by_model and before is None and seen.rgb is not None
        rgb = seen.rgb.copy() if pictured else None
        still = replace(seen, rgb=rgb, depth_m=None, cloud_m=None, slot=None)
        instances = {
            one.id: one.copied()
            for label in self._mission.brief.targets
            for one in map.tracker.of(label, doubted=False)
        }
        if not self._refused:
            self.phase = "writing"
        self._order = _Order(
            self.config,
            self._mission.brief.translation.instruction,
            map.view,
            still,
            tuple(instances.values()),
            self._objects,
            None if found is None else replace(found, observation=still),
            before,
            self._index,
            self._why,
            nearer_to,
        )
        self._worker.submit(self._order)

    def _take(self, draft: Draft, order: _Order, now_ns: int) -> None:
        """Drive what was found; where nothing was, have another written, or give up."""
        mission, self._order = self._mission, None
        for n, said in enumerate(draft.rounds, start=1):
            if said.error and order.before is None:
                mission.tell(_line(f"answer {n} of the model: {said.error}"), now_ns)
        if draft.refined is not None:
            if order.nearer_to is not None:  # the task's trajectory is still the one before
                draft = replace(self._draft, refined=draft.refined, stops_at=None)
            self._draft, self._index, self._looked_ns = draft, 0, 0
            self._refinements += 1
            self.phase, self._refused = "driving", ""
            mission.tell(_line(_told(draft, order)), now_ns)
        elif order.nearer_to is not None:
            mission.complete("driven to its end", now_ns)
        elif order.before is not None:
            self._write_again(draft.error, now_ns)
        elif not (draft.hopeless or self._why or self._by_model):
            if not self._refused:
                mission.tell(_line(f"{draft.error}: looking further"), now_ns)
            self.phase, self._refused, self._looked_ns = "looking", draft.error, now_ns
        else:
            self._draft = draft
            after = f"{self._why}; written again: " if self._why else ""
            mission.fail(_line(f"{after}{draft.error}"), now_ns)

    def _drive(
        self,
        map: SemanticMap,
        goals: GoalTracker,
        observation: Observation,
        stuck: bool,
        now_ns: int,
    ) -> None:
        """See whether the robot is there, and whether it can go on."""
        refined, goal, answer = self._draft.refined, goals.goal, goals.answer
        assert refined is not None
        pose, state = observation.pose, None if answer is None else answer.state
        if state == "reached" and goal is not None and _is_end(goal.pose, refined):
            if (thing := self._draft.stops_at) is None:
                self._mission.complete("driven to its end", now_ns)
            else:
                self._ask(map, observation, None, nearer_to=thing)
        elif state == "reached":
            # Where the path doubles back, the robot is as near to a part of it that lies behind.
            self._index = index_ahead(refined.poses[:, :2], self._index, AHEAD_M)
        elif stuck or state == "failed":
            why = "the robot is held up"
            if not stuck:
                why = f"the controller failed: {answer.reason}"
            before, self._held_up_at = self._held_up_at, pose
            if before is not None and pose.distance_to(before.x_m, before.y_m) < SAME_PLACE_M:
                self._write_again(why, now_ns)
            else:
                self._refine_again(why, map, observation, now_ns)
        elif now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            away_m = blocked_ahead_m(refined, map.view, self._index)
            if away_m is not None:
                why = f"something is in the way, {away_m:.1f} m ahead"
                self._refine_again(why, map, observation, now_ns)

    def _refine_again(
        self, why: str, map: SemanticMap, observation: Observation, now_ns: int
    ) -> None:
        self._mission.tell(_line(f"{why}: the rest is refined again"), now_ns)
        self._ask(map, observation, None, self._draft)

    def _write_again(self, why: str, now_ns: int) -> None:
        """Once; who is asked for the same again and again helps no one."""
        if self._why:
            self._mission.fail(_line(why), now_ns)
            return
        self.phase, self._why = "writing", why
        self._mission.tell(_line(f"{why}: written again from here"), now_ns)


def _is_end(pose: SE2, refined: Refined) -> bool:
    x_m, y_m, _, yaw_rad = refined.poses[-1].tolist()
    return pose == SE2(x_m, y_m, yaw_rad)


def _told(draft: Draft, order: _Order) -> str:
    """A trajectory, for the story."""
    refined = draft.refined
    length_m = float(np.hypot(*np.diff(refined.poses[:, :2], axis=0).T).sum())
    what = draft.understood or "written by the model"
    if order.before is not None:
        what = "refined again"
    elif order.nearer_to is not None:
        what = "nearer to where it ends"
    notes = "".join(f"; {note}" for note in refined.notes)
    return f"trajectory of {length_m:.1f} m: {what}{notes}"


def _line(text: str) -> str:
    return one_line(text, _REASON_CHARS)


# -- beside the loop ------------------------------------------------------------------------------


def _done(order: _Look | _Order) -> Draft | None:
    """What comes of an order, whatever goes wrong: a task waits for it."""
    if isinstance(order, _Look):
        try:
            add_found(order.objects, order.found, order.range_m)
        finally:
            _let_go(order)
        return None
    try:
        if order.nearer_to is not None:
            return _nearer(order, order.nearer_to)
        return _refined(order) if order.before is not None else _written(order)
    except UserError as error:
        return Draft(error=str(error), hopeless=isinstance(error, TranslationError))
    except Exception as error:
        log.exception("writing a trajectory")
        return Draft(error=f"a fault of edge itself: {type(error).__name__}: {error}")


def _let_go(item: _Look | _Order) -> None:
    if isinstance(item, _Look):
        item.found.observation.release()


def _written(order: _Order) -> Draft:
    config, scene = order.config, _scene(order)
    limits, instruction = _tasks(config).trajectory, order.instruction
    told = ""
    if isinstance(config.tasks.planner, WriterModel):
        told = f"{prompt()}\n\n{words(instruction, scene, limits, order.why)}"
    draft = Draft(prompt=told)
    try:
        written = write(instruction, scene, _tasks(config), order.rounds.append, order.why)
        coarse = written.coarse
        draft = replace(
            draft, coarse_m=coarse.points_m, speed_mps=coarse.speed_mps,
            understood=written.understood, stops_at=written.stops_at,
        )  # fmt: skip
        refined = refine(
            scene, coarse.segments, coarse.regions, _body(config), _limits(config, draft),
            heading_rad=coarse.heading_rad,
        )  # fmt: skip
    except UserError as error:
        hopeless = isinstance(error, TranslationError)
        return replace(draft, error=str(error), hopeless=hopeless, rounds=tuple(order.rounds))
    return replace(draft, refined=refined, rounds=tuple(order.rounds))


def _refined(order: _Order) -> Draft:
    config, before = order.config, order.before
    limits = _limits(config, before)
    refined = refine_again(_scene(order), before.refined, order.index, _body(config), limits)
    return replace(before, refined=refined)


def _nearer(order: _Order, thing: int) -> Draft:
    """The rest of the way to a thing that was far off, or hidden, when the trajectory was written;
    none where that is hardly any."""
    draft = _written(replace(order, instruction=f"go to object {thing}"))
    if draft.refined is None:
        return draft
    points_m = _scene(order).objects[thing].points_m[:, :2]
    pose, end_m = order.observation.pose, draft.refined.poses[-1, :2]
    gaps_m = [float(np.hypot(*(points_m - at).T).min()) for at in ((pose.x_m, pose.y_m), end_m)]
    if gaps_m[0] - gaps_m[1] < NEARER_M:
        return Draft()
    return draft


def _scene(order: _Order) -> Scene:
    radius_m = _body(order.config).clearance_m
    return scene_of_map(
        order.view, order.observation, order.instances, radius_m, order.found, seen=order.objects
    )


def _tasks(config: Config) -> Tasks:
    """No nearer to anything than the map inflates it by: there, the way counts as blocked."""
    tasks, trajectory = config.tasks, config.tasks.trajectory
    clearance_m = max(trajectory.clearance_m, config.mapping.inflation_m)
    trajectory = trajectory.model_copy(update={"clearance_m": clearance_m})
    return tasks.model_copy(update={"trajectory": trajectory})


def _body(config: Config) -> Body:
    return Body(_tasks(config).trajectory.clearance_m)


def _limits(config: Config, draft: Draft) -> MotionLimits:
    limits = MotionLimits.of(config.robot)
    asked_mps = limits.speed_mps if draft.speed_mps is None else draft.speed_mps
    return replace(limits, speed_mps=min(asked_mps, limits.speed_mps))

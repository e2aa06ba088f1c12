"""A task under way: what it names is looked for, its trajectory is written, refined and driven.

As many of its steps as can be written are driven; what a later one names is looked for as they are,
and searched for once nothing more can be driven. Writing and refining take from a tenth of a second
to minutes, so they are done in the background (`draft.py`); the robot stands meanwhile. A
trajectory means something in the frame in which it was written, and from where the robot stood
then: where the pose jumps, and after a restart, a new one is written for the steps that are left.
It is written about things that may have been seen from far off only, so what it stops at is made
sure of from there, as a mission's target is; what is none after all is left, and another is looked
for.
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
from edge.loop.behaviours.draft import AGAIN_M, Draft, Look, Order, carried_out, let_go, told
from edge.loop.behaviours.search import newest_ids
from edge.loop.goal import MIN_IMAGES, GoalTracker
from edge.loop.journal import TASK, Journal
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.mission.task_step import TaskStep
from edge.policies.base import Context
from edge.tasks.facts import StepFacts, StepState, TaskFacts, TaskPhase
from edge.tasks.follow import blocked_ahead_m, end_of, goal_ahead, index_at_goal, leg_end
from edge.tasks.objects import ObjectMap
from edge.tasks.refine import Refined
from edge.text import one_line
from edge.types import Detections, Goal, Instance, Observation

AHEAD_M = 1.5
"""How far the goal moves ahead of the robot, and `APART_M` from where it was before it is sent."""
APART_M = 0.3
LOOK_NS = 500_000_000
"""How often the path ahead is looked at."""
AGAIN_NS = 2_000_000_000
"""How often it is tried to write a trajectory that what was seen so far did not allow."""
TURNS = 3
"""On the spot, in which a model's robot comes round once before the trajectory is written."""
FACING_RAD = math.radians(25.0)
"""The robot looks at a thing that lies no farther off the direction that it faces."""
SAME_PLACE_M = 0.5
"""A robot that is held up twice within this distance is not helped by the same trajectory."""
_REASON_CHARS = 300


class FollowBehaviour:
    """One task, from what it names to the end of its trajectory; for one thread, the loop's.

    Args:
        mission: keeps time, limits and the log of steps.
        journal: records what the worker found.

    Attributes:
        phase: what is done now.
    """

    def __init__(
        self,
        mission: MissionRun,
        config: Config,
        here: SemanticMap,
        goals: GoalTracker,
        journal: Journal,
    ) -> None:
        self._config = config
        self._mission, self._map, self._goals = mission, here, goals
        self._side: Worker[Look | Order, Draft] = Worker(
            "task", carried_out, inline=config.loop.lockstep, drop=let_go
        )
        self._worker: Any = journal.beside(TASK, self._side)
        self._objects = ObjectMap()  # the worker's
        self._begin()

    def _begin(self) -> None:
        """With the first step that was not driven."""
        self.phase: TaskPhase = "looking"
        self._turns = TURNS if self._by_model else 0
        self._turning: SE2 | None = None
        self._draft = Draft()
        self._index = self._refinements = 0
        self._order: Order | None = None  # that the worker is at
        self._why = ""  # a trajectory before this one could not be driven on
        self._refused = ""  # why none can be written from what was seen so far
        self._unsure: tuple[int, ...] = ()  # instances of which it may be any
        self._all_seen = False
        self._held_up_at: SE2 | None = None
        self._looked_ns = 0
        self._sure = self._mission.state  # at the stops of so many steps were the things named
        self._halt: tuple[int, int] | None = None  # the next stop: its step, the index of its pose
        self._unproven: list[tuple[int, str]] = []  # things of the stop that the robot is at
        self._proven: set[int] = set()  # instances that were found to be the others
        self._images = 0  # since it looks at the first of them, from `_stopped_ns` on
        self._stopped_ns = 0

    @property
    def _by_model(self) -> bool:
        return isinstance(self._config.tasks.planner, WriterModel)

    @property
    def missing(self) -> tuple[str, ...]:
        """What the steps that were not driven name, and has to be seen yet."""
        return self._mission.plan.steps

    @property
    def missed(self) -> bool:
        """Whether nothing more can be driven before something is seen that it names."""
        return self.phase == "looking" and not self._ends

    @property
    def searching(self) -> bool:
        """Whether the robot searches, as for a mission's target: for what it names, or for ground
        that a trajectory can lead over."""
        return self.missed or (self.phase == "looking" and bool(self._refused))

    @property
    def _steps(self) -> tuple[TaskStep, ...]:
        return self._mission.brief.steps or ()

    @property
    def _ends(self) -> tuple[int, ...]:
        """Up to how many steps a trajectory may be written now, the most first."""
        steps, unseen, first = self._steps, set(self.missing), self._mission.state
        if self._by_model:
            return (len(steps),)
        named = (n for n in range(first, len(steps)) if not unseen.isdisjoint(steps[n].names))
        ready = range(next(named, len(steps)), first, -1)
        return tuple(n for n in ready if n == len(steps) or not steps[n].joined)

    # -- in each tick -----------------------------------------------------------------------

    def gather(self) -> Sequence[Instance]:
        """Return the objects of which one was named, and that are not confirmed yet."""
        found = [self._map.tracker.get(number) for number in self._unsure]
        return [one for one in found if one is not None and one.state == "seen"]

    def plan(self, context: Context, images: int) -> None:
        """Advance the task; start in the background what takes long."""
        mission, goals, now_ns = self._mission, self._goals, context.now_ns
        targets, sure = mission.brief.targets, not self._config.policy.instances
        # What is driven past may get out of sight, and is not looked for again.
        seen = newest_ids(self._map.tracker, targets, sure, doubted=False)
        mission.see(seen, now_ns, keep=self.phase != "looking")
        if not (goals.follows(mission) and mission.active):
            return
        stuck = goals.judge(self._map.grid, context.pose, mission, images, now_ns)
        self._step(context, stuck)
        if goals.exhausted and self.missed:
            mission.give_up(goals.why_in_vain(mission, self._map.grid), now_ns)

    def select(self, context: Context, scores: np.ndarray, images: int) -> Goal | None:
        """Choose by score while something is looked for; else move the goal along the path."""
        if self.searching:
            return self._goals.choose(context, self._map.grid, scores, images)
        self._lead(context.pose, context.now_ns)
        return self._goals.goal

    def _step(self, context: Context, stuck: bool) -> None:
        """Take one step of the present phase.

        Args:
            stuck: the robot was to drive and stands still.
        """
        observation, detections = context.observation, context.detections
        pose, now_ns = context.pose, context.now_ns
        if detections is not None:
            self._see(detections)
            self._images += 1
        if (draft := self._worker.poll()) is not None and self._order is not None:
            self._take(draft, self._order, now_ns)
        if self.phase == "looking" and not self.missed and not self._mission.done:
            if self._refused:
                self._look_on(observation, now_ns)
            else:
                self._look_round(pose, stuck)
        if self.phase == "writing" and self._order is None and not self._mission.done:
            if not self._by_model:
                self._ask(observation, None)
            elif detections is not None:  # with the picture that the boxes are in
                self._ask(detections.observation, detections)
        elif self.phase == "driving":
            self._drive(observation, stuck, now_ns)
        elif self.phase == "verifying" and not self._mission.done:
            self._verify(pose, stuck, now_ns)

    def _lead(self, pose: SE2, now_ns: int) -> None:
        """Where the robot goes now, in place of a candidate: on the trajectory, or to stand."""
        refined = self._draft.refined
        if self.phase == "driving" and refined is not None:
            until = None if self._halt is None else self._halt[1]
            ahead, self._index = goal_ahead(refined, pose, AHEAD_M, self._index, until)
            ends = (leg_end(refined, self._index), len(refined.poses) - 1)
            exact = any(
                _is_at(ahead, refined, end) for end in ends if until is None or end <= until
            )
            apart_m = 0.0 if exact else APART_M
            self._goals.lead(ahead, self._mission, now_ns, apart_m)
        elif self._turning is not None:
            self._goals.lead(self._turning, self._mission, now_ns, 0.0)
        else:
            self._goals.rest()

    def reconfigure(self, config: Config) -> None:
        self._config = config

    def forget(self) -> None:
        """The frame is another: what was written means nothing in it."""
        self._worker.forget()
        self._objects = ObjectMap()
        self._begin()

    def close(self) -> None:
        """Nobody waits any more for what is under way."""
        self._worker.forget()
        self._worker.stop()

    def facts(self) -> TaskFacts:
        """See `edge.loop.result.TickResult.task`."""
        mission, draft, planner = self._mission, self._draft, self._config.tasks.planner
        outcome = mission.status("searching").phase
        return TaskFacts(
            instruction=mission.brief.translation.instruction,
            phase=outcome if outcome in ("reached", "failed") else self.phase,
            writer=f"{planner.model} at {planner.url}" if planner.kind == "model" else planner.kind,
            missing=self.missing,
            understood=draft.understood,
            prompt=draft.prompt,
            rounds=draft.rounds if self._order is None else tuple(self._order.rounds),
            coarse_m=draft.coarse_m,
            refined=draft.refined,
            index=self._index,
            refinements=self._refinements,
            notes=() if draft.refined is None else draft.refined.notes,
            steps=tuple(self.steps()),
        )

    def steps(self) -> Iterator[StepFacts]:
        """How each step stands; any thread may ask."""
        mission, order, missing = self._mission, self._order, set(self.missing)
        upto = self._draft.upto if order is None else order.ends[0]
        for n, step in enumerate(self._steps):
            state: StepState
            if n < mission.state:
                state = "driven"
            elif mission.done:
                state = "not driven"
            elif n < upto and self.phase != "looking":
                state = "under way"
            else:
                state = "to come" if missing.isdisjoint(step.names) else "looked for"
            yield StepFacts(step.said, state)

    # -- inside -----------------------------------------------------------------------------

    def _look_round(self, pose: SE2, stuck: bool) -> None:
        """All that has to be seen was seen; before a model writes, the robot turns once."""
        answer = self._goals.answer
        ended = answer is not None and answer.state in ("reached", "failed")
        if self._turning is not None and not (stuck or ended):
            return
        if self._turns:
            self._turns -= 1
            self._turning = SE2(pose.x_m, pose.y_m, pose.yaw_rad + math.tau / TURNS)
        else:
            self._turning, self.phase = None, "writing"

    def _look_on(self, observation: Observation, now_ns: int) -> None:
        """Try again now and then while the map grows, and once it does no more."""
        if self._order is not None:
            return
        if self._all_seen:
            self._mission.fail(_line(self._refused), now_ns)
            return
        settled = self._unsure and not self.gather()
        if settled or self._goals.exhausted or now_ns - self._looked_ns >= AGAIN_NS:
            self._looked_ns, self._all_seen = now_ns, self._goals.exhausted
            self._ask(observation, None)

    def _see(self, found: Detections) -> None:
        """What the targets look like all round is gathered beside the loop."""
        perception, seen = self._config.perception, found.observation
        found = found.above(perception.tau_det)
        ranged = seen.depth_m is not None or seen.cloud_m is not None
        if len(found) and ranged and seen.camera is not None:
            seen.hold()
            self._side.submit(Look(found, self._objects, perception.lift_max_range_m), Look)

    def _ask(
        self,
        seen: Observation,
        found: Detections | None,
        before: Draft | None = None,
        nearer_to: tuple[int, str] | None = None,
    ) -> None:
        """Have a trajectory written, or `before`'s refined again; see `Order`.

        A copy of the picture costs less than a frame that is held while a model is asked.
        """
        rgb = seen.rgb if self._by_model and before is None else None
        still = replace(
            seen, rgb=None if rgb is None else rgb.copy(), depth_m=None, cloud_m=None, slot=None
        )
        instances = {
            one.id: one.copied()
            for label in self._mission.brief.targets
            for one in self._map.tracker.of(label, doubted=False)
        }
        if not self._refused:
            self.phase = "writing"
        self._order = Order(
            self._config,
            self._mission.brief.translation.instruction,
            self._mission.state,
            self._ends,
            len(self._steps),
            self._map.view,
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

    def _take(
        self,
        draft: Draft,
        order: Order,
        now_ns: int,
    ) -> None:
        """Drive what was found; where nothing was, have another written, or give up."""
        mission, self._order = self._mission, None
        self._unsure = draft.mistakable
        unsure = self.gather()
        for n, said in enumerate(draft.rounds, start=1):
            if said.error and order.before is None:
                mission.tell(_line(f"answer {n} of the model: {said.error}"), now_ns)
        if draft.refined is not None:
            refined = draft.refined
            if order.nearer_to is not None:  # the task's trajectory is still the one before
                draft = replace(self._draft, refined=refined, stops_at=None)
            self._draft, self._index, self._looked_ns = draft, 0, 0
            self._refinements += 1
            self._halt = self._next_halt(refined)
            self.phase, self._refused = "driving", ""
            mission.tell(_line(told(draft, refined, order)), now_ns)
        elif order.nearer_to is not None:
            self._stop(now_ns)
        elif order.before is not None:
            self._write_again(draft.error, now_ns)
        elif unsure or not (draft.hopeless or self._why or self._by_model):
            if not self._refused:
                mission.tell(_line(f"{draft.error}: looking further"), now_ns)
            self.phase, self._refused, self._looked_ns = "looking", draft.error, now_ns
        else:
            self._draft = draft
            after = f"{self._why}; written again: " if self._why else ""
            mission.fail(_line(f"{after}{draft.error}"), now_ns)

    def _drive(
        self,
        observation: Observation,
        stuck: bool,
        now_ns: int,
    ) -> None:
        """See whether the robot is there, and whether it can go on."""
        refined, goal, answer = self._draft.refined, self._goals.goal, self._goals.answer
        assert refined is not None
        pose, state = observation.pose, None if answer is None else answer.state
        if (driven := self._driven(refined)) > self._mission.state:
            self._mission.drove(driven, now_ns)
        last = len(refined.poses) - 1
        until = last if self._halt is None else self._halt[1]
        if state == "reached" and goal is not None and _is_at(goal.pose, refined, until):
            thing = self._draft.stops_at
            if thing is None or until < last:
                self._stop(now_ns)
            else:
                self._ask(observation, None, nearer_to=thing)
        elif state == "reached" and goal is not None:
            self._index = index_at_goal(refined, goal.pose, self._index)
        elif stuck or state == "failed":
            why = "the robot is held up"
            if answer is not None and not stuck:
                why = f"the controller failed: {answer.reason}"
            before, self._held_up_at = self._held_up_at, pose
            if before is not None and pose.distance_to(before.x_m, before.y_m) < SAME_PLACE_M:
                self._write_again(why, now_ns)
            else:
                self._refine_again(why, observation, now_ns)
        elif now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            away_m = blocked_ahead_m(refined, self._map.view, self._index)
            if away_m is not None:
                why = f"something is in the way, {away_m:.1f} m ahead"
                self._refine_again(why, observation, now_ns)

    def _driven(self, refined: Refined) -> int:
        """How many steps lie behind the robot, each of which the rules made one segment."""
        ahead = refined.legs[refined.leg[self._index] :]
        driven = max(self._draft.upto - sum(leg.ends_segment for leg in ahead), 0)
        while self._steps[driven].joined:
            driven -= 1
        return driven

    def _next_halt(self, refined: Refined) -> tuple[int, int] | None:
        """The next step that stops at things, and the index of the pose where it does."""
        ends = [k for k, leg in enumerate(refined.legs) if leg.ends_segment]
        upto, stops = self._draft.upto, self._draft.stops
        for step, leg in zip(range(upto - len(ends), upto), ends, strict=True):
            if step >= max(self._sure, upto - len(stops)) and stops[step - upto]:
                return step, end_of(refined, leg)
        return None

    def _stop(self, now_ns: int) -> None:
        """At a stop, or at the end of a trajectory, as near to a thing there as one gets."""
        if self._halt is None:
            self._go_on(now_ns)
            return
        self._unproven = list(self._draft.stops[self._halt[0] - self._draft.upto])
        self._proven.clear()
        self.phase, self._stopped_ns, self._images = "verifying", now_ns, 0

    def _verify(self, pose: SE2, stuck: bool, now_ns: int) -> None:
        """Whether what the robot stopped at is what the task names; from afar there is no telling,
        and it is taken for it."""
        (number, label), perception = self._unproven[0], self._config.perception
        here = [
            one
            for one in self._map.tracker.of(label)
            if one.distance_m(pose.x_m, pose.y_m) <= min(AGAIN_M, perception.confirm_range_m)
            and one.id not in self._proven
        ]
        here.sort(key=lambda one: (one.id != number, one.distance_m(pose.x_m, pose.y_m)))
        thing = self._map.tracker.get(number)
        found = next((one for one in here if self._map.tracker.confirmed(one)), None)
        away = thing is not None and thing.state != "refuted" and not here
        if thing is not None and away and not self._map.tracker.confirmed(thing):
            away_m = thing.distance_m(pose.x_m, pose.y_m)
            said = f"{label} {number} is {away_m:.1f} m away: too far to make sure that it is one"
            self._mission.tell(_line(said), now_ns)
        if away or found is not None:
            self._proven.add(number if found is None else found.id)
            self._turning, self._stopped_ns, self._images = None, now_ns, 0
            self._unproven.pop(0)
            if not self._unproven:
                self._leave(now_ns)
            return
        if here and not self._faces(here[0], pose, stuck):
            self._stopped_ns, self._images = now_ns, 0
        elif (
            self._images >= MIN_IMAGES
            and (now_ns - self._stopped_ns) * 1e-9 > self._config.mission.verify_s
        ):
            if here:  # it may have got another number
                number = here[0].id
            self._map.tracker.refute(number)
            said = f"{label} {number} is none, as seen from near by: looking further"
            self._mission.tell(_line(said), now_ns)
            self._begin()
            self._goals.set_out(self._mission)

    def _faces(self, thing: Instance, pose: SE2, stuck: bool) -> bool:
        """Whether the robot looks at a thing; if not, it turns to it, once."""
        bearing_rad = pose.bearing_to(*thing.center_m[:2].tolist())
        if self._turning is None:
            if abs(bearing_rad) <= FACING_RAD:
                return True
            self._turning = SE2(pose.x_m, pose.y_m, pose.yaw_rad + bearing_rad)
            return False
        answer = self._goals.answer
        ended = answer is not None and answer.state in ("reached", "failed")
        return ended or stuck

    def _leave(self, now_ns: int) -> None:
        """All things of a stop are what the task names: drive on, or end."""
        refined = self._draft.refined
        assert refined is not None
        assert self._halt is not None
        step, index = self._halt
        if index == len(refined.poses) - 1:
            self._go_on(now_ns)
            return
        self._sure, self._index, self.phase = step + 1, index + 1, "driving"
        self._halt = self._next_halt(refined)

    def _go_on(self, now_ns: int) -> None:
        """At the end of a trajectory: with the steps that come after it, if any do."""
        self._mission.drove(self._draft.upto, now_ns)
        if not self._mission.done:
            self._begin()
            self._goals.set_out(self._mission)

    def _refine_again(self, why: str, observation: Observation, now_ns: int) -> None:
        self._mission.tell(_line(f"{why}: the rest is refined again"), now_ns)
        self._ask(observation, None, self._draft)

    def _write_again(self, why: str, now_ns: int) -> None:
        """Once; who is asked for the same again and again helps no one."""
        if self._why:
            self._mission.fail(_line(why), now_ns)
            return
        self.phase, self._why = "writing", why
        self._mission.tell(_line(f"{why}: written again from here"), now_ns)


def _is_at(pose: SE2, refined: Refined, index: int) -> bool:
    x_m, y_m, _, yaw_rad = refined.poses[index].tolist()
    return pose == SE2(x_m, y_m, yaw_rad)


def _line(text: str) -> str:
    return one_line(text, _REASON_CHARS)

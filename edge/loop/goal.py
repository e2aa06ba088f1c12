"""The present goal, from its choice to the controller's answer and what follows from that.

Here alone is kept what the robot is sent to, and what was tried in vain. A controller drives to the
last goal that it heard until it is there, so a goal that is given up is taken back: by one at the
place where the robot is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass
from functools import partial
from typing import Literal

import numpy as np

from edge.config import Config
from edge.geometry import SE2, wrap_angle
from edge.host.checkpoint import Arrays, check_arrays
from edge.loop.candidates import CandidatePool
from edge.loop.goal_client import ARRIVED_M, GoalClient
from edge.loop.search import LASTING_NS, LEFT, TURNS, NextBestView, Search
from edge.loop.standstill import Standstill
from edge.mapping.coverage import Viewpoint
from edge.mapping.grid import RollingMap
from edge.mission.run import MissionRun
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import FRONTIER, INSTANCE, LOOK, Context
from edge.policies.select import Held, choose, ranked
from edge.text import one_line
from edge.types import CandidateKind, Goal, GoalStatus, Instance, MissionPhase

# A detector that stands still refutes nothing: so many images have to be searched on the spot.
MIN_IMAGES = 5
# A goal that is dropped in one tick and chosen again in one of the next is not taken back.
GRACE_NS = 300_000_000

# A place whose cell is closed is reached next to it; a goal there that failed is tried again.
_AT_PLACE_M, _PLACE_TRIES = 0.5, 3

_KINDS: tuple[CandidateKind, ...] = ("frontier", "instance", "look")

Verdict = Literal["reached", "refuted", "out of reach"]


@dataclass(slots=True, eq=False)
class _Present:
    """The goal being driven to, and all that ends with it.

    Attributes:
        peak: the best score of its candidate so far.
        view: what is to be seen from there, where that is what it is for.
        told: whether it was sent.
        answer: the controller's newest.
        verifying_since_ns: when the robot was there and near enough to verify the instance;
            `images_before`: how many the detector had searched by then.
    """

    goal: Goal
    peak: float = 0.0
    view: Viewpoint | None = None
    told: bool = False
    answer: GoalStatus | None = None
    verifying_since_ns: int | None = None
    images_before: int = 0


class GoalTracker:
    """Follows one goal after another; for one thread.

    Args:
        pool: the candidates; those that were tried in vain are discarded there.
        tracker: the instances; those that were reached or refuted are marked there.
        send: hands a goal to those who transmit it.
        event: tells of something that a person would want to know.

    Attributes:
        phase: what the robot is at: searching, approaching or verifying.
        client: sends the goals.
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
        self._config, self._pool, self._tracker = config, pool, tracker
        self._event = event
        self._present: _Present | None = None
        self._search = Search()
        self._next_view = NextBestView(config.perception.confirm_hits)
        self._standstill = Standstill(config, event)
        self._warned_of: set[int] = set()
        self._turns = -1
        self._place_failures = 0
        self._restored: tuple[str, Search, _Present | None] | None = None  # and its target
        self._without_since_ns: int | None = None
        self._grace_ns = GRACE_NS

    # -- what others read -------------------------------------------------------------------

    @property
    def goal(self) -> Goal | None:
        """Where the robot is sent; None: nowhere."""
        return None if self._present is None else self._present.goal

    @property
    def answer(self) -> GoalStatus | None:
        """The controller's newest answer to the present goal; None before it came."""
        return None if self._present is None else self._present.answer

    @property
    def searched(self) -> bool:
        """Whether nothing was left to go to: what was passed over as doubtful is what is left."""
        return self._search.exhausted

    @property
    def exhausted(self) -> bool:
        """Nothing is left to go to, nor to look at again."""
        return self._search.exhausted and self._next_view.done

    @property
    def views(self) -> int:
        """How many views of what had been seen badly it has seen, in this mission."""
        return self._next_view.views

    def why_in_vain(self, mission: MissionRun, grid: RollingMap) -> str:
        """What was tried to get to the mission's target, when it is exhausted, and what barred."""
        target, views = mission.target, self.views
        seen = target in mission.detected or target in mission.places
        found = "no way to" if seen else "found no"
        again = f", looked again at {views} place{'s' * (views > 1)}" if views else ""
        barred = _barred(grid)
        left = self._pool.out_of_reach if barred else 0
        explored = "explored all that can be reached"
        if left:
            explored = f"no way to the {left} frontier{'s' * (left > 1)} left"
        return f"{explored}{again}, {found} {target}{barred}"

    # -- choosing ---------------------------------------------------------------------------

    def choose(
        self, context: Context, grid: RollingMap, score: np.ndarray, images: int
    ) -> Goal | None:
        """Algorithm 2 of VL-Nav over the scored candidates: the goal of this tick.

        With none left the robot turns on the spot. Then those that were given up come once more,
        and the ways on which the robot was held up, as soon as the reach field leads there; then
        what the detector has seen badly is looked at again.

        Args:
            grid: opened again where the robot was held up, and searched for views.
            score: (n,) float32, of the context's candidates.
            images: how many the detector has searched so far.

        Returns:
            A goal on a free cell that the robot can reach, facing its candidate, the same object
            as before while it stands; or None.
        """
        self._leave_vanished(context)
        chosen = self._towards_best(context, score) or self._turn(context)
        if chosen is not None or not self._search.exhausted:
            self._next_view.drop()
        elif not self._search.trying_again(context, grid, self._pool, self._tracker):
            chosen = self._look_again(context, grid, images)
        self._present = chosen
        return self.goal

    def go_to_place(
        self, context: Context, grid: RollingMap, place: SE2, target: str, images: int
    ) -> Goal | None:
        """Return a goal at a place; a frontier on the way to it while no path to it is known.

        Args:
            place: position and final heading.
            target: the place's name.
            images: number of images that the detector has searched so far.
        """
        cell = grid.reach.nearest(place.x_m, place.y_m, _AT_PLACE_M)
        if cell is None:
            frontiers, n = context.candidates, context.candidates.n
            rest_m = np.hypot(*(frontiers.xy_m[:n] - (place.x_m, place.y_m)).T)
            score = 1.0 / (1.0 + frontiers.path_m[:n] + rest_m)
            return self.choose(context, grid, score.astype(np.float32), images)
        self._next_view.drop()
        self._search.found()
        goal, at = self.goal, (place.x_m, place.y_m)
        if goal is None or goal.kind != "place" or grid.state_at(goal.pose.x_m, goal.pose.y_m):
            pose = SE2(cell[0], cell[1], place.yaw_rad)
            goal = Goal(context.now_ns, pose, "place", 0, at, 1.0, target)
            self._present = _Present(goal)
        return self.goal

    def lead(self, pose: SE2, mission: MissionRun, now_ns: int, apart_m: float) -> Goal:
        """A task's goal, in the place of the present one; of a goal that moves the present one
        stays until it is farther than `apart_m` from where it should be, 0: until it is another."""
        goal = self.goal
        if (
            goal is None
            or goal.kind != "trajectory"
            or goal.pose.distance_to(pose.x_m, pose.y_m) > apart_m
            or (not apart_m and goal.pose != pose)
        ):
            goal = Goal(now_ns, pose, "trajectory", 0, (pose.x_m, pose.y_m), 0.0, mission.target)
            self._present = _Present(goal)
        return goal

    def _towards_best(self, context: Context, score: np.ndarray) -> _Present | None:
        """To the best candidate; the present goal, where that serves it still."""
        c, policy, search = context.candidates, self._config.policy, self._search
        present, held = self._present, None
        order = ranked(c, score, context.pose, policy.delta_reached_m)
        if search.exhausted:
            lasting = c.first_seen_ns[order] <= c.stamp_ns - LASTING_NS
            order = order[lasting | (c.kind[order] == INSTANCE)]
        if present is not None:
            fickle = partial(search.fickle, present.goal.candidate_xy_m)
            held = Held(present.goal, present.peak, fickle)
        chosen = choose(context, score, order, held, policy.switch_margin, self._tracker.get)
        goal, peak, stays = chosen or (None, 0.0, False)
        if present is not None and present.goal.kind == "frontier" and not stays:
            search.left.append(present.goal.candidate_xy_m)
        if goal is None:
            return None
        search.found()
        if present is None or goal is not present.goal:
            return _Present(goal, peak)
        present.peak = peak
        return present

    def _turn(self, context: Context) -> _Present | None:
        """With nowhere to go, on the spot."""
        turning = self.goal is not None and self.goal.kind == "look"
        if not self._search.may_turn(turning, context.now_ns):
            return None
        if turning:
            return self._present
        at = context.pose
        yaw_rad = at.yaw_rad + 2.0 * math.pi / TURNS
        return _Present(_look(SE2(at.x_m, at.y_m, yaw_rad), context.now_ns, context.target))

    def _look_again(self, context: Context, grid: RollingMap, images: int) -> _Present | None:
        """To where something can be seen that was seen badly."""
        view, present = self._next_view.choose(grid, images), self._present
        if view is None:
            return None
        if present is not None and present.view is view:
            return present
        yaw_rad = wrap_angle(view.heading_rad - grid.coverage.camera_yaw_rad)
        pose = SE2(view.x_m, view.y_m, yaw_rad)
        return _Present(_look(pose, context.now_ns, context.target), view=view)

    def _leave_vanished(self, context: Context) -> None:
        """A frontier that shows from afar alone would have the robot come and go without end."""
        goal, search = self.goal, self._search
        if goal is None or goal.kind != "frontier":
            return
        gone = context.candidates.index_of(FRONTIER, goal.candidate_id) < 0
        if gone and (search.exhausted or search.fickle(goal.candidate_xy_m)):
            self._discard(context.now_ns)

    # -- sending ----------------------------------------------------------------------------

    def tell(self, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Send the present goal, if that was not done; without one the last is taken back."""
        self.client.notice_silence(now_ns)
        present = self._present
        if present is not None:
            self._without_since_ns = None
            if not present.told:
                self._send(present.goal, now_ns)
                present.told = True
                self._warn_of_neighbours(present.goal, mission, now_ns)
            return
        if self._without_since_ns is None:
            self._without_since_ns = now_ns
        if self.client.driving and now_ns - self._without_since_ns >= self._grace_ns:
            self.stand(mission, pose, now_ns)

    def stand(self, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Have the robot stay where it is; the goal for that is nobody's to follow up."""
        self._present = None
        self._send(_look(pose, now_ns, mission.target), now_ns)
        self.client.driving = False

    def answered(self, answer: GoalStatus) -> None:
        """The controller said something, which may be of an old goal."""
        present = self._present
        if present is not None and not present.told:
            present = None
        goal = None if present is None else present.goal
        if self.client.answered(answer, goal) and present is not None:
            present.answer = answer

    def _send(self, goal: Goal, now_ns: int) -> None:
        self._grace_ns = GRACE_NS
        self.client.send(goal, now_ns)

    def _warn_of_neighbours(self, goal: Goal, mission: MissionRun, now_ns: int) -> None:
        """Report, before the robot stops there, a goal beside what must not be reached now.

        Each thing is told once, until a goal is not beside it.
        """
        near: set[int] = set()
        for label in mission.forbidden:
            for instance in self._tracker.of(label):
                away_m = instance.distance_m(goal.pose.x_m, goal.pose.y_m)
                if away_m > self._config.mission.reach_m:
                    continue
                near.add(instance.id)
                if instance.id not in self._warned_of:
                    text = f"goal {away_m:.1f} m from {label}, which must not be reached now"
                    mission.warn(label, text, now_ns)
        self._warned_of = near

    # -- following up -----------------------------------------------------------------------

    def judge(
        self, grid: RollingMap, pose: SE2, mission: MissionRun, images: int, now_ns: int
    ) -> bool:
        """Handle what became of the present goal; `FollowBehaviour` handles a trajectory's own.

        Args:
            grid: closed where the robot is held up.
            images: how many the detector has searched so far.

        Returns:
            Whether the robot was to drive and stands still.
        """
        present = self._present
        self._standstill.told(grid, pose, self.client.take_blocked(), now_ns)
        if present is not None and present.told and present.answer is None:
            present.answer = self.client.arrived(present.goal, pose, now_ns)
        instance = None
        if present is not None and present.goal.kind == "instance":
            instance = self._tracker.get(present.goal.candidate_id)
        verdict = None
        if present is None or instance is None:
            known = present is not None and present.goal.kind in ("trajectory", "place")
            self.phase = "approaching" if known else "searching"
        elif verdict := self._verdict(present, instance, pose, now_ns, images):
            self._act_on(verdict, present, instance, mission, now_ns)
        if present is not None and present.goal.kind == "place":
            self._follow_to_place(present, pose, mission, now_ns)
        elif present is not None and verdict is None:
            self._follow(present, pose, now_ns, images)
        # If nobody drives the robot, it is not the candidate's fault that it stands.
        driven_to = self.goal if self.client.is_driven(pose) else None
        stuck = self._standstill.noticed(grid, pose, driven_to, now_ns)
        if stuck:
            self._event("stuck: goal discarded", now_ns)
            self._discard(now_ns)
        return stuck

    def _verdict(
        self, present: _Present, instance: Instance, pose: SE2, now_ns: int, images: int
    ) -> Verdict | None:
        """Is the instance that the robot goes to the thing, and is the robot near it?

        `reached` is declared only when the robot stopped on a goal of its own choosing within
        `reach_m` of the instance's nearest surface point and the detector confirmed it
        (DESIGN.md, "Reached means").
        """
        config = self._config.mission
        if present.answer is None or present.answer.state != "reached":
            present.verifying_since_ns, self.phase = None, "approaching"
            return None
        if instance.distance_m(pose.x_m, pose.y_m) > config.reach_m:
            return "out of reach"
        self.phase = "verifying"
        if present.verifying_since_ns is None:
            present.verifying_since_ns, present.images_before = now_ns, images
        if self._tracker.confirmed(instance):
            return "reached"
        long_enough = (now_ns - present.verifying_since_ns) * 1e-9 > config.verify_s
        if long_enough and images - present.images_before >= MIN_IMAGES:
            return "refuted"
        return None

    def _act_on(
        self,
        verdict: Verdict,
        present: _Present,
        instance: Instance,
        mission: MissionRun,
        now_ns: int,
    ) -> None:
        if verdict == "reached" and mission.brief.steps is not None:
            self.drop()  # of a task, it is made sure of: nothing more was wanted here
            return
        if verdict == "reached":
            self._tracker.mark_reached(instance.id)
            label = mission.target
            mission.arrive(f"confirmed, seen in {instance.hits} images", now_ns)
            if mission.target == label and not mission.done:
                # A second visit to a thing of this kind: another one, or later.
                self._discard(now_ns)
            return
        if verdict == "refuted":
            self._tracker.refute(instance.id)
            self.drop()
        else:
            at = present.goal.pose
            if not self._search.missed(instance.id, (at.x_m, at.y_m)):
                self.drop()  # what came to be known on the way here may lead nearer
                return
            self._discard(now_ns)
        x, y, _ = instance.center_m
        self._event(f"{verdict}: {instance.label} #{instance.id} at ({x:.1f}, {y:.1f})", now_ns)

    def _follow(self, present: _Present, pose: SE2, now_ns: int, images: int) -> None:
        """Take up the controller's answers about frontiers, turns and views."""
        goal, answer = present.goal, present.answer
        if goal.kind == "trajectory":
            return
        state = None if answer is None else answer.state
        if present.view is not None:
            if state == "failed":
                self._next_view.give_up()
            elif state == "reached":
                self._next_view.came(images)
        elif goal.kind == "look":
            if state in ("reached", "failed"):
                self._discard(now_ns)
        elif answer is not None and state == "failed":
            self._event(f"goal failed: {answer.reason}", now_ns)
            self._discard(now_ns)
        elif goal.kind == "frontier" and (
            state == "reached"
            or pose.distance_to(*goal.candidate_xy_m) <= self._config.policy.delta_reached_m
        ):
            # Been there. Algorithm 2 leaves out what is this near; were that all, the robot would
            # turn to another frontier, and back as soon as it is a little farther away.
            self._discard(now_ns)

    def _follow_to_place(
        self, present: _Present, pose: SE2, mission: MissionRun, now_ns: int
    ) -> None:
        """Handle the controller's answer about a place."""
        goal, answer = present.goal, present.answer
        state = None if answer is None else answer.state
        away_m = pose.distance_to(*goal.candidate_xy_m)
        if state == "reached" and away_m <= _AT_PLACE_M + ARRIVED_M:
            self.drop()
            mission.arrive(f"{away_m:.1f} m from the place", now_ns)
        elif answer is not None and state in ("reached", "failed"):
            reason = answer.reason or f"the controller stopped {away_m:.1f} m from it"
            self._event(f"goal failed: {reason}", now_ns)
            self._discard(now_ns)
            if self._place_failures >= _PLACE_TRIES:
                mission.give_up(f"no way to {goal.target}: {one_line(reason)}", now_ns)

    # -- leaving ----------------------------------------------------------------------------

    def drop(self) -> None:
        """Leave the present goal; its candidate may be chosen again, and answers to it are void."""
        self._present = None
        self._next_view.drop()

    def rest(self) -> None:
        """There is nothing to be done: the robot is to stand, unless something turns up at once."""
        self.drop()
        self._grace_ns = 0

    def follows(self, mission: MissionRun) -> bool:
        """Whether it has set out for the mission's present target."""
        return self._turns == mission.turns

    def set_out(self, mission: MissionRun) -> None:
        """For another target: nothing that held for the last one does."""
        self._turns = mission.turns
        self.drop()
        self._search, self._place_failures = Search(), 0
        restored, self._restored = self._restored, None
        if restored is not None and restored[0] == mission.target:
            _, self._search, self._present = restored

    def state_dict(self) -> Arrays:
        """Return the present goal and what was tried in vain, but no view and no task's goal."""
        present, goals = self._present, []
        if present is not None and present.view is None and present.goal.kind in _KINDS:
            goals = [(present.goal, present.peak)]
        return {
            **self._search.state_dict(),
            "kind": np.array([_KINDS.index(goal.kind) for goal, _ in goals], np.int8),
            "id": np.array([goal.candidate_id for goal, _ in goals], np.int64),
            "at": np.array(
                [
                    (*astuple(goal.pose), *goal.candidate_xy_m, goal.score, peak)
                    for goal, peak in goals
                ]
            ).reshape(-1, 7),
        }

    def load_state_dict(self, state: Arrays, target: str, now_ns: int) -> None:
        """Go on with a `state_dict` as soon as it sets out for this target, if it does so first.

        The goal is sent again, by another stamp: what became of the last sending is not known.
        """
        present, goal_rows = None, ("kind", "id", "at")
        rows = {goal_rows: 1, ("left_m",): LEFT, ("missed",): 1}
        most = {"kind": len(_KINDS) - 1, "turns": 1000}
        check_arrays(state, self.state_dict(), rows, most)
        for kind, i, at in zip(state["kind"], state["id"], state["at"].tolist(), strict=True):
            x_m, y_m, yaw_rad, to_x_m, to_y_m, score, peak = at
            pose = SE2(x_m, y_m, yaw_rad)
            goal = Goal(now_ns, pose, _KINDS[kind], int(i), (to_x_m, to_y_m), score, target)
            present = _Present(goal, peak)
        self._restored = (target, Search.of_state_dict(state), present)

    def forget_mission(self) -> None:
        """Another mission has other goals, and forbids other things."""
        self._warned_of = set()
        self._restored = None
        self._turns = -1
        self.drop()
        self._next_view.start_over()

    def reconfigure(self, config: Config) -> None:
        """Go by another configuration; see `edge.loop.reload.LIVE` for what may differ."""
        self._config = config
        self._next_view.enough = config.perception.confirm_hits

    def forget_places(self) -> None:
        """The pose jumped. The robot is told to stand unless the next tick finds a goal."""
        self.rest()
        self.client.forget_places()
        self._search, self._restored = Search(), None
        self._standstill.reset()

    def _discard(self, now_ns: int) -> None:
        """Leave the present goal's candidate alone for a while and choose another."""
        present = self._present
        if present is not None and present.view is not None:
            self._next_view.give_up()
            return
        if present is not None and present.goal.kind == "look":
            self._search.turned(now_ns)
            goal, until_ns = present.goal, now_ns + int(self._config.mission.discard_s * 1e9)
            self._pool.discard(LOOK, goal.candidate_id, goal.candidate_xy_m, until_ns)
        elif present is not None and present.goal.kind == "place":
            self._place_failures += 1
        elif present is not None and present.goal.kind != "trajectory":
            goal = present.goal
            kind = INSTANCE if goal.kind == "instance" else FRONTIER
            until_ns = now_ns + int(self._config.mission.discard_s * 1e9)
            self._pool.discard(kind, goal.candidate_id, goal.candidate_xy_m, until_ns)
        self.drop()


def _barred(grid: RollingMap) -> str:
    """What held the robot up, for the end of a reason; empty where nothing did."""
    places_m = grid.bumps.known_m
    if not places_m:
        return ""
    x, y = places_m[0]
    more = f" and {len(places_m) - 1} more" if len(places_m) > 1 else ""
    return f"; held up at ({x:.1f}, {y:.1f}){more}"


def _look(pose: SE2, now_ns: int, target: str) -> Goal:
    """A goal that is for no candidate: to turn on the spot, to see a view, or to stand."""
    return Goal(now_ns, pose, "look", 0, (pose.x_m, pose.y_m), 0.0, target)

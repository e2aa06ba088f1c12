"""The goal that the robot is sent to: chosen, told to the controller, judged, given up."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from edge.config import Config
from edge.geometry import SE2
from edge.loop.candidates import FRONTIER, INSTANCE, CandidatePool
from edge.loop.orders import Orders
from edge.mapping.grid import RollingMap
from edge.mission.approach import Approach, Verdict
from edge.mission.run import MissionRun
from edge.mission.sight import Neighbours
from edge.motion.stuck import StuckDetector
from edge.perception.instances import InstanceTracker
from edge.policies.base import Policy
from edge.policies.next_view import NextBestView
from edge.policies.select import LASTING_NS, GoalSelector
from edge.types import Goal, GoalStatus, Instance, MissionPhase

# A controller that says that the robot is held up farther away than this mistakes the frame.
_HELD_UP_M = 2.0
# Where the robot was held up is tried once more for so long at least: a frontier that comes to
# light there is gone to once it has lasted, and shows a tick or two after the opening.
_RETRY_NS = LASTING_NS + 1_000_000_000


class Pursuit:
    """Follows one goal after another; for one thread.

    Args:
        pool: the candidates; those that were tried in vain are discarded there.
        tracker: the instances; those that were reached or refuted are marked there.
        tell: hands a goal to those who send it.
        held_up: hears where, x and y in `map`, the robot was to drive and could not.
        event: tells of something that a person would want to know.

    Attributes:
        goal: where the robot is sent; None: nowhere.
        orders: what of that was told to the controller.
    """

    def __init__(
        self,
        config: Config,
        policy: Policy,
        pool: CandidatePool,
        tracker: InstanceTracker,
        tell: Callable[[Goal], None],
        held_up: Callable[[tuple[float, float], int], None],
        event: Callable[[str, int], None],
    ) -> None:
        self.goal: Goal | None = None
        self.orders = Orders(tell)
        self._policy, self._pool, self._tracker, self._event = policy, pool, tracker, event
        self._held_up, self._radius_m = held_up, config.robot.radius_m
        self._selector = GoalSelector(policy)
        self._next_view = NextBestView(config.perception.confirm_hits)
        self._approach = Approach(config.mission)
        self._stuck, self._stuck_far = (
            StuckDetector(config.mission.stuck_s, config.motion.stuck_m) for _ in range(2)
        )
        self._neighbours = Neighbours(config.mission.reach_m)
        self._discard_ns = int(config.mission.discard_s * 1e9)
        self._second_chance = False
        self._retry: tuple[int, int] | None = None  # reach generation and time that end it

    @property
    def phase(self) -> MissionPhase:
        """What the robot is at: searching, approaching or verifying."""
        return self._approach.phase

    @property
    def exhausted(self) -> bool:
        """Nothing is left to go to, nor to look at again."""
        return self._selector.exhausted and self._next_view.done

    @property
    def views(self) -> int:
        """How many views of what had been seen badly it has seen, in this mission."""
        return self._next_view.views

    def judge(self, mission: MissionRun, pose: SE2, now_ns: int, looks: int) -> None:
        """What has become of the present goal.

        Args:
            looks: how often the detector has answered so far.
        """
        goal, answer = self.goal, self.orders.answer
        blocked, self.orders.blocked = self.orders.blocked, None
        if blocked is not None and pose.distance_to(*blocked) <= _HELD_UP_M:
            self._held_up(blocked, now_ns)
        instance = None
        if goal is not None and goal.kind == "instance":
            instance = self._tracker.get(goal.candidate_id)
        confirmed = instance is not None and self._tracker.confirmed(instance)
        verdict = self._approach.advance(goal, instance, confirmed, answer, pose, now_ns, looks)
        if verdict is not None:
            self._act_on(verdict, mission, now_ns)
        elif goal is not None:
            self._follow(goal, answer, pose, now_ns, looks)
        self._notice_standstill(pose, now_ns)

    def set_out(self, target: str) -> None:
        """For another target: nothing that held for the last one does."""
        self.drop()
        self._selector.start_over()
        self._second_chance = False
        self.orders.target = target

    def choose(
        self,
        grid: RollingMap,
        instances: Mapping[int, Instance],
        pose: SE2,
        now_ns: int,
        target: str,
        looks: int,
    ) -> Goal | None:
        """Algorithm 2 of VL-Nav over the scored candidates; see `GoalSelector.select`.

        With none left, those that were given up come once more, and the ways on which the robot
        was held up, as soon as the reach field leads there; then what the detector has seen badly
        is looked at again.

        Args:
            looks: how often the detector has answered so far.
        """
        self._leave_vanished(now_ns)
        goal = self._selector.select(self._pool, grid, instances, pose, now_ns, target)
        if goal is not None or not self._selector.exhausted:
            self._next_view.drop()
            return goal
        if not self._second_chance:
            self._second_chance = True
            self._pool.lift_discards()
            self._tracker.forget_refuted(target)
            opened = grid.bumps.open_all()  # doors open, and people go
            # The reach field that is growing may have begun before; the one after it leads there.
            self._retry = (grid.reach.generation + 2, now_ns + _RETRY_NS) if opened else None
            return None
        if self._retry is not None:
            generation, until_ns = self._retry
            if grid.reach.generation < generation or now_ns < until_ns:
                return None
            self._retry = None
        return self._next_view.choose(grid, looks, now_ns, target)

    def rest(self) -> None:
        """There is nothing to be done: the robot stands in the next tick."""
        self._selector.drop()
        self._next_view.drop()
        self.orders.withdraw(at_once=True)

    def give(self, goal: Goal | None, mission: MissionRun, pose: SE2, now_ns: int) -> None:
        """Tell the controller, where it has not heard of this goal yet."""
        if goal is None:
            self.orders.give_none(pose, now_ns)
        elif self.orders.give(goal, now_ns):
            self._neighbours.look(goal, mission, self._tracker, now_ns)
        self.goal = goal

    def drop(self) -> None:
        """Leave the present goal; its candidate may be chosen again."""
        self._selector.drop()
        self._next_view.drop()
        self.orders.withdraw()
        self.goal = None

    def forget_mission(self) -> None:
        """Another mission has other goals, and forbids other things."""
        self._neighbours.forget()
        self.drop()
        self._next_view.start_over()

    def forget_places(self) -> None:
        """The pose jumped. The robot is told to stand unless the next tick finds a goal."""
        self.drop()
        self.orders.withdraw(at_once=True)
        self._selector.start_over()
        self._stuck.reset()
        self._stuck_far.reset()
        self._second_chance = False

    def _act_on(self, verdict: Verdict, mission: MissionRun, now_ns: int) -> None:
        instance = verdict.instance
        x, y, _ = instance.center_m
        where = f"{instance.label} #{instance.id} at ({x:.1f}, {y:.1f})"
        if verdict.kind == "reached":
            self._tracker.mark_reached(instance.id)
            label = mission.target
            mission.arrive(f"confirmed, seen in {instance.hits} images", now_ns)
            if mission.target == label and not mission.done:
                # A second visit to a thing of this kind: another one, or later.
                self._discard(now_ns)
            return
        if verdict.kind == "refuted":
            self._tracker.refute(instance.id)
            self.drop()
        else:
            self._discard(now_ns)
        self._event(f"{verdict.kind.replace('_', ' ')}: {where}", now_ns)

    def _follow(
        self, goal: Goal, answer: GoalStatus | None, pose: SE2, now_ns: int, looks: int
    ) -> None:
        """Take up the controller's answers about frontiers, turns and views."""
        if goal is self._next_view.goal:
            self._next_view.follow(answer, looks)
        elif goal.kind == "look":
            if answer is not None and answer.state in ("reached", "failed"):
                self._selector.looked(now_ns)
                self.drop()
        elif answer is not None and answer.state == "failed":
            self._event(f"goal failed: {answer.reason}", now_ns)
            self._discard(now_ns)
        elif goal.kind == "frontier" and (
            (answer is not None and answer.state == "reached")
            or pose.distance_to(*goal.candidate_xy_m) <= self._policy.delta_reached_m
        ):
            # Been there. Algorithm 2 leaves out what is this near; were that all, the robot would
            # turn to another frontier, and back as soon as it is a little farther away.
            self._discard(now_ns)

    def _notice_standstill(self, pose: SE2, now_ns: int) -> None:
        """Whichever goals they are: a robot that is held up may be given one after another.

        Where no controller answers, it is no candidate's fault that the robot stands; and a robot
        that was only to turn on the spot is not held up by what is ahead.
        """
        goal, orders = self.goal, self.orders
        told = goal is not None and orders.heard and orders.driving
        far = told and pose.distance_to(goal.pose.x_m, goal.pose.y_m) > self._radius_m
        stuck = self._stuck.update(pose, told, now_ns)
        if self._stuck_far.update(pose, far, now_ns):
            self._held_up(pose.ahead(self._radius_m), now_ns)
        if stuck:
            self._event("stuck: goal discarded", now_ns)
            self._discard(now_ns)

    def _leave_vanished(self, now_ns: int) -> None:
        """A frontier that shows from afar alone would have the robot come and go without end."""
        goal, selector = self.goal, self._selector
        if goal is None or goal.kind != "frontier":
            return
        gone = self._pool.index_of(FRONTIER, goal.candidate_id) < 0
        if gone and (selector.exhausted or selector.fickle(goal.candidate_xy_m)):
            self._discard(now_ns)

    def _discard(self, now_ns: int) -> None:
        """Leave the present goal's candidate alone for a while and choose another."""
        goal = self.goal
        if goal is not None and goal is self._next_view.goal:
            self._next_view.give_up()
            return
        if goal is not None and goal.kind == "look":
            self._selector.looked(now_ns)
        elif goal is not None:
            kind = INSTANCE if goal.kind == "instance" else FRONTIER
            until_ns = now_ns + self._discard_ns
            self._pool.discard(kind, goal.candidate_id, goal.candidate_xy_m, until_ns)
        self.drop()

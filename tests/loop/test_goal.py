"""Choice, life and end of goals, on a made-up map."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

from edge.geometry import SE2
from edge.loop.goals.candidates import CandidatePool
from edge.loop.goals.goal import GoalTracker
from edge.mapping.results import Frontiers
from edge.policies.base import FRONTIER, INSTANCE, PolicyInput, ScorerOutputs
from edge.types import Goal, GoalStatus, Instance, Observation

S = 1_000_000_000
HERE = SE2(0.0, 0.0, 0.0)
Entry = tuple[int, int, float, float, float]


class Map:
    """All cells are free and can be reached, but for those near to a point in `walled`.

    Attributes:
        arrived: True if something came into the way, which may go again.
        asked: where to stop for an instance: how near, to how many points; nowhere is nearer than
            `least_m`, nor near to more than `most_points`.
        view_m2: area that the view shows.
    """

    def __init__(self) -> None:
        self.walled: list[tuple[float, float]] = []
        self.closed: list[tuple[float, float]] = []
        self.generation, self.closed_m, self.known_m = 7, [], []
        self.arrived = self.small_too = False
        self.camera_yaw_rad, self.view, self.here = 0.0, None, HERE
        self.view_m2 = 0.0
        self.travel_cost = self.coverage = self.bumps = self
        self.asked: list[tuple[float, int]] = []
        self.least_m, self.most_points = 0.0, 64

    def nearest(self, x: float, y: float, within_m: float) -> tuple[float, float, float] | None:
        if any(math.hypot(x - wx, y - wy) < 0.5 for wx, wy in self.walled):
            return None
        return x, y, math.hypot(x, y)

    def stopping_point(
        self,
        surface_m: np.ndarray,
        within_m: float,
        points: int = 1,
        except_disc: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> tuple[float, float, float] | None:
        self.asked.append((within_m, points))
        if within_m < self.least_m or points > self.most_points:
            return None
        x_m, y_m, radius_m = except_disc
        cells = (self.nearest(x, y, within_m) for x, y, _ in surface_m.tolist())
        allowed = [c for c in cells if c and math.dist(c[:2], (x_m, y_m)) >= radius_m]
        return min(allowed, key=lambda cell: self.here.distance_to(*cell[:2]), default=None)

    def state_at(self, x: float, y: float) -> int:
        return 100 if (round(x, 3), round(y, 3)) in self.closed else 0

    def open_all(self) -> bool:
        closed, self.closed_m = self.closed_m, []
        return bool(closed)

    def forget_arrivals(self, small_too: bool) -> bool:
        self.small_too = small_too
        arrived, self.arrived = self.arrived, False
        return arrived

    def restart_search(self) -> None:
        """Do nothing: the only badly seen view is `view`."""

    def search(self, reach) -> bool:
        return True

    def is_worth_visiting(self, view: SE2) -> bool:
        return True

    def write_off(self, view: SE2) -> None:
        self.view = None

    def area_m2(self, view: SE2) -> float:
        return self.view_m2

    def distance_m(self, x: float, y: float) -> float:
        return math.hypot(x, y)


class Instances(dict):
    """As much of the instances as a goal asks for."""

    sure: tuple[int, ...] = ()
    one_sided: tuple[int, ...] = ()
    viewpoint: tuple[float, float] | None = None

    def verified(self, instance: Instance, pose: SE2) -> bool:
        return self.confirmed(instance) and instance.id not in self.one_sided

    verified_now = verified

    def confirmed(self, instance: Instance) -> bool:
        return instance.id in self.sure

    @property
    def tracks(self) -> dict[int, SimpleNamespace]:
        track = SimpleNamespace(only_viewpoint=lambda confirm_hits: self.viewpoint)
        return dict.fromkeys(self, track)

    def of(self, label: str) -> list[Instance]:
        return list(self.values())

    def reason_for(self, label: str, instance: Instance) -> str:
        return ""

    def mark_reached(self, instance_id: int) -> None:
        self[instance_id].state = "reached"

    def reject(self, instance_id: int) -> None:
        self[instance_id].state = "rejected"

    def forget_rejected(self, label: str) -> None:
        """Nothing is found again here."""


class Mission:
    """Stays at its target, as one that asks for two chairs."""

    target, retargets, done, stopped = "chair", 1, False, ""
    progress, sets = SimpleNamespace(forbidden=()), SimpleNamespace(detected={"chair"})
    spec, destinations = SimpleNamespace(steps=None), {}

    def __init__(self) -> None:
        self.arrivals: list[str] = []

    def on_reached(self, evidence: str, now_ns: int) -> None:
        self.arrivals.append(evidence)


class Case:
    """A goal tracker, and the world in which it chooses."""

    def __init__(self, sensors_ahead_ns: int = 0) -> None:
        config = simulated({"mission": {"verify_s": 2.0}})
        self.pool, self.instances = CandidatePool(16, 0.5), Instances()
        self.sent: list[Goal] = []
        self.events: list[str] = []
        self.goals = GoalTracker(
            config,
            self.pool,
            self.instances,
            self.sent.append,
            lambda text, _: self.events.append(text),
        )
        self.map, self.mission = Map(), Mission()
        self.now_ns, self._ahead_ns = 0, sensors_ahead_ns
        self.score = np.zeros(16, np.float32)
        self.goals.begin_target(self.mission)

    def context(self, pose: SE2 = HERE) -> PolicyInput:
        seen, self.map.here = Observation(0, self.now_ns, pose.matrix()), pose
        return PolicyInput(
            seen, pose, self.map, (0, 0, 0, 0), self.pool.candidates, None, ScorerOutputs(),
            ("chair",),
            "chair", self.now_ns,
        )  # fmt: skip

    def choose(
        self, *entries: Entry, pose: SE2 = HERE, sure=(), after_s: float = 0.1, since_s: float = 0.0
    ):
        """Run a tick with candidates (kind, id, x, y, score), first seen before `since_s`."""
        c = self.pool.candidates
        c.n = len(entries)
        for i, (kind, id, x, y, score) in enumerate(entries):
            c.kind[i], c.id[i], c.xy_m[i], self.score[i] = kind, id, (x, y), score
            c.confirmed[i] = id in sure
            c.first_seen_ns[i] = int(since_s * S) + self._ahead_ns
            if kind == INSTANCE:
                points = np.array([[x, y, 0.5], [x + 1.0, y, 0.5]], np.float32)
                self.instances[id] = Instance(id, "chair", points[0], points, score, 3, 0, 0)
        self.now_ns += int(after_s * S)
        c.stamp_ns = self.now_ns + self._ahead_ns
        return self._tick(pose, 0)

    def tick(self, *frontiers: tuple[float, float], after_s: float = 0.1, images: int = 0):
        """Run one tick with frontiers at these places; a place identifies its frontier."""
        self.now_ns += int(after_s * S)
        xy = np.array(frontiers, np.float32).reshape(-1, 2)
        counts = np.ones(len(xy), np.int32)
        self.pool.update(Frontiers(len(xy), xy, counts, counts), [], self.now_ns, self.now_ns)
        return self._tick(HERE, images)

    def _tick(self, pose: SE2, images: int):
        goal = self.goals.chooser.choose(self.context(pose), self.map, self.score, images)
        self.goals.send_pending(self.mission, pose, self.now_ns)
        return goal

    def answer(self, state: str, reason: str = "") -> None:
        self.goals.on_goal_status(GoalStatus(self.goals.goal.stamp_ns, state, reason))

    def judge(self, images: int = 0, pose: SE2 = HERE, after_s: float = 0.0) -> None:
        self.now_ns += int(after_s * S)
        self.goals.check_progress(self.map, pose, self.mission, images, self.now_ns)

    def turn(self, pose: SE2 = HERE) -> Goal:
        """Return the next spin, which comes after one second without a candidate."""
        assert self.choose(pose=pose) is None
        goal = self.choose(pose=pose, after_s=1.1)
        assert goal.kind == "spin"
        assert self.choose(pose=pose) is goal
        return goal

    def turn_round(self) -> None:
        """Turn on the spot until nothing is left."""
        for _ in range(3):
            self.turn()
            self.answer("reached")
            self.judge()
        assert self.choose(after_s=1.1) is None


def frontier(id: int, x: float, score: float, y: float = 0.0) -> Entry:
    return (FRONTIER, id, x, y, score)


def chair(id: int, x: float, score: float, y: float = 0.0) -> Entry:
    return (INSTANCE, id, x, y, score)


def who(goal: Goal | None) -> tuple[str, int] | None:
    return None if goal is None else (goal.kind, goal.candidate_id)


# -- choosing ---------------------------------------------------------------------------------


def test_nothing_to_choose_from():
    case = Case()
    assert case.choose() is None
    assert case.sent == []
    assert not case.goals.chooser.exhausted


def test_a_goal_faces_its_candidate_and_stays_the_same_object():
    case = Case()
    case.map.nearest = lambda x, y, within_m: (x, y - 1.0, 3.0)
    goal = case.choose(frontier(1, 3.0, 0.5))
    assert (goal.pose.x_m, goal.pose.y_m) == (3.0, -1.0)
    assert goal.pose.yaw_rad == pytest.approx(math.pi / 2)
    assert (goal.stamp_ns, goal.candidate_xy_m, goal.target) == (case.now_ns, (3.0, 0.0), "chair")
    assert case.choose(frontier(1, 3.0, 0.4)) is goal
    assert case.sent == [goal]


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        # Another frontier has to be better by more than the margin of 30 %.
        ([frontier(1, 3, 0.5)], [frontier(1, 3, 0.5), frontier(2, -3, 0.6)], ("frontier", 1)),
        ([frontier(1, 3, 0.5)], [frontier(1, 3, 0.5), frontier(2, -3, 0.7)], ("frontier", 2)),
        ([frontier(1, 3, 0.5)], [frontier(1, 3, 0.2), frontier(2, -3, 0.3)], ("frontier", 2)),
        # An instance needs no margin over a frontier, and no frontier beats it.
        ([frontier(1, 3, 0.5)], [frontier(1, 3, 0.5), chair(9, -3, 0.1)], ("instance", 9)),
        ([chair(9, -3, 0.1)], [frontier(1, 3, 5.0), chair(9, -3, 0.1)], ("instance", 9)),
        # An instance is seen through: its best score counts, not the one of now.
        ([chair(9, 3, 0.6)], [chair(9, 3, 0.3), chair(8, -3, 0.7)], ("instance", 9)),
        ([chair(9, 3, 0.6)], [chair(9, 3, 0.3), chair(8, -3, 0.8)], ("instance", 8)),
        # The chosen candidate has gone.
        ([frontier(1, 3, 0.5)], [frontier(2, -3, 0.1)], ("frontier", 2)),
        ([chair(9, 3, 0.6)], [chair(8, -3, 0.1)], ("instance", 8)),
        ([frontier(1, 3, 0.5)], [], None),
    ],
)
def test_when_the_goal_changes(before, after, expected):
    case = Case()
    assert case.choose(*before) is not None
    assert who(case.choose(*after)) == expected


@pytest.mark.parametrize(
    ("least_m", "frontier_path_m", "expected_x_m"),
    [(1.1, 9.0, 4.0), (1.1, 0.0, 2.0), (1.6, 9.0, 2.0)],
    ids=["look from near", "shorter over the frontier", "no place near enough to look"],
)
def test_without_a_stop_the_robot_looks_from_near_or_goes_around(
    least_m, frontier_path_m, expected_x_m
):
    case = Case()
    case.map.least_m = least_m
    found = frontier(1, 2.0, 0.5), chair(9, 4.0, 0.8)
    case.pool.candidates.path_m[0] = frontier_path_m
    assert case.choose(*found).pose.x_m == expected_x_m


@pytest.mark.parametrize(
    ("chair_x_m", "viewpoint", "goal_x_m"),
    [(3.0, None, 3.0), (3.0, (2.8, 0.0), 4.0), (3.0, (3.5, 0.0), 3.0), (3.1, (2.8, 0.0), 3.1)],
    ids=["two viewpoints", "the other side", "all stops at the viewpoint", "far around"],
)
def test_an_object_seen_from_one_viewpoint_is_viewed_from_another_side(
    chair_x_m, viewpoint, goal_x_m
):
    case = Case()
    case.instances.viewpoint = viewpoint
    assert case.choose(chair(9, chair_x_m, 0.8)).pose.x_m == pytest.approx(goal_x_m)


def test_the_only_viewpoint_will_do_if_the_robot_cannot_get_to_another_side():
    case = Case()
    case.instances.viewpoint = (2.8, 0.0)
    assert case.choose(chair(9, 3.0, 0.8)).pose.x_m == 4.0
    case.answer("failed")
    case.judge()
    goal = case.choose(chair(9, 3.0, 0.8), after_s=60.0)
    assert (who(goal), goal.pose.x_m) == (("instance", 9), 3.0)


def test_a_place_from_which_an_object_was_out_of_reach_is_no_goal_again():
    case = Case()
    case.map.least_m = 1.1
    found = frontier(1, 2.0, 0.5), chair(9, 4.0, 0.8)
    case.pool.candidates.path_m[0] = 9.0
    assert case.choose(*found).pose.x_m == 4.0
    case.answer("reached")
    case.judge(pose=HERE)
    assert case.choose(*found).pose.x_m == 2.0


def test_once_the_map_was_opened_an_object_may_be_in_reach_again():
    case = Case()
    search = case.goals.chooser.search
    search.mark_missed(9, (4.0, 0.0))
    case.turn_round()
    assert search.missed_from(9, (4.0, 0.0))
    case.map.arrived = True
    case.tick(after_s=11.0)  # nothing is left, so the cells of those who came are freed
    assert (case.map.arrived, search.missed_from(9, (4.0, 0.0))) == (False, False)


@pytest.mark.parametrize(
    ("paths_m", "at_y_m"),
    [((2.0, 2.1), 1.0), ((2.3, 2.0), 1.0), ((4.0, 2.0), -1.0), ((math.inf, 2.0), -1.0)],
)
def test_the_goal_keeps_its_side_of_a_wall(paths_m, at_y_m):
    case = Case()
    case.map.least_m = 9.0  # no free cell is near the chair
    found = frontier(1, 2, 0.5, y=1.0), frontier(2, 2, 0.5, y=-1.0), chair(9, 4, 0.8)
    path_m = case.pool.candidates.path_m
    path_m[:2] = 2.0, 2.1
    first = case.choose(*found)
    assert who(first) == ("instance", 9)
    path_m[:2] = paths_m
    goal = case.choose(*found)
    assert (goal.pose.y_m, goal is first) == (at_y_m, at_y_m > 0)


@pytest.mark.parametrize(
    ("nearest_m", "place"),
    [
        (0.7, ""),
        (1.5, ": seen at (3.0, 0.0), no way nearer than 1.5 m"),
        (None, ": seen at (3.0, 0.0), no way nearer than 5.0 m"),
    ],
)
def test_the_failure_reason_names_an_unreachable_place(nearest_m, place):
    case = Case()
    case.choose(chair(9, 3.0, 0.8))
    cell = None if nearest_m is None else (3.0 - nearest_m, 0.0, 2.0)
    case.map.nearest = lambda x, y, within_m: cell
    reason = case.goals.chooser.failure_reason(case.mission, case.map)
    assert reason == f"explored all reachable space, found no path to chair{place}"


@pytest.mark.parametrize("candidate", [chair(9, 3.0, 0.8), frontier(1, 3.0, 0.8)])
def test_each_failure_doubles_the_discard_time(candidate):
    case, times_ns = Case(), []
    case.pool.discarded.add = lambda *entry: times_ns.append(entry[-1] - case.now_ns)
    for _ in range(3):
        case.choose(candidate)
        case.answer("failed")
        case.judge()
    assert times_ns == [45 * S, 90 * S, 180 * S]


@pytest.mark.parametrize(("side_m", "is_left_alone"), [(1.0, True), (0.5, False)])
def test_an_object_with_alternating_stopping_points_is_given_up(side_m, is_left_alone):
    case, discarded = Case(), []
    case.pool.discarded.add = lambda *entry: discarded.append(entry[1])
    for k in range(4):
        case.map.stopping_point = lambda *_, y=(-1) ** k * side_m: (3.0, y, 3.0)
        goal = case.choose(chair(9, 3.0, 0.8))
        assert (goal.pose.y_m, discarded) == ((-1) ** k * side_m, [])
    case.map.stopping_point = lambda *_: (3.0, side_m, 3.0)
    goal = case.choose(chair(9, 3.0, 0.8))
    assert (goal is None, discarded) == (is_left_alone, [9] if is_left_alone else [])


def test_unreachable_candidates_are_skipped():
    case = Case()
    case.map.walled = [(3.0, 0.0)]
    assert who(case.choose(frontier(1, 3.0, 0.9), frontier(2, -3.0, 0.1))) == ("frontier", 2)
    # And given up when it is the present goal.
    case.map.walled = [(-3.0, 0.0)]
    assert who(case.choose(frontier(1, 3.0, 0.1), frontier(2, -3.0, 0.9))) == ("frontier", 1)


@pytest.mark.parametrize("gone", ["rejected", "forgotten"])
def test_a_rejected_or_forgotten_instance_is_skipped(gone):
    case = Case()
    case.choose(chair(9, 3.0, 0.5))
    case.goals.chooser.abandon()
    if gone == "rejected":
        case.instances.reject(9)
    else:
        del case.instances[9]
    assert case.goals.chooser.choose(case.context(), case.map, case.score, 0) is None


def test_a_frontier_left_three_times_is_kept():
    """Two far frontiers, each the better one from where the way to the other leads."""
    case, chosen = Case(), []
    for k in range(12):
        here, there = (0.9, 0.3) if k % 2 else (0.3, 0.9)
        chosen.append(who(case.choose(frontier(1, 3, here), frontier(2, -3, there)))[1])
    assert chosen == [2, 1, 2, 1, 2, 1, 2, 2, 2, 2, 2, 2]
    # Another place has its own count, and another target starts over.
    assert who(case.choose(frontier(2, -3, 0.3), chair(9, 3, 0.1))) == ("instance", 9)
    case.goals.begin_target(case.mission)
    assert who(case.choose(frontier(1, 3, 0.3), frontier(2, -3, 0.9))) == ("frontier", 2)
    assert who(case.choose(frontier(1, 3, 0.9), frontier(2, -3, 0.3))) == ("frontier", 1)


# -- with nothing to go to ------------------------------------------------------------------


@pytest.mark.parametrize("sensors_ahead_ns", [0, 10**18, -(10**18)])
def test_with_no_candidates_the_robot_spins_three_times(sensors_ahead_ns):
    case, pose = Case(sensors_ahead_ns), HERE
    for _ in range(3):
        goal = case.turn(pose)
        turned = (goal.pose.yaw_rad - pose.yaw_rad) % (2 * math.pi)
        assert turned == pytest.approx(2 * math.pi / 3)
        assert goal.pose.distance_to(0.0, 0.0) == 0.0
        case.answer("reached")
        case.judge(pose=pose)
        pose = goal.pose
    assert case.choose(pose=pose, after_s=1.1) is None
    assert not case.goals.chooser.exhausted
    # A later candidate becomes the goal without another spin.
    late_s = case.now_ns / S
    assert who(case.choose(chair(9, 3, 0.1), since_s=late_s)) == ("instance", 9)
    assert case.choose(frontier(1, 3, 0.9), since_s=late_s, after_s=1.0) is None
    assert who(case.choose(frontier(1, 3, 0.9), since_s=late_s, after_s=1.0)) == ("frontier", 1)
    assert case.choose(pose=pose, after_s=5.0) is None
    assert case.goals.chooser.exhausted
    case.goals.begin_target(case.mission)
    assert not case.goals.chooser.exhausted
    assert case.turn().kind == "spin"


def test_without_candidates_or_views_the_search_is_exhausted():
    case = Case()
    case.turn_round()
    assert not case.goals.chooser.exhausted
    case.tick()
    assert case.goals.chooser.exhausted
    assert case.goals.chooser.next_view.views == 0


def test_a_badly_seen_view_is_looked_at_again():
    case = Case()
    case.map.view, case.map.camera_yaw_rad = SE2(1.0, 2.0, 0.5), math.pi / 2
    case.turn_round()
    goal = case.tick()
    # A camera that looks aside is turned to the view.
    assert (goal.pose.x_m, goal.pose.y_m, goal.kind) == (1.0, 2.0, "spin")
    assert goal.pose.yaw_rad == pytest.approx(0.5 - math.pi / 2)
    assert case.tick(images=50) is goal
    case.answer("reached")
    case.judge(images=60)
    assert case.tick(images=60) is goal
    for _ in range(2):  # the end of this view, and the search for the next
        assert case.tick(images=60 + simulated().perception.confirm_hits) is None
    assert (case.goals.chooser.next_view.views, case.goals.chooser.exhausted) == (1, True)


@pytest.mark.parametrize(
    ("confirmed", "view_m2", "gain_m2", "expected"),
    [
        (True, 4.0, 0.5, "spin"),
        # A frontier that shows more per metre comes first.
        (True, 1.0, 3.0, "frontier"),
        # A mistake tells nothing about known space.
        (False, 4.0, 0.5, "frontier"),
    ],
)
def test_if_a_confirmed_object_has_moved_known_space_is_searched(
    confirmed, view_m2, gain_m2, expected
):
    case, there = Case(), SE2(2.5, 0.0, 0.0)
    case.instances.sure = (9,) if confirmed else ()
    case.pool.candidates.path_m[:] = 1.0
    case.pool.candidates.gain_m2[:] = gain_m2
    case.map.view, case.map.view_m2 = SE2(1.0, 0.0, 0.5), view_m2
    case.choose(chair(9, 3.0, 0.8))
    case.answer("reached")
    case.goals.check_progress(case.map, there, case.mission, 0, case.now_ns, lambda *_: False)
    case.now_ns += 3 * S
    case.goals.check_progress(case.map, there, case.mission, 9, case.now_ns, lambda *_: False)
    assert case.instances[9].state == "rejected"
    goal = case.choose(frontier(1, 3.0, 0.5))
    assert goal.kind == expected
    assert case.choose(frontier(1, 3.0, 0.5)) is goal
    # Another such object is gone to before.
    assert who(case.choose(frontier(1, 3.0, 0.5), chair(8, -3.0, 0.1))) == ("instance", 8)


@pytest.mark.parametrize(("reach_m", "stop_m"), [(0.9, 0.85), (1.0, 0.85), (0.6, 0.55)])
def test_the_robot_stops_just_within_reach_of_the_object(reach_m, stop_m):
    case = Case()
    case.goals.reconfigure(simulated({"mission": {"reach_m": reach_m}}))
    case.choose(chair(9, 3.0, 0.8))
    assert case.map.asked[0][0] == pytest.approx(stop_m)


@pytest.mark.parametrize(("explored", "chances"), [(False, 4), (True, 1)])
def test_a_frontier_that_vanishes_time_and_again_is_left_alone(explored, chances):
    """Four times while exploring, once where all was explored: it shows from afar alone."""
    case = Case()
    if explored:
        case.turn_round()
    for _ in range(chances):
        case.tick((3.0, 0.0))
        goal = case.tick((3.0, 0.0), after_s=2.5)
        assert (goal.kind, goal.candidate_xy_m) == ("frontier", (3.0, 0.0))
        assert case.tick() is None
    case.tick((3.0, 0.0))
    goal = case.tick((3.0, 0.0), after_s=2.5)
    assert goal is None or goal.kind == "spin"
    case.tick((3.0, 0.0), (-3.0, 0.0))
    goal = case.tick((3.0, 0.0), (-3.0, 0.0), after_s=2.5)
    assert goal.candidate_xy_m == (-3.0, 0.0)  # other places are not affected
    assert case.tick((3.0, 0.0), after_s=60.0) is not None  # nor is this one for ever


def test_a_discarded_frontier_is_tried_again_before_the_end():
    case = Case()
    case.tick((3.0, 0.0))
    case.answer("failed", "no way")
    case.judge()
    assert (case.goals.goal, case.events) == (None, ["goal failed: no way"])
    case.pool.discarded.add(FRONTIER, 1, (3.0, 0.0), case.now_ns + 1000 * S)
    assert case.tick((3.0, 0.0)) is None
    case.turn_round()
    assert not case.goals.chooser.exhausted
    case.tick((3.0, 0.0))
    assert case.tick((3.0, 0.0), after_s=2.5).candidate_xy_m == (3.0, 0.0)


@pytest.mark.parametrize("path_m", [math.inf, 5.0], ids=["space out of reach", "all in reach"])
def test_the_search_waits_for_moved_obstacles_before_the_end(path_m):
    """Forget arrivals whenever nothing is left, but not on the way to a viewpoint."""
    case = Case()
    case.turn_round()
    case.map.walled, case.pool.candidates.path_m[0] = [(3.0, 0.0)], path_m
    for small_too, is_last in ((False, False), (False, False), (True, False), (True, True)):
        case.tick((3.0, 0.0), after_s=11.0)
        assert case.goals.chooser.exhausted
        case.map.arrived = True
        assert case.tick((3.0, 0.0), after_s=11.0) is None
        assert (case.map.arrived, case.map.small_too) == (False, small_too)
        case.map.generation += 2
        case.tick((3.0, 0.0), after_s=4.0)
        assert case.goals.chooser.exhausted == (is_last and math.isfinite(path_m)), (
            "it may go in the next seconds"
        )
    case.map.arrived = True
    case.tick()
    assert case.map.arrived, "ten seconds between two tries"
    case.map.view = SE2(1.0, 2.0, 0.5)
    case.goals.chooser.abandon()
    view = case.tick()
    assert view.kind == "spin"
    assert case.tick(after_s=11.0) is view
    assert case.map.arrived


@pytest.mark.parametrize("path_m", [math.inf, 5.0])
def test_an_obstacle_on_the_only_path_is_forgotten(path_m):
    case = Case()
    case.pool.candidates.path_m[:2] = 2.0, path_m
    case.map.arrived = True
    case.choose(frontier(1, -3, 0.5), chair(9, 3, 0.6))
    assert case.map.arrived == math.isfinite(path_m)
    case.map.arrived = True
    case.choose(frontier(1, -3, 0.5), chair(9, 3, 0.6), after_s=9.0)
    assert case.map.arrived, "ten seconds between two tries"
    case.choose(frontier(1, -3, 0.5), chair(9, 3, 0.6), after_s=1.1)
    assert case.map.arrived == math.isfinite(path_m)


# -- arriving -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("away_m", "state", "confirmed", "phase", "came_to"),
    [
        (0.5, "", True, "approaching", ""),
        (0.5, "accepted", True, "approaching", ""),
        # Passing or stopping next to it is not enough: the controller must answer "reached".
        (0.5, "failed", True, "approaching", "goal failed: no reason given"),
        (0.5, "reached", True, "verifying", "confirmed, seen in 3 images"),
        (0.5, "reached", False, "verifying", ""),
    ],
)
def test_arrival_needs_the_answer_of_the_controller(away_m, state, confirmed, phase, came_to):
    case = Case()
    case.judge()
    assert case.goals.phase == "searching"
    case.choose(chair(9, 3.0, 0.8))
    case.instances.sure = (9,) if confirmed else ()
    if state:
        case.answer(state)
    case.judge(pose=SE2(3.0 - away_m, 0.0, 0.0))
    assert case.goals.phase == phase
    assert (case.mission.arrivals + case.events) == ([came_to] if came_to else [])
    assert (case.instances[9].state == "reached") == bool(case.mission.arrivals)
    # A settled object is not pursued again; this mission asks for a second chair.
    assert (case.goals.goal is None) == bool(came_to)


@pytest.mark.parametrize(
    ("off_m", "off_rad", "said", "steps_m", "reached"),
    [
        (0.0, 0.0, "", 0.0, True),
        (0.25, 3.0, "", 0.0, True),  # many controllers do not turn at the end
        (0.4, 0.0, "", 0.0, False),
        (0.0, 0.0, "", 0.06, False),  # it is driving past
        (0.0, 0.0, "accepted", 0.0, False),  # a controller that answers says when it is there
    ],
)
def test_an_unanswered_goal_is_reached_when_the_robot_stops(off_m, off_rad, said, steps_m, reached):
    case = Case()
    goal = case.choose(chair(9, 3.0, 0.8)).pose
    if said:
        case.answer(said)
    for i in range(4):  # 0.5 s apart
        pose = SE2(goal.x_m - off_m + i * steps_m, goal.y_m, goal.yaw_rad + off_rad)
        case.judge(pose=pose, after_s=0.5)
        assert case.goals.phase == "approaching"
    case.judge(pose=SE2(pose.x_m + steps_m, pose.y_m, pose.yaw_rad), after_s=0.5)
    assert case.goals.phase == ("verifying" if reached else "approaching")
    assert case.goals.client.driving != reached


@pytest.mark.parametrize(("turned_rad", "done"), [(0.0, False), (2.0, True), (2.6, False)])
def test_an_unanswered_turn_is_done_after_the_rotation(turned_rad, done):
    case = Case()
    case.turn()
    for _ in range(5):
        case.judge(pose=SE2(0.0, 0.0, turned_rad), after_s=0.5)
    assert (case.goals.goal is None) == done


def test_an_object_out_of_reach_twice_is_given_up():
    case = Case()
    case.instances.sure = (9,)
    for x_m, given_up in ((1.0, False), (1.6, False), (1.7, True)):
        case.choose(chair(9, x_m + 1.4, 0.8))
        case.answer("reached")
        case.judge(pose=SE2(0.0, 0.0, 0.0))
        assert (case.goals.goal is None, case.goals.phase) == (True, "searching")
        left = "out of reach: chair #9"
        assert any(event.startswith(left) for event in case.events) == given_up


@pytest.mark.parametrize(
    ("looks", "rejected"),
    [
        # (seconds since arrival, images that the detector has searched so far)
        ([(0, 40), (1, 45), (3, 50)], True),
        ([(0, 40), (1, 50), (1.9, 60)], False),
        # A detector that stalls, or has looked a few times only, rejects nothing.
        ([(0, 40), (3, 40), (60, 40)], False),
        ([(0, 40), (3, 44), (9, 44)], False),
        ([(0, 40), (3, 44), (9, 45)], True),
    ],
)
def test_an_instance_is_rejected_by_images_and_time(looks, rejected):
    case, there = Case(), SE2(2.5, 0.0, 0.0)
    case.choose(chair(9, 3.0, 0.8))
    case.answer("reached")
    start_ns = case.now_ns
    for t_s, images in looks:
        case.now_ns = start_ns + int(t_s * S)
        case.judge(images, there)
    assert (case.instances[9].state == "rejected") == rejected
    assert case.goals.phase == "verifying"


def test_an_object_confirmed_from_one_viewpoint_is_only_probable():
    case, there = Case(), SE2(2.5, 0.0, 0.0)
    case.instances.sure = case.instances.one_sided = (9,)
    case.choose(chair(9, 3.0, 0.8))
    case.answer("reached")
    for images in (0, 50):
        case.judge(images, there)
        case.now_ns += 3 * S
    assert case.instances[9].state == "rejected"
    assert case.goals.chooser.search.probable.xy_m == (3.0, 0.0)


@pytest.mark.parametrize("between", ["dropped", "another"])
def test_every_arrival_is_verified_afresh(between):
    case, there = Case(), SE2(2.5, 0.0, 0.0)
    case.choose(chair(9, 3.0, 0.8))
    case.answer("reached")
    case.judge(0, there)
    if between == "dropped":
        case.goals.chooser.abandon()
        case.choose(chair(9, 3.0, 0.8), after_s=3.0)
    else:
        case.choose(chair(9, 3.0, 0.1), chair(8, 3.0, 0.8, y=0.1), sure=(8,), after_s=3.0)
    case.answer("reached")
    case.judge(60, there)
    assert case.goals.phase == "verifying"
    assert "rejected" not in [entry.state for entry in case.instances.values()]
    case.judge(90, there, after_s=3.0)
    assert "rejected" in [entry.state for entry in case.instances.values()]


def test_a_goal_next_to_a_forbidden_object_warns_once():
    case, logged = Case(), []
    point = np.array([[3.4, 0.0, 0.5]], np.float32)
    lamp = Instance(5, "lamp", point[0], point, 0.8, 3, 0, 0)
    case.instances.of = {"lamp": [lamp]}.__getitem__
    case.mission = SimpleNamespace(
        target="chair",
        progress=SimpleNamespace(forbidden=("lamp",)),
        stopped="",
        log_event=lambda now_ns, kind, label, text: logged.append((kind, label, text)),
    )
    for x in (3.0, 3.5, -3.0, 3.0):
        case.choose(frontier(int(abs(x) * 10), x, 0.5))
    text = "goal 0.4 m from lamp, which must not be reached now"
    assert logged == [("warning", "lamp", text)] * 2
    case.goals.forget_mission()
    case.choose(frontier(30, 3.0, 0.5))
    assert len(logged) == 3

"""Which goal is published, and for how long it stands, on a grid that the test makes up."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge.geometry import SE2
from edge.loop.candidates import FRONTIER, INSTANCE, CandidatePool
from edge.policies.select import GoalSelector
from edge.types import Goal, Instance

S = 1_000_000_000
HERE = SE2(0.0, 0.0, 0.0)
POLICY = SimpleNamespace(delta_reached_m=0.5, switch_margin=0.3)
Entry = tuple[int, int, float, float, float]


class Grid:
    """All cells are free and can be reached, but for those near to a point in `walled`."""

    def __init__(self) -> None:
        self.walled: list[tuple[float, float]] = []
        self.closed: list[tuple[float, float]] = []
        self.reach = self

    def nearest(self, x: float, y: float, within_m: float) -> tuple[float, float, float] | None:
        if any(math.hypot(x - wx, y - wy) < 0.5 for wx, wy in self.walled):
            return None
        return x, y, math.hypot(x, y)

    def state_at(self, x: float, y: float) -> int:
        return 100 if (round(x, 3), round(y, 3)) in self.closed else 0


class Case:
    """A selector, and the world it selects in."""

    def __init__(self, sensors_ahead_ns: int = 0) -> None:
        self.selector, self.grid = GoalSelector(POLICY), Grid()
        self.now_ns, self._ahead_ns = 0, sensors_ahead_ns

    def select(
        self, *entries: Entry, pose: SE2 = HERE, sure=(), after_s: float = 0.1, since_s: float = 0.0
    ):
        """One tick with candidates of (kind, id, x, y, score), seen for the first time before
        `since_s`."""
        pool, instances = CandidatePool(16, 0.5), {}
        pool.n = len(entries)
        for i, (kind, id, x, y, score) in enumerate(entries):
            pool.kind[i], pool.id[i], pool.xy_m[i], pool.score[i] = kind, id, (x, y), score
            pool.sure[i] = id in sure
            pool.first_seen_ns[i] = int(since_s * S) + self._ahead_ns
            if kind == INSTANCE:
                points = np.array([[x, y, 0.5], [x + 1.0, y, 0.5]], np.float32)
                instances[id] = Instance(id, "chair", points[0], points, score, 3, 0, 0)
        self.now_ns += int(after_s * S)
        pool.stamp_ns = self.now_ns + self._ahead_ns
        return self.selector.select(pool, self.grid, instances, pose, self.now_ns, "chair")


def frontier(id: int, x: float, score: float, y: float = 0.0) -> Entry:
    return (FRONTIER, id, x, y, score)


def chair(id: int, x: float, score: float, y: float = 0.0) -> Entry:
    return (INSTANCE, id, x, y, score)


def who(goal: Goal | None) -> tuple[str, int] | None:
    return None if goal is None else (goal.kind, goal.candidate_id)


def test_nothing_to_choose_from():
    case = Case()
    assert case.select() is None
    assert not case.selector.exhausted


def test_a_goal_faces_its_candidate_and_stays_the_same_object():
    case = Case()
    case.grid.nearest = lambda x, y, within_m: (x, y - 1.0, 3.0)
    goal = case.select(frontier(1, 3.0, 0.5))
    assert (goal.pose.x_m, goal.pose.y_m) == (3.0, -1.0)
    assert goal.pose.yaw_rad == pytest.approx(math.pi / 2)
    assert (goal.stamp_ns, goal.candidate_xy_m, goal.target) == (case.now_ns, (3.0, 0.0), "chair")
    assert case.select(frontier(1, 3.0, 0.4)) is goal


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
        # What was chosen has gone.
        ([frontier(1, 3, 0.5)], [frontier(2, -3, 0.1)], ("frontier", 2)),
        ([chair(9, 3, 0.6)], [chair(8, -3, 0.1)], ("instance", 8)),
        ([frontier(1, 3, 0.5)], [], None),
    ],
)
def test_when_the_goal_changes(before, after, expected):
    case = Case()
    assert case.select(*before) is not None
    assert who(case.select(*after)) == expected


def test_a_confirmed_instance_beats_one_that_is_not():
    case = Case()
    case.select(chair(9, 3, 0.6))
    assert who(case.select(chair(9, 3, 0.6), chair(8, -3, 0.4), sure=(8,))) == ("instance", 8)


@pytest.mark.parametrize(
    ("heir_x", "kept"),
    [
        # A redrawn frontier takes the place of the one that went; one far off does not.
        (3.9, True),
        (4.1, False),
    ],
)
def test_a_redrawn_frontier_is_heir_to_the_goal(heir_x, kept):
    case = Case()
    goal = case.select(frontier(1, 3.0, 0.5))
    after = case.select(frontier(2, heir_x, 0.5), frontier(3, -3.0, 0.6))
    assert (after is goal) == kept
    assert who(after) == ("frontier", 1 if kept else 3)


@pytest.mark.parametrize(
    ("moved_m", "same"),
    [(0.2, True), (0.29, True), (0.9, True), (1.1, False)],
)
def test_a_goal_far_ahead_may_shift_a_quarter_of_the_way(moved_m, same):
    case = Case()
    goal = case.select(frontier(1, 4.0, 0.5))
    assert (case.select(frontier(1, 4.0, 0.5, y=moved_m)) is goal) == same


def test_a_goal_whose_cell_was_closed_is_published_anew():
    case = Case()
    goal = case.select(frontier(1, 3.0, 0.5))
    case.grid.closed.append((3.0, 0.0))
    anew = case.select(frontier(1, 3.0, 0.5))
    assert (who(anew), anew is goal) == (("frontier", 1), False)


def test_what_cannot_be_reached_is_passed_over():
    case = Case()
    case.grid.walled = [(3.0, 0.0)]
    assert who(case.select(frontier(1, 3.0, 0.9), frontier(2, -3.0, 0.1))) == ("frontier", 2)
    # And given up when it is the present goal.
    case.grid.walled = [(-3.0, 0.0)]
    assert who(case.select(frontier(1, 3.0, 0.1), frontier(2, -3.0, 0.9))) == ("frontier", 1)


def test_an_instance_is_approached_at_its_nearest_point():
    case = Case()
    goal = case.select(chair(9, 3.0, 0.5), pose=SE2(6.0, 0.0, 0.0))
    assert goal.pose.x_m == 4.0


def test_an_instance_refuted_since_is_passed_over():
    case = Case()
    pool = CandidatePool(4, 0.5)
    pool.n, pool.kind[0], pool.id[0], pool.xy_m[0] = 1, INSTANCE, 9, (3.0, 0.0)
    assert case.selector.select(pool, case.grid, {}, HERE, 0, "chair") is None


def test_a_dropped_goal_is_chosen_afresh():
    case = Case()
    first = case.select(frontier(1, 3.0, 0.5))
    case.selector.drop()
    again = case.select(frontier(1, 3.0, 0.5))
    assert (who(again), again is first) == (("frontier", 1), False)


def test_a_frontier_that_was_left_three_times_for_another_is_seen_through():
    """Two far frontiers, each the better one from where the way to the other leads."""
    case, chosen = Case(), []
    for k in range(12):
        here, there = (0.9, 0.3) if k % 2 else (0.3, 0.9)
        chosen.append(who(case.select(frontier(1, 3, here), frontier(2, -3, there)))[1])
    assert chosen == [2, 1, 2, 1, 2, 1, 2, 2, 2, 2, 2, 2]
    # Another place has its own count, and another target starts over.
    assert who(case.select(frontier(2, -3, 0.3), chair(9, 3, 0.1))) == ("instance", 9)
    case.selector.drop()
    case.selector.start_over()
    assert who(case.select(frontier(1, 3, 0.3), frontier(2, -3, 0.9))) == ("frontier", 2)
    assert who(case.select(frontier(1, 3, 0.9), frontier(2, -3, 0.3))) == ("frontier", 1)


def test_a_frontier_that_the_robot_came_to_was_not_left():
    case = Case()
    for _ in range(5):
        goal = case.select(frontier(1, 3, 0.9))
        case.selector.drop()
        case.select(frontier(2, -3, 0.9))
        case.selector.drop()
    assert not case.selector.fickle(goal.candidate_xy_m)


def turn(case: Case, pose: SE2) -> Goal:
    """The next turn on the spot, which comes after a second without anything to choose."""
    assert case.select(pose=pose) is None
    goal = case.select(pose=pose, after_s=1.1)
    assert goal.kind == "look"
    assert case.select(pose=pose) is goal
    return goal


@pytest.mark.parametrize("sensors_ahead_ns", [0, 10**18, -(10**18)])
def test_with_nowhere_to_go_it_looks_around_three_times_and_is_exhausted(sensors_ahead_ns):
    case, pose = Case(sensors_ahead_ns), HERE
    for _ in range(3):
        goal = turn(case, pose)
        turned = (goal.pose.yaw_rad - pose.yaw_rad) % (2 * math.pi)
        assert turned == pytest.approx(2 * math.pi / 3)
        assert goal.pose.distance_to(0.0, 0.0) == 0.0
        assert not case.selector.exhausted
        case.selector.looked(case.now_ns)
        pose = goal.pose
    assert case.select(pose=pose, after_s=1.1) is None
    assert case.selector.exhausted
    # What turns up later is gone to, and no reason to look around once more.
    late_s = case.now_ns / S
    assert who(case.select(chair(9, 3, 0.1), since_s=late_s)) == ("instance", 9)
    assert case.select(frontier(1, 3, 0.9), since_s=late_s, after_s=1.0) is None
    assert who(case.select(frontier(1, 3, 0.9), since_s=late_s, after_s=1.0)) == ("frontier", 1)
    assert case.select(pose=pose, after_s=5.0) is None
    assert case.selector.exhausted
    case.selector.start_over()
    assert not case.selector.exhausted
    assert turn(case, pose).kind == "look"


def test_something_to_go_to_ends_looking_around():
    case = Case()
    for _ in range(2):
        turn(case, HERE)
        case.selector.looked(case.now_ns)
    assert who(case.select(frontier(1, 3.0, 0.5))) == ("frontier", 1)
    for _ in range(3):
        case.selector.drop()
        turn(case, HERE)
        case.selector.looked(case.now_ns)
    assert not case.selector.exhausted

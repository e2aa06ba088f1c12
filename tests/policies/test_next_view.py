"""One view after another, on a map that the test makes up."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from edge.geometry import SE2
from edge.mapping.coverage import View
from edge.policies.next_view import NextBestView
from edge.types import GoalStatus

LOOKS = 3


class Coverage:
    """Has some views to offer; the search for one takes `steps` calls."""

    def __init__(self, *views: View, steps: int = 1) -> None:
        self.camera_yaw_rad = 0.0
        self.view: View | None = None
        self.left, self.shown = list(views), set()
        self.steps, self._calls = steps, 0

    def start_over(self) -> None:
        self._calls = 0

    def search(self, reach) -> bool:
        self._calls += 1
        self.view = self.left[0] if self.left else None
        return self._calls >= self.steps

    def worth(self, view: View) -> bool:
        return view not in self.shown

    def write_off(self, view: View) -> None:
        self.left.remove(view)


class Case:
    """A survey of a map with some views."""

    def __init__(self, *views: View, steps: int = 1) -> None:
        self.coverage = Coverage(*views, steps=steps)
        self.grid = SimpleNamespace(coverage=self.coverage, reach=None)
        self.survey = NextBestView(LOOKS)
        self.looks = self.now_ns = 0

    def choose(self):
        self.now_ns += 1
        return self.survey.choose(self.grid, self.looks, self.now_ns, "chair")

    def answer(self, state: str) -> None:
        self.survey.follow(GoalStatus(self.survey.goal.stamp_ns, state), self.looks)


A, B = View(1.0, 2.0, 0.5), View(3.0, 4.0, -0.5)


def test_nothing_to_see():
    case = Case()
    assert case.choose() is None
    assert case.survey.done
    assert case.survey.views == 0


def test_a_view_is_a_goal_until_it_was_looked_at_often_enough():
    case = Case(A)
    goal = case.choose()
    assert (goal.pose, goal.kind, goal.target) == (SE2(1.0, 2.0, 0.5), "look", "chair")
    case.survey.follow(None, case.looks)
    case.answer("accepted")
    case.looks = 100
    assert case.choose() is goal
    for looks in (100, 101, 102):
        case.looks = looks
        case.answer("reached")
        assert case.choose() is goal
    case.looks = 103
    assert case.choose() is None
    assert (case.survey.done, case.survey.views, case.coverage.left) == (True, 1, [])


def test_what_was_seen_on_the_way_need_not_be_gone_to():
    case = Case(A, B)
    case.choose()
    case.coverage.shown.add(A)
    assert case.choose().pose.x_m == B.x_m
    assert (case.survey.views, case.coverage.left) == (1, [B])


@pytest.mark.parametrize("why", ["failed", "stuck"])
def test_where_the_robot_does_not_get_to_nothing_was_looked_at(why):
    case = Case(A, B)
    goal = case.choose()
    if why == "failed":
        case.answer("failed")
    else:
        case.survey.give_up()
    other = case.choose()
    assert (other.pose.x_m, other is goal) == (B.x_m, False)
    assert (case.survey.views, case.coverage.left) == (0, [B])


def test_the_search_may_take_some_ticks():
    case = Case(A, steps=3)
    assert [case.choose() for _ in range(2)] == [None, None]
    assert not case.survey.done
    assert case.choose().pose.x_m == A.x_m


def test_a_dropped_view_may_be_sought_again_as_another_goal():
    case = Case(A)
    goal = case.choose()
    case.answer("reached")
    case.survey.drop()
    case.looks = 50
    again = case.choose()
    assert (again.pose, again is goal) == (goal.pose, False)
    assert case.choose() is again  # it has not come there yet


def test_what_shows_less_than_it_seemed_is_no_goal():
    case = Case(A, B)
    case.coverage.shown.add(A)
    assert case.choose() is None
    assert case.choose().pose.x_m == B.x_m
    assert case.survey.views == 0


def test_a_camera_that_looks_aside_is_turned_to_the_view():
    case = Case(A)
    case.coverage.camera_yaw_rad = math.pi / 2
    assert case.choose().pose.yaw_rad == pytest.approx(0.5 - math.pi / 2)

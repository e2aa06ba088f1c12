"""One view after another, on a map that the test makes up."""

from __future__ import annotations

from types import SimpleNamespace

from edge.geometry import SE2
from edge.loop.goals.search_state import NextBestView

ENOUGH = 3


class Coverage:
    """Has some views to offer; the search for one takes `steps` calls."""

    def __init__(self, *views: SE2, steps: int = 1) -> None:
        self.view: SE2 | None = None
        self.left, self.shown = list(views), set()
        self.steps, self._calls = steps, 0

    def restart_search(self) -> None:
        self._calls = 0

    def search(self, reach) -> bool:
        self._calls += 1
        self.view = self.left[0] if self.left else None
        return self._calls >= self.steps

    def is_worth_visiting(self, view: SE2) -> bool:
        return view not in self.shown

    def write_off(self, view: SE2) -> None:
        self.left.remove(view)


class Case:
    """A survey of a map with some views."""

    def __init__(self, *views: SE2, steps: int = 1) -> None:
        self.coverage = Coverage(*views, steps=steps)
        self.map = SimpleNamespace(coverage=self.coverage, travel_cost=None)
        self.survey = NextBestView(ENOUGH)
        self.images = 0

    def choose(self) -> SE2 | None:
        return self.survey.choose(self.map, self.images)


A, B = SE2(1.0, 2.0, 0.5), SE2(3.0, 4.0, -0.5)


def test_a_view_lasts_until_it_has_enough_images():
    case = Case(A)
    assert case.choose() is A
    case.images = 100
    assert case.choose() is A
    for images in (100, 101, 102):
        case.images = images
        case.survey.on_arrived(images)
        assert case.choose() is A
    case.images = 103
    assert case.choose() is None
    assert not case.survey.done, "the search for the next view comes after this one's end"
    assert case.choose() is None
    assert (case.survey.done, case.survey.views, case.coverage.left) == (True, 1, [])


def test_a_view_that_shows_too_little_is_skipped():
    case = Case(A, B)
    case.coverage.shown.add(A)
    assert case.choose() is None
    assert case.choose() is B
    assert case.survey.views == 0

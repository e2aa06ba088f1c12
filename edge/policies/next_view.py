"""With nothing left to go to: looking again, from near by, at what the detector saw badly."""

from __future__ import annotations

from edge.geometry import SE2, wrap_angle
from edge.mapping.coverage import View
from edge.mapping.grid import RollingMap
from edge.types import Goal, GoalStatus


class NextBestView:
    """One view after another as a goal, until none is worth one; each is tried once.

    Args:
        looks: of the detector, for which the robot stays at a view.

    Attributes:
        goal: of the present view; None while there is none.
        done: there is nothing left that could be seen better.
        views: how many views the robot has seen, from where they are or on the way there.
    """

    def __init__(self, looks: int) -> None:
        self.goal: Goal | None = None
        self.done = False
        self.views = 0
        self._looks = looks
        self._view: View | None = None
        self._searching = self._given_up = False
        self._came_at: int | None = None  # the detector's count of looks when the robot came

    def choose(self, grid: RollingMap, looks: int, now_ns: int, target: str) -> Goal | None:
        """The view to go to; None while it is being searched for, and when there is none.

        Args:
            looks: how often the detector has answered so far.
        """
        if self._view is not None and (self._over(looks) or not grid.coverage.worth(self._view)):
            grid.coverage.write_off(self._view)
            self.views += not self._given_up
            self.drop()
        if self._view is None and not self.done:
            self._search(grid, now_ns, target)
        return self.goal

    def follow(self, answer: GoalStatus | None, looks: int) -> None:
        """Take up what the controller says of the present goal."""
        if answer is None:
            return
        if answer.state == "failed":
            self.give_up()
        elif answer.state == "reached" and self._came_at is None:
            self._came_at = looks

    def give_up(self) -> None:
        """The robot does not get to the present view."""
        self._given_up = True

    def start_over(self) -> None:
        """Another mission: no view of it has been seen."""
        self.drop()
        self.views = 0

    def drop(self) -> None:
        """Leave the present view; what it shows may be sought again."""
        self.goal = self._view = self._came_at = None
        self.done = self._searching = self._given_up = False

    def _over(self, looks: int) -> bool:
        stayed = self._came_at is not None and looks - self._came_at >= self._looks
        return stayed or self._given_up

    def _search(self, grid: RollingMap, now_ns: int, target: str) -> None:
        coverage = grid.coverage
        if not self._searching:
            coverage.start_over()
        self._searching = True
        if not coverage.search(grid.reach):
            return
        view, self._searching = coverage.view, False
        if view is None:
            self.done = True
            return
        if not coverage.worth(view):  # rays that just missed a cell's corner
            coverage.write_off(view)
            return
        self._view = view
        yaw_rad = wrap_angle(view.heading_rad - coverage.camera_yaw_rad)
        pose = SE2(view.x_m, view.y_m, yaw_rad)
        self.goal = Goal(now_ns, pose, "look", 0, (view.x_m, view.y_m), 0.0, target)

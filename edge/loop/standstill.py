"""Noticing that the robot is held up; where no sensor shows by what, the map closes."""

from __future__ import annotations

from collections.abc import Callable

from edge.config import Config
from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.stuck import StuckDetector
from edge.types import Goal

# A controller that says that the robot is held up farther away than this mistakes the frame.
_HELD_UP_M = 2.0


class Standstill:
    """Whichever goals they are: a robot that is held up may be given one after another.

    Args:
        event: tells of something that a person would want to know.
    """

    def __init__(self, config: Config, event: Callable[[str, int], None]) -> None:
        self._radius_m, self._event = config.robot.radius_m, event
        self._any, self._far = (
            StuckDetector(config.mission.stuck_s, config.motion.stuck_m) for _ in range(2)
        )

    def reset(self) -> None:
        """The pose jumped."""
        self._any.reset()
        self._far.reset()

    def noticed(self, grid: RollingMap, pose: SE2, goal: Goal | None, now_ns: int) -> bool:
        """Whether the robot, driving to this goal (None: to none), does not move.

        A robot that was only to turn on the spot is not held up by what is ahead.
        """
        told = goal is not None
        far = told and pose.distance_to(goal.pose.x_m, goal.pose.y_m) > self._radius_m
        stuck = self._any.update(pose, told, now_ns)
        if self._far.update(pose, far, now_ns):
            self._hold_up(grid, pose, pose.ahead(self._radius_m), now_ns)
        return stuck

    def told(
        self, grid: RollingMap, pose: SE2, place: tuple[float, float] | None, now_ns: int
    ) -> None:
        """The controller said that the robot is held up at a place, or, by None, nothing."""
        if place is not None and pose.distance_to(*place) <= _HELD_UP_M:
            self._hold_up(grid, pose, place, now_ns)

    def _hold_up(
        self, grid: RollingMap, pose: SE2, place: tuple[float, float], now_ns: int
    ) -> None:
        """Where no sensor shows what is there only driving can tell: the map closes."""
        where = f"held up at ({place[0]:.2f}, {place[1]:.2f})"
        if grid.bumps.explained(pose, place, self._radius_m):
            self._event(f"{where} by what the map shows", now_ns)
            return
        self._event(f"{where}: the map closes there", now_ns)
        grid.bumps.close(*place, now_ns)

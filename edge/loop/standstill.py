"""Noticing that the robot is held up; where no sensor shows by what, the map closes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from edge.config import Config
from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.stuck import StuckDetector
from edge.types import Goal

# A controller that says that the robot is held up farther away than this mistakes the frame.
_HELD_UP_M = 2.0
# What is told of one place again so soon is of one and the same standstill.
_AGAIN_NS, _SAME_M = 2_000_000_000, 0.3
# Who stood there has gone by then: what the map shows does not explain a third standstill.
_EXPLAINED, _REMEMBERED = 2, 64


class Standstill:
    """Whichever goals they are: a robot that is held up may be given one after another.

    Args:
        event: tells of something that a person would want to know.
    """

    def __init__(self, config: Config, event: Callable[[str, int], None]) -> None:
        self._radius_m, self._event = config.robot.radius_m, event
        self._any, self._far = (StuckDetector(config.mission.stuck_s) for _ in range(2))
        self._explained: deque[tuple[float, float, int]] = deque(maxlen=_REMEMBERED)

    def reset(self) -> None:
        """The pose jumped."""
        self._any.reset()
        self._far.reset()
        self._explained.clear()

    def noticed(self, grid: RollingMap, pose: SE2, goal: Goal | None, now_ns: int) -> bool:
        """Whether the robot, driving to this goal (None: to none), does not move.

        A robot that was only to turn on the spot is not held up by what is ahead.
        """
        far = goal is not None and pose.distance_to(goal.pose.x_m, goal.pose.y_m) > self._radius_m
        stuck = self._any.update(pose, goal is not None, now_ns)
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
        if grid.bumps.explained(pose, place, self._radius_m) and self._waits(place, now_ns):
            self._event(f"{where} by what the map shows", now_ns)
            return
        closed = grid.bumps.close(pose, place, self._radius_m, now_ns)
        done = "the map closes there" if closed else "it drove there before, the map stays open"
        self._event(f"{where}: {done}", now_ns)

    def _waits(self, place: tuple[float, float], now_ns: int) -> bool:
        """Whether it may be someone who goes, that the robot waited for so often there."""
        before = [t for x, y, t in self._explained if math.dist((x, y), place) <= _SAME_M]
        if not before or now_ns - before[-1] > _AGAIN_NS:
            self._explained.append((*place, now_ns))
            before.append(now_ns)
        return len(before) <= _EXPLAINED

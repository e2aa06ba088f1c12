"""Detection of a blocked robot. If no sensor shows the obstacle, it is closed in the map."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from edge.config import Config
from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.stuck import StuckDetector
from edge.types import Goal

# A controller that reports a blocked place farther away than this uses the wrong frame.
_HELD_UP_M = 2.0
# Reports for one place within this time belong to the same standstill.
_AGAIN_NS, _SAME_M = 2_000_000_000, 0.3
# After this number of standstills at a place, the obstacle in the map is not accepted as the
# reason any more: a person would have left by then.
_EXPLAINED, _REMEMBERED = 2, 64


class StandstillMonitor:
    """A monitor for a robot that does not move although it should.

    It does not depend on single goals, because a blocked robot may get one goal after another.

    Args:
        config: The configuration.
        event: Reports an event for people, at a loop time.
    """

    def __init__(self, config: Config, event: Callable[[str, int], None]) -> None:
        self._radius_m, self._event = config.robot.radius_m, event
        self._any, self._far = (StuckDetector(config.mission.stuck_s) for _ in range(2))
        self._explained: deque[tuple[float, float, int]] = deque(maxlen=_REMEMBERED)

    def reset(self) -> None:
        """Forget everything, after a pose jump."""
        self._any.reset()
        self._far.reset()
        self._explained.clear()

    def update(self, grid: RollingMap, pose: SE2, goal: Goal | None, now_ns: int) -> bool:
        """Return True if the robot drives to this goal (None: no goal) and does not move.

        A robot that only turns on the spot is not blocked by an obstacle ahead.
        """
        far = goal is not None and pose.distance_to(goal.pose.x_m, goal.pose.y_m) > self._radius_m
        stuck = self._any.update(pose, goal is not None, now_ns)
        if self._far.update(pose, far, now_ns):
            self._hold_up(grid, pose, pose.ahead(self._radius_m), now_ns)
        return stuck

    def on_blocked(
        self, grid: RollingMap, pose: SE2, place: tuple[float, float] | None, now_ns: int
    ) -> None:
        """Handle a blocked place that the controller reported; None if it reported none."""
        if place is not None and pose.distance_to(*place) <= _HELD_UP_M:
            self._hold_up(grid, pose, place, now_ns)

    def _hold_up(
        self, grid: RollingMap, pose: SE2, place: tuple[float, float], now_ns: int
    ) -> None:
        """Close the map at the place, unless the map already shows an obstacle there."""
        where = f"blocked at ({place[0]:.2f}, {place[1]:.2f})"
        if grid.bumps.explained_by_obstacle(pose, place, self._radius_m) and self._waits(
            place, now_ns
        ):
            self._event(f"{where} by an obstacle in the map", now_ns)
            return
        closed = grid.bumps.close(pose, place, self._radius_m, now_ns)
        done = "place closed in the map" if closed else "not closed, the robot drove there before"
        self._event(f"{where}: {done}", now_ns)

    def _waits(self, place: tuple[float, float], now_ns: int) -> bool:
        """Return True if the obstacle may be a person who leaves: few standstills here so far."""
        before = [t for x, y, t in self._explained if math.dist((x, y), place) <= _SAME_M]
        if not before or now_ns - before[-1] > _AGAIN_NS:
            self._explained.append((*place, now_ns))
            before.append(now_ns)
        return len(before) <= _EXPLAINED

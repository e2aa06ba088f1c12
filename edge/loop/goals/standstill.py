"""Detection of a blocked robot. If no sensor shows the obstacle, its place is closed in the map."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from edge.config import Config
from edge.geometry import SE2
from edge.mapping.bumps import explained_by_obstacle
from edge.mapping.grid import RollingMap
from edge.stuck import StuckDetector
from edge.types import Goal

# A controller that reports a blocked place farther away than this uses the wrong frame.
_MAX_DISTANCE_M = 2.0
# Reports for one place within this time belong to the same standstill.
_SAME_NS = 2_000_000_000
# Reports this near to each other are for one place.
_SAME_M = 0.3
# After this number of standstills at a place, the obstacle in the map is no longer accepted as
# the reason: a person would have left by then.
_MAX_EXPLAINED = 2
# Largest number of remembered standstills.
_MAX_REMEMBERED = 64


class StandstillMonitor:
    """A monitor for a robot that does not move although it should.

    The monitor does not depend on single goals: a blocked robot may get one goal after another.
    """

    def __init__(self, config: Config, event: Callable[[str, int], None]) -> None:
        self._radius_m, self._event = config.robot.radius_m, event
        self._still, self._still_far_from_goal = (
            StuckDetector(config.mission.stuck_s) for _ in range(2)
        )
        # Standstills at obstacles that the map shows: x [m], y [m], loop time [ns].
        self._explained: deque[tuple[float, float, int]] = deque(maxlen=_MAX_REMEMBERED)

    def reset(self) -> None:
        """Forget everything, after a pose jump."""
        self._still.reset()
        self._still_far_from_goal.reset()
        self._explained.clear()

    def update(self, grid: RollingMap, pose: SE2, goal: Goal | None, now_ns: int) -> bool:
        """Return True if the robot should drive to this goal (None: no goal) and does not move.

        If the goal is also farther away than the robot's radius, the place ahead of the robot is
        handled as blocked. A nearer goal is a turn on the spot, which no obstacle ahead blocks.
        """
        far = goal is not None and pose.distance_to(goal.pose.x_m, goal.pose.y_m) > self._radius_m
        stuck = self._still.update(pose, goal is not None, now_ns)
        if self._still_far_from_goal.update(pose, far, now_ns):
            self._handle_blocked_place(grid, pose, pose.ahead(self._radius_m), now_ns)
        return stuck

    def on_blocked(
        self, grid: RollingMap, pose: SE2, place: tuple[float, float] | None, now_ns: int
    ) -> None:
        """Handle a blocked place that the controller reported; None if it reported none."""
        if place is not None and pose.distance_to(*place) <= _MAX_DISTANCE_M:
            self._handle_blocked_place(grid, pose, place, now_ns)

    def _handle_blocked_place(
        self, grid: RollingMap, pose: SE2, place: tuple[float, float], now_ns: int
    ) -> None:
        """Close the map at the place, unless the map already shows an obstacle there."""
        blocked = f"blocked at ({place[0]:.2f}, {place[1]:.2f})"
        is_explained = explained_by_obstacle(
            grid.layers, grid.window, grid.config.inflation_m, pose, place, self._radius_m
        )
        if is_explained and self._may_leave(place, now_ns):
            self._event(f"{blocked} by an obstacle in the map", now_ns)
            return
        closed = grid.bumps.close(pose, place, self._radius_m, now_ns)
        outcome = (
            "this place is now closed in the map"
            if closed
            else "this place stays open in the map, because the robot drove there before"
        )
        self._event(f"{blocked}: {outcome}", now_ns)

    def _may_leave(self, place: tuple[float, float], now_ns: int) -> bool:
        """Return True if the obstacle may be a person who leaves: few standstills here so far."""
        times_ns = [t for x, y, t in self._explained if math.dist((x, y), place) <= _SAME_M]
        if not times_ns or now_ns - times_ns[-1] > _SAME_NS:
            self._explained.append((*place, now_ns))
            times_ns.append(now_ns)
        return len(times_ns) <= _MAX_EXPLAINED

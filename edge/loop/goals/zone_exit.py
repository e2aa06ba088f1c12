"""The way out of a zone that the robot is in: the goal outside of it."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from edge.geometry import SE2
from edge.loop.goals.goal import GoalTracker
from edge.loop.goals.known_goals import goal_at_pose
from edge.mapping.grid import RollingMap
from edge.mission.run import MissionRun
from edge.policies.base import PolicyInput
from edge.types import Goal

_EXIT_M = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Radii of the search for a free cell outside the zone, tried in this order."""
_BEYOND_M, _BEYOND_RADIUS_M = 0.35, 0.15
"""Distance of the goal behind that cell, and radius of the search for a free cell there. A goal at
the edge would count as reached while the robot is still in the zone."""


class ZoneExit:
    """Leads the robot out of zones; for the loop's thread.

    Args:
        event: Reports an event for people, at a loop time, with the level of its log record.
    """

    def __init__(self, goals: GoalTracker, event: Callable[[str, int, int], None]) -> None:
        self._goals, self._event = goals, event
        self._in_zone = False

    def goal(self, grid: RollingMap, mission: MissionRun, context: PolicyInput) -> Goal | None:
        """Return a goal outside the zone that the robot is in, or None if it is in none."""
        robot, now_ns = context.pose, context.now_ns
        inside = grid.zones.any and grid.zones.contains(robot.x_m, robot.y_m)
        if inside != self._in_zone:
            self._in_zone = inside
            text = "inside a zone: leaving it by the shortest way" if inside else "left the zone"
            self._event(text, now_ns, logging.WARNING if inside else logging.INFO)
        if not inside:
            return None
        for radius_m in _EXIT_M:
            # The nearest free cell, then a free cell `_BEYOND_M` farther, if there is one.
            if (cell := grid.travel_cost.nearest(robot.x_m, robot.y_m, radius_m)) is not None:
                yaw_rad = math.atan2(cell[1] - robot.y_m, cell[0] - robot.x_m)
                beyond_m = SE2(*cell[:2], yaw_rad).ahead(_BEYOND_M)
                x_m, y_m, _ = grid.travel_cost.nearest(*beyond_m, _BEYOND_RADIUS_M) or cell
                # Keep the goal while the robot drives to it, although the nearest cell changes.
                apart_m = 0.0 if self._goals.arrived else _EXIT_M[0]
                pose, before = SE2(x_m, y_m, yaw_rad), self._goals.goal
                goal = goal_at_pose(before, "zone_exit", pose, mission.target, now_ns, apart_m)
                return self._goals.chooser.drive_to(goal)
        return None

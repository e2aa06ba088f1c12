"""What the instances that were seen mean to a mission."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from edge.mission.run import MissionRun
from edge.types import Goal

if TYPE_CHECKING:
    from edge.perception.instances import InstanceTracker


def newest_ids(
    tracker: InstanceTracker, targets: Iterable[str], sure: bool = False
) -> dict[str, int]:
    """For each target of which an instance is known, the highest id of them.

    Args:
        sure: only confirmed ones count.
    """
    known = {}
    for label in targets:
        if found := tracker.of(label, sure):
            known[label] = max(instance.id for instance in found)
    return known


def places(tracker: InstanceTracker, letters: Iterable[str]) -> list[np.ndarray]:
    """For each letter the (m, 2) float64 positions of its known instances in `map`."""
    found = [[instance.center_m[:2] for instance in tracker.of(label)] for label in letters]
    return [np.array(xy, np.float64).reshape(-1, 2) for xy in found]


class Neighbours:
    """Reports, before the robot stops there, a goal beside what must not be reached now.

    Each thing is told once, until a goal is not beside it.
    """

    def __init__(self, reach_m: float) -> None:
        self._reach_m = reach_m
        self._warned_of: set[int] = set()

    def look(self, goal: Goal, mission: MissionRun, tracker: InstanceTracker, now_ns: int) -> None:
        """Warn of what lies within reach of a new goal."""
        near: set[int] = set()
        for label in mission.forbidden:
            for instance in tracker.of(label):
                away_m = instance.distance_m(goal.pose.x_m, goal.pose.y_m)
                if away_m <= self._reach_m:
                    near.add(instance.id)
                    if instance.id not in self._warned_of:
                        text = f"goal {away_m:.1f} m from {label}, which must not be reached now"
                        mission.warn(label, text, now_ns)
        self._warned_of = near

    def forget(self) -> None:
        """Another mission forbids other things."""
        self._warned_of = set()

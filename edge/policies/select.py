"""From scored candidates to one published goal (VL-Nav III.E, algorithm 2)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from edge.geometry import SE2
from edge.loop.candidates import FRONTIER, INSTANCE, CandidatePool
from edge.mapping.grid import RollingMap
from edge.policies.base import Policy, bearing, ranked
from edge.types import CandidateKind, Goal, Instance

_KINDS: dict[int, CandidateKind] = {FRONTIER: "frontier", INSTANCE: "instance"}
# How far from its candidate a goal cell may lie: a frontier borders free space, an instance's
# surface is behind inflation and often on a table.
_SNAP_M = {FRONTIER: 0.6, INSTANCE: 1.5}
# A frontier that vanished while another stands this near was merely redrawn.
_HEIR_M = 1.0
_MOVE_SHARE = 0.25
_LOOKS = 3
_LOOK_AFTER_NS = 1_000_000_000
# A frontier left so often for another, or because it vanished, before the robot came there, shows
# from afar alone or is farther than it looks: then it is seen through, or left alone.
_FICKLE, _SAME_M, _LEFT = 3, 0.6, 64
# From afar the rim of what is known flickers: a frontier that turns up later has to last.
LASTING_NS = 2_000_000_000


class GoalSelector:
    """Holds the present goal, changes it for a clearly better one, drops it when it is void.

    Attributes:
        goal: what was last chosen; None when nothing can be chosen.
        exhausted: nothing was left to go to, and looking around showed nothing new. What turns
            up since is gone to, but the robot does not look around after it.
    """

    def __init__(self, policy: Policy, move_m: float = 0.3) -> None:
        self.goal: Goal | None = None
        self.exhausted = False
        self._policy = policy
        self._move_m = move_m
        self._peak = 0.0  # the best score of the present goal's candidate
        self._looks = 0
        self._idle_since_ns: int | None = None
        self._left: deque[tuple[float, float]] = deque(maxlen=_LEFT)

    def select(
        self,
        pool: CandidatePool,
        grid: RollingMap,
        instances: Mapping[int, Instance],
        pose: SE2,
        now_ns: int,
        target: str,
    ) -> Goal | None:
        """The goal of this tick; the same object as before while it stands.

        Args:
            instances: live instances by id, for their surface points.

        Returns:
            A goal on a free cell that the robot can reach, facing its candidate; or None.
        """
        order = ranked(pool, pose, self._policy.delta_reached_m)
        if self.exhausted:
            lasting = pool.first_seen_ns[order] <= pool.stamp_ns - LASTING_NS
            order = order[lasting | (pool.kind[order] == INSTANCE)]
        present, goal = self._present(pool), self.goal
        choice = self._choose(order, present, pool, grid, instances, pose)
        if goal is not None and goal.kind == "frontier" and (not choice or choice[0] != present):
            self._left.append(goal.candidate_xy_m)
        if choice is None:
            self.goal = self._look_around(pose, now_ns, target)
            return self.goal
        index, cell = choice
        self._idle_since_ns = None
        if not self.exhausted:
            self._looks = 0
        same = index == present
        self._peak = max(self._peak if same else 0.0, float(pool.score[index]))
        if not (same and self._stands(cell, grid, pose)):
            self.goal = _goal(index, cell, pool, now_ns, target)
        return self.goal

    def fickle(self, xy_m: tuple[float, float]) -> bool:
        """Whether a frontier was left too often before the robot came there."""
        return sum(math.dist(xy_m, left) < _SAME_M for left in self._left) >= _FICKLE

    def drop(self) -> None:
        """Forget the present goal; the next tick chooses afresh."""
        self.goal = None

    def _choose(
        self,
        order: np.ndarray,
        present: int,
        pool: CandidatePool,
        grid: RollingMap,
        instances: Mapping[int, Instance],
        pose: SE2,
    ) -> tuple[int, tuple[float, float]] | None:
        """The best reachable candidate, or the present one where that is about as good."""
        if present not in order:
            present = -1
        for index in map(int, order):
            cell = _goal_cell(index, pool, grid, instances, pose)
            if cell is None:
                continue
            if present in (-1, index) or self._beats(index, present, pool):
                return index, cell
            kept = _goal_cell(present, pool, grid, instances, pose)
            return (present, kept) if kept is not None else (index, cell)
        return None

    def _beats(self, index: int, present: int, pool: CandidatePool) -> bool:
        """Whether a better-ranked candidate is worth a change of goal.

        An instance is seen through: its score falls while the robot comes too near to see it
        whole, and must not make it turn to another, whose score then falls, and back. So is a
        frontier that was left often: the way to it may lead past where the other scores better.
        """
        if pool.kind[index] != pool.kind[present] or pool.sure[index] != pool.sure[present]:
            return True
        assert self.goal is not None
        if pool.kind[index] == FRONTIER and self.fickle(self.goal.candidate_xy_m):
            return False
        margin = 1.0 + self._policy.switch_margin
        if pool.kind[index] == INSTANCE:
            return bool(pool.score[index] > margin * self._peak)
        return bool(pool.score[index] > margin * pool.score[present])

    def _present(self, pool: CandidatePool) -> int:
        """The candidate of the present goal: by identity, or a frontier that took its place."""
        goal = self.goal
        if goal is None or goal.kind == "look":
            return -1
        if goal.kind == "instance":
            return pool.index_of(INSTANCE, goal.candidate_id)
        same = pool.index_of(FRONTIER, goal.candidate_id)
        return same if same >= 0 else pool.nearest(FRONTIER, goal.candidate_xy_m, _HEIR_M)

    def _stands(self, cell: tuple[float, float], grid: RollingMap, pose: SE2) -> bool:
        """Whether the published goal still serves its candidate, whose best cell is `cell` now.

        A cell far ahead may move farther before the controller need hear of it.
        """
        goal = self.goal
        assert goal is not None
        free = grid.state_at(goal.pose.x_m, goal.pose.y_m) == 0
        allowed_m = max(self._move_m, _MOVE_SHARE * pose.distance_to(*cell))
        return free and goal.pose.distance_to(*cell) < allowed_m

    def _look_around(self, pose: SE2, now_ns: int, target: str) -> Goal | None:
        """With nowhere to go, turn on the spot; the space behind may never have been seen."""
        if self.exhausted:
            return None
        if self._idle_since_ns is None:
            self._idle_since_ns = now_ns
        if self.goal is not None and self.goal.kind == "look":
            return self.goal
        if now_ns - self._idle_since_ns < _LOOK_AFTER_NS:
            return None
        if self._looks == _LOOKS:
            self.exhausted = True
            return None
        self._looks += 1
        ahead = SE2(pose.x_m, pose.y_m, pose.yaw_rad + 2.0 * math.pi / _LOOKS)
        return Goal(now_ns, ahead, "look", 0, (pose.x_m, pose.y_m), 0.0, target)

    def looked(self, now_ns: int) -> None:
        """The turn of a `look` goal is done (or failed)."""
        self.goal = None
        self._idle_since_ns = now_ns

    def start_over(self) -> None:
        """Look around again, as after new space or a lifted discard."""
        self.exhausted, self._looks, self._idle_since_ns = False, 0, None
        self._left.clear()


def _goal_cell(
    index: int,
    pool: CandidatePool,
    grid: RollingMap,
    instances: Mapping[int, Instance],
    pose: SE2,
) -> tuple[float, float] | None:
    """The reachable free cell to stand on for a candidate."""
    kind = int(pool.kind[index])
    x, y = float(pool.xy_m[index, 0]), float(pool.xy_m[index, 1])
    if kind == INSTANCE:
        instance = instances.get(int(pool.id[index]))
        if instance is None:  # refuted since the candidates were gathered
            return None
        points = instance.points_m[:, :2]
        away = np.hypot(points[:, 0] - pose.x_m, points[:, 1] - pose.y_m)
        x, y = map(float, points[int(np.argmin(away))])
    found = grid.reach.nearest(x, y, _SNAP_M[kind])
    return None if found is None else (found[0], found[1])


def _goal(
    index: int, cell: tuple[float, float], pool: CandidatePool, now_ns: int, target: str
) -> Goal:
    x, y = float(pool.xy_m[index, 0]), float(pool.xy_m[index, 1])
    pose = SE2(cell[0], cell[1], bearing(cell[0], cell[1], x, y))
    kind = _KINDS[int(pool.kind[index])]
    return Goal(now_ns, pose, kind, int(pool.id[index]), (x, y), float(pool.score[index]), target)

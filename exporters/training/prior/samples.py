"""Partial views of houses with the objects still to be found: the training data of a prior.

In each house a robot explores from a few places by √area/(path + 1 m), the best geometric choice,
for all targets. At every other decision each frontier is a sample: the objects seen near it, and
whether an unseen object stands near it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.jit import jit
from edge.mapping import regions
from edge.perception.prior import rooms
from edge.perception.prior.cooccurrence import NEAR_M
from edge.perception.prior.nearby import nearby
from exporters.training.prior.explorer import Explorer, Frontiers, clear, paths_m
from exporters.training.prior.house import CELL_M, Plan

RUNS = 2
"""Explorations of each house."""
_STEP_M = 1.0  # driven distance between two decisions
_MAX_DECISIONS = 100  # of one exploration
_EVERY = 2  # each second decision gives samples
REGION_M = 0.7
"""Largest distance of an object from the cells of its region, since it may be part of a wall."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """One sample for each frontier of a decision; n samples of m objects and k kinds of room.

    Attributes:
        house: (n,) int32.
        near: (n, m) bool, objects seen near the place, in line of sight.
        held: (n, m) bool, objects seen in the place's region.
        beside: (n, m) bool, objects seen in the neighbouring region (see `rooms.adjacent_regions`).
        kind: (n,) int8, kind of the room that most of the region belongs to; -1 for none.
        wanted: (n, m) bool, objects of the house that were not seen yet.
        found: (n, m) bool, wanted objects near the place, in line of sight.
    """

    house: np.ndarray
    near: np.ndarray
    held: np.ndarray
    beside: np.ndarray
    kind: np.ndarray
    wanted: np.ndarray
    found: np.ndarray


class PriorInputs:
    """The robot's knowledge in the form of a prior's inputs.

    Args:
        explorer: the robot.
        frontiers: its current frontiers.
        row: index of each of the plan's objects in the prior's table; -1 for none.
        m: number of objects in the table.

    Attributes:
        near: see `Samples`, for the current frontiers.
        held: see `Samples`.
        beside: see `Samples`.
        region: (n,) int16, region of each frontier; 0 for none.
        label: grid of regions.
    """

    def __init__(self, explorer: Explorer, frontiers: Frontiers, row: np.ndarray, m: int) -> None:
        n, grid = len(frontiers.cell), explorer.survey()
        self.label, n_regions = regions.segment_rooms(grid.cells, CELL_M)
        seen = np.flatnonzero(explorer.seen & (row >= 0))
        thing_m, rows = explorer.seen_m[seen], row[seen].astype(np.int32)
        near, sure = np.empty((n, m), np.float32), np.ones(len(seen), np.float32)
        wall = grid.cells == regions.WALL
        nearby(
            wall, 0.0, 0.0, CELL_M, frontiers.xy_m, n, thing_m, rows, sure, len(seen), NEAR_M, near
        )  # fmt: skip
        at, self.region = np.empty(len(seen), np.int16), np.empty(n, np.int16)
        regions.regions_at(self.label, 0.0, 0.0, CELL_M, thing_m, len(seen), REGION_M, at)
        regions.regions_at(self.label, 0.0, 0.0, CELL_M, frontiers.xy_m, n, REGION_M, self.region)
        held = np.zeros((n_regions + 1, m), np.bool_)
        held[at, rows] = True
        held[0] = False
        next_to = rooms.adjacent_regions(regions.border_lengths(self.label, n_regions), held)
        self.near, self.held = near > 0, held[self.region]
        self.beside = held[next_to[self.region]]


def gather(
    plans: Sequence[Plan], things: Sequence[str], kinds: Sequence[str], seed: int = 0
) -> Samples:
    """Explore every house `RUNS` times; return the samples."""
    row_of = {name: i for i, name in enumerate(things)}
    columns: list[tuple[np.ndarray, ...]] = []
    for number, plan in enumerate(plans):
        random = np.random.default_rng((seed, number))
        row = np.array([row_of.get(plan.words[w], -1) for w in plan.word], np.int64)
        starts = standing(plan)
        kind = np.array([kinds.index(k) for k in plan.kinds], np.int8)
        for _ in range(RUNS if len(starts) else 0):
            start = starts[random.integers(len(starts))]
            explorer = Explorer(plan, (int(start[0]), int(start[1])), random)
            for turn in range(_MAX_DECISIONS):
                frontiers = explorer.frontiers()
                if not len(frontiers.cell):
                    break
                if turn % _EVERY == 0:
                    columns.append(_sample(number, explorer, frontiers, row, len(things), kind))
                best = np.argmax(np.sqrt(frontiers.area_m2) / (frontiers.path_m + 1.0))
                explorer.drive(frontiers.cell[best], _STEP_M)
    return Samples(*map(np.concatenate, zip(*columns, strict=True)))


def standing(plan: Plan) -> np.ndarray:
    """Return the cells from which a robot can reach most of the house: (n, 2) int64."""
    best = np.zeros((0, 2), np.int64)
    free = np.argwhere(~plan.closed)
    for start in free[:: max(len(free) // 8, 1)]:
        reached = np.argwhere(np.isfinite(paths_m(plan, (int(start[0]), int(start[1])))))
        best = max(best, reached, key=len)
    return best


def _sample(
    number: int, explorer: Explorer, frontiers: Frontiers, row: np.ndarray, m: int, kind: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return one decision's rows, in the order of the fields of `Samples`."""
    plan, n = explorer.plan, len(frontiers.cell)
    views = PriorInputs(explorer, frontiers, row, m)
    room = _rooms(views.label, plan.room, len(kind))[views.region]
    wanted, found = np.zeros(m, np.bool_), np.zeros((n, m), np.bool_)
    unseen = np.flatnonzero(~explorer.seen & (row >= 0))
    wanted[row[unseen]] = True
    wanted[row[explorer.seen & (row >= 0)]] = False
    stands_near(
        plan.wall, CELL_M, frontiers.xy_m, explorer.thing_m[unseen], plan.half_m[unseen],
        row[unseen], NEAR_M, found,
    )  # fmt: skip
    return (
        np.full(n, number, np.int32),
        views.near,
        views.held,
        views.beside,
        np.where(room < 0, -1, kind[room]).astype(np.int8),
        np.tile(wanted, (n, 1)),
        found,
    )


def _rooms(label: np.ndarray, room: np.ndarray, n_rooms: int) -> np.ndarray:
    """Return the room that most of each region belongs to; -1 for region 0 and for none."""
    inside = (label > 0) & (room >= 0)
    count = np.zeros((int(label.max(initial=0)) + 1, n_rooms), np.int64)
    np.add.at(count, (label[inside], room[inside]), 1)
    return np.where(count.any(1), count.argmax(1), -1)


@jit
def stands_near(wall, cell_m, xy_m, thing_m, half_m, row, radius_m, out):
    """Mark the kinds of objects that stand near a place, with no wall between."""
    for i in range(len(xy_m)):
        for j in range(len(row)):
            x, y, tx, ty = xy_m[i, 0], xy_m[i, 1], thing_m[j, 0], thing_m[j, 1]
            near = (tx - x) ** 2 + (ty - y) ** 2 <= radius_m * radius_m
            if near and clear(wall, x, y, tx, ty, half_m[j] + 0.15, cell_m):
                out[i, row[j]] = True

"""Training data of the prior: objects that are seen, and objects that are still to be found.

In each house a robot explores from a few places. It drives to the frontier with the largest
√area/(path + 1 m), the best choice by geometry. At every second decision each frontier is a sample:
the objects seen near it, and the unseen objects that stand near it.
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
from exporters.training.prior.explorer import WALL_GAP_M, Explorer, Frontiers, is_clear, paths_m
from exporters.training.prior.house import CELL_M, HousePlan

RUNS = 2
"""Explorations of each house."""
_STEP_M = 1.0  # driven distance between two decisions
_MAX_DECISIONS = 100  # of one exploration
_EVERY = 2  # each second decision gives samples
REGION_M = 0.7
"""Largest distance of an object from the cells of its region, since it may stand in a wall's
cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples, one for each frontier of a decision: n samples, m objects of the prior's table.

    An object of the table is a name, such as "chair", for all chairs of a house.

    A region is a part of the map behind doors, as the service finds it.

    Attributes:
        house: (n,) int32, number of the house.
        near: (n, m) bool, objects seen near the place, in line of sight.
        in_region: (n, m) bool, objects seen in the place's region.
        in_adjacent: (n, m) bool, objects seen in the neighbouring region; see
            `rooms.adjacent_regions`.
        kind: (n,) int8, kind of the room that most of the region belongs to; -1 for none.
        wanted: (n, m) bool, objects of the house that were not seen yet.
        found: (n, m) bool, wanted objects near the place, in line of sight.
    """

    house: np.ndarray
    near: np.ndarray
    in_region: np.ndarray
    in_adjacent: np.ndarray
    kind: np.ndarray
    wanted: np.ndarray
    found: np.ndarray


class PriorInputs:
    """The robot's knowledge in the form of the prior's inputs, for its current frontiers.

    Args:
        row: index of each of the plan's objects in the prior's table; -1 for none.
        m: number of objects in the prior's table.

    Attributes:
        near: see `Samples`, for the current frontiers.
        in_region: see `Samples`.
        in_adjacent: see `Samples`.
        region: (n,) int16, region of each frontier; 0 for none.
        label: (h, w) region of each cell of the map; 0 for none.
    """

    def __init__(self, explorer: Explorer, frontiers: Frontiers, row: np.ndarray, m: int) -> None:
        n, grid = len(frontiers.cell), explorer.wall_grid()
        self.label, n_regions = regions.segment_rooms(grid.cells, CELL_M)
        seen = np.flatnonzero(explorer.seen & (row >= 0))
        object_m, rows = explorer.seen_m[seen], row[seen].astype(np.int32)
        near, weight = np.empty((n, m), np.float32), np.ones(len(seen), np.float32)
        wall = grid.cells == regions.WALL
        nearby(
            wall, 0.0, 0.0, CELL_M, frontiers.xy_m, n, object_m, rows, weight, len(seen), NEAR_M,
            near,
        )  # fmt: skip
        # Region of each seen object (`at`), and of each frontier.
        at, self.region = np.empty(len(seen), np.int16), np.empty(n, np.int16)
        regions.regions_at(self.label, 0.0, 0.0, CELL_M, object_m, len(seen), REGION_M, at)
        regions.regions_at(self.label, 0.0, 0.0, CELL_M, frontiers.xy_m, n, REGION_M, self.region)
        by_region = np.zeros((n_regions + 1, m), np.bool_)  # objects seen in each region
        by_region[at, rows] = True
        by_region[0] = False  # 0 is no region
        adjacent = rooms.adjacent_regions(regions.border_lengths(self.label, n_regions), by_region)
        self.near, self.in_region = near > 0, by_region[self.region]
        self.in_adjacent = by_region[adjacent[self.region]]


def gather(
    plans: Sequence[HousePlan], classes: Sequence[str], kinds: Sequence[str], seed: int = 0
) -> Samples:
    """Explore every house `RUNS` times; return the samples."""
    row_of = {name: i for i, name in enumerate(classes)}
    parts: list[tuple[np.ndarray, ...]] = []  # of each decision
    for number, plan in enumerate(plans):
        random = np.random.default_rng((seed, number))
        # For each object of the house, its row in the table; -1 for none.
        row = np.array([row_of.get(plan.words[w], -1) for w in plan.word], np.int64)
        starts = starting_cells(plan)
        kind = np.array([kinds.index(k) for k in plan.kinds], np.int8)
        for _ in range(RUNS if len(starts) else 0):
            start = starts[random.integers(len(starts))]
            explorer = Explorer(plan, (int(start[0]), int(start[1])), random)
            for turn in range(_MAX_DECISIONS):
                frontiers = explorer.frontiers()
                if not len(frontiers.cell):
                    break
                if turn % _EVERY == 0:
                    parts.append(_sample(number, explorer, frontiers, row, len(classes), kind))
                best = np.argmax(np.sqrt(frontiers.area_m2) / (frontiers.path_m + 1.0))
                explorer.drive(frontiers.cell[best], _STEP_M)
    return Samples(*map(np.concatenate, zip(*parts, strict=True)))


def starting_cells(plan: HousePlan) -> np.ndarray:
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
    """Return the samples of one decision, in the order of the fields of `Samples`."""
    plan, n = explorer.plan, len(frontiers.cell)
    views = PriorInputs(explorer, frontiers, row, m)
    room = _rooms(views.label, plan.room, len(kind))[views.region]
    wanted, found = np.zeros(m, np.bool_), np.zeros((n, m), np.bool_)
    unseen = np.flatnonzero(~explorer.seen & (row >= 0))
    # A kind of which one object was seen is not wanted any more.
    wanted[row[unseen]] = True
    wanted[row[explorer.seen & (row >= 0)]] = False
    stands_near(
        plan.wall, CELL_M, frontiers.xy_m, explorer.object_m[unseen], plan.half_m[unseen],
        row[unseen], NEAR_M, found,
    )  # fmt: skip
    return (
        np.full(n, number, np.int32),
        views.near,
        views.in_region,
        views.in_adjacent,
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
def stands_near(wall, cell_m, xy_m, object_m, half_m, row, radius_m, out):
    """Mark in `out` (n, m) the table's objects near each of n positions, in line of sight.

    Of k objects of the house, `object_m` (k, 2), `half_m` (k,) and `row` (k,) are position, half
    of the smaller side, and row in the table.
    """
    for i in range(len(xy_m)):
        for j in range(len(row)):
            x, y, tx, ty = xy_m[i, 0], xy_m[i, 1], object_m[j, 0], object_m[j, 1]
            near = (tx - x) ** 2 + (ty - y) ** 2 <= radius_m * radius_m
            if near and is_clear(wall, x, y, tx, ty, half_m[j] + WALL_GAP_M, cell_m):
                out[i, row[j]] = True

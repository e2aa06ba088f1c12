"""A* against a plain Dijkstra, its refusals, and its workspace."""

from __future__ import annotations

import heapq
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.trajectory import astar, kernels
from edge.trajectory.costmap import from_weights

WORKSPACE = astar.Workspace()  # shared on purpose: every search has to leave it clean


def dijkstra(weights: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Return least costs in cells by exact step lengths, no cut corners; inf: no path."""
    rows, columns = weights.shape

    def is_open(r: int, c: int) -> bool:
        return 0 <= r < rows and 0 <= c < columns and weights[r, c] > 0

    best, queue = {start: 0.0}, [(0.0, start)]
    while queue:
        cost, (r, c) = heapq.heappop(queue)
        if (r, c) == goal:
            return cost
        if cost > best[r, c]:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                near = (r + dr, c + dc)
                if (dr, dc) == (0, 0) or not is_open(*near):
                    continue
                if not (is_open(r + dr, c) and is_open(r, c + dc)):
                    continue
                through = cost + float(weights[near]) * math.hypot(dr, dc)
                if through < best.get(near, math.inf):
                    best[near] = through
                    heapq.heappush(queue, (through, near))
    return math.inf


def centre(cell: tuple[int, int]) -> tuple[float, float]:
    return cell[1] + 0.5, cell[0] + 0.5


def plan_cells(
    weights: np.ndarray, start: tuple[int, int], goal: tuple[int, int]
) -> astar.GridPath:
    costmap = from_weights(Grid(weights, (0.0, 0.0), 1.0), unit=1)
    return astar.plan(costmap, centre(start), centre(goal), WORKSPACE, escape_m=0.0)


def check_path(weights: np.ndarray, plan: astar.GridPath) -> None:
    """Check that the path steps between open neighbours and cuts no corner."""
    cells = np.floor(plan.path_m).astype(int)
    assert (weights[cells[:, 1], cells[:, 0]] > 0).all()
    for (c0, r0), (c1, r1) in itertools.pairwise(cells):
        assert max(abs(c1 - c0), abs(r1 - r0)) <= 1
        assert weights[r0, c1] > 0
        assert weights[r1, c0] > 0


@st.composite
def _problems(draw):
    rows, columns = draw(st.integers(1, 24)), draw(st.integers(1, 24))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    top = draw(st.sampled_from([1, 3, 10, 255]))
    weights = rng.integers(1, top + 1, (rows, columns)).astype(np.uint8)
    weights[rng.random((rows, columns)) < draw(st.sampled_from([0.0, 0.15, 0.35]))] = 0
    ends = [(int(rng.integers(rows)), int(rng.integers(columns))) for _ in range(2)]
    for end in ends:
        weights[end] = max(weights[end], 1)
    return weights, *ends


@given(_problems())
def test_cost_is_within_a_thousandth_of_dijkstra(problem):
    weights, start, goal = problem
    least = dijkstra(weights, start, goal)
    plan = plan_cells(weights, start, goal)
    if math.isinf(least):
        assert plan.reason == "unreachable"
        assert plan.path_m.shape == (0, 2)
        return
    assert plan.ok
    assert least * (1 - 1e-9) <= plan.cost_m <= least * 1.001
    assert tuple(plan.path_m[0]) == centre(start)
    assert tuple(plan.path_m[-1]) == centre(goal)
    check_path(weights, plan)


@pytest.mark.parametrize(("seed", "top"), [(0, 1), (1, 10), (2, 255)])
def test_large_grid_with_walls_against_dijkstra(seed, top):
    rng = np.random.default_rng(seed)
    weights = rng.integers(1, top + 1, (120, 150)).astype(np.uint8)
    for column in range(15, 150, 15):
        gap = int(rng.integers(0, 110))
        weights[:gap, column] = weights[gap + 4 :, column] = 0
    plan = plan_cells(weights, (0, 0), (119, 149))
    least = dijkstra(weights, (0, 0), (119, 149))
    assert least <= plan.cost_m * (1 + 1e-9)
    assert plan.cost_m <= least * 1.001
    check_path(weights, plan)


@pytest.mark.parametrize(
    ("shape", "start", "goal", "reason"),
    [
        ((0, 0), (0.5, 0.5), (0.5, 0.5), "start outside the map"),
        ((1, 1), (0.5, 0.5), (0.5, 0.5), ""),
        ((1, 1), (-0.5, 0.5), (0.5, 0.5), "start outside the map"),
        ((1, 1), (0.5, 0.5), (1.5, 0.5), "goal outside the map"),
        ((1, 1), (math.nan, 0.5), (0.5, 0.5), "start outside the map"),
        ((1, 1), (0.5, 0.5), (0.5, math.inf), "goal outside the map"),
        ((1, 5), (0.5, 0.5), (4.5, 0.5), ""),
        ((5, 1), (0.5, 0.5), (0.5, 4.5), ""),
        ((5, 5), (0.1, 0.9), (4.9, 4.1), ""),
    ],
)
def test_edges_of_the_map(shape, start, goal, reason):
    costmap = from_weights(Grid(np.ones(shape, np.uint8), (0.0, 0.0), 1.0))
    plan = astar.plan(costmap, start, goal)
    assert plan.reason == reason
    assert plan.ok == (len(plan.path_m) > 0) == math.isfinite(plan.cost_m)
    if plan.ok:
        assert tuple(plan.path_m[0]) == start
        assert tuple(plan.path_m[-1]) == goal


def test_a_refusal_names_the_blocked_end():
    weights = np.ones((9, 9), np.uint8)
    weights[:, 4] = 0
    costmap = from_weights(Grid(weights, (0.0, 0.0), 1.0))
    assert astar.plan(costmap, (0.5, 0.5), (4.5, 0.5)).reason == "goal blocked"
    assert astar.plan(costmap, (4.5, 0.5), (0.5, 0.5), escape_m=0.3).reason == "start blocked"
    walled = astar.plan(costmap, (0.5, 0.5), (8.5, 0.5))
    assert walled.reason == "unreachable"
    assert walled.expansions == 4 * 9  # all of the left side, and nothing else


def test_start_in_an_obstacle_escapes_to_the_nearest_open_cell():
    weights = np.ones((9, 9), np.uint8)
    weights[:, :3] = 0
    costmap = from_weights(Grid(weights, (0.0, 0.0), 0.1))
    plan = astar.plan(costmap, (0.18, 0.42), (0.85, 0.45), escape_m=0.3)
    assert plan.ok
    assert tuple(plan.path_m[0]) == (0.18, 0.42)
    assert plan.path_m[1] == pytest.approx((0.35, 0.45))
    assert plan.escape_m == pytest.approx(math.hypot(0.17, 0.03))


def test_a_diagonal_between_two_blocked_cells_is_closed():
    weights = np.array([[1, 0], [0, 1]], np.uint8)
    assert plan_cells(weights, (0, 0), (1, 1)).reason == "unreachable"
    weights[0, 1] = 1  # one free corner is not enough for a robot either: it goes round
    assert plan_cells(weights, (0, 0), (1, 1)).cost_m == 2.0


def test_workspace_is_clean_after_every_search():
    rng = np.random.default_rng(5)
    workspace = astar.Workspace()
    for side in (40, 7, 63, 12):
        weights = rng.integers(0, 9, (side, side)).astype(np.uint8)
        weights[0, 0] = weights[-1, -1] = 1
        costmap = from_weights(Grid(weights, (0.0, 0.0), 1.0))
        ends = (0.5, 0.5), (side - 0.5, side - 0.5)
        again, fresh = astar.plan(costmap, *ends, workspace), astar.plan(costmap, *ends)
        assert again.cost_m == fresh.cost_m
        assert again.expansions == fresh.expansions
        assert (workspace.g == kernels.UNSEEN).all()
        assert (workspace.head == -1).all()


def test_small_pool_and_path_grow_without_changing_the_answer():
    rng = np.random.default_rng(6)
    weights = rng.integers(1, 200, (80, 80)).astype(np.uint8)
    costmap = from_weights(Grid(weights, (0.0, 0.0), 1.0))
    small = astar.Workspace(pool=np.empty(16, np.int64), path=np.empty(4, np.int32))
    ends = (0.5, 0.5), (79.5, 79.5)
    assert astar.plan(costmap, *ends, small).cost_m == astar.plan(costmap, *ends).cost_m
    assert small.pool.size > 16
    assert small.path.size > 4
    assert (small.g == kernels.UNSEEN).all()


@pytest.mark.parametrize("h_weight", [0, 1, 2])
def test_heuristic_changes_the_work_and_not_the_cost(h_weight):
    rng = np.random.default_rng(8)
    weights = rng.integers(2, 6, (90, 90)).astype(np.uint8)
    weights[rng.random(weights.shape) < 0.2] = 0
    weights[0, 0] = weights[89, 89] = 2
    costmap = from_weights(Grid(weights, (0.0, 0.0), 1.0), unit=1)
    assert costmap.h_weight == 2
    ends = (0.5, 0.5), (89.5, 89.5)
    plan = astar.plan(replace(costmap, h_weight=h_weight), *ends, WORKSPACE)
    assert plan.cost_m == pytest.approx(dijkstra(weights, (0, 0), (89, 89)), rel=1e-3)
    assert plan.expansions >= astar.plan(costmap, *ends, WORKSPACE).expansions


def test_cost_overflow_is_reported_and_not_wrapped():
    weights = np.zeros((1200, 1200), np.uint8)  # a serpentine, 360,000 cells of the top weight
    weights[::4], weights[2::4] = 255, 255
    weights[1::4, -1], weights[3::4, 0] = 255, 255
    plan = plan_cells(weights, (0, 0), (1198, 0))
    assert plan.reason == "cost overflow"

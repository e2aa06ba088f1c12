"""Benchmark: A* on mazes and on a house's map, cost maps, smoothing, and a controller's step."""

from __future__ import annotations

import math
import statistics
import time
from functools import partial

import cv2
import numpy as np
import pytest
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from edge.config import parse
from edge.geometry import SE2, Grid
from edge.lab.motion.controller import Controller
from edge.tasks.scene.value_map import PathMargins, value_map
from edge.trajectory import astar, smoothing
from edge.trajectory.costmap import from_occupancy, from_weights


def maze(side: int, seed: int = 1) -> np.ndarray:
    """Return random weights 1 to 10, and nine walls (0) from edge to edge with one gap each."""
    rng = np.random.default_rng(seed)
    weights = rng.integers(1, 11, (side, side)).astype(np.uint8)
    gap = side // 80
    for column in range(side // 10, side - side // 20, side // 10):
        row = int(rng.integers(0, side - gap))
        weights[:row, column] = weights[row + gap :, column] = 0
    return weights


def house(side: int) -> np.ndarray:
    """Return an inflated occupancy grid: rooms of 80 cells with doors, the last third unknown."""
    cells = np.zeros((side, side), np.int8)
    cells[:, 2 * side // 3 :] = -1
    for k in range(80, side - 40, 80):
        cells[k - 5 : k + 6, :] = cells[:, k - 5 : k + 6] = 100
    for k in range(40, side, 80):
        cells[:, k - 4 : k + 4] = np.where(cells[:, k - 4 : k + 4] == 100, 0, 0)
        cells[k - 4 : k + 4, :] = 0
    return cells


@pytest.mark.parametrize("side", [250, 500, 1000])
def test_astar_weighted_maze(benchmark, side):
    costmap = from_weights(Grid(maze(side), (0.0, 0.0), 1.0), unit=1)
    workspace = astar.Workspace()
    ends = (0.5, 0.5), (side - 0.5, side - 0.5)
    plan = astar.plan(costmap, *ends, workspace)
    assert plan.ok
    benchmark.extra_info.update(budget=f"astar_weighted_{side}", expansions=plan.expansions)
    benchmark.pedantic(astar.plan, (costmap, *ends, workspace), rounds=30, warmup_rounds=3)


def graph(weights: np.ndarray) -> scipy.sparse.csr_matrix:
    """Build the search's graph: 8-connected, without cutting corners of closed cells.

    Entering a cell costs its weight times the step.
    """
    numbers = np.arange(weights.size).reshape(weights.shape)
    is_open = np.pad(weights != 0, 1)
    h, w = weights.shape
    froms, tos, costs = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, columns = slice(0, h - dy), slice(max(-dx, 0), w - max(dx, 0))
        a = numbers[rows, columns]
        b = a + dy * w + dx
        r, c = np.divmod(a, w)
        passes = is_open[r + 1, c + 1] & is_open[r + dy + 1, c + dx + 1]
        passes &= is_open[r + dy + 1, c + 1] & is_open[r + 1, c + dx + 1]
        a, b, step = a[passes], b[passes], math.hypot(dx, dy)
        froms += [a, b]
        tos += [b, a]
        costs += [step * weights.ravel()[b], step * weights.ravel()[a]]
    arrays = (np.concatenate(costs), (np.concatenate(froms), np.concatenate(tos)))
    return scipy.sparse.csr_matrix(arrays, shape=(weights.size, weights.size))


@pytest.mark.parametrize("other", ["scipy", "pyastar2d"])
def test_astar_against(benchmark, other):
    """Compare our search with another library's on a maze of 1000 x 1000 cells, by turns.

    scipy's Dijkstra has the same graph and finds the least cost. pyastar2d has the same weights,
    but counts a diagonal step as long as a straight one.
    """
    weights = maze(1000)
    costmap = from_weights(Grid(weights, (0.0, 0.0), 1.0), unit=1)
    workspace = astar.Workspace()
    ends = (0.5, 0.5), (999.5, 999.5)
    plan = astar.plan(costmap, *ends, workspace)
    if other == "scipy":
        edges = graph(weights)
        least = dijkstra(edges, indices=0)[-1]
        assert least * (1 - 1e-9) <= plan.cost_m <= least * 1.001
        work = partial(dijkstra, edges, indices=0)
    else:
        pyastar2d = pytest.importorskip("pyastar2d", reason="pyastar2d has no wheel here")
        floats = np.where(weights == 0, np.inf, weights).astype(np.float32)
        work = partial(pyastar2d.astar_path, floats, (0, 0), (999, 999), allow_diagonal=True)
        assert len(work()) > 1000
    took_s = []

    def by_turns() -> None:
        began_s = time.thread_time()
        work()
        took_s.append(time.thread_time() - began_s)

    benchmark.extra_info["budget"] = f"astar_weighted_1000_{other}"
    arguments = (costmap, *ends, workspace)
    benchmark.pedantic(astar.plan, arguments, setup=by_turns, rounds=9)
    benchmark.extra_info["reference_ms"] = 1e3 * statistics.median(took_s)


def test_value_map(benchmark, against):
    """Compare with OpenCV's distance to the nearest obstacle.

    10 ms are a tenth of a period at the paper's 10 Hz.
    """
    cells = house(1000)
    regions = np.zeros(cells.shape, np.uint8)
    regions[200:700], regions[700:750] = 1, 2
    place = ((0.0, 0.0), 0.1)
    t = np.linspace(0.0, 1.0, 200)
    coarse_m = np.column_stack([5.0 + 90.0 * t, 45.0 + 8.0 * np.sin(9.0 * t)])
    free = (cells != 100).astype(np.uint8)
    against(lambda: cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    benchmark.extra_info["budget"] = "value_map_1000"
    arguments = (Grid(cells, *place), Grid(regions, *place), {1, 2}, coarse_m, PathMargins(0.4))
    benchmark.pedantic(value_map, arguments, rounds=30, warmup_rounds=3)


def test_astar_house(benchmark):
    costmap = from_occupancy(Grid(house(400), (0.0, 0.0), 0.05))
    workspace = astar.Workspace()
    ends = (2.0, 2.0), (18.0, 14.0)
    plan = astar.plan(costmap, *ends, workspace)
    assert plan.ok
    benchmark.extra_info.update(budget="astar_house_400", expansions=plan.expansions)
    benchmark.pedantic(astar.plan, (costmap, *ends, workspace), rounds=50, warmup_rounds=3)


def test_costmap_from_occupancy(benchmark, against):
    """Compare with OpenCV's distance to the nearest obstacle, from which the costs are made."""
    cells = house(1000)
    free = (cells != 100).astype(np.uint8)
    against(lambda: cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    benchmark.extra_info["budget"] = "costmap_1000"
    benchmark.pedantic(from_occupancy, (Grid(cells, (0.0, 0.0), 0.05),), rounds=30, warmup_rounds=3)


def test_smoothing(benchmark):
    costmap = from_occupancy(Grid(house(400), (0.0, 0.0), 0.05))
    path = astar.plan(costmap, (2.0, 2.0), (18.0, 14.0)).path_m
    benchmark.extra_info["budget"] = "path_smoothing_400"
    benchmark.pedantic(smoothing.smooth, (costmap, path), rounds=50, warmup_rounds=3)


def test_controller_step(benchmark):
    """Measure a step along a path; a step that plans again takes `astar_house_400` longer."""
    controller = Controller(parse({"perception": {"detector": {"kind": "sim"}}}))
    controller.on_map(Grid(house(400), (0.0, 0.0), 0.05))
    controller.on_goal(1, SE2(18.0, 14.0, 0.0))
    step = (SE2(2.0, 2.0, 0.0), 0.0, 0.0, 0)
    controller.step(*step)
    benchmark.extra_info["budget"] = "controller_step"
    benchmark.pedantic(controller.step, step, rounds=200, warmup_rounds=10)

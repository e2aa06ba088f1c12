"""Paths: A* on weighted mazes and on a house's map, and what the controller does with them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from edge.config import parse
from edge.geometry import SE2, Grid
from edge.motion.controller import Controller
from edge.trajectory import astar, smoothing
from edge.trajectory.costmap import from_occupancy, from_weights


def maze(side: int, seed: int = 1) -> np.ndarray:
    """Random weights 1 to 10, and nine walls from edge to edge with one gap each."""
    rng = np.random.default_rng(seed)
    weights = rng.integers(1, 11, (side, side)).astype(np.uint8)
    gap = side // 80
    for column in range(side // 10, side - side // 20, side // 10):
        row = int(rng.integers(0, side - gap))
        weights[:row, column] = weights[row + gap :, column] = 0
    return weights


def house(side: int) -> np.ndarray:
    """An inflated occupancy grid: rooms of 80 cells with doors, the last third unknown."""
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


def test_astar_house(benchmark):
    costmap = from_occupancy(Grid(house(400), (0.0, 0.0), 0.05))
    workspace = astar.Workspace()
    ends = (2.0, 2.0), (18.0, 14.0)
    plan = astar.plan(costmap, *ends, workspace)
    assert plan.ok
    benchmark.extra_info.update(budget="astar_house_400", expansions=plan.expansions)
    benchmark.pedantic(astar.plan, (costmap, *ends, workspace), rounds=50, warmup_rounds=3)


def test_costmap_from_occupancy(benchmark, against):
    """Against OpenCV's distance to the nearest obstacle, from which costs are made."""
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
    """A step that follows its path; the one that plans again costs an `astar_house_400` more."""
    controller = Controller(parse({"perception": {"detector": {"kind": "sim"}}}))
    controller.on_map(Grid(house(400), (0.0, 0.0), 0.05))
    controller.on_goal(1, SE2(18.0, 14.0, 0.0))
    step = (SE2(2.0, 2.0, 0.0), 0.0, 0.0, 0)
    controller.step(*step)
    benchmark.extra_info["budget"] = "controller_step"
    benchmark.pedantic(controller.step, step, rounds=200, warmup_rounds=10)

"""The persistent frontier set equals a full recomputation, whatever happened to the map."""

from __future__ import annotations

import math
from collections import deque

import mapping_twins as twins
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mapping_twins import SMALL, look, room

from edge import config
from edge.geometry import SE2
from edge.mapping import cluster_kernels as kernels
from edge.mapping import clusters as cl
from edge.mapping.grid import RollingMap


def clusters_of(grid: RollingMap) -> kernels.Clusters:
    return grid._finder.clusters


def components(cells: np.ndarray) -> list[set[tuple[int, int]]]:
    """8-connected components of a boolean array, as sets of (x, y)."""
    left = {(int(x), int(y)) for y, x in np.argwhere(cells)}
    found = []
    while left:
        seed = left.pop()
        group, queue = {seed}, deque([seed])
        while queue:
            x, y = queue.popleft()
            for near in [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
                if near in left:
                    left.remove(near)
                    group.add(near)
                    queue.append(near)
        found.append(group)
    return found


def check(grid: RollingMap, cut: bool = False) -> None:
    """Cells, clusters and target points are what NumPy makes of the map.

    Args:
        grid: map under test.
        cut: whether a cluster has ever been cut at its limit; its parts stay apart until
            something changes beside them.
    """
    expected = twins.frontier_cells(twins.states(grid))
    np.testing.assert_array_equal(twins.window(grid, "frontier") > 0, expected)
    label = twins.window(grid, "label")
    np.testing.assert_array_equal(label > 0, expected)
    size = clusters_of(grid).size
    for group in components(expected):
        ids = {int(label[y, x]) for x, y in group}
        assert cut or len(ids) == 1, "only clusters that were cut at the limit may be apart"
        for k in ids:
            assert size[k] == sum(label[y, x] == k for x, y in group) <= kernels.MAX_CELLS
    assert size.sum() == expected.sum()
    check_targets(grid, expected, label)


def check_targets(grid: RollingMap, expected: np.ndarray, label: np.ndarray) -> None:
    f = grid.frontiers
    cells = np.floor(f.xy_m[: f.n] / grid.resolution_m).astype(int) - grid.window.origin
    assert all(expected[y, x] for x, y in cells), "targets are frontier cells"
    np.testing.assert_array_equal([label[y, x] for x, y in cells], f.cluster[: f.n])
    size = clusters_of(grid).size
    assert set(f.cluster[: f.n]) == set(np.flatnonzero(size >= cl.FRONTIER_MIN_CELLS))
    for k in set(f.cluster[: f.n]):
        own = f.xy_m[: f.n][f.cluster[: f.n] == k]
        if size[k] < cl.FRONTIER_LARGE_CELLS:
            assert len(own) == 1
        apart = np.hypot(*(own[:, None] - own[None]).transpose(2, 0, 1))
        apart[np.eye(len(own), dtype=bool)] = np.inf
        assert (apart >= cl.FRONTIER_SPACING_M - 1e-3).all()


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=73)  # a cut cluster that shrank
def test_the_frontier_set_is_right_after_random_updates_and_rolls(seed):
    rng = np.random.default_rng(seed)
    grid = RollingMap(SMALL)
    x = y = 0.0
    cut = False
    for _ in range(10):
        if rng.random() < 0.1:
            x, y = rng.uniform(-60, 60, 2)
        x, y = x + rng.uniform(-1.5, 1.5), y + rng.uniform(-1.5, 1.5)
        boxes = []
        for _ in range(3):
            bx, by = x + rng.uniform(-2.5, 2.5), y + rng.uniform(-2.5, 2.5)
            boxes.append((bx, by, 0.0, bx + rng.uniform(0.1, 1), by + 0.2, rng.uniform(0.2, 2)))
        look(grid, SE2(x, y, rng.uniform(-math.pi, math.pi)), boxes)
        cut |= bool((clusters_of(grid).size == kernels.MAX_CELLS).any())
        check(grid, cut)
    assert clusters_of(grid).count[kernels.OVERFLOW] == 0


def test_a_change_behind_the_robot_moves_the_frontier_there():
    """A cell freed or blocked outside the forward wedge keeps the set right too."""
    grid = RollingMap(SMALL)
    look(grid, SE2(0, 0, 0), room(2.0))
    x = math.floor(-1.0 / grid.resolution_m) - grid.window.origin[0]
    y = 0 - grid.window.origin[1]

    for dx in range(12):
        twins.set_free(grid, x + dx, y)
    look(grid, SE2(0, 0, 0), room(2.0))
    check(grid)
    assert any(fx < -0.4 for fx in grid.frontiers.xy_m[: grid.frontiers.n, 0])


def test_a_room_seen_all_around_has_no_frontier():
    grid = RollingMap(SMALL)
    for yaw in np.arange(0, 6.4, 0.2):
        look(grid, SE2(0, 0, yaw), room(1.5))
    check(grid)
    assert grid.frontiers.n == 0


def test_an_open_door_is_a_frontier():
    grid = RollingMap(SMALL.model_copy(update={"range_m": 2.0}))
    walls = [w for w in room(1.5) if w[0] < 1.5]
    walls += [(1.5, 0.45, 0, 1.6, 1.5, 2), (1.5, -1.5, 0, 1.6, -0.45, 2)]
    for yaw in np.arange(0, 6.4, 0.2):
        look(grid, SE2(0, 0, yaw), walls)
    check(grid)
    points = grid.frontiers.xy_m[: grid.frontiers.n]
    assert len(points) >= 1
    assert (points[:, 0] > 1.3).all()
    assert (np.abs(points[:, 1]) < 0.5).all()


def test_large_clusters_have_several_targets(monkeypatch):
    monkeypatch.setattr(cl, "FRONTIER_SPACING_M", 0.8)
    open_field = RollingMap(config.MappingConfig())
    look(open_field, SE2(0, 0, 0), [])
    assert open_field.frontiers.n >= 4
    check(open_field)
    monkeypatch.setattr(cl, "FRONTIER_LARGE_CELLS", 5000)
    one = RollingMap(config.MappingConfig())
    look(one, SE2(0, 0, 0), [])
    assert one.frontiers.n == len(set(one.frontiers.cluster[: one.frontiers.n]))
    check(one)


def test_more_targets_than_fit_leave_out_small_clusters(monkeypatch):
    monkeypatch.setattr(cl, "FRONTIER_SPACING_M", 0.1)
    everything = RollingMap(SMALL)
    monkeypatch.setattr(cl, "MAX_FRONTIERS", 8)
    grid = RollingMap(SMALL)
    look(grid, SE2(0, 0, 0), [(1.0, 0.0, 0.0, 1.1, 0.1, 0.5)])
    f = grid.frontiers
    assert 0 < f.n <= 8
    look(everything, SE2(0, 0, 0), [(1.0, 0.0, 0.0, 1.1, 0.1, 0.5)])
    assert everything.frontiers.n > 8
    assert f.cells[: f.n].max() == everything.frontiers.cells[: everything.frontiers.n].max()


@pytest.mark.parametrize("n_cells", [0, 1, 5, 700])
def test_clusters_are_cut_at_their_limit(n_cells):
    """A straight frontier of n cells becomes clusters of MAX_CELLS at most, all cells in one."""
    grid = RollingMap(config.MappingConfig())
    twins.move_to(grid, 0, 0)

    for x in range(n_cells):
        twins.set_free(grid, 100 + x, 300)
    grid._refresh_frontiers(True)
    size = clusters_of(grid).size
    assert size.sum() == n_cells
    assert (size > 0).sum() == math.ceil(n_cells / kernels.MAX_CELLS)

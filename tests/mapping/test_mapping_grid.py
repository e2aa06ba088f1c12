"""The rolling map: marked, cleared and forgotten cells; bad input; its memory limit."""

from __future__ import annotations

import math
import tracemalloc

import mapping_twins as twins
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapping_twins import CAMERA, SMALL, T_BASE_CAMERA, look, render, room

from edge import config
from edge.geometry import SE2, CameraModel
from edge.loop.warmup import warm_mapping, warm_values
from edge.mapping import cluster_kernels, layers, points, reach_kernels, unknown, update, values
from edge.mapping.grid import CLEAR_AFTER, RollingMap
from edge.types import Observation

ORIGIN = SE2(0.0, 0.0, 0.0)
STILL = np.eye(4), np.eye(4)


def test_an_empty_map_is_unknown_everywhere():
    grid = RollingMap(SMALL)
    assert grid.state_at(0.0, 0.0) == -1
    assert not grid.is_floor_between(np.zeros(2), np.ones(2))
    assert grid.frontiers.n == 0
    assert grid.snapshot().cells.shape == (0, 0)
    assert grid.travel_cost.nearest(0.0, 0.0, 1.0) is None
    out = np.zeros(1, np.float32)
    grid.unknown.ratio(np.zeros((1, 2), np.float32), 1, 1.0, out)
    assert out[0] == 1.0


def test_a_room_seen_all_around_is_free_inside_and_walled():
    grid = RollingMap(SMALL.model_copy(update={"inflation_m": 0.0}))
    for yaw in np.arange(0, 6.3, 0.3):
        look(grid, SE2(0, 0, yaw), room(1.5))
    for angle in np.arange(0, 6.3, 0.1):
        for r in np.arange(0, 1.4, 0.1):
            assert grid.state_at(r * math.cos(angle), r * math.sin(angle)) == 0
    walls = [grid.state_at(1.51, y) for y in np.arange(-1.3, 1.3, 0.05)]
    assert all(s == 100 for s in walls)
    assert grid.state_at(1.8, 0.0) == -1
    centre = (0.0, 0.0)
    for point_m, other_m, is_floor in (
        (centre, (1.2, 0.5), True),
        (centre, (2.0, 0.0), True),
        (centre, (4.0, 0.0), False),
        ((9.2, 0.0), (9.6, 0.0), False),  # outside the window, which is 9.6 m wide
    ):
        ends_m = np.array(point_m), np.array(other_m)
        assert grid.is_floor_between(*ends_m) == grid.is_floor_between(*ends_m[::-1]) == is_floor


def test_a_walking_person_leaves_no_ghost():
    """VL-Nav V.C: a moving obstacle is where it is and nowhere it was."""
    grid = RollingMap(SMALL)
    for step in range(30):
        y = -0.8 + 0.05 * step
        look(grid, ORIGIN, [*room(2.5), (1.5, y - 0.15, 0.0, 1.7, y + 0.15, 1.7)])
    for _ in range(CLEAR_AFTER):
        look(grid, ORIGIN, room(2.5))
    occupied = np.argwhere(twins.window(grid, "raw") >= 2)
    x_m = (occupied[:, 1] + grid.window.origin[0]) * grid.resolution_m
    y_m = (occupied[:, 0] + grid.window.origin[1]) * grid.resolution_m
    assert not (np.hypot(x_m - 1.6, y_m) < 0.8).any()
    assert all(grid.state_at(1.6, y) == 0 for y in np.arange(-0.7, 0.7, 0.05))
    assert len(occupied) > 20, "the walls stay"


def test_a_leaving_person_leaves_no_ghost_in_front_of_furniture():
    """No ray ends behind the cell near enough to show that it passed low over it."""
    grid = RollingMap(SMALL)
    cupboard = [*room(2.5), (1.6, -0.6, 0.0, 1.9, 0.6, 1.7)]
    person = (1.5, -0.15, 0.0, 1.58, 0.15, 1.7)
    looks = [*(update.SURELY_FREE + 1) * [cupboard], [*cupboard, person], *CLEAR_AFTER * [cupboard]]
    states = []
    for boxes in looks:
        look(grid, ORIGIN, boxes)
        x, y = grid.window.cell_of(1.52, 0.0)
        states.append(int(grid.layers.raw[y % grid.window.n, x % grid.window.n]))
    assert states[-1 - CLEAR_AFTER] == layers.ARRIVED
    assert states[-1] == states[0] == layers.FREE


def test_an_opened_door_is_free_and_a_closed_one_occupied():
    grid = RollingMap(SMALL)
    door = (1.5, -0.4, 0.0, 1.55, 0.4, 2.0)
    walls = [(1.5, 0.4, 0, 1.55, 2, 2.0), (1.5, -2, 0, 1.55, -0.4, 2.0)]
    for closed in (True, False, True):
        for _ in range(3):
            look(grid, ORIGIN, [*walls, door] if closed else walls)
        assert grid.state_at(1.52, 0.0) == (100 if closed else 0)


@pytest.mark.parametrize(
    ("floor_looks", "x_m", "forgotten"),
    [
        (0, 1.5, False),
        (update.SURELY_FREE, 1.5, False),  # the first look frees the cell
        (update.SURELY_FREE + 1, 1.5, True),
        (update.SURELY_FREE + 1, 0.3, False),  # next to the robot
    ],
)
def test_only_new_obstacles_on_seen_floor_are_forgotten(floor_looks, x_m, forgotten):
    grid, walls = RollingMap(SMALL), room(2.5)
    assert not grid.forget_arrivals()
    with_person = [*walls, (x_m, -0.15, 0.0, x_m + 0.3, 0.15, 1.7)]
    for boxes in [*floor_looks * [walls], with_person]:
        look(grid, ORIGIN, boxes)
    assert grid.state_at(x_m + 0.02, 0.0) == 100
    before = np.count_nonzero(twins.window(grid, "raw") >= layers.OCCUPIED)
    assert grid.forget_arrivals() == forgotten
    assert grid.state_at(x_m + 0.02, 0.0) == (0 if forgotten else 100)
    assert (np.count_nonzero(twins.window(grid, "raw") >= layers.OCCUPIED) < before) == forgotten
    assert grid.state_at(2.52, 1.0) == 100, "the walls stay"
    look(grid, ORIGIN, with_person)
    assert grid.state_at(x_m + 0.02, 0.0) == 100
    assert grid.forget_arrivals() == forgotten, "again"


@pytest.mark.parametrize(("robot_m", "stays"), [(0.5, False), (1.0, True)])
def test_an_obstacle_partly_next_to_the_robot_stays_whole(robot_m, stays):
    grid, walls = RollingMap(SMALL), room(2.5)
    with_person = [*walls, (1.5, -0.15, 0.0, 1.58, 0.15, 1.7)]
    for boxes in [*(update.SURELY_FREE + 1) * [walls], with_person]:
        look(grid, ORIGIN, boxes)
    look(grid, SE2(robot_m, 0.0, 0.0), with_person)

    def arrived() -> int:
        raw = twins.window(grid, "raw")
        return np.count_nonzero((raw >= layers.ARRIVED) & (raw < layers.BUMPED))

    before = arrived()
    assert before > 1
    grid.forget_arrivals()
    assert arrived() == before * stays


@pytest.mark.parametrize(
    ("width_m", "small_too", "state"), [(0.6, True, -1), (0.6, False, 100), (0.9, True, 100)]
)
def test_only_small_obstacles_may_have_been_people(width_m, small_too, state):
    grid = RollingMap(SMALL)
    boxes = [*room(2.5), (1.5, -width_m / 2, 0.0, 1.6, width_m / 2, 1.7)]
    look(grid, ORIGIN, boxes)
    grid.forget_arrivals(small_too)
    assert grid.state_at(1.52, 0.0) == state
    assert grid.state_at(2.52, 1.0) == 100, "the walls stay"
    look(grid, ORIGIN, boxes)
    assert grid.state_at(1.52, 0.0) == 100


def test_a_low_obstacle_stays_below_the_view():
    """Seen from afar, then under the camera's blind zone: nothing flew low enough to clear it."""
    grid = RollingMap(SMALL)
    low = (1.5, -0.1, 0.0, 1.6, 0.1, 0.2)
    for x in np.arange(0.0, 1.1, 0.1):
        look(grid, SE2(x, 0, 0), [low])
    for _ in range(5):
        look(grid, SE2(1.05, 0, 0), [low])
    assert grid.state_at(1.52, 0.0) == 100


def test_an_obstacle_hidden_by_another_is_not_cleared():
    grid = RollingMap(SMALL)
    far = (2.5, -0.3, 0.0, 2.6, 0.3, 0.8)
    look(grid, ORIGIN, [far])
    for _ in range(4):
        look(grid, ORIGIN, [far, (1.0, -0.6, 0.0, 1.1, 0.6, 1.5)])
    assert grid.state_at(2.52, 0.0) == 100


def test_missing_returns_clear_nothing():
    grid = RollingMap(SMALL)
    look(grid, ORIGIN, [(1.5, -0.3, 0.0, 1.6, 0.3, 0.8)])
    before = twins.states(grid)
    for _ in range(4):
        nothing = np.full((120, 160), np.nan, np.float32)
        grid.update_depth(nothing, CAMERA, np.eye(4), T_BASE_CAMERA)
    np.testing.assert_array_equal(twins.states(grid), before)


def test_the_changed_rectangle_holds_every_change():
    grid = RollingMap(SMALL)
    rng = np.random.default_rng(3)
    look(grid, ORIGIN, [])
    for _ in range(20):
        pose = SE2(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3))
        x, y = rng.uniform(-2, 2, 2)
        before = twins.states(grid)
        result = look(grid, pose, [(x, y, 0, x + 0.3, y + 0.3, 0.9)])
        assert not result.rolled
        ys, xs = np.nonzero(before != twins.states(grid))
        x0, y0, x1, y1 = result.changed
        xs, ys = xs + grid.window.origin[0], ys + grid.window.origin[1]
        assert ((xs >= x0) & (xs < x1) & (ys >= y0) & (ys < y1)).all()
        if len(xs) == 0:
            assert result.changed == (0, 0, 0, 0)


def test_a_snapshot_is_the_map():
    grid = RollingMap(SMALL)
    for yaw in (0.0, 1.0, 2.0):
        look(grid, SE2(0.3, -0.2, yaw), room(1.5))
    shot = grid.snapshot()
    assert shot.cells.dtype == np.int8
    for row in range(shot.cells.shape[0]):
        for column in range(shot.cells.shape[1]):
            x = shot.origin_xy_m[0] + (column + 0.5) * shot.resolution_m
            y = shot.origin_xy_m[1] + (row + 0.5) * shot.resolution_m
            assert shot.cells[row, column] == grid.state_at(x, y)
    assert (shot.cells == 0).sum() == (twins.states(grid) == 0).sum()


def test_a_pose_jump_beyond_the_window_starts_a_new_map():
    grid = RollingMap(SMALL)
    look(grid, ORIGIN, room(1.5))
    assert look(grid, SE2(500.0, -300.0, 0.0), []).rolled
    assert grid.state_at(1.0, 0.0) == -1
    assert grid.state_at(501.0, -300.0) == 0
    assert not (twins.states(grid) == 100).any()
    np.testing.assert_array_equal(
        twins.window(grid, "frontier") > 0, twins.frontier_cells(twins.states(grid))
    )


def test_rolling_keeps_the_cells_inside_the_window():
    grid = RollingMap(SMALL.model_copy(update={"extent_m": 8.0}))
    pillar = (6.5, 0.8, 0.0, 6.7, 1.0, 0.9)
    rolled = 0
    for x in np.arange(0.0, 10.0, 0.1):
        rolled += look(grid, SE2(x, 0.0, 0.0), [pillar]).rolled
    assert rolled >= 1
    assert grid.state_at(6.52, 0.9) == 100
    assert grid.state_at(0.0, 0.0) == -1, "left behind"


@pytest.mark.parametrize("shape", [(120, 161), (160, 120), (0, 0), (120, 160, 1)])
def test_a_depth_image_of_the_wrong_size_is_an_error(shape):
    with pytest.raises(ValueError, match="120x160"):
        RollingMap(SMALL).update_depth(np.zeros(shape, np.float32), CAMERA, *STILL)


@pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 3, 1)])
def test_a_cloud_of_the_wrong_shape_is_an_error(shape):
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        RollingMap(SMALL).update_cloud(np.zeros(shape, np.float32), *STILL)


def test_a_pose_that_is_not_finite_changes_nothing():
    grid = RollingMap(SMALL)
    look(grid, ORIGIN, [])
    before = twins.states(grid)
    T = np.eye(4)
    T[0, 3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        grid.update_depth(np.ones((120, 160), np.float32), CAMERA, np.eye(4), T)
    with pytest.raises(ValueError, match="not finite"):
        grid.update_depth(np.ones((120, 160), np.float32), CAMERA, T, np.eye(4))
    np.testing.assert_array_equal(twins.states(grid), before)


@given(st.integers(0, 2**32 - 1))
def test_degenerate_depth_never_breaks_the_layers(seed):
    """Random images full of holes from random poses: every layer agrees with `raw`."""
    rng = np.random.default_rng(seed)
    grid = RollingMap(SMALL)
    camera = CameraModel.from_hfov(32, 24, 1.3)
    for _ in range(6):
        depth = rng.uniform(0.0, 5.0, (24, 32)).astype(np.float32)
        depth[rng.random(depth.shape) < 0.4] = rng.choice([np.nan, 0.0, np.inf])
        pose = SE2(*rng.uniform(-8, 8, 2), rng.uniform(-3, 3))
        grid.update_depth(depth, camera, pose.matrix(), T_BASE_CAMERA)
        state = twins.states(grid)
        np.testing.assert_array_equal(twins.window(grid, "near") > 0, state == 100)
        np.testing.assert_array_equal(twins.window(grid, "blocked") > 0, state == 100)
        np.testing.assert_array_equal(
            twins.window(grid, "known") > 0, twins.window(grid, "raw") > 0
        )
        assert not grid._reader.scan.seen.any()
        seen = np.count_nonzero(grid.layers.raw)
        assert grid.known_m2 == pytest.approx(seen * SMALL.resolution_m**2)


def test_memory_is_fixed_and_a_steady_update_allocates_nothing_large():
    grid = RollingMap(config.MappingConfig())
    camera = CameraModel.from_hfov(320, 256, math.radians(75))
    pose, T_map_base = ORIGIN, np.eye(4)
    depth = twins.render(camera, T_BASE_CAMERA, room(3.0))
    size = sum(layer.nbytes for layer in grid.layers)
    for _ in range(3):
        grid.update_depth(depth, camera, T_map_base, T_BASE_CAMERA)
        grid.travel_cost.step(pose)
    tracemalloc.start()
    try:
        for _ in range(5):
            grid.update_depth(depth, camera, T_map_base, T_BASE_CAMERA)
            grid.travel_cost.step(pose)
        assert tracemalloc.get_traced_memory()[1] < 64 * 1024
    finally:
        tracemalloc.stop()
    assert sum(layer.nbytes for layer in grid.layers) == size < 10 * 1024 * 1024


def signatures() -> dict[str, int]:
    """Compiled variants of every kernel of the package."""
    modules = (cluster_kernels, layers, points, reach_kernels, unknown, update, values)
    return {
        f"{module.__name__}.{name}": len(kernel.signatures)
        for module in modules
        for name, kernel in vars(module).items()
        if hasattr(kernel, "signatures")
    }


@pytest.mark.parametrize("kind", ["plain", "read-only", "sliced", "float64"])
def test_nothing_is_compiled_after_warmup(kind):
    warm_mapping(SMALL)
    warm_values(SMALL)
    before = signatures()
    grid = RollingMap(SMALL)
    grid.values.set_targets(("bed", "sofa"))
    depth = np.full((120, 320), 2.0, np.float32)[:, ::2].copy()
    if kind == "read-only":
        depth.flags.writeable = False
    elif kind == "sliced":
        depth = np.full((120, 320), 2.0, np.float32)[:, ::2]
    elif kind == "float64":
        depth = depth.astype(np.float64)
    for x in (np.float32(0.0), 1, 30.0, 30.5, 24.0):
        pose = SE2(x, 0.0, 0.0)
        grid.update_depth(depth, CAMERA, pose.matrix(), T_BASE_CAMERA)
        grid.update_cloud(depth[:, :3], pose.matrix(), SE2(0.0, 0.0, 0.0).matrix(0.5))
        grid.travel_cost.step(pose)
        grid.travel_cost.nearest(grid.frontiers.xy_m[0, 0], grid.frontiers.xy_m[0, 1], 0.6)
        shown_m = layers.read_only(grid.frontiers.xy_m)  # as policies have it
        grid.unknown.ratio(shown_m, grid.frontiers.n, 1.0, np.zeros(999, np.float32))
        for seen in (depth, None):
            observation = Observation(
                0, 0, pose.matrix(), depth_m=seen, camera=CAMERA, T_base_camera=T_BASE_CAMERA
            )
            sight = grid.values.range_profile(observation)
            grid.values.write_view(sight, ("sofa", "bed"), np.ones(2, np.float32))
        p = np.ones(2, np.float32)
        grid.values.write_directions(sight, "bed", shown_m[:2].astype(np.float64), p, 0.5)
        grid.values.best(1, shown_m, grid.frontiers.n, 0.5, np.zeros(999, np.float32))
    grid.bumps.close(SE2(23.8, 0.0, 0.0), (24.0, 0.0), 0.2, 0)
    grid.bumps.open_all()
    grid.snapshot()
    assert signatures() == before


@pytest.mark.parametrize("foot_m", [0.0, 0.08])
@pytest.mark.parametrize("from_m", [-0.5, 0.4], ids=["from afar", "from near by"])
def test_creeping_up_to_a_bed_does_not_lift_the_floor(foot_m, from_m):
    """The floor in front is in the blind zone; the lowest visible points climb up its side."""
    grid = RollingMap(SMALL)
    bed = [(1.0, -0.8, foot_m, 3.0, 0.8, 0.5)]
    for x in np.arange(from_m, 0.75, 0.01):
        update = look(grid, SE2(x, 0.0, 0.0), bed)
    assert not update.floor_seen
    assert not abs(update.floor_z_m) > 0.02
    for x, y in ((1.05, 0.0), (1.3, 0.3), (1.5, -0.4)):
        assert grid.state_at(x, y) == 100


def test_the_floor_follows_a_ramp():
    """A surface observed over some distance is floor, even if it slopes from the start."""
    grid = RollingMap(SMALL)
    for step in range(60):
        rise_m, pose = 0.002 * step, SE2(0.02 * step, 0.0, 0.0)
        lower = pose.matrix(-rise_m) @ T_BASE_CAMERA
        update = grid.update_depth(render(CAMERA, lower, []), CAMERA, pose.matrix(), T_BASE_CAMERA)
    assert update.floor_z_m == pytest.approx(rise_m, abs=0.03)
    assert not (grid.snapshot().cells == 100).any()

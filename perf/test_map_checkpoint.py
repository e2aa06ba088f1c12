"""Benchmark: cost of the map's checkpoint, when it is saved in the loop and when it is restored."""

from __future__ import annotations

import numpy as np
import pytest
from test_mapping import MAPPING, explored_map, update_all_round

from edge import config
from edge.config import parse
from edge.geometry import SE2
from edge.host.checkpoint import Checkpoint
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.checkpoints.map_checkpoint import MAP, MapParts, StampedPose, make_map, state_of
from edge.loop.goals.goal_choice import GoalChooser
from edge.loop.semantic_map import SemanticMap
from edge.loop.warmup import warm_mapping
from edge.mapping import grid as mapping
from edge.mapping.tiles import MOST_PER_STEP, PackedTiles, TileCopier
from edge.policies import make_policy

NOW = StampedPose(SE2(0.0, 0.0, 0.0), 10**9, 10**9)
SETTINGS = {"perception": {"detector": {"kind": "sim"}}, "policy": {"kind": "search"}}


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_mapping(MAPPING)


def settings(cells: int) -> config.Config:
    return parse({**SETTINGS, "mapping": {"extent_m": cells * MAPPING.resolution_m}})


def parts_of(grid: mapping.RollingMap, c: config.Config) -> MapParts:
    known = SemanticMap(c, ())
    known.grid = grid
    goals = GoalChooser(c, known.pool, known.tracker)
    return MapParts(known, goals, make_policy(c.policy))


def file_of(cells: int) -> bytes:
    """Return the checkpoint of a fully explored map, all tiles included."""
    grid, c = explored_map(cells), settings(cells)
    copier, packed = TileCopier(), PackedTiles()
    grid.window.written[:] = True
    copier.step(grid.window, grid.planes, grid.window.written.size)
    packed.update(copier.collect()[1])
    saved = state_of(parts_of(grid, c), NOW, "", ("bed",), "bed")
    tiles = packed.state_dict(saved.arrays["map/origin"], grid.window.n)
    arrays = {f"tiles/{name}": array for name, array in tiles.items()}
    return MAP.encode(Checkpoint(saved.state, {**saved.arrays, **arrays}))


@pytest.mark.parametrize("cells", [1000, 4000])
def test_copy_of_changed_tiles(benchmark, cells):
    """Measure the copy of the changed tiles, which one tick makes every three seconds."""
    benchmark.extra_info["budget"] = f"map_copy_{cells}"
    grid, c = explored_map(cells), settings(cells)
    parts, update, copier = parts_of(grid, c), update_all_round(grid), TileCopier()
    update()
    grid.window.written[:] = False

    def change_map() -> None:
        update()
        copier.collect()

    def copy() -> None:
        assert copier.step(grid.window, grid.planes, MOST_PER_STEP + grid.tiles_of_update)
        state_of(parts, NOW, "", ("bed",), "bed")

    benchmark.pedantic(copy, setup=change_map, rounds=100, warmup_rounds=5)


@pytest.mark.parametrize("cells", [1000, 4000])
def test_restoring(benchmark, cells):
    """Measure the time from the file's bytes to a map with frontiers, before the first tick."""
    benchmark.extra_info["budget"] = f"map_restore_{cells}"
    content, c = file_of(cells), settings(cells)

    def restore() -> mapping.RollingMap:
        return make_map(MAP.decode(content), c)

    grid = benchmark.pedantic(restore, rounds=5, warmup_rounds=1)
    benchmark.extra_info["megabytes"] = len(content) * 1e-6
    print(f"{cells} cells: a file of {len(content) * 1e-6:.2f} MB")
    assert grid.known_m2 > 0.9 * (cells * MAPPING.resolution_m) ** 2


@pytest.mark.parametrize("saves", [False, True])
def test_tick(benchmark, tmp_path, saves):
    """Measure a tick with a checkpoint, and one without, on the same drive."""
    benchmark.extra_info["budget"] = "tick_with_checkpoint" if saves else "tick_without_checkpoint"
    lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 0.05}}
    loop = ClosedLoop(parse({**SETTINGS, **lockstep, "mission": {"target": "toilet"}}))
    if saves:
        checkpoint = ServiceCheckpoint(loop.config, tmp_path / "mission.json", None)
        loop.service.checkpoint = checkpoint

    def drive() -> tuple[tuple, dict]:
        loop.step()
        return (loop.observe(), loop.drive.motion.stamp_ns), {}

    benchmark.pedantic(loop.service.tick, setup=drive, rounds=300, warmup_rounds=20)
    if saves:
        checkpoint.close()
        assert checkpoint.map.writer.written > 3
    assert np.isfinite(loop.service.perception.scores).all()

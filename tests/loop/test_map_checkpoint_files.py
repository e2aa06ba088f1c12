"""A map's checkpoint with anything in its arrays: set aside, or the service goes on."""

from __future__ import annotations

import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_map_checkpoint import Run, config

from edge.host.checkpoint import Arrays, Checkpoint, save
from edge.loop.checkpoints.map_checkpoint import MAP, MapCheckpoint, MapState

SETTINGS = config("hvl", source={"localised": True})


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Checkpoint[MapState]:
    """Return a saved file with content in every part."""
    path = tmp_path_factory.mktemp("saved") / "m.json"
    run = Run(path, SETTINGS).ticks(60)
    pose, now_ns = run.drive.motion.odometry, run.drive.motion.stamp_ns
    run.service.map.grid.bumps.close(pose, pose.ahead(0.5), 0.2, now_ns)
    run.service.map.pool.discarded.add(0, 7, (1.0, 2.0), now_ns + 10**10)
    run.service.checkpoint.close()
    return MAP.decode(path.with_name("m.json.map").read_bytes())


def problem(folder: Path, saved: Checkpoint[MapState], changes: Arrays) -> str:
    """Return why a file with these arrays is set aside; "" if it is not."""
    path = folder / "m.json.map"
    save(path, replace(saved, arrays={**saved.arrays, **changes}), MAP)
    checkpoint = MapCheckpoint(SETTINGS, path)
    checkpoint.prepare()
    checkpoint.close()
    assert path.exists() == (checkpoint.problem == "") == (checkpoint.waiting is not None)
    assert "\n" not in checkpoint.problem
    return checkpoint.problem


def test_every_array_has_its_dtype_shape_and_limits(tmp_path, saved):
    assert problem(tmp_path, saved, {}) == ""
    for turn, (name, array) in enumerate(saved.arrays.items()):
        part, _, own = name.partition("/")
        if part == "policy":  # checks its own
            continue
        others = [array[..., None], array.astype("U" if array.dtype.kind != "U" else bool)]
        if array.dtype.kind == "f" and array.size:
            others.append(np.full_like(array, np.nan))
        other = others[turn % len(others)]  # in turns: one table checks all arrays
        said = problem(tmp_path, saved, {name: other})
        assert part in said or part == "tiles", (name, other.dtype, other.shape)
        assert own in said or own == "words", (name, other.dtype, other.shape)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("sightings/word", lambda a: a + 1000),
        ("sightings/cursor", lambda a: a + 1000),
        ("sightings/n_points", lambda a: a + 1000),
        ("sightings/id", lambda a: a * 0),
        ("sightings/words", lambda a: np.repeat(a[:1], len(a))),
        ("sightings/words", lambda a: np.repeat("a\nb", len(a))),
        ("sightings/weight", lambda a: -a),
        ("instances/id", lambda a: np.append(a[:-1], a[:1]) if len(a) > 1 else a[:0]),
        ("instances/state", lambda a: a + 9),
        ("instances/n_points", lambda a: a * 0),
        ("instances/n_points", lambda a: a - 1),
        ("instances/label", lambda a: np.repeat("", len(a))),
        ("candidates/id", lambda a: a * 0),
        ("candidates/discarded_kind", lambda a: a + 9),
        ("goals/turns", lambda a: a - 1),
        ("goals/left_m", lambda a: np.zeros((65, 2))),
        ("bumps/cell", lambda a: a + 1000),
        ("bumps/closed", lambda a: a + 1000),
        ("gain/next", lambda a: a - 1000),
        ("map/cells", lambda a: a - 1000_000),
        ("map/origin", lambda a: a + (1 << 40)),
        ("map/cluster_cell", lambda a: a + (1 << 20)),
        ("map/cluster_id", lambda a: a * 0),
        ("map/cluster_sample", lambda a: a + 1),
        ("tiles/n_bytes", lambda a: a + 1),
        ("tiles/packed", lambda a: a * 0),
        ("tiles/packed", lambda a: a[:-1]),
    ],
)
def test_impossible_numbers_are_set_aside(tmp_path, saved, name, change):
    array = saved.arrays[name]
    assert array.size
    assert problem(tmp_path, saved, {name: change(array).astype(array.dtype, copy=False)})


@settings(max_examples=20)
@given(st.data(), st.integers(0, 1000))
def test_the_service_survives_any_numbers_in_a_checkpoint(tmp_path_factory, saved, data, seed):
    random, changes = np.random.default_rng(seed), {}
    arrays = st.sampled_from(sorted(saved.arrays))
    for name in data.draw(st.lists(arrays, min_size=1, max_size=3)):
        array = saved.arrays[name]
        if array.dtype.kind == "U":
            continue
        far = 10.0 ** random.integers(1, 6 if array.dtype.kind == "f" else 18)
        far = min(far, 2.0 ** (8 * array.itemsize - 2))
        low = 0.0 if random.integers(2) or array.dtype.kind == "u" else -far
        changes[name] = random.uniform(low, far, array.shape).astype(array.dtype)
    path = tmp_path_factory.mktemp("forged") / "m.json"
    made = replace(saved, arrays={**saved.arrays, **changes})
    save(path.with_name("m.json.map"), made, MAP)
    run = Run(path, SETTINGS).ticks(2)
    assert run.service.map.grid.window.placed
    run.service.checkpoint.close()


def test_a_bomb_in_a_tile_takes_no_memory(tmp_path, saved):
    bomb = np.frombuffer(zlib.compress(bytes(1 << 25)), np.uint8)
    n_bytes, packed = saved.arrays["tiles/n_bytes"], saved.arrays["tiles/packed"]
    tiles = {
        "tiles/n_bytes": np.array([len(bomb), *n_bytes[1:]], np.int32),
        "tiles/packed": np.concatenate((bomb, packed[n_bytes[0] :])),
    }
    most = []
    for changes, text in (({}, ""), (tiles, "does not have 8960 bytes")):
        tracemalloc.start()
        assert text in problem(tmp_path, saved, changes)
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert most[1] < most[0] + (8 << 20)

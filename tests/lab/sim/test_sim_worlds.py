"""Built-in houses, ProcTHOR houses, floor plans and objects."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from collisions import collides
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge import names
from edge.config import Lidar, WorldHouse
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.lab.sim import assemblies
from edge.lab.sim.base import LidarRays, WorldError, WorldObject, free_poses
from edge.lab.sim.boxworld import CELL_M, BoxWorld
from edge.lab.sim.house import HOUSES, House, build_house, load_house, read_house
from edge.lab.sim.mesh import read_objects
from edge.lab.sim.procthor import build_procthor, read_houses, rectangles
from edge.lab.sim.worlds import load_world

EMPTY_ROOM = {
    "name": "empty",
    "start": [0, 0, 0],
    "wall_thickness_m": 0.1,
    "rooms": [{"name": "room", "rect": [-3, -2, 3, 2]}],
    "walls": [
        {"start": a, "end": b}
        for a, b in (
            ([-3, -2], [3, -2]), ([3, -2], [3, 2]), ([3, 2], [-3, 2]), ([-3, 2], [-3, -2]),
        )
    ],
}  # fmt: skip


def house_with(*objects: dict) -> BoxWorld:
    return build_house(House.model_validate({**EMPTY_ROOM, "objects": objects}), simulated())


def look(world, pose: SE2, width=96, height=64, pitch_rad=0.0, colour=True):
    camera = CameraModel.from_hfov(width, height, math.radians(75.0))
    rgb = np.empty((height, width, 3), np.uint8) if colour else None
    depth, ids = np.empty((height, width), np.float32), np.empty((height, width), np.uint16)
    mount = to_optical(se3(0.0, 0.0, 0.6, pitch_rad=pitch_rad))
    world.render(camera, pose.matrix() @ mount, rgb, depth, ids)
    return rgb, depth, ids


@pytest.fixture(scope="module")
def demo() -> BoxWorld:
    return load_house(WorldHouse(), simulated())


def test_depth_is_along_the_optical_axis_and_limited():
    world = house_with()
    _, depth, ids = look(world, SE2(0.0, 0.0, 0.0))
    assert depth[32, 10:86] == pytest.approx(2.95, abs=1e-3)  # the wall ahead, everywhere
    assert (ids == 0).all()
    short = simulated({"sensors": {"camera": {"depth_max_m": 2.0}}})
    _, depth, _ = look(build_house(House.model_validate(EMPTY_ROOM), short), SE2(0, 0, 0))
    assert np.isnan(depth[32]).all()


def test_an_object_is_seen_with_its_id_and_nearest_surface():
    world = house_with(
        {"category": "ball", "at": [0.0, -1.5]},
        {"category": "box", "at": [2.0, 0.0], "size": [0.4, 0.6, 1.2]},
    )
    _, depth, ids = look(world, SE2(0.0, 0.0, 0.0))
    assert set(np.unique(ids)) == {0, 2}
    # Half the depth in front, and the strip of tape on it.
    assert np.nanmin(depth[ids == 2]) == pytest.approx(1.8, abs=0.01)
    assert world.objects[1].label == "box"


def test_an_object_above_the_robot_does_not_collide():
    high = {"category": "box", "at": [1.0, 0.0], "z_m": 1.0}
    assert not collides(house_with(high), 1.0, 0.0, 0.2)
    assert collides(house_with({**high, "z_m": 0.5}), 1.0, 0.0, 0.2)
    assert not collides(house_with({"category": "rug", "at": [1.0, 0.0]}), 1.0, 0.0, 0.2)


def test_a_moved_object_moves_in_pictures_ranges_and_collisions():
    world = house_with({"category": "pillar", "at": [1.5, 0.0]})
    fan, ranges = LidarRays.of(Lidar(rings=1, columns=360)), np.empty((1, 360), np.float32)
    world.cast(fan, se3(z_m=0.5), ranges)
    assert ranges[0, 180] == pytest.approx(1.3, abs=1e-3)
    world.move(1, 0.0, 1.2)
    world.cast(fan, se3(z_m=0.5), ranges)
    assert ranges[0, 180] == pytest.approx(2.95, abs=1e-3)
    assert ranges[0, 270] == pytest.approx(1.0, abs=1e-3)
    assert not collides(world, 1.5, 0.0, 0.2)
    assert collides(world, 0.0, 1.2, 0.2)
    assert world.objects[0].distance_m(0.0, 0.0) == pytest.approx(1.0)
    assert (look(world, SE2(0.0, 0.0, 0.0))[2] == 0).all()
    with pytest.raises(KeyError):
        world.move(9, 0.0, 0.0)


@given(
    x=st.floats(-3, 3), y=st.floats(-3, 3), yaw=st.floats(-math.pi, math.pi),
    a=st.floats(0.1, 2.0), b=st.floats(0.1, 2.0),
)  # fmt: skip
def test_distance_to_a_footprint_is_that_to_its_nearest_sample(x, y, yaw, a, b):
    box = WorldObject(1, "box", "box", "box", (0.4, -0.3, 0.5), (a, b, 1.0), yaw)
    u, v = np.meshgrid(np.linspace(-a / 2, a / 2, 81), np.linspace(-b / 2, b / 2, 81))
    px = 0.4 + math.cos(yaw) * u - math.sin(yaw) * v
    py = -0.3 + math.sin(yaw) * u + math.cos(yaw) * v
    nearest = float(np.hypot(px - x, py - y).min())
    assert box.distance_m(x, y) <= nearest + 1e-9
    assert box.distance_m(x, y) == pytest.approx(nearest, abs=0.02)
    samples = np.stack([px.ravel(), py.ravel()], axis=1).astype(np.float32)
    sampled = WorldObject(1, "b", "b", "b", (0, 0, 0), (a, b, 1.0), yaw, samples)
    assert sampled.distance_m(x, y) == pytest.approx(nearest, abs=1e-4)


def test_the_demo_house_is_connected_and_furnished(demo: BoxWorld):
    house = read_house(HOUSES / "demo.json")
    assert len(house.rooms) >= 4
    reachable = demo.plan.reachable(demo.start.x_m, demo.start.y_m, 0.25)
    for room in house.rooms:
        (x0, y0), (x1, y1) = demo.plan.grid.to_cells(np.reshape(room.rect, (2, 2))).astype(int)
        assert reachable[y0:y1, x0:x1].any(), room.name
    # The robot can stand next to every object on the floor.
    row, col = np.nonzero(reachable)
    places = demo.plan.grid.centres_m(row, col)
    for item in demo.objects:
        if item.center_m[2] - item.size_m[2] / 2 < 0.1:
            x, y = item.center_m[:2]
            near = places[np.argsort(np.hypot(*(places - (x, y)).T))[:200]]
            assert min(item.distance_m(*p) for p in near) < 0.6, item.name
    assert names.canonical("trash can") in {item.label for item in demo.objects}


def test_free_poses_are_free_reachable_and_repeatable(demo: BoxWorld):
    poses = free_poses(demo, 40, seed=3, radius_m=0.2)
    assert poses == free_poses(demo, 40, seed=3, radius_m=0.2)
    assert poses != free_poses(demo, 40, seed=4, radius_m=0.2)
    assert all(0 < p.x_m < 11 and 0 < p.y_m < 10.4 for p in poses)
    assert not any(collides(demo, p.x_m, p.y_m, 0.25) for p in poses)


def test_free_poses_refuse_a_start_that_is_not_free():
    world = build_house(House.model_validate({**EMPTY_ROOM, "start": [3, 0, 0]}), simulated())
    with pytest.raises(WorldError, match="does not fit at the start"):
        free_poses(world, 1, 0, 0.2)


@pytest.mark.parametrize("category", assemblies.CATEGORIES)
def test_assemblies_fill_their_box(category: str):
    size = assemblies.CATEGORIES[category].size_m
    parts = assemblies.build(category, size, (200.0, 100.0, 50.0))
    low = np.min([np.subtract(p.center_m, np.multiply(p.size_m, 0.5)) for p in parts], axis=0)
    high = np.max([np.add(p.center_m, np.multiply(p.size_m, 0.5)) for p in parts], axis=0)
    assert (high - low > 0.85 * np.array(size)).all()
    assert (high - low < 1.45 * np.array(size) + 0.08).all()
    assert low[2] > -0.011
    double = assemblies.build(category, tuple(2 * v for v in size), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(double[0].size_m, np.multiply(parts[0].size_m, 2))


def test_there_are_enough_categories():
    assert len(assemblies.CATEGORIES) >= 20


BAD_HOUSES = {
    "not json": ("{", "not a JSON file"),
    "unknown category": (
        json.dumps({**EMPTY_ROOM, "objects": [{"category": "chiar", "at": [0, 0]}]}),
        r"objects\.0\.category: unknown category \(choices: chair",
    ),
    "misspelt key": (json.dumps({**EMPTY_ROOM, "wals": []}), "wals"),
    "no start": (json.dumps({"name": "x"}), "start"),
    "negative size": (
        json.dumps({**EMPTY_ROOM, "objects": [
            {"category": "box", "at": [0, 0], "size": [1, -1, 1]}]}),
        r"objects\.0\.size\.1",
    ),
    "nothing in it": (json.dumps({"name": "x", "start": [0, 0, 0]}), "has no walls and no objects"),
    "a list": ("[]", "top"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_HOUSES.values(), ids=BAD_HOUSES)
def test_a_malformed_house_gives_one_clear_line(tmp_path: Path, text: str, message: str):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(WorldError, match=message) as caught:
        load_house(WorldHouse(house=str(path)), simulated())
    assert "\n" not in str(caught.value)


def test_rectangles_cover_a_polygon_exactly():
    assert rectangles([[0, 0], [2, 0], [2, 1], [0, 1]]) == [(0, 0, 2, 1)]
    u_shape = [[0, 0], [3, 0], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2]]
    areas = [(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in rectangles(u_shape)]
    assert len(areas) == 3
    assert sum(areas) == pytest.approx(5.0)


def test_procthor_houses_start_free_and_have_reachable_rooms(shared_dir: Path):
    path = shared_dir / "worlds" / "procthor_val.jsonl.gz"
    houses = {house["name"]: house for house in read_houses(path)}
    assert len(houses) == 75
    for name in ("procthor-val-0", "procthor-val-7", "procthor-val-31", "procthor-val-74"):
        world = build_procthor(houses[name], simulated())
        assert len(world.rooms) == len(houses[name]["rooms"])
        assert not collides(world, world.start.x_m, world.start.y_m, 0.2), name
        area = world.plan.reachable(world.start.x_m, world.start.y_m, 0.2).sum() * CELL_M**2
        assert area > 10.0, name
        assert len(world.objects) == len(houses[name]["objects"])
        _, depth, _ = look(world, world.start)
        assert np.isfinite(depth).any()


def test_the_files_that_the_docs_describe_are_read(tmp_path: Path):
    text = (Path(__file__).resolve().parents[3] / "docs" / "worlds.md").read_text(encoding="utf-8")
    house, objects = re.findall(r"```json\n(.*?)```", text, re.DOTALL)
    (config,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    path = tmp_path / "houses.jsonl"
    path.write_text(json.dumps(json.loads(house)) + "\n")
    sim = yaml.safe_load(config)["sim"]
    world = load_world(simulated({"sim": sim}))
    assert (world.name, world.start) == ("demo", SE2(2.0, 1.0, 0.0))
    section = {"kind": "procthor", "file": str(path), "name": "my-house-0"}
    world = load_world(simulated({"sim": {"world": section}}))
    assert [item.label for item in world.objects] == ["refrigerator"]
    assert not collides(world, world.start.x_m, world.start.y_m, 0.2)
    (tmp_path / "objects.json").write_text(objects)
    (item,) = read_objects(tmp_path / "objects.json")
    assert names.canonical(item["category"]) == "sofa"


def test_procthor_errors_name_the_file_and_house(shared_dir: Path, tmp_path: Path):
    def load(file: Path, name: str):
        world = {"kind": "procthor", "file": str(file), "name": name}
        return load_world(simulated({"sim": {"world": world}}))

    path = shared_dir / "worlds" / "procthor_val.jsonl.gz"
    assert load(path, "procthor-val-1").name == "procthor-val-1"
    with pytest.raises(WorldError, match=r"none of the 75 houses is called 'nope'.*procthor-val-0"):
        load(path, "nope")
    with pytest.raises(WorldError, match="No such file"):
        load(tmp_path / "missing.jsonl.gz", "x")
    broken = tmp_path / "broken.jsonl"
    broken.write_text('{"name": "a"}\n{"name": \n')
    with pytest.raises(WorldError, match="line 2: not JSON"):
        load(broken, "b")
    with pytest.raises(WorldError, match="house a: a field is missing or wrong"):
        load(broken, "a")


def test_without_colour_depth_and_ids_are_the_same(demo):
    _, depth, ids = look(demo, demo.start)
    _, grey_depth, grey_ids = look(demo, demo.start, colour=False)
    assert ids.any()
    np.testing.assert_array_equal(depth, grey_depth)
    np.testing.assert_array_equal(ids, grey_ids)

"""Textured meshes: a small one made here, and the AWS house where it is."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from collisions import collides
from simulated import simulated

from edge.config import Lidar
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.lab.sim import mesh_kernels
from edge.lab.sim.base import LidarRays, WorldError
from edge.lab.sim.worlds import load_world

pytest.importorskip("trimesh", reason="needs the extra `worlds`")
import trimesh
from PIL import Image

pytestmark = pytest.mark.weights


def world_config(mesh: Path, objects: Path):
    return simulated(
        {"sim": {"world": {"kind": "mesh", "mesh": str(mesh), "objects": str(objects)}}}
    )


def look(world, pose: SE2, width: int = 160, height: int = 128, colour=True):
    camera = CameraModel.from_hfov(width, height, math.radians(75.0))
    rgb = np.empty((height, width, 3), np.uint8) if colour else None
    depth, ids = np.empty((height, width), np.float32), np.empty((height, width), np.uint16)
    world.render(camera, pose.matrix() @ to_optical(se3(0.0, 0.0, 0.6)), rgb, depth, ids)
    return rgb, depth, ids


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return a floor and a panel 2 m ahead: red above, green below left, blue right."""
    folder = tmp_path_factory.mktemp("mesh")
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32], pixels[32:, :32], pixels[32:, 32:] = (250, 0, 0), (0, 250, 0), (0, 0, 250)
    # Seen from the origin: left is +y. glTF's t runs down, trimesh's v up.
    corners = np.array([[2, 1, 0.1], [2, -1, 0.1], [2, -1, 1.1], [2, 1, 1.1]], float)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(pixels))
    panel = trimesh.Trimesh(
        corners, [[0, 1, 2], [0, 2, 3]], process=False,
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
    )  # fmt: skip
    floor = trimesh.creation.box((8, 8, 0.1), se3(z_m=-0.05))
    scene = trimesh.Scene()
    scene.add_geometry(panel, node_name="Panel_01", geom_name="panel")
    scene.add_geometry(floor, node_name="FloorB_01", geom_name="floor")
    (folder / "small.glb").write_bytes(scene.export(file_type="glb"))
    box = {"yaw": 0.0, "aabb_min": [2.0, -1.0, 0.1], "aabb_max": [2.0, 1.0, 1.1]}
    floor_box = {"yaw": 0.0, "aabb_min": [-4, -4, -0.1], "aabb_max": [4, 4, 0]}
    (folder / "objects.json").write_text(json.dumps([
        {"name": "FloorB_01", "category": "FloorB", **floor_box},
        {"name": "Panel_01", "category": "TV", **box},
    ]))  # fmt: skip
    return load_world(world_config(folder / "small.glb", folder / "objects.json"))


def test_the_texture_is_upright(small):
    rgb, depth, ids = look(small, SE2(0.0, 0.0, 0.0))
    rows, cols = np.nonzero(ids)
    top, bottom, left, right = rows.min(), rows.max(), cols.min(), cols.max()
    assert depth[rows, cols] == pytest.approx(2.0, abs=1e-4)
    inside = {
        "red": rgb[top + 3, (left + right) // 2],
        "green": rgb[bottom - 3, left + 3],
        "blue": rgb[bottom - 3, right - 3],
    }
    assert [int(np.argmax(inside[name])) for name in ("red", "green", "blue")] == [0, 1, 2]


def test_objects_get_ids_and_structure_none(small):
    assert [(o.id, o.label) for o in small.objects] == [(1, "television")]
    _, depth, ids = look(small, SE2(0.0, 0.0, 0.0))
    assert set(np.unique(ids)) == {0, 1}
    assert (ids[-1] == 0).all()
    assert np.isfinite(depth[-1]).all(), "the floor is there"


def test_footprint_and_collision_of_a_panel(small):
    assert small.objects[0].distance_m(0.0, 0.0) == pytest.approx(2.0, abs=0.03)
    assert small.objects[0].distance_m(2.0, 2.0) == pytest.approx(1.0, abs=0.03)
    assert collides(small, 1.9, 0.5, 0.2)
    assert not collides(small, 1.7, 0.5, 0.2)


def test_lidar_on_a_mesh(small):
    pytest.importorskip("embreex", reason="needs the extra `worlds`")
    ranges = np.empty((1, 360), np.float32)
    small.cast(LidarRays.of(Lidar(rings=1, columns=360)), se3(0.5, 0.0, 0.6), ranges)
    assert ranges[0, 180] == pytest.approx(1.5, abs=1e-3)
    assert np.isnan(ranges[0, 0])


def plain_lookup(picture: np.ndarray, s: float, t: float) -> np.ndarray:
    """Bilinear, wrapping around: texel centres lie at half-integers."""
    height, width = picture.shape[:2]
    x, y = (s % 1.0) * width - 0.5, (t % 1.0) * height - 0.5
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    rows, cols = np.array([y0, y0 + 1]) % height, np.array([x0, x0 + 1]) % width
    return np.einsum("r,c,rcj->j", [1 - fy, fy], [1 - fx, fx], picture[np.ix_(rows, cols)])


def test_shade_hits_agrees_with_a_plain_one():
    rng = np.random.default_rng(5)
    n, faces, fx = 400, 9, 180.0
    pictures = [rng.integers(0, 256, (h, w, 3)) for h, w in ((8, 12), (4, 6), (2, 3), (1, 1))]
    texels = np.concatenate([p.reshape(-1, 3) for p in pictures]).astype(np.uint8)
    offsets = np.cumsum([0, *(p.shape[0] * p.shape[1] for p in pictures)])
    levels = np.array([(o, *p.shape[:2]) for o, p in zip(offsets, pictures, strict=False)])
    face = rng.integers(-1, faces, n).astype(np.int32)
    b1, b2 = rng.dirichlet((1, 1, 1), n)[:, :2].T.astype(np.float32)
    distance = rng.uniform(0.5, 9.0, n).astype(np.float32)
    rays = rng.normal(size=(n, 3)).astype(np.float32)
    normals = rng.normal(size=(faces, 3, 3)).astype(np.float32)
    uvs = rng.uniform(-2.0, 2.0, (faces, 3, 2)).astype(np.float32)
    tint = rng.uniform(0.3, 1.0, (faces, 3)).astype(np.float32)
    density = rng.uniform(1.0, 300.0, faces).astype(np.float32)
    sky, rgb = np.array([9, 8, 7], np.uint8), np.empty((n, 3), np.uint8)
    mesh_kernels.shade_hits(
        face, b1, b2, distance, rays, fx, normals, uvs, tint, texels, levels,
        np.zeros(faces, np.int64), np.full(faces, 4), density, sky, rgb,
    )  # fmt: skip
    for k in range(n):
        f = face[k]
        if f < 0:
            assert tuple(rgb[k]) == (9, 8, 7)
            continue
        weights = np.array([1.0 - b1[k] - b2[k], b1[k], b2[k]])
        footprint = density[f] * distance[k] / fx
        level = 0
        while footprint > 1.42 and level < 3:
            footprint, level = footprint / 2, level + 1
        color = plain_lookup(pictures[level], *(weights @ uvs[f]))
        normal = weights @ normals[f]
        normal /= np.linalg.norm(normal)
        ray = rays[k] / np.linalg.norm(rays[k])
        if normal @ ray > 0:
            normal = -normal
        light = 0.66 - 0.24 * normal @ ray + 0.14 * normal @ (0.3, 0.42, 0.86)
        expected = np.minimum(255.0, color * tint[f] * light)
        np.testing.assert_allclose(rgb[k], expected, atol=1.01)


def test_aim_is_a_rotation_and_a_translation():
    rays = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    T = se3(1.0, -2.0, 0.5, 0.3, -0.4, 2.0)
    origins, directions = np.empty((50, 3), np.float32), np.empty((50, 3), np.float32)
    mesh_kernels.aim(rays, T, origins, directions)
    np.testing.assert_allclose(directions, rays @ T[:3, :3].T, atol=1e-5)
    np.testing.assert_allclose(origins, np.tile(T[:3, 3], (50, 1)), atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_rasterise_triangles_covers_a_dense_sampling(seed: int):
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-1.0, 1.0, (6, 3, 3)).astype(np.float32)
    grid = np.zeros((44, 44), np.uint8)
    mesh_kernels.rasterise_triangles(triangles, 0.05, 0.8, np.array([-1.1, -1.1]), 0.05, grid)
    dense = np.zeros(grid.shape, bool)
    weights = rng.dirichlet((1.0, 1.0, 1.0), 40000)
    for triangle in triangles:
        points = weights @ triangle
        points = points[(points[:, 2] > 0.05) & (points[:, 2] < 0.8)]
        col, row = ((points[:, :2] + 1.1) / 0.05).astype(int).T
        dense[row, col] = True
    reached = cv2.dilate(grid, np.ones((3, 3), np.uint8)).astype(bool)
    assert not (dense & ~reached).any(), "no cell farther than one from a marked one"
    assert not (grid.astype(bool) & ~cv2.dilate(dense.astype(np.uint8), np.ones((3, 3))).astype(
        bool)).any()  # fmt: skip
    assert (grid.astype(bool) & dense).sum() > 0.95 * dense.sum()


@pytest.mark.parametrize(
    ("mesh", "objects", "message"),
    [(None, "[]", "sim.world.mesh: no file "), (b"not a mesh", "[]", "not a readable mesh")],
)
def test_bad_files_give_one_clear_line(tmp_path: Path, mesh, objects, message):
    path, listing = tmp_path / "a.glb", tmp_path / "a.json"
    if mesh is not None:
        path.write_bytes(mesh)
    listing.write_text(objects)
    with pytest.raises(WorldError, match=message) as caught:
        load_world(world_config(path, listing))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a JSON list of objects"),
        ("3", "not"),
        ('[{"name": "a"}]', "object 0 .*: the field 'category' is missing"),
        (
            '[{"name": "a", "category": "-", "yaw": 0, "aabb_min": [], "aabb_max": []}]',
            "object 0 .*: category: '-' is no name",
        ),
    ],
)
def test_bad_object_lists_give_one_clear_line(tmp_path: Path, text: str, message: str):
    from edge.lab.sim.mesh import read_objects

    path = tmp_path / "objects.json"
    path.write_text(text)
    with pytest.raises(WorldError, match=message):
        read_objects(path)


@pytest.mark.parametrize(("package", "sensors"), [("trimesh", {}), ("embreex", {"lidar": {}})])
def test_without_the_extra_the_error_names_the_package(
    monkeypatch, tmp_path: Path, package, sensors
):
    import sys

    monkeypatch.setitem(sys.modules, package, None)
    world = {"kind": "mesh", "mesh": str(tmp_path / "a.glb"), "objects": str(tmp_path / "a.json")}
    with pytest.raises(WorldError, match=rf"{package}.*pip install 'edge-vln\[worlds\]'"):
        load_world(simulated({"sim": {"world": world}, "sensors": sensors}))


@pytest.fixture(scope="module")
def aws(shared_dir: Path):
    folder = shared_dir / "worlds" / "aws_small_house"
    config = world_config(folder / "small_house_zup.glb", folder / "small_house.objects.json")
    return load_world(config)


def test_aws_house_agrees_with_its_makers_map(aws, shared_dir: Path):
    folder = shared_dir / "worlds" / "aws_small_house"
    about = yaml.safe_load((folder / "map.yaml").read_text())
    pixels = cv2.imread(str(folder / "map.pgm"), cv2.IMREAD_UNCHANGED)[::-1]
    rows, cols = np.nonzero(pixels >= 250)
    xs = about["origin"][0] + (cols + 0.5) * about["resolution"]
    ys = about["origin"][1] + (rows + 0.5) * about["resolution"]
    ours = np.array([aws.plan.clearance_at(x, y) > 0 for x, y in zip(xs, ys, strict=True)])
    assert ours.mean() > 0.93, "what the makers' robot found free is free"
    reachable = aws.plan.reachable(aws.start.x_m, aws.start.y_m, 0.2)
    row, col = np.nonzero(reachable)
    x, y = aws.plan.grid.centres_m(row, col).T
    u = ((x - about["origin"][0]) / about["resolution"]).astype(int)
    v = ((y - about["origin"][1]) / about["resolution"]).astype(int)
    assert (pixels[v, u] >= 250).mean() > 0.93, "what is reachable here was free there"


@pytest.mark.parametrize("label", ["trash can", "sofa", "chair", "bed", "desk"])
def test_aws_targets_exist_and_can_be_reached(aws, label: str):
    mine = [item for item in aws.objects if item.label == label]
    assert mine
    row, col = np.nonzero(aws.plan.reachable(aws.start.x_m, aws.start.y_m, 0.2))
    places = aws.plan.grid.centres_m(row, col)
    for item in mine:
        x, y = item.center_m[:2]
        near = places[np.argsort(np.hypot(*(places - (x, y)).T))[:300]]
        assert min(item.distance_m(*p) for p in near) < 0.5, item.name


def test_the_aws_trash_can_is_visible_from_the_front(aws):
    can = next(item for item in aws.objects if item.name == "Trash_01_001")
    x, y = can.center_m[:2]
    _, depth, ids = look(aws, SE2(x + 1.5, y, math.pi))
    assert (ids == can.id).sum() > 40
    assert np.nanmedian(depth[ids == can.id]) == pytest.approx(1.4, abs=0.15)


def test_without_colour_depth_and_ids_are_the_same(small):
    _, depth, ids = look(small, SE2(0.0, 0.0, 0.0))
    _, grey_depth, grey_ids = look(small, SE2(0.0, 0.0, 0.0), colour=False)
    np.testing.assert_array_equal(depth, grey_depth)
    np.testing.assert_array_equal(ids, grey_ids)

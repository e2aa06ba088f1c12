from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest
import twins
from hypothesis import given
from hypothesis import strategies as st

from edge import config
from edge.geometry import CameraModel, invert
from edge.perception.tracking import back_projection_kernels as kernels
from edge.perception.tracking.back_projection import BackProjector
from edge.types import MASK_SIDE, ContextBoxes, Detections, Observation

SIMULATED = config.PerceptionConfig(detector=config.DetectorSim())


def detect(observation, *boxes, score=0.9):
    n = len(boxes)
    return Detections(
        observation=observation,
        xyxy_px=np.array(boxes, np.float32).reshape(n, 4),
        score=np.full(n, score, np.float32),
        class_id=np.zeros(n, np.int32),
        prompts=("thing",),
    )


def lift(observation, *boxes, **settings):
    lifter = BackProjector(config.PerceptionConfig(detector=config.DetectorSim(), **settings))
    return lifter.back_project(detect(observation, *boxes))[0]


def wall_with_thing(thing_m=2.0, wall_m=4.0):
    """Depth of a wall with a thing of 20 × 24 px in the middle of an 80 × 64 image."""
    depth = np.full((64, 80), wall_m, np.float32)
    depth[20:44, 30:50] = thing_m
    return depth


BOX = (28, 18, 52, 46)


@pytest.mark.parametrize("way", ["depth", "cloud"])
def test_no_box_nothing_lifted(make_observation, way):
    assert len(lift(make_observation(), back_projection=way)) == 0


@pytest.mark.parametrize(
    ("box", "depth_m"),
    [
        (BOX, np.nan),
        (BOX, 0.0),
        (BOX, 9.0),
        ((40, 30, 41, 31), 2.0),
        ((-50, -50, -10, -10), 2.0),
        ((np.nan, 0, 10, 10), 2.0),
    ],
    ids=["nan", "zero", "far", "tiny", "outside", "nan box"],
)
def test_too_few_returns_are_invalid_not_wrong(make_observation, box, depth_m):
    out = lift(make_observation(depth_m=np.full((64, 80), depth_m, np.float32)), box)
    assert out.valid.tolist() == [False]


@pytest.mark.parametrize("base_m", [0.0, 0.4])
def test_the_floor_in_front_is_left_out(make_observation, base_m):
    """Camera at 0.6 m: rows below the horizon see the floor, nearer than the object."""
    seen = make_observation(depth_m=np.full((64, 80), 4.0, np.float32))
    camera = seen.camera
    rows = np.arange(64)
    floor = np.where(rows > camera.cy_px, 0.6 * camera.fy_px / (rows - camera.cy_px + 1e-9), 99)
    seen.depth_m[:] = np.minimum(4.0, floor)[:, None]
    seen.depth_m[24:48, 30:50] = np.minimum(seen.depth_m[24:48, 30:50], 2.0)
    legs = np.eye(4)
    legs[2, 3] = base_m
    seen = dataclasses.replace(
        seen, T_map_base=seen.T_map_base @ legs, T_base_camera=invert(legs) @ seen.T_base_camera
    )
    out, _ = BackProjector(SIMULATED).back_project(detect(seen, (28, 22, 52, 63)), -base_m)
    np.testing.assert_allclose(out.center_m[0][:2], [2.0, 0.0], atol=0.1)
    assert 0.05 < out.surface_m(0)[:, 2].min() < 0.3
    assert out.surface_m(0)[:, 0].min() > 1.8


def test_an_object_flat_on_the_floor_is_lifted(make_observation):
    seen = make_observation()
    rows = np.arange(64)[:, None]
    floor = 0.6 * seen.camera.fy_px / np.maximum(rows - seen.camera.cy_px, 1e-3)
    depth = np.repeat(np.where(floor < 8, floor, 0), 80, axis=1).astype(np.float32)
    out = lift(dataclasses.replace(seen, depth_m=depth), (20, 45, 60, 60))
    assert out.valid.all()
    assert abs(out.center_m[0][2]) < 0.05


def cloud_of(observation):
    """Return the depth image as a cloud in the base frame."""
    c, depth = observation.camera, observation.depth_m
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    x, y = (u - c.cx_px) / c.fx_px * depth, (v - c.cy_px) / c.fy_px * depth
    optical = np.stack((x, y, depth), axis=-1).reshape(-1, 3)
    T = observation.T_base_camera
    return (optical @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


def test_cloud_and_depth_agree(make_observation):
    seen = make_observation(x_m=1.0, depth_m=wall_with_thing())
    cloud = np.vstack((cloud_of(seen), np.full((5, 3), np.inf, np.float32)))
    by_cloud = lift(
        dataclasses.replace(seen, cloud_m=cloud, depth_m=None), BOX, back_projection="cloud"
    )
    by_depth = lift(seen, BOX)
    np.testing.assert_allclose(by_cloud.center_m, by_depth.center_m, atol=0.05)
    assert by_cloud.valid.all()


@pytest.mark.parametrize(
    ("change", "way", "message"),
    [
        ({"camera": None}, "depth", "no camera model"),
        ({"depth_m": None}, "depth", "no depth"),
        ({"depth_m": np.ones((3, 3), np.float32)}, "depth", "does not fit the 64x80"),
        ({}, "cloud", "no cloud"),
    ],
)
def test_missing_inputs_are_counted_and_reported_once(
    make_observation, change, way, message, caplog
):
    """A LiDAR or depth camera that falls silent must not end the loop."""
    seen = dataclasses.replace(make_observation(depth_m=wall_with_thing()), **change)
    lifter = BackProjector(
        config.PerceptionConfig(detector=config.DetectorSim(), back_projection=way)
    )
    for _ in range(2):
        lifted, _ = lifter.back_project(detect(seen, BOX))
        assert len(lifted) == 1
        assert not lifted.valid.any()
    assert lifter.skipped == 2
    assert [message in record.getMessage() for record in caplog.records] == [True]


# -- real data ------------------------------------------------------------------------------

TRUCK, TRUNK, POLE = 18, 71, 80


def kitti(folder, frame):
    """Observation, and the class of every point of its cloud."""
    rows = dict(line.split(":", 1) for line in (folder / "calib.txt").read_text().splitlines())
    P2 = np.array(rows["P2"].split(), float).reshape(3, 4)
    tr = (folder / "Tr_velo_to_cam0.txt").read_text().split("Tr:")[1].split()
    T_cam0_velo = np.vstack((np.array(tr[:12], float).reshape(3, 4), [0, 0, 0, 1]))
    T_cam2_cam0 = np.eye(4)
    T_cam2_cam0[:3, 3] = np.linalg.solve(P2[:, :3], P2[:, 3])
    image = cv2.imread(str(folder / "image_2" / f"{frame:06d}.png"))
    cloud = np.fromfile(folder / "velodyne" / f"{frame:06d}.bin", np.float32).reshape(-1, 4)
    labels = np.fromfile(folder / "labels" / f"{frame:06d}.label", np.uint32)
    T_base_lidar = np.eye(4)
    T_base_lidar[2, 3] = 1.73  # the scanner's height over the road
    T_map_base = np.eye(4)
    T_map_base[:2, 3] = 100.0, -50.0
    camera = CameraModel(image.shape[1], image.shape[0], P2[0, 0], P2[1, 1], P2[0, 2], P2[1, 2])
    seen = Observation(
        seq=frame, stamp_ns=0, T_map_base=T_map_base, rgb=image[:, :, ::-1], camera=camera,
        T_base_camera=T_base_lidar @ invert(T_cam2_cam0 @ T_cam0_velo),
        cloud_m=np.ascontiguousarray(cloud[:, :3]), T_base_lidar=T_base_lidar,
    )  # fmt: skip
    return seen, labels & 0xFFFF


def box_around(seen, points):
    """Return the image box of LiDAR points."""
    T = invert(seen.T_base_camera) @ seen.T_base_lidar
    x, y, z = (points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]).T
    u = seen.camera.fx_px * x / z + seen.camera.cx_px
    v = seen.camera.fy_px * y / z + seen.camera.cy_px
    return (u.min(), v.min(), u.max(), v.max()), z


def things(cloud, half_m=0.5):
    """Points (n, 3) of each thing in a cloud of one class: neighbours on a grid of cells."""
    cell = np.floor(cloud[:, :2] / half_m).astype(int) + 200
    inside = ((cell >= 0) & (cell < 400)).all(axis=1)
    cloud, cell = cloud[inside], cell[inside]
    filled = np.zeros((400, 400), np.uint8)
    filled[cell[:, 0], cell[:, 1]] = 1
    n, which = cv2.connectedComponents(filled)
    return [cloud[which[cell[:, 0], cell[:, 1]] == i] for i in range(1, n)]


def test_objects_of_a_real_lidar_scan(shared_dir):
    """Trucks, trunks and poles; those with a bush before them may be taken for the bush."""
    folder = shared_dir / "logs" / "semantic_kitti_05"
    if not folder.is_dir():
        pytest.skip(f"not there: {folder.name}")
    settings = {
        "back_projection": "cloud",
        "back_projection_max_range_m": 60.0,
        "back_projection_min_points": 4,
    }
    lifter = BackProjector(config.PerceptionConfig(detector=config.DetectorSim(), **settings))
    gaps = {TRUCK: [], TRUNK: [], POLE: []}
    for frame in (0, 2, 4, 6, 8):
        seen, semantic = kitti(folder, frame)
        offset_m = (seen.T_map_base @ seen.T_base_lidar)[:3, 3]
        for kind, found in gaps.items():
            for points in things(seen.cloud_m[semantic == kind]):
                box, z = box_around(seen, points)
                in_view = box[0] >= 0 and box[2] < seen.camera.width_px and z.min() > 2
                if len(points) < 25 or not in_view or box[2] - box[0] < 6:
                    continue
                out, _ = lifter.back_project(detect(seen, box))
                assert out.valid.all()
                apart = points[:, :2] + offset_m[:2] - out.center_m[0, :2]
                found.append(np.linalg.norm(apart, axis=1).min())
    assert len(gaps[TRUCK]) == 10
    assert max(gaps[TRUCK]) < 0.15
    everything = np.concatenate(list(gaps.values()))
    assert np.median(everything) < 0.1
    assert np.mean(everything < 0.2) > 0.75


def test_the_chair_of_a_real_depth_camera(shared_dir):
    folder = shared_dir / "logs" / "redwood_rgbd"
    if not folder.is_dir():
        pytest.skip(f"not there: {folder.name}")
    intrinsics = json.loads((folder / "camera_primesense.json").read_text())
    k = intrinsics["intrinsic_matrix"]
    camera = CameraModel(intrinsics["width"], intrinsics["height"], k[0], k[4], k[6], k[7])
    depth = cv2.imread(str(folder / "depth" / "00000.png"), cv2.IMREAD_UNCHANGED) / 1000
    seen = Observation(0, 0, np.eye(4), depth_m=depth.astype(np.float32), camera=camera)
    seat = (400, 180, 560, 280)  # the seat and back of the white chair, wall behind it
    out = lift(seen, (335, 107, 612, 384), seat)
    assert out.valid.all()
    # Here `map` is the optical frame: z is the distance.
    np.testing.assert_allclose(out.center_m[0], out.center_m[1], atol=0.35)
    wall_m = np.median(seen.depth_m[20:60, 330:380])
    assert 1.0 < out.center_m[0][2] < wall_m


def sofa_behind_table(table_left=0, table_right=80):
    """Return a sofa 3 m away behind a table at 1.5 m that hides its lower part."""
    depth = np.full((64, 80), 5.0, np.float32)
    depth[20:44, 20:60] = 3.0
    depth[36:64, table_left:table_right] = 1.5
    return depth


@pytest.mark.parametrize("table", [(0, 80), (25, 55)])
def test_an_obstacle_in_front_of_the_box_is_left_out(make_observation, table):
    """The box around the visible part of the sofa also contains much of the table."""
    out = lift(make_observation(depth_m=sofa_behind_table(*table)), (20, 20, 60, 44))
    assert out.valid.tolist() == [True]
    assert out.center_m[0, 0] == pytest.approx(3.0, abs=0.1)


def test_an_object_on_a_table_keeps_the_nearest_surface(make_observation):
    """Vase and table top are one surface, and the wall goes on beyond the box as well."""
    depth = np.full((64, 80), 4.0, np.float32)
    depth[20:44, 34:46] = 2.0
    depth[44:64, :] = 2.0
    out = lift(make_observation(depth_m=depth), (32, 18, 48, 46))
    assert out.center_m[0, 0] == pytest.approx(2.0, abs=0.1)


def shelf_behind_a_cabinet():
    """Return a shelf of 20 × 50 px at 3 m, before a wall.

    A cabinet that extends to the left hides its lower two thirds.
    """
    depth = np.full((64, 80), 5.0, np.float32)
    depth[6:56, 40:60] = 3.0
    depth[22:56, 10:60] = 1.5
    return depth


SHELF, CABINET = (39, 5, 61, 57), (9, 21, 61, 57)


@pytest.mark.parametrize(
    ("around", "x_m"),
    [
        (None, 1.5),
        ((), 1.5),
        ((CABINET,), 3.0),
        # A competing class at the same box hides nothing of it.
        ((SHELF,), 1.5),
        (((200, 200, 210, 210),), 1.5),
        ((CABINET, (np.nan, 0, 1, 1)), 3.0),
    ],
)
def test_depth_that_fits_another_box_is_left_out(make_observation, around, x_m):
    seen = detect(make_observation(depth_m=shelf_behind_a_cabinet()), SHELF)
    if around is not None:
        boxes = np.array(around, np.float32).reshape(-1, 4)
        n = len(boxes)
        others = ContextBoxes(boxes, np.ones(n, np.float32), np.zeros(n, np.int32), ("cabinet",))
        seen = dataclasses.replace(seen, context=others)
    out, beside = BackProjector(SIMULATED).back_project(seen)
    assert out.center_m[0, 0] == pytest.approx(x_m, abs=0.1)
    assert (beside is None) == (around is None)
    if around and around[0] == CABINET:
        assert beside.center_m[0, 0] == pytest.approx(1.5, abs=0.1)


def test_a_bed_behind_a_lamp_is_not_the_lamp(make_observation):
    """Another box takes the bed's surface; the rest of its own box is the lamp's."""
    depth = np.tile(np.linspace(5.2, 7.8, 80, dtype=np.float32), (64, 1))
    depth[31:48, 20:60] = 4.5
    depth[2:20, 28:52] = depth[20:64, 32:38] = 0.6  # its shade and its stem
    seen = detect(make_observation(depth_m=depth), (20, 24, 56, 48), score=0.6)
    alone, _ = BackProjector(SIMULATED).back_project(seen)
    assert alone.center_m[0, 0] == pytest.approx(4.5, abs=0.1)
    boxes = np.array([[6, 1, 74, 60], [36, 32, 59, 50]], np.float32)
    scores, words = np.array([0.7, 0.3], np.float32), ("lamp", "coffee table")
    around = ContextBoxes(boxes, scores, np.arange(2, dtype=np.int32), words)
    out, beside = BackProjector(SIMULATED).back_project(dataclasses.replace(seen, context=around))
    assert beside.center_m[:, 0] == pytest.approx([0.6, 4.5], abs=0.1)
    assert not out.valid[0]


@given(seed=st.integers(0, 2**32 - 1))
def test_samples_of_other_objects_are_dropped_one_by_one(seed):
    rng = np.random.default_rng(seed)
    n, view = 60, (None, None, None, 0, 40.0, 40.0, 20.0, 20.0)
    z = rng.uniform(1, 4, n)
    u, v = rng.uniform(5, 35, (2, n))
    samples = np.stack([(u - 20) / 40 * z, (v - 20) / 40 * z, z], axis=1).astype(np.float32)
    corner = rng.uniform(0, 35, (3, 2))
    boxes = np.vstack([[5, 5, 35, 35], np.hstack([corner, corner + rng.uniform(2, 20, (3, 2))])])
    boxes = boxes.astype(np.float32)
    depth = np.sort(rng.uniform(0.5, 4, (4, 2)), axis=1).astype(np.float32)
    claim, word = rng.uniform(0, 1, 4).astype(np.float32), rng.integers(0, 3, 4).astype(np.int32)
    kept = twins.without_others(samples, view, boxes, word, 0, depth, claim)
    left = samples.copy()
    whole = (np.zeros((1, 1), np.float32),) * 3 + view[3:]
    k = kernels.drop_others(left, n, whole, boxes, word, 0, depth, claim)
    assert {*map(tuple, left[:k])} == {*map(tuple, kept)}
    assert {*map(tuple, left)} == {*map(tuple, samples)}


def mask_over(box, shows):
    """Return a mask (1, MASK_SIDE, MASK_SIDE) of the depth pixels for which `shows` holds."""
    out = np.zeros((1, MASK_SIDE, MASK_SIDE), np.bool_)
    u = np.linspace(box[0], box[2], 2 * MASK_SIDE + 1)[1::2].astype(int)
    v = np.linspace(box[1], box[3], 2 * MASK_SIDE + 1)[1::2].astype(int)
    out[0] = shows[np.ix_(v, u)]
    return out


@pytest.mark.parametrize("way", ["depth", "cloud"])
@pytest.mark.parametrize(("shown_m", "x_m"), [(None, 1.5), (3.0, 3.0), (99.0, 1.5)])
def test_only_points_on_the_mask_are_used(make_observation, shown_m, x_m, way):
    """An empty mask counts for nothing."""
    depth = shelf_behind_a_cabinet()
    seen = make_observation(depth_m=depth)
    seen = dataclasses.replace(seen, cloud_m=cloud_of(seen))
    found = detect(seen, SHELF)
    if shown_m is not None:
        found = dataclasses.replace(found, mask=mask_over(SHELF, depth == np.float32(shown_m)))
    lifter = BackProjector(
        config.PerceptionConfig(detector=config.DetectorSim(), back_projection=way)
    )
    out, _ = lifter.back_project(found)
    assert out.valid.tolist() == [True]
    assert out.center_m[0, 0] == pytest.approx(x_m, abs=0.1)


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.0, 0.02, 0.3, 1.0]))
def test_samples_off_the_mask_are_dropped_one_by_one(seed, share):
    rng = np.random.default_rng(seed)
    n, view = 60, (None, None, None, 0, 40.0, 40.0, 20.0, 20.0)
    z = rng.uniform(1, 4, n)
    u, v = rng.uniform(5, 35, (2, n))
    samples = np.stack([(u - 20) / 40 * z, (v - 20) / 40 * z, z], axis=1).astype(np.float32)
    boxes = np.array([[0, 0, 1, 1], [8, 3, 30, 37]], np.float32)
    masks = rng.random((2, 16, 16)) < share
    kept = twins.on_mask(samples, view, boxes[1], masks[1])
    left = samples.copy()
    whole = (np.zeros((1, 1), np.float32),) * 3 + view[3:]
    assert kernels.drop_unmasked(left, n, whole, boxes, masks[:1], 1) == n
    k = kernels.drop_unmasked(left, n, whole, boxes, masks, 1)
    assert {*map(tuple, left[:k])} == {*map(tuple, kept.astype(np.float32))}
    assert {*map(tuple, left)} == {*map(tuple, samples)}

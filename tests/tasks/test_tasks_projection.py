from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scans import CAMERA, LIDAR, MODEL, Box, found_in, picture, street

from edge.geometry import CameraModel, invert
from edge.tasks.scene import scan_kernels as kernels
from edge.tasks.scene.projection import GAP_M, GAP_SHARE, MARGIN_SHARE, in_picture, points_of_masks
from edge.types import MASK_SIDE

T_CAMERA_LIDAR = invert(CAMERA) @ LIDAR


def of_boxes(observation, found, **more):
    return points_of_masks(
        observation.cloud_m, T_CAMERA_LIDAR, MODEL, found.xyxy_px, found.mask, **more
    )


def test_no_cloud_no_points():
    box = np.array([[0, 0, 100, 100]], np.float32)
    (points,) = points_of_masks(np.zeros((0, 3), np.float32), np.eye(4), MODEL, box)
    assert len(points) == 0


@given(
    x_m=st.floats(7.0, 25.0), aside=st.floats(-0.5, 0.5), heading=st.floats(-1.5, 1.5),
    wall_m=st.floats(8.0, 20.0),
)  # fmt: skip
@example(x_m=20.0, aside=0.25, heading=0.0, wall_m=8.0)
def test_a_car_before_a_wall_has_its_own_points_alone(x_m, aside, heading, wall_m):
    """Check eq. 2 with the box as the mask, for all positions of the car.

    Ground and wall are background. All points of the car in its box are found, except those behind
    a gap: this LiDAR has a column every 0.5 deg, so returns of a grazed side are farther apart
    than surfaces may.
    """
    car = Box(x_m, aside * x_m, heading_rad=heading)
    wall = Box(x_m + wall_m, 0.0, (0.5, 100.0, 6.0), label="wall")
    observation, hit = street([car, wall])
    found = found_in(observation, [car, wall])
    above = observation.cloud_m[:, 2] > 0.15 - LIDAR[2, 3]
    points = of_boxes(observation, found, keep=above)[0]
    at_px, shown = in_picture(observation.cloud_m, T_CAMERA_LIDAR, MODEL)
    x0, y0, x1, y1 = found.xyxy_px[0]
    in_box = (at_px >= (x0, y0)).all(axis=1) & (at_px < (x1, y1)).all(axis=1)
    depth_m = observation.cloud_m @ T_CAMERA_LIDAR[2, :3] + T_CAMERA_LIDAR[2, 3]
    own = np.flatnonzero((hit == 0) & above & shown)
    own = own[np.argsort(depth_m[own])]
    leaps = np.diff(depth_m[own]) > GAP_M + GAP_SHARE * depth_m[own[:-1]]
    parts = [part[in_box[part]] for part in np.split(own, np.flatnonzero(leaps) + 1)]
    assert set(points) in [set(part) for part in parts]
    # The best fit may be a little smaller than the largest: the box's rim cuts off returns.
    assert len(points) >= 0.9 * max(map(len, parts))


def test_points_in_front_of_an_object_are_left_out():
    """A pole in front of the middle of a car's box covers too little of it."""
    car, pole = Box(14.0, 0.0, heading_rad=1.57), Box(8.0, 0.3, (0.2, 0.2, 3.0), label="pole")
    observation, hit = street([car, pole])
    car_points, pole_points = of_boxes(
        observation,
        found_in(observation, [car, pole]),
        keep=observation.cloud_m[:, 2] > 0.15 - LIDAR[2, 3],
    )
    assert (hit[car_points] == 0).all()
    assert (hit[pole_points] == 1).all()
    assert len(pole_points) > 5


def test_a_mask_leaves_out_other_points_of_its_box():
    """The mask covers the left half; points on the right belong to another object."""
    left, right = Box(12.0, 1.0, (1, 1, 1.5)), Box(12.0, -1.0, (1, 1, 1.5))
    observation, hit = street([left, right])
    found = found_in(observation, [left, right])
    both = np.concatenate((found.xyxy_px[:, :2].min(0), found.xyxy_px[:, 2:].max(0)))[None]
    mask = np.zeros((1, MASK_SIDE, MASK_SIDE), np.bool_)
    mask[:, :, : MASK_SIDE // 2] = True
    above = observation.cloud_m[:, 2] > 0.15 - LIDAR[2, 3]
    cloud = observation.cloud_m
    (points,) = points_of_masks(cloud, T_CAMERA_LIDAR, MODEL, both, mask, above)
    assert set(hit[points]) == {0}
    (whole,) = points_of_masks(cloud, T_CAMERA_LIDAR, MODEL, both, np.zeros_like(mask), above)
    assert set(hit[whole]) == {0, 1}, "an empty mask is none"


@pytest.mark.parametrize("T_camera_cloud", [T_CAMERA_LIDAR, np.eye(4)], ids=["lidar", "depth"])
def test_a_mask_keeps_both_wings_behind_two_trees(T_camera_cloud):
    """Two wings at different depths, a trunk before each: all of the building, nothing else."""
    wings = [Box(16.0, 6.0, (1, 9, 4)), Box(24.0, -5.0, (1, 9, 4))]
    trunks = [Box(8.0, 3.0, (0.3, 0.3, 3)), Box(9.0, -2.0, (0.3, 0.3, 3))]
    observation, hit = street([*wings, *trunks])
    _, shown = picture([*wings, *trunks], np.eye(4))
    building = np.isin(shown, (0, 1))
    v, u = np.nonzero(building)
    x0, y0, x1, y1 = u.min(), v.min(), u.max() + 1, v.max() + 1
    rows = np.linspace(y0, y1, MASK_SIDE, endpoint=False).astype(int)
    columns = np.linspace(x0, x1, MASK_SIDE, endpoint=False).astype(int)
    cloud = observation.cloud_m @ T_CAMERA_LIDAR[:3, :3].T + T_CAMERA_LIDAR[:3, 3]
    if T_camera_cloud is T_CAMERA_LIDAR:
        cloud = observation.cloud_m
    (points,) = points_of_masks(
        cloud.astype(np.float32), T_camera_cloud, MODEL, np.array([[x0, y0, x1, y1]], np.float32),
        building[np.ix_(rows, columns)][None], hit >= 0,
    )  # fmt: skip
    assert {0, 1} <= set(hit[points])
    assert np.isin(hit[points], (0, 1)).mean() > 0.95
    _, inside = in_picture(observation.cloud_m, T_CAMERA_LIDAR, MODEL)
    for wing in (0, 1):
        assert (hit[points] == wing).sum() > 0.8 * (inside & (hit == wing)).sum()


def test_points_of_another_object_in_a_box_corner_are_dropped():
    """A house too high for the LiDAR, behind a low hedge."""
    hedge = Box(10.0, 0.0, (1.0, 20.0, 0.8), label="hedge")
    observation, hit = street([hedge])
    tall = np.array([[100, 10, 300, 150]], np.float32)  # ends in the hedge
    shown = in_picture(observation.cloud_m, T_CAMERA_LIDAR, MODEL)[0]
    assert ((hit == 0) & (shown[:, 1] < 150) & (shown[:, 0] > 100)).any()
    (points,) = points_of_masks(observation.cloud_m, T_CAMERA_LIDAR, MODEL, tall, keep=hit == 0)
    assert len(points) == 0


def windows_twin(cloud, T, camera, boxes, masks, keep):
    """Return sets of (box, on its mask, point) by plain NumPy."""
    at_px, shown = in_picture(cloud, T, camera)
    shown &= keep
    rows, columns = masks.shape[1:]
    out = set()
    for i, (x0, y0, x1, y1) in enumerate(boxes.astype(np.float64)):
        u, v = at_px.T
        wide, high = x1 - x0, y1 - y0
        near = (u >= x0 - MARGIN_SHARE * wide) & (u < x1 + MARGIN_SHARE * wide)
        near &= (v >= y0 - MARGIN_SHARE * high) & (v < y1 + MARGIN_SHARE * high) & shown
        for p in np.flatnonzero(near):
            on = x0 <= u[p] < x1 and y0 <= v[p] < y1
            if on and len(masks):
                r, c = int((v[p] - y0) / high * rows), int((u[p] - x0) / wide * columns)
                on = masks[i, min(r, rows - 1), min(c, columns - 1)]
            out.add((i, bool(on), int(p)))
    return out


@pytest.mark.parametrize("masked", [False, True])
@given(seed=st.integers(0, 2**32 - 1))
def test_windows_agree_with_their_twin(masked, seed):
    random = np.random.default_rng(seed)
    camera = CameraModel(64, 48, 40.0, 40.0, 31.7, 23.1)
    cloud = random.uniform(-3, 3, (200, 3)).astype(np.float32)
    cloud[random.random(200) < 0.05] = np.nan
    k = int(random.integers(1, 5))
    corner = random.uniform(-10, (60, 44), (k, 2))
    boxes = np.hstack((corner, corner + random.uniform(3, 30, (k, 2)))).astype(np.float32)
    masks = random.random((k if masked else 0, MASK_SIDE, MASK_SIDE)) < 0.5
    keep = random.random(200) < 0.9
    mask_of, point_of = np.empty(2000, np.int32), np.empty(2000, np.int32)
    depth = np.empty(2000, np.float32)
    n = kernels.points_of_windows(
        cloud, np.eye(4), (64.0, 48.0, 40.0, 40.0, 31.7, 23.1), boxes, masks, MARGIN_SHARE, keep,
        mask_of, point_of, depth,
    )  # fmt: skip
    got = {
        (int(m) if m >= 0 else -1 - int(m), bool(m >= 0), int(p))
        for m, p in zip(mask_of[:n], point_of[:n], strict=True)
    }
    expected = windows_twin(cloud, np.eye(4), camera, boxes, masks, keep)
    # On the very edge float32 and float64 may differ.
    assert len(got ^ expected) <= 2
    np.testing.assert_array_equal(depth[:n], cloud[point_of[:n], 2])


def surface_twin(depth, on, gap_m, gap_share):
    if not on.any():
        return 0, 0
    leaps = np.flatnonzero(np.diff(depth) > gap_m + gap_share * depth[:-1]) + 1
    bounds = [0, *leaps.tolist(), len(depth)]
    fits = [on[a:b].sum() / (on.sum() + (~on[a:b]).sum()) for a, b in pairwise(bounds)]
    best = int(np.argmax(fits))
    return bounds[best], bounds[best + 1]


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 60))
def test_surfaces_agree_with_their_twin(seed, n):
    random = np.random.default_rng(seed)
    depth = np.sort(random.uniform(1, 30, n)).astype(np.float32)
    on = random.random(n) < 0.6
    assert kernels.best_surface(depth, on, 0.5, 0.0) == surface_twin(depth, on, 0.5, 0.0)

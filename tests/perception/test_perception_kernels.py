from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import (
    cloud_raster,
    iou,
    merge_points,
    object_boxes,
    sample_depth,
    split_scores,
    strongest_rivals,
    suppress,
    surface,
    to_planes,
)

from edge.perception import instance_kernels, kernels, lift_kernels

TAU = np.float32(0.05)
seeds = st.integers(0, 2**32 - 1)


def random_boxes(random, n):
    corner = random.uniform(-5, 60, (n, 2))
    return np.hstack((corner, corner + random.uniform(1, 40, (n, 2)))).astype(np.float32)


def split(boxes, scores, n_targets, tau=TAU):
    n = len(boxes)
    best, rival = np.zeros(n, np.float32), np.zeros(n, np.float32)
    label = np.zeros(n, np.int32)
    invalid = kernels.split_scores(boxes, scores, n_targets, tau, best, label, rival)
    return best, label, rival, invalid


@pytest.mark.parametrize(
    ("shape", "top", "left"), [((1, 1), 0, 0), ((6, 10), 1, 2), ((8, 8), 4, 0)]
)
def test_to_planes_agrees_with_its_twin(shape, top, left):
    rgb = np.random.default_rng(0).integers(0, 256, (*shape, 3), np.uint8)
    ours = np.full((3, 16, 16), np.nan, np.float32)
    twin = ours.copy()
    kernels.to_planes(rgb, np.float32(1 / 255), top, left, ours)
    to_planes(rgb, np.float32(1 / 255), top, left, twin)
    np.testing.assert_array_equal(ours, twin)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ((0, 0, 2, 2), (5, 5, 6, 6), 0.0),
        ((0, 0, 2, 2), (2, 0, 4, 2), 0.0),
        ((0, 0, 2, 2), (0, 0, 2, 2), 1.0),
        ((0, 0, 2, 2), (1, 0, 3, 2), 1 / 3),
        ((0, 0, 0, 0), (0, 0, 0, 0), 0.0),
    ],
)
def test_iou(a, b, expected):
    assert kernels.iou(np.array(a, np.float32), np.array(b, np.float32)) == pytest.approx(expected)


def test_no_anchor_gives_no_box():
    best, label, _rival, invalid = split(
        np.zeros((0, 4), np.float32), np.zeros((0, 1), np.float32), 1
    )
    assert invalid == 0
    keep = np.zeros(4, np.int32)
    assert kernels.suppress(np.zeros((0, 4), np.float32), best, label, 0.5, keep) == 0


@given(seed=seeds, n=st.integers(1, 60), targets=st.integers(1, 3), rest=st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_split_and_suppress_agree_with_their_twins(seed, n, targets, rest):
    random = np.random.default_rng(seed)
    boxes = random_boxes(random, n)
    scores = random.uniform(0, 1, (n, targets + rest)).astype(np.float32) ** 2
    scores[random.random(scores.shape) < 0.05] = np.nan
    boxes[random.random(boxes.shape) < 0.02] = np.inf
    best, label, rival, invalid = split(boxes, scores, targets)
    t_best, t_label, t_rival, t_invalid = split_scores(boxes, scores, targets, TAU)
    assert invalid == t_invalid
    np.testing.assert_array_equal(best, t_best)
    np.testing.assert_array_equal(rival, t_rival)
    np.testing.assert_array_equal(label[best > 0], t_label[best > 0])
    keep = np.zeros(10, np.int32)
    k = kernels.suppress(boxes, best, label, 0.5, keep)
    assert list(keep[:k]) == suppress(boxes, best, label, 0.5, 10)
    against = np.zeros(10, np.float32)
    kernels.strongest_rivals(boxes, rival, keep, k, 0.5, against)
    np.testing.assert_array_equal(against[:k], strongest_rivals(boxes, rival, keep[:k], 0.5))


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_kept_boxes_of_a_class_do_not_overlap_and_come_highest_first(seed):
    random = np.random.default_rng(seed)
    boxes = random_boxes(random, 40)
    best, label, _rival, _ = split(boxes, random.random((40, 2), dtype=np.float32), 2)
    keep = np.zeros(40, np.int32)
    kept = keep[: kernels.suppress(boxes, best, label, 0.4, keep)]
    assert (np.diff(best[kept]) <= 0).all()
    for a in kept:
        assert all(a == b or label[a] != label[b] or iou(boxes[a], boxes[b]) <= 0.4 for b in kept)


def test_boxes_come_back_to_the_image_and_are_clipped():
    boxes = np.array([[-10, 8, 160, 128], [0, 0, 320, 4], [40, 18, 50, 28]], np.float32)
    keep = np.array([0, 1, 2], np.int32)
    out = np.zeros((3, 4), np.float32)
    n = kernels.to_image(boxes, keep, 3, 0.5, 8, 0, 640, 480, out)
    assert n == 2  # the second lies on the letterbox's rim only
    assert list(keep[:2]) == [0, 2]
    np.testing.assert_allclose(out[:2], [[0, 0, 320, 240], [80, 20, 100, 40]])


@given(seed=seeds, n=st.integers(0, 5))
@settings(max_examples=30, deadline=None)
def test_object_boxes_agree_with_their_twin(seed, n):
    random = np.random.default_rng(seed)
    ids = random.integers(0, n + 2, (12, 17)).astype(np.uint16)
    depth = random.uniform(0.1, 9, ids.shape).astype(np.float32)
    depth[random.random(ids.shape) < 0.2] = np.nan
    depth[random.random(ids.shape) < 0.2] = 0
    box, pixels = np.zeros((n, 4), np.int32), np.zeros(n, np.int32)
    distance = np.zeros(n, np.float32)
    kernels.object_boxes(ids, depth, box, pixels, distance)
    t_box, t_pixels, t_distance = object_boxes(ids, depth, n)
    np.testing.assert_array_equal(box, t_box.reshape(n, 4))
    np.testing.assert_array_equal(pixels, t_pixels)
    np.testing.assert_allclose(distance, t_distance, rtol=1e-5)


@given(seed=seeds, n=st.integers(0, 200))
@settings(max_examples=30, deadline=None)
def test_cloud_raster_agrees_with_its_twin(seed, n):
    random = np.random.default_rng(seed)
    cloud = random.uniform(-4, 8, (n, 3)).astype(np.float32)
    cloud[random.random(n) < 0.1] = np.inf
    T = np.eye(4)
    T[:3, 3] = random.uniform(-1, 1, 3)
    raster, points = np.zeros((6, 8), np.int32), np.zeros((n, 3), np.float32)
    lift_kernels.cloud_raster(cloud, T, 40.0, 40.0, 15.5, 11.5, 4.0, raster, points)
    np.testing.assert_array_equal(
        raster, cloud_raster(cloud, T, 40.0, 40.0, 15.5, 11.5, 4.0, raster.shape)
    )


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_sample_depth_agrees_with_its_twin(seed):
    random = np.random.default_rng(seed)
    depth = random.uniform(0, 9, (40, 60)).astype(np.float32)
    depth[random.random(depth.shape) < 0.2] = np.nan
    x, y = np.sort(random.uniform(-10, 70, 2)), np.sort(random.uniform(-10, 50, 2))
    samples = np.zeros((lift_kernels.SIDE**2, 3), np.float32)
    n = lift_kernels.sample_depth(
        depth, 50.0, 50.0, 29.5, 19.5, x[0], y[0], x[1], y[1], 8.0, samples
    )
    twin = sample_depth(
        depth, 50.0, 50.0, 29.5, 19.5, (x[0], y[0], x[1], y[1]), 8.0, lift_kernels.SIDE
    )
    np.testing.assert_allclose(samples[:n], twin, rtol=1e-5, atol=1e-6)


def surface_of(z):
    samples = np.zeros((max(1, len(z)), 3), np.float32)
    samples[: len(z), 2] = z
    histogram = np.zeros(lift_kernels.BINS, np.int32)
    return lift_kernels.surface(samples, len(z), 8.0, histogram)


@given(seed=seeds, n=st.integers(0, 576), spread=st.floats(0.05, 4))
@settings(max_examples=60, deadline=None)
def test_surface_agrees_with_its_twin(seed, n, spread):
    random = np.random.default_rng(seed)
    middles = random.uniform(0.2, 8, 3)
    z = np.clip(random.choice(middles, n) + spread * random.normal(size=n) / 4, 0.05, 7.99)
    z = z.astype(np.float32)
    twin = surface(
        z.astype(np.float64), 8.0, lift_kernels.BINS, lift_kernels.GAP_M, lift_kernels.NEAREST_SHARE
    )
    assert surface_of(z) == pytest.approx(twin)


@pytest.mark.parametrize(
    ("parts", "expected_m"),
    [
        ([(1.0, 300)], 1.0),
        ([(1.0, 300), (3.0, 200)], 1.0),  # the thing before the wall
        ([(1.0, 200), (3.0, 300)], 1.0),
        ([(1.0, 20), (3.0, 400)], 3.0),  # a table leg in front of the thing
        ([(1.0, 60), (2.0, 60), (3.0, 80), (4.0, 70), (5.0, 60)], 3.0),  # the largest of many
    ],
)
def test_the_nearest_surface_of_good_size_is_the_thing(parts, expected_m):
    random = np.random.default_rng(0)
    z = np.concatenate([at + 0.05 * random.normal(size=n) for at, n in parts])
    low, high = surface_of(z.astype(np.float32))
    assert low < expected_m < high
    assert high - low < 0.8


@given(seed=seeds, n_old=st.integers(0, 64), n_new=st.integers(1, 32))
@settings(max_examples=40, deadline=None)
def test_merge_points_agrees_with_its_twin(seed, n_old, n_new):
    random = np.random.default_rng(seed)
    old = random.uniform(-3, 3, (n_old, 3)).astype(np.float32)
    new = random.uniform(-1, 1, (n_new, 3)).astype(np.float32)
    points, center, radius = instance_kernels.merge_points(old, new, 0.25, 20)
    twin = merge_points(old, new, 0.25, 20)
    np.testing.assert_array_equal(points, twin)
    np.testing.assert_allclose(center, np.median(twin, axis=0), rtol=1e-6)
    planar = np.linalg.norm(twin[:, :2] - center[:2], axis=1)
    assert radius == pytest.approx(planar.max(), rel=1e-5)
    x, y = random.uniform(-4, 4, 2)
    apart = np.linalg.norm(twin[:, :2] - (x, y), axis=1)
    assert instance_kernels.nearest(points, x, y) == pytest.approx(apart.min(), rel=1e-5)

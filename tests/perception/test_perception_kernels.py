from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import (
    candidates,
    cloud_raster,
    fold,
    going_on,
    iou,
    merge_points,
    object_boxes,
    sample_depth,
    strongest_competing_scores,
    suppress,
    surfaces,
    to_planes,
)

from edge.perception.detection import kernels
from edge.perception.tracking import back_projection_kernels, instance_kernels, sample_kernels

TAU = np.float32(0.05)
FAR_PX = 1000.0
seeds = st.integers(0, 2**32 - 1)


def random_boxes(random, n):
    corner = random.uniform(-5, 60, (n, 2))
    return np.hstack((corner, corner + random.uniform(1, 40, (n, 2)))).astype(np.float32)


def found_in(boxes, scores, n_targets, tau=TAU):
    """(anchor, label, score, top, how many, invalid)."""
    places, n = len(boxes) * n_targets, len(boxes)
    anchor, label = np.zeros(places, np.int32), np.zeros(places, np.int32)
    score, top = np.zeros(places, np.float32), np.zeros(n, np.float32)
    m, invalid = kernels.candidates(
        boxes, scores, n_targets, tau, FAR_PX, anchor, label, score, top
    )
    assert kernels.count_invalid(boxes, scores, FAR_PX) == invalid
    return anchor, label, score, top, m, invalid


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
    assert kernels.iou(np.array([a, b], np.float32), 0, 1) == pytest.approx(expected)


def test_no_anchor_gives_no_box():
    boxes = np.zeros((0, 4), np.float32)
    anchor, label, score, _top, m, invalid = found_in(boxes, np.zeros((0, 1), np.float32), 1)
    assert (m, invalid) == (0, 0)
    assert (
        kernels.suppress(boxes, anchor, label, score, m, 0, 1, False, 0.5, np.zeros(4, np.int32))
        == 0
    )


@given(seed=seeds, n=st.integers(1, 60), targets=st.integers(1, 3), rest=st.integers(0, 3))
def test_candidates_and_suppress_agree_with_their_twins(seed, n, targets, rest):
    random = np.random.default_rng(seed)
    boxes = random_boxes(random, n)
    scores = random.uniform(0, 1, (n, targets + rest)).astype(np.float32) ** 2
    bad = random.random(scores.shape) < 0.05
    scores[bad] = random.choice(np.float32([np.nan, np.inf, 1e30, 1.1, -0.1]), bad.sum())
    bad = random.random(boxes.shape) < 0.02
    boxes[bad] = random.choice(np.float32([np.nan, -np.inf, 1e30, -FAR_PX - 1]), bad.sum())
    anchor, label, score, top, m, invalid = found_in(boxes, scores, targets)
    t_anchor, t_label, t_score, t_top, t_invalid = candidates(boxes, scores, targets, TAU, FAR_PX)
    assert (m, invalid) == (len(t_anchor), t_invalid)
    np.testing.assert_array_equal(anchor[:m], t_anchor)
    np.testing.assert_array_equal(label[:m], t_label)
    np.testing.assert_array_equal(score[:m], t_score)
    np.testing.assert_array_equal(top, t_top)
    keep = np.zeros(10, np.int32)
    first, one_word = int(random.integers(0, targets)), bool(random.random() < 0.5)
    k = kernels.suppress(boxes, anchor, label, score, m, first, targets, one_word, 0.5, keep)
    assert list(keep[:k]) == suppress(
        boxes, t_anchor, t_label, t_score, range(first, targets), one_word, 0.5, 10
    )
    against = np.zeros(10, np.float32)
    competes = random.random((2, targets, targets + rest)) < 0.5
    cut = random.random(10) < 0.5
    kernels.competing_scores(
        boxes, scores, competes, TAU, top, anchor, label, keep, k, cut, 0.5, against
    )
    expected = strongest_competing_scores(
        boxes, scores, competes, TAU, FAR_PX, anchor, label, keep[:k], cut[:k], 0.5
    )
    np.testing.assert_array_equal(against[:k], expected)


@given(seed=seeds, n=st.integers(0, 20), names=st.lists(st.integers(1, 3), min_size=1, max_size=4))
def test_fold_agrees_with_its_twin(seed, n, names):
    random = np.random.default_rng(seed)
    thing = np.repeat(np.arange(len(names), dtype=np.int32), names)
    scores = random.random((n, len(thing)), np.float32)
    bad = random.random(scores.shape) < 0.3
    scores[bad] = random.choice(np.float32([np.nan, 1e30, 1 + 2**-23, -(2**-24), 1.01]), bad.sum())
    ours = np.zeros((n, len(names)), np.float32)
    kernels.best_per_class(scores, thing, ours)
    np.testing.assert_array_equal(ours, fold(scores, thing))


@given(seed=seeds)
def test_kept_boxes_do_not_overlap_and_are_sorted(seed):
    random = np.random.default_rng(seed)
    boxes = random_boxes(random, 40)
    anchor, label, score, _, m, _ = found_in(boxes, random.random((40, 2), dtype=np.float32), 2)
    keep = np.zeros(80, np.int32)
    kept = keep[: kernels.suppress(boxes, anchor, label, score, m, 0, 2, False, 0.4, keep)]
    assert (np.diff(score[kept]) <= 0).all()
    for a in kept:
        for b in kept:
            apart = iou(boxes[anchor[a]], boxes[anchor[b]]) <= 0.4
            assert a == b or label[a] != label[b] or apart


def test_boxes_are_mapped_back_to_the_image_and_clipped():
    boxes = np.array([[-10, 8, 160, 128], [0, 0, 320, 4], [40, 18, 50, 28]], np.float32)
    cut = np.zeros(3, np.bool_)
    keep = np.array([2, 0, 1], np.int32)
    anchor = np.array([1, 2, 0], np.int32)
    out = np.zeros((3, 4), np.float32)
    n = kernels.to_image(boxes, anchor, keep, 3, 0.5, 8, 0, 640, 480, out, cut)
    assert n == 2  # the second lies on the letterbox's rim only
    assert list(keep[:2]) == [2, 1]
    np.testing.assert_allclose(out[:2], [[0, 0, 320, 240], [80, 20, 100, 40]])
    assert list(cut[:2]) == [True, False]


@given(seed=seeds, n=st.integers(0, 5))
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
def test_cloud_raster_agrees_with_its_twin(seed, n):
    random = np.random.default_rng(seed)
    cloud = random.uniform(-4, 8, (n, 3)).astype(np.float32)
    cloud[random.random(n) < 0.1] = np.inf
    T = np.eye(4)
    T[:3, 3] = random.uniform(-1, 1, 3)
    raster, points = np.zeros((6, 8), np.int32), np.zeros((n, 3), np.float32)
    sample_kernels.cloud_raster(cloud, T, 40.0, 40.0, 15.5, 11.5, 4.0, raster, points)
    np.testing.assert_array_equal(
        raster, cloud_raster(cloud, T, 40.0, 40.0, 15.5, 11.5, 4.0, raster.shape)
    )


@given(seed=seeds)
def test_sample_depth_agrees_with_its_twin(seed):
    random = np.random.default_rng(seed)
    depth = random.uniform(0, 9, (40, 60)).astype(np.float32)
    depth[random.random(depth.shape) < 0.2] = np.nan
    x, y = np.sort(random.uniform(-10, 70, 2)), np.sort(random.uniform(-10, 50, 2))
    samples = np.zeros((sample_kernels.SIDE**2, 3), np.float32)
    n = sample_kernels.sample_depth(
        depth, 50.0, 50.0, 29.5, 19.5, x[0], y[0], x[1], y[1], 8.0, samples
    )
    twin = sample_depth(
        depth, 50.0, 50.0, 29.5, 19.5, (x[0], y[0], x[1], y[1]), 8.0, sample_kernels.SIDE
    )
    np.testing.assert_allclose(samples[:n], twin, rtol=1e-5, atol=1e-6)


def surfaces_of(z):
    samples = np.zeros((max(1, len(z)), 3), np.float32)
    samples[: len(z), 2] = z
    histogram = np.zeros(back_projection_kernels.BINS, np.int32)
    found = np.zeros((back_projection_kernels.BINS, 3), np.float32)
    return found[: back_projection_kernels.surfaces(samples, len(z), 8.0, histogram, found)]


@given(seed=seeds, n=st.integers(0, 576), spread=st.floats(0.05, 4))
def test_surfaces_agree_with_their_twin(seed, n, spread):
    random = np.random.default_rng(seed)
    middles = random.uniform(0.2, 8, 3)
    z = np.clip(random.choice(middles, n) + spread * random.normal(size=n) / 4, 0.05, 7.99)
    z = z.astype(np.float32)
    twin = surfaces(
        z.astype(np.float64),
        8.0,
        back_projection_kernels.BINS,
        back_projection_kernels.GAP_M,
        back_projection_kernels.SPARSE,
    )
    np.testing.assert_allclose(surfaces_of(z), twin, rtol=1e-6)


@given(seed=seeds)
def test_share_beyond_box_agrees_with_its_twin(seed):
    random = np.random.default_rng(seed)
    n = random.integers(0, 20, 4).astype(np.int32)
    beside = random.uniform(-3, 3, (4, 20, 3)).astype(np.float32)
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(random.normal(size=(3, 3)))[0]
    low, high = np.sort(random.uniform(-3, 3, 2))
    ours = back_projection_kernels.share_beyond_box(beside, n, low, high, T, -0.5)
    strips = [beside[k, : n[k]].astype(np.float64) for k in range(4)]
    assert ours == pytest.approx(going_on(strips, low, high, T, -0.5))


def test_a_single_wrong_view_does_not_move_an_object():
    """A sofa seen thirty times, and a table before it twice."""
    sofa = np.array([[x, 4.0, 0.4] for x in np.arange(0, 2, 0.2)], np.float32)
    table = sofa - np.float32([0, 1.5, 0])
    points, support = np.empty((0, 3), np.float32), np.empty(0, np.int32)
    for view in range(32):
        seen = table if view in (3, 20) else sofa
        points, support = instance_kernels.merge_points(points, support, seen, 0.1, 64)
    core, center, _ = instance_kernels.core_points(points, support)
    assert core[:, 1].min() == pytest.approx(4.0)
    assert center[1] == pytest.approx(4.0)
    assert len(points) == 20


@given(seed=seeds, n_old=st.integers(0, 64), n_new=st.integers(1, 32))
def test_merge_points_agrees_with_its_twin(seed, n_old, n_new):
    random = np.random.default_rng(seed)
    old = random.uniform(-3, 3, (n_old, 3)).astype(np.float32)
    new = random.uniform(-1, 1, (n_new, 3)).astype(np.float32)
    support = random.integers(1, 9, n_old).astype(np.int32)
    points, views = instance_kernels.merge_points(old, support, new, 0.25, 20)
    near_m = instance_kernels.NEAR_M
    twin, twin_views = merge_points(old, support, new, 0.25, 20, near_m)
    np.testing.assert_array_equal(points, twin)
    np.testing.assert_array_equal(views, twin_views)
    core, center, radius = instance_kernels.core_points(points, views)
    least = max(min(2, views.max()), instance_kernels.CORE_SHARE * views.max())
    often = twin[twin_views >= least]
    np.testing.assert_allclose(center, np.median(often, axis=0), rtol=1e-6)
    apart = np.linalg.norm(often[:, :2] - center[:2], axis=1)
    astray = max(instance_kernels.LEAST_RADIUS_M, instance_kernels.STRAY * np.median(apart))
    np.testing.assert_array_equal(core, often[apart <= astray])
    planar = np.linalg.norm(core[:, :2] - center[:2], axis=1)
    assert radius == pytest.approx(planar.max(), rel=1e-5)
    x, y = random.uniform(-4, 4, 2)
    apart = np.linalg.norm(twin[:, :2] - (x, y), axis=1)
    assert instance_kernels.nearest(points, x, y) == pytest.approx(apart.min(), rel=1e-5)

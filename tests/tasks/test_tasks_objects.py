from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import wrap_angle
from edge.tasks.scene import objects
from edge.tasks.scene.objects import (
    MOST_POINTS,
    ObjectMap,
    box_around,
    clusters,
    downsample,
    first_in_voxels,
    main_clusters,
    overlap_share,
)

NONE = np.zeros((0, 3), np.float32)


def block(x_m=0.0, y_m=0.0, size=(2.0, 1.0, 1.0), heading=0.0, n=400, seed=0):
    """Points in a box on the ground."""
    local = (np.random.default_rng(seed).random((n, 3)) - (0.5, 0.5, 0.0)) * size
    c, s = np.cos(heading), np.sin(heading)
    xy = local[:, :2] @ np.array([[c, s], [-s, c]]) + (x_m, y_m)
    return np.column_stack((xy, local[:, 2])).astype(np.float32)


# All around the sides of a unit square, below and above.
_TO = np.linspace(-0.5, 0.5, 21)
_RIM = np.vstack([np.column_stack((a, b)) for h in (-0.5, 0.5)
                  for a, b in ((_TO, 0 * _TO + h), (0 * _TO + h, _TO))])  # fmt: skip
SIDES = np.vstack([np.column_stack((_RIM, np.full(len(_RIM), z))) for z in (0.0, 1.0)])


@given(
    st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-10, 10),
    st.floats(0.3, 5.0), st.floats(0.1, 0.25), st.floats(0.1, 4.0),
)  # fmt: skip
def test_box_around_recovers_a_box(x_m, y_m, heading, along, across, up):
    local = SIDES * (along, across, up)
    c, s = np.cos(heading), np.sin(heading)
    points = local @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + (x_m, y_m, 0.5)
    position, size, turn = box_around(points)
    np.testing.assert_allclose(position, [x_m, y_m, 0.5 + 0.5 * up], atol=0.02)
    np.testing.assert_allclose(size, [along, across, up], atol=0.03)
    assert -0.5 * np.pi <= turn < 0.5 * np.pi
    if along > 1.2 * across:
        assert abs(wrap_angle(2.0 * (turn - heading))) < 0.02  # either end may be the front


@given(st.floats(-1.5, 1.5))
def test_two_visible_sides_give_the_heading(heading):
    """A LiDAR sees an L, and the smallest rectangle around it is another."""
    side = np.linspace(0, 1, 40)
    local = np.vstack(
        (np.column_stack((4 * side, 0 * side)), np.column_stack((0 * side, 1.8 * side)))
    )
    c, s = np.cos(heading), np.sin(heading)
    points = np.column_stack((local @ np.array([[c, s], [-s, c]]), np.zeros(80)))
    _, size, turn = box_around(points)
    np.testing.assert_allclose(size, [4.0, 1.8, 0.0], atol=0.03)
    assert abs(wrap_angle(2.0 * (turn - heading))) < 0.02


def test_nothing_hangs_together_of_nothing():
    assert len(main_clusters(NONE, np.zeros(3), True)) == 0
    assert clusters(NONE, 1.0) == []
    assert downsample(NONE).shape == (0, 3)


@pytest.mark.parametrize(("by_mask", "count"), [(True, 500), (False, 400)])
def test_only_a_mask_has_other_parts(by_mask, count):
    points = np.vstack((block(10.0), block(10.0, 5.0, n=100)))
    assert len(main_clusters(points, np.zeros(3), by_mask)) == count


def test_strays_are_left_out():
    points = np.vstack((block(10.0), block(10.0, 5.0, n=10)))
    assert (main_clusters(points, np.zeros(3), True) < 400).all()
    assert [len(group) for group in clusters(points, 1.0)] == [400, 10]


@given(st.integers(0, 2**32 - 1), st.integers(0, 80))
def test_voxels_hold_one_point_each(seed, n):
    points = np.random.default_rng(seed).uniform(-1, 1, (n, 3))
    first = first_in_voxels(points, np.full(3, 0.5))
    voxels = [tuple(v) for v in np.floor(points / 0.5)]
    assert first.tolist() == [i for i, v in enumerate(voxels) if v not in voxels[:i]]


def test_no_more_points_than_there_is_room_for():
    assert len(downsample(block(size=(50, 50, 5), n=20_000))) == MOST_POINTS


def test_without_points_the_overlap_is_zero():
    assert overlap_share(NONE, block()) == overlap_share(block(), NONE) == 0.0


def test_too_few_points_make_no_object():
    things = ObjectMap()
    assert things.add("car", NONE) is None
    assert things.add("car", block(n=4)) is None
    assert things.objects == {}


MERGES = {
    "the same again": (("car", 0.0), ("car", 0.0), 1),
    "more of it": (("car", 0.0), ("car", 1.0), 1),
    "by another word for it": (("trash can", 0.0), ("trash bin", 0.0), 1),
    "by a wrong name": (("car", 0.0), ("truck", 0.0), 1),
    "another beside it": (("car", 0.0), ("car", 3.5), 2),
    "one thing touching another": (("car", 0.0), ("truck", 1.5), 2),
}


@pytest.mark.parametrize("case", MERGES)
def test_repeated_views_join_one_object(case):
    (a, at_a), (b, at_b), n = MERGES[case]
    things = ObjectMap()
    one = things.add(a, block(at_a), score=0.9)
    two = things.add(b, block(at_b, seed=1), score=0.5)
    assert len(things.objects) == n
    assert (one is two) == (n == 1)


def test_objects_in_a_row_stay_separate():
    """0.1 m apart, their ends are near each other's; twice in one picture, an object is one."""
    things = ObjectMap()
    for picture in (1, 2):
        for x_m in (0.0, 1.1, 2.2):
            things.add("chair", block(x_m, size=(1.0, 0.6, 1.0), seed=picture), picture=picture)
    assert [len(things.objects), {obj.hits for obj in things.objects.values()}] == [3, {2}]
    things.add("chair", block(size=(1.0, 0.6, 1.0), seed=3), picture=2)
    assert [obj.hits for obj in things.objects.values()] == [3, 2, 2]


def test_an_object_takes_its_most_frequent_label():
    things = ObjectMap()
    things.add("truck", block(), "white truck", 0.5)
    for score in (0.4, 0.4):
        things.add("car", block(), "red car", score)
    (obj,) = things.objects.values()
    assert (obj.label, obj.caption, obj.hits, obj.score) == ("car", "red car", 3, 0.5)


def test_objects_that_grow_together_merge_without_reused_ids():
    things = ObjectMap()
    for x_m in (0.0, 4.0):
        things.add("hedge", block(x_m, size=(2, 1, 1)))
    things.add("hedge", block(2.0, size=(4, 1, 1), n=1000))
    assert list(things.objects) == [1]
    assert things.add("hedge", block(50.0)).id == 3


def test_two_of_one_picture_stay_two_when_one_of_them_merges():
    """Benches 2 and 3 are in one picture; then 1 and 2 turn out to be one."""
    things, size = ObjectMap(), (1.0, 0.6, 1.0)
    things.add("bench", block(0.0, size=size), picture=1)
    for x_m in (1.6, 2.7):
        things.add("bench", block(x_m, size=size), picture=2)
    things.add("bench", block(0.95, size=(2.0, 0.6, 1.0), n=1500), picture=3)
    assert list(things.objects) == [1, 3]
    things.add("bench", block(2.7, size=size, seed=1), picture=4)
    assert list(things.objects) == [1, 3]


def test_a_long_drive_forgets_the_votes_that_are_oldest(monkeypatch):
    monkeypatch.setattr(objects, "MOST_VOTES", 100)
    seen, places = ObjectMap(), np.arange(5000)[:, None] * (0.1, 0.0, 0.0) + 0.05
    first, last = (seen.add("van", points) for points in (places[:20], places[-20:]))
    for _ in range(3):
        seen.vote("van", places[:10], 1)
    assert len(seen.confirmed_points_m(first)) == 10
    for begin in range(20, 5000, 20):
        seen.vote("van", places[begin : begin + 20], 1)
        seen.vote("van", places[:10], 1)  # always in view
        assert len(seen._votes) <= 100
    assert len(seen.confirmed_points_m(first)) == 10
    seen.vote("van", places[20:-5], 1)
    assert len(seen.confirmed_points_m(first)) == 20, "of nothing that is known, all is taken"
    assert len(seen.confirmed_points_m(last)) == 15

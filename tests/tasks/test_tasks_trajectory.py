"""Checks of a trajectory before the robot moves."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_scenes import STREET, street

from edge.config import TrajectoryLimits
from edge.tasks.scene.ground import ground_of
from edge.tasks.trajectory import CoarseTrajectory, TrajectoryError, check, coarse_of

LIMITS = TrajectoryLimits()
GROUND = ground_of(street(*STREET), LIMITS.clearance_m)


def line(*ends, step_m=1.0):
    """Points along a polyline."""
    way = []
    for a, b in pairwise(ends):
        steps = max(math.ceil(math.dist(a, b) / step_m), 1)
        way += [tuple(np.add(a, np.subtract(b, a) * k / steps)) for k in range(steps)]
    return [*way, ends[-1]]


@pytest.mark.parametrize(
    ("segments", "shape"),
    [
        ([(0, 0)], [(1, 2)]),
        ([[0, 0], [1, 0]], [(2, 2)]),
        ([[(0, 0), (1, 0)], [(1, 0)]], [(2, 2), (1, 2)]),
        ([[(0, 0, 1), (1, 0)]], [(2, 2)]),
    ],
)
def test_accepted_segments_become_a_trajectory(segments, shape):
    coarse = coarse_of(segments, [1, 1, 2], None)
    assert [points.shape for points in coarse.segments] == shape
    assert all(points.dtype == np.float64 for points in coarse.segments)
    assert coarse.regions == (1, 2)
    check(coarse, GROUND, LIMITS)


@pytest.mark.parametrize(
    ("segments", "message"),
    [
        ([], "the trajectory has 0 segments; give 1 to 50"),
        ([[]], "segment 1 is empty"),
        ("0,0", "segments: expected a list, got '0,0'"),
        ([None], "segment 1: expected a list, got None"),
        ([[(0, 0), (0, 0, 0, 0)]], "point 2 of segment 1: expected a point"),
        ([[(0, True)]], "point 1 of segment 1: y: expected a number, got True"),
        ([[(0, math.nan)]], "point 1 of segment 1: y: nan is not within -1e"),
        ([[(1e9, 0)]], "point 1 of segment 1: x: 1e"),
        ([[(0, 0)] * 4000] * 2, "the trajectory has 8000 points"),
        ([[(0, 0)] * 5001], "segment 1: 5001 entries, at most 5000"),
        ("x" * 10_000, "segments: expected a list, got 'x{39}…'"),
    ],
)
def test_invalid_segments_are_refused(segments, message):
    with pytest.raises(TrajectoryError, match=f"^{message}") as raised:
        coarse_of(segments, (), None)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 200


@pytest.mark.parametrize("regions", [7, "1", [0], [256], [10**5000], [1.0], [True], [None], [[1]]])
def test_invalid_regions_are_refused(regions):
    with pytest.raises(TrajectoryError, match=r"^regions: expected "):
        coarse_of([(0, 0)], regions, None)


@pytest.mark.parametrize(
    ("segments", "message"),
    [
        ([(0, 0), (25, 0)], r"point 2 of segment 1, \(25, 0\), is outside the map \(x -20 to 20"),
        (line((0, 0), (8, 0)), r"point 7 of segment 1, \(6, 0\), is occupied; the nearest"),
        ([(5.9, 0)], "point 1 of segment 1, .*, is too close to what is occupied"),
        ([(0, 0), (3, 0)], "point 2 of segment 1 is 3.0 m from the point before it, at most 2 m"),
        ([(3, 0)], "point 1 of segment 1 is 3.0 m from the robot, at most 2 m are allowed"),
    ],
)
def test_an_undrivable_trajectory_is_refused(segments, message):
    with pytest.raises(TrajectoryError, match=f"^{message}"):
        check(CoarseTrajectory((np.array(segments, float),)), GROUND, LIMITS)


def test_a_jump_between_segments_is_refused():
    segments = (np.array([(0.0, 0.0), (1.0, 0.0)]), np.array([(1.0, 4.0)]))
    with pytest.raises(
        TrajectoryError, match=r"^point 1 of segment 2 is 4\.0 m from the point bef"
    ):
        check(CoarseTrajectory(segments), GROUND, LIMITS)


def test_a_leap_through_a_thin_wall_is_seen():
    """Both ends are reachable: the wall can be walked round."""
    ground = ground_of(street(walls=((1.0, 1.2, -3.0, 3.0),)), 0.3)
    way = [*line((0.0, 0.0), (0.4, 0.0)), (1.8, 0.0)]
    with pytest.raises(
        TrajectoryError, match=r"obstacle is between point 3 of segment 1 and the point bef"
    ):
        check(CoarseTrajectory((np.array(way),)), ground, LIMITS)
    check(CoarseTrajectory((ground.plan((0.0, 0.0), (1.8, 0.0)).path_m,)), ground, LIMITS)


def test_unseen_and_cut_off_ground_have_different_errors():
    scene = street(walls=((10.0, 10.4, -20.0, 20.0),))
    scene.occupancy.cells[:, :20] = -1
    scene.regions_grid.cells[:, :20] = 0
    ground = ground_of(scene, 0.3)
    for x_m, message in ((-18.0, "was never seen to be free"), (15.0, "cannot be reached from")):
        with pytest.raises(TrajectoryError, match=message):
            check(CoarseTrajectory((np.array([(x_m, 0.0)]),)), ground, LIMITS)


def test_a_robot_near_a_wall_may_start_there():
    """Nearer to a wall than it may drive."""
    ground = ground_of(street(walls=((0.4, 0.8, -5.0, 5.0),)), 0.6)
    check(CoarseTrajectory((np.array(line((0.0, 0.0), (-3.0, 0.0))),)), ground, LIMITS)
    with pytest.raises(TrajectoryError, match="is occupied"):
        check(CoarseTrajectory((np.array([(0.5, 0.0)]),)), ground, LIMITS)


@pytest.mark.parametrize(
    "speed_mps", [0.0, 5e-324, 1e-9, 0.049, -1.0, 2.1, 1e9, math.nan, math.inf]
)
def test_speeds_that_are_too_high_or_too_low(speed_mps):
    with pytest.raises(TrajectoryError, match=r"is not within 0\.05 to 2 m/s"):
        check(CoarseTrajectory((np.zeros((1, 2)),), (), speed_mps), GROUND, LIMITS)


@pytest.mark.parametrize("value", [0.0, 5e-324, 1e300, math.inf, math.nan])
@pytest.mark.parametrize("key", ["max_jump_m", "max_length_m", "max_speed_mps"])
def test_limits_that_no_robot_has_are_refused(key, value):
    with pytest.raises(ValueError, match=key):
        TrajectoryLimits(**{key: value})


def test_the_length_and_the_regions_are_bounded():
    there_and_back = np.array(line(*[(0.0, 0.0), (-10.0, 0.0)] * 30))
    with pytest.raises(TrajectoryError, match="the trajectory is 590 m long, at most 500 m are"):
        check(CoarseTrajectory((there_and_back,)), GROUND, LIMITS)
    with pytest.raises(TrajectoryError, match=r"there is no region 3 \(known: 1, 2\)"):
        check(CoarseTrajectory((np.zeros((1, 2)),), (1, 3)), GROUND, LIMITS)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.tuples(inner, inner) | st.dictionaries(
        st.text(max_size=2), inner, max_size=2
    ),
    max_leaves=20,
)  # fmt: skip


@given(JUNK, JUNK, JUNK)
def test_junk_is_refused_or_safe(segments, regions, speed_mps):
    """An accepted trajectory is within every limit, from any author."""
    try:
        coarse = coarse_of(segments, regions, speed_mps)
        check(coarse, GROUND, LIMITS)
    except TrajectoryError:
        return
    way = np.vstack([(0.0, 0.0), coarse.points_m])
    assert np.isfinite(way).all()
    assert np.hypot(*np.diff(way, axis=0).T).max() <= LIMITS.max_jump_m
    assert set(coarse.regions) <= {1, 2}
    assert coarse.speed_mps is None or 0.05 <= coarse.speed_mps <= LIMITS.max_speed_mps

"""The tree of frames in time: chains, loops, moving frames, and odometry outside the map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge.bus.wire.messages import OdometryMessage
from edge.bus.wire.transforms import MOST_TRANSFORMS, Transform, encode_transforms
from edge.geometry import invert, se2_of, se3
from edge.sources.odometry import RESET_AFTER
from edge.sources.tf import RobotFrames, TfBuffer

MS = 1_000_000
WAIT_NS = 500 * MS


def buffer(*edges: tuple[str, str, np.ndarray], stamp_ns: int = 0) -> TfBuffer:
    tf = TfBuffer(WAIT_NS)
    for parent, child, T in edges:
        assert tf.offer(Transform(stamp_ns, parent, child, T))
    return tf


def panned(*samples: tuple[float, float], tf: TfBuffer | None = None) -> TfBuffer:
    """Return a head that pans: (stamp in ms, yaw in rad)."""
    tf = tf or TfBuffer(WAIT_NS)
    for ms, yaw_rad in samples:
        assert tf.offer(Transform(int(ms * MS), "base", "pan", se3(yaw_rad=yaw_rad)))
    return tf


A, B, C = se3(1.0, 2.0, 3.0, 0.1, 0.2, 0.3), se3(-1.0, yaw_rad=2.0), se3(0.0, 0.5, 0.1, 1.0)


def test_an_empty_tree_knows_only_that_a_frame_is_itself():
    assert TfBuffer(WAIT_NS).lookup("a", "b", 0).T is None
    np.testing.assert_array_equal(TfBuffer(WAIT_NS).lookup("a", "a", 0).T, np.eye(4))


@pytest.mark.parametrize(
    ("target", "source", "expected"),
    [
        ("base", "camera", A),
        ("camera", "base", invert(A)),
        ("base", "lens", A @ B),
        ("lidar", "lens", invert(C) @ A @ B),
        ("base", "elsewhere", None),
        ("other", "base", None),
    ],
)
def test_up_and_down_the_tree(target, source, expected):
    tf = buffer(
        ("base", "camera", A), ("camera", "lens", B), ("base", "lidar", C), ("other", "one", A)
    )
    got = tf.lookup(target, source, 0)
    if expected is None:
        assert got.T is None
        assert got.why == tf.why_apart(target, source) != ""
    else:
        np.testing.assert_allclose(got.T, expected, atol=1e-12)
        assert (got.age_ns, got.why, tf.why_apart(target, source)) == (0, "", "")


@pytest.mark.parametrize(
    ("samples", "asked_ms", "yaw_rad", "age_ms"),
    [
        # One transform alone holds for all time, before its stamp too.
        ([(100, 0.5)], 0, 0.5, 0),
        ([(100, 0.5)], 10_000, 0.5, 0),
        ([(0, 0.0), (100, 1.0)], 0, 0.0, 0),
        ([(0, 0.0), (100, 1.0)], 25, 0.25, 0),
        ([(0, 0.0), (100, 1.0)], 100, 1.0, 0),
        # Newer ones may come; older ones are always too late.
        ([(0, 0.0), (100, 1.0)], 130, 1.0, 30),
        ([(50, 0.0), (100, 1.0)], 30, None, -20),
        # A transform that is sent rarely moves in steps.
        ([(0, 0.0), (501, 1.0)], 400, 0.0, 0),
        ([(0, 0.0), (501, 1.0)], 501, 1.0, 0),
        ([(0, 0.0), (501, 1.0)], 9_000, 1.0, 0),
        ([(0, 0.0), (500, 1.0)], 250, 0.5, 0),
        # Out of order, again, and from a clock that was set back.
        ([(0, 0.0), (100, 1.0), (50, 9.0)], 50, 0.5, 0),
        ([(0, 0.0), (100, 1.0), (100, 2.0)], 100, 2.0, 0),
        ([(10_000, 2.0), *((ms, ms / 100) for ms in range(0, 20 * RESET_AFTER, 10))], 105, 1.05, 0),
    ],
)
def test_a_moving_frame_is_interpolated_at_the_stamp(samples, asked_ms, yaw_rad, age_ms):
    found = panned(*samples).lookup("base", "pan", asked_ms * MS)
    if yaw_rad is None:
        said = f"the first transform from 'pan' to 'base' is {-age_ms} ms later"
        assert (found.T, found.why) == (None, said)
    else:
        assert se2_of(found.T).yaw_rad == pytest.approx(yaw_rad, abs=0.005)  # nlerp
        assert found.age_ns == age_ms * MS
        assert found.why == ""


def test_a_chain_is_as_old_as_its_oldest_transform():
    tf = panned((0, 0.0), (100, 1.0))
    tf.offer(Transform(0, "pan", "tilt", se3(pitch_rad=0.1)))
    tf.offer(Transform(60 * MS, "pan", "tilt", se3(pitch_rad=0.2)))
    tf.offer(Transform(10**18, "tilt", "eye", B), static=True)
    found = tf.lookup("base", "eye", 110 * MS)
    assert found.age_ns == 50 * MS
    np.testing.assert_allclose(found.T, se3(yaw_rad=1.0) @ se3(pitch_rad=0.2) @ B, atol=1e-12)
    seen_from_the_eye = tf.lookup("eye", "base", 110 * MS)
    np.testing.assert_allclose(seen_from_the_eye.T, invert(found.T), atol=1e-12)
    assert seen_from_the_eye.age_ns == 50 * MS


@pytest.mark.parametrize("asked_ms", [0, 10, 20, 25, 700, 1500])
def test_a_returned_transform_is_not_overwritten(asked_ms):
    tf = panned((0, 0.0), (10, 0.1), (20, 0.2), *(((900, 0.3),) if asked_ms > 25 else ()))
    found = tf.lookup("base", "pan", asked_ms * MS).T
    before = found.copy()
    panned(*((10 * k, 0.01 * k) for k in range(91, 1000)), tf=tf)
    np.testing.assert_array_equal(found, before)


@given(st.lists(st.tuples(st.sampled_from("abcdef"), st.sampled_from("abcdef")), max_size=30))
def test_a_loop_of_frames_does_not_hang(edges):
    tf = TfBuffer(WAIT_NS)
    for parent, child in edges:
        assert tf.offer(Transform(0, parent, child, A)) == (parent != child)
    for target in "abcdef":
        tf.lookup(target, "a", 0)


def test_a_flood_of_frames_is_bounded():
    tf = buffer(*(("base", f"f{i}", A) for i in range(MOST_TRANSFORMS)))
    assert not tf.offer(Transform(0, "base", "one_more", A))
    assert tf.offer(Transform(0, "base", "f0", B))


@pytest.mark.parametrize(("parent", "child"), [("", "a"), ("a", ""), ("a", "a")])
def test_a_transform_that_joins_no_two_frames_is_named(parent, child):
    frames = RobotFrames(simulated())
    assert frames.take(encode_transforms([Transform(0, "a", "b", A)]), static=False) == ""
    payload = encode_transforms([Transform(0, parent, child, A)])
    assert (
        frames.take(payload, static=False)
        == f"1 transforms, the first from '{child}' to '{parent}'"
    )


@pytest.fixture
def frames() -> RobotFrames:
    found = RobotFrames(simulated())
    edges = [("map", "odom", A), ("base_footprint", "base_link", B), ("base_link", "eye", C)]
    found.take(encode_transforms([Transform(0, *edge) for edge in edges]), static=True)
    return found


@pytest.mark.parametrize(
    ("frame_id", "child_frame_id", "expected"),
    [
        ("map", "base_link", C),
        ("odom", "base_link", A @ C),
        ("odom", "base_footprint", A @ C @ B),
        ("/odom", "/base_link", A @ C),
        ("elsewhere", "base_link",
         "no transform from 'elsewhere' to 'map' in tf, which has no 'elsewhere'"),
        ("odom", "elsewhere",
         "no transform from 'base_link' to 'elsewhere' in tf, which has no 'elsewhere'"),
        ("odom", "odom", "no transform from 'base_link' to 'odom' in tf"),
        ("", "base_link", "header.frame_id is empty: the driver must set it, as odom"),
        ("/", "base_link", "header.frame_id is '/': the driver must set it, as odom"),
        ("odom", "",
         "child_frame_id is empty: the driver must set it to the robot's frame, as base_link"),
    ],
)  # fmt: skip
def test_odometry_is_taken_into_the_map(frames, frame_id, child_frame_id, expected):
    got = frames.base_in_map(OdometryMessage(0, C, 0.0, 0.0, frame_id, child_frame_id))
    if isinstance(expected, str):
        assert (got.T, got.why) == (None, expected)
    else:
        np.testing.assert_allclose(got.T, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("frame_id", "why"),
    [
        ("eye", ""),
        ("/eye", ""),
        ("map", "no transform from 'map' to 'base_link' in tf"),
        ("nose", "no transform from 'nose' to 'base_link' in tf, which has no 'nose'"),
        ("", "header.frame_id is empty: the driver must name the sensor's frame"),
        ("//", "header.frame_id is '//': the driver must name the sensor's frame"),
    ],
)
def test_a_sensor_without_a_place_is_named(frames, frame_id, why):
    assert frames.why_unplaced(frame_id) == why
    if not why:
        np.testing.assert_allclose(frames.mount_at(frame_id, 5).T, C, atol=1e-12)

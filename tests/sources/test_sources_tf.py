"""The tree of frames: chains, loops, and odometry that is in another frame than the map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.bus.wire.messages import Odometry
from edge.bus.wire.transforms import MOST_TRANSFORMS, Transform
from edge.config import Ros2
from edge.geometry import invert, se3
from edge.sources.tf import Frames, TfBuffer


def buffer(*edges: tuple[str, str, np.ndarray]) -> TfBuffer:
    tf = TfBuffer()
    for parent, child, T in edges:
        assert tf.offer(Transform(0, parent, child, T))
    return tf


A, B, C = se3(1.0, 2.0, 3.0, 0.1, 0.2, 0.3), se3(-1.0, yaw_rad=2.0), se3(0.0, 0.5, 0.1, 1.0)


def test_an_empty_tree_knows_only_that_a_frame_is_itself():
    assert TfBuffer().lookup("a", "b") is None
    np.testing.assert_array_equal(TfBuffer().lookup("a", "a"), np.eye(4))


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
    got = tf.lookup(target, source)
    if expected is None:
        assert got is None
    else:
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_the_newest_counts_and_a_frame_may_move_elsewhere():
    tf = buffer(("a", "b", A), ("a", "b", B), ("c", "b", C))
    assert tf.lookup("a", "b") is None
    np.testing.assert_allclose(tf.lookup("c", "b"), C)


@given(st.lists(st.tuples(st.sampled_from("abcdef"), st.sampled_from("abcdef")), max_size=30))
def test_no_loop_keeps_it_busy(edges):
    tf = TfBuffer()
    for parent, child in edges:
        assert tf.offer(Transform(0, parent, child, A)) == (parent != child)
    for target in "abcdef":
        tf.lookup(target, "a")


def test_a_flood_of_frames_is_bounded():
    tf = buffer(*(("base", f"f{i}", A) for i in range(MOST_TRANSFORMS)))
    assert not tf.offer(Transform(0, "base", "one_more", A))
    assert tf.offer(Transform(0, "base", "f0", B))


@pytest.mark.parametrize(
    ("frame_id", "child_frame_id", "expected"),
    [
        ("map", "base_link", C),
        ("odom", "base_link", A @ C),
        ("odom", "base_footprint", A @ C @ B),
        ("/odom", "base_link", A @ C),
        ("elsewhere", "base_link", None),
        ("odom", "elsewhere", None),
    ],
)
def test_odometry_is_taken_into_the_map(frame_id, child_frame_id, expected):
    frames = Frames(Ros2())
    frames._tf = buffer(("map", "odom", A), ("base_footprint", "base_link", B))
    got = frames.base_in_map(Odometry(0, C, 0.0, 0.0, frame_id, child_frame_id))
    if expected is None:
        assert got is None
    else:
        np.testing.assert_allclose(got, expected, atol=1e-12)

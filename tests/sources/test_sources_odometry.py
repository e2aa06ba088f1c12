"""Odometry: order of stamps, interpolation, jumps, clocks that are set again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import SE2, se2_of
from edge.sources.odometry import RESET_AFTER, OdometryRing, StampGuard


def ring(*samples: tuple[int, float], capacity=64, max_gap_s=1.0, max_jump_m=1.0) -> OdometryRing:
    """Return a ring with poses (stamp, x)."""
    result = OdometryRing(capacity, max_gap_s, max_jump_m)
    for stamp_ns, x_m in samples:
        result.push(stamp_ns, SE2(x_m, 0.0, 0.0).matrix())
    return result


@pytest.mark.parametrize(
    ("samples", "asked_ns", "x_m", "missing"),
    [
        ([], 5, None, "empty"),
        ([(10, 1.0)], 9, None, "too_old"),
        ([(10, 1.0)], 10, 1.0, ""),
        ([(10, 1.0)], 11, None, "too_new"),
        ([(10, 0.0), (20, 1.0)], 15, 0.5, ""),
        ([(10, 0.0), (20, 1.0)], 20, 1.0, ""),
        ([(10, 0.0), (20, 0.5), (30, 1.0)], 12, 0.1, ""),
        ([(0, 0.0), (2_000_000_000, 0.5)], 10, None, "gap"),
    ],
)
def test_pose_at(samples, asked_ns, x_m, missing):
    T, why, _ = ring(*samples).pose_at(asked_ns)
    assert why == missing
    if x_m is None:
        assert T is None
    else:
        assert se2_of(T).x_m == pytest.approx(x_m)


@pytest.mark.parametrize("every_ns", [1, 3, 10, 25])
def test_a_flood_of_odometry_keeps_older_poses(every_ns):
    """64 poses, of those closer than 10 the newest; all are on one line."""
    poses = OdometryRing(64, 1.0, 1.0, apart_ns=10)
    for stamp_ns in range(0, 1000, every_ns):
        assert poses.push(stamp_ns, SE2(0.001 * stamp_ns, 0.0, 0.0).matrix()) == ""
    newest_ns = range(0, 1000, every_ns)[-1]
    assert poses.newest_ns == newest_ns
    for asked_ns in (newest_ns - 55, newest_ns - 500, newest_ns):
        assert se2_of(poses.pose_at(asked_ns)[0]).x_m == pytest.approx(0.001 * asked_ns)


def test_a_returned_pose_is_not_overwritten():
    poses = ring((0, 0.5), capacity=2)
    T, *_ = poses.pose_at(0)
    for i in range(1, 5):
        poses.push(i, SE2(0.5 + 0.1 * i, 0.0, 0.0).matrix())
    assert T[0, 3] == 0.5


def test_repeated_and_backward_stamps_are_named_and_left_out():
    poses = ring((10, 0.0), (20, 0.2))
    assert poses.push(20, SE2(0.9, 0.0, 0.0).matrix()) == "repeated"
    assert poses.push(15, SE2(0.9, 0.0, 0.0).matrix()) == "backward"
    assert poses.epoch == 0
    assert se2_of(poses.pose_at(15)[0]).x_m == pytest.approx(0.1)


def test_a_pose_with_a_bad_stamp_still_updates_the_position():
    assert ring().newest_pose is None
    backward = ring((1000, 1.0), (900, 1.2), (800, 1.4))
    assert (backward.newest_ns, backward.newest_pose) == (1000, SE2(1.4, 0.0, 0.0))


def test_a_jump_starts_a_new_epoch():
    poses = ring((10, 0.0), (20, 0.9))
    assert poses.push(30, SE2(2.0, 0.0, 0.0).matrix()) == "pose_jump"
    assert poses.epoch == 1
    assert poses.pose_at(25)[1] == "too_old"
    assert se2_of(poses.pose_at(30)[0]).x_m == 2.0


def test_a_restarted_sender_is_accepted():
    poses = ring((10**9, 5.0))
    odd = [poses.push(i, SE2(0.0, 0.0, 0.0).matrix()) for i in range(RESET_AFTER + 2)]
    assert odd == ["backward"] * (RESET_AFTER - 1) + ["pose_jump", "", ""]
    assert (poses.epoch, poses.newest_ns) == (1, RESET_AFTER + 1)


def test_one_future_stamp_starts_no_epoch():
    poses = ring((0, 0.0), (10, 0.1), (10**15, 0.2))
    odd = [poses.push(20 + i, SE2(0.3, 0.0, 0.0).matrix()) for i in range(RESET_AFTER + 1)]
    assert odd == ["backward"] * (RESET_AFTER - 1) + ["clock_reset", ""]
    assert (poses.epoch, poses.newest_ns) == (0, 20 + RESET_AFTER)
    assert poses.pose_at(20)[1] == "too_old"


@pytest.mark.parametrize(
    ("after_s", "x_m", "yaw_rad", "epoch"),
    [
        (0.1, 0.9, 0.0, 0),
        (0.1, 1.5, 0.0, 1),
        # 4 s at 0.5 m/s and more, or at 1.2 rad/s: driven, not jumped.
        (4.0, 3.9, 0.0, 0),
        (4.0, 4.1, 0.0, 1),
        (0.1, 0.0, 1.1, 0),
        (0.1, 0.0, 1.3, 1),
        (0.1, 0.0, -1.3, 1),
        (1.0, 0.0, 2.7, 0),
    ],
)
def test_a_jump_is_more_than_the_robot_can_drive(after_s, x_m, yaw_rad, epoch):
    poses = OdometryRing(64, 1.0, 1.0, max_speed_mps=0.5, max_turn_radps=1.2)
    poses.push(0, SE2(0.0, 0.0, 0.0).matrix())
    verdict = poses.push(int(after_s * 1e9), SE2(x_m, 0.0, yaw_rad).matrix())
    assert (verdict, poses.epoch) == (("pose_jump", 1) if epoch else ("", 0))


def test_the_newest_pose_serves_for_a_while():
    poses = ring((10**9, 0.5), max_gap_s=0.25)
    assert poses.extrapolate(1_250_000_000)[0][0, 3] == 0.5
    assert poses.extrapolate(1_250_000_001) == (None, 0)
    assert poses.extrapolate(999_999_999) == (None, 0)
    assert ring().extrapolate(5) == (None, 0)


@pytest.mark.parametrize(
    ("stamps_ms", "asked_ms", "x_m"),
    [
        # At 1 m/s, as far as it was followed.
        (range(0, 301, 20), 300, 0.3),
        (range(0, 301, 20), 330, 0.33),
        (range(0, 301, 20), 550, 0.55),
        (range(0, 301, 200), 250, 0.25),
        ((280, 300), 320, 0.32),
        ((280, 300), 321, 0.3),
        ((300,), 301, 0.3),
    ],
)
def test_the_newest_pose_is_extrapolated(stamps_ms, asked_ms, x_m):
    poses = ring(*((1_000_000 * ms, 1e-3 * ms) for ms in stamps_ms))
    assert poses.extrapolate(1_000_000 * asked_ms)[0][0, 3] == pytest.approx(x_m)


def test_a_ring_of_one_is_refused():
    with pytest.raises(ValueError, match="at least 2"):
        OdometryRing(1, 1.0, 1.0)


@given(st.lists(st.integers(0, 50), max_size=60))
def test_accepted_stamps_rise_except_after_resets(stamps):
    guard, newest = StampGuard(), -1
    for stamp_ns in stamps:
        verdict = guard.check(stamp_ns)
        assert (verdict == "ok") == (stamp_ns > newest)
        assert (verdict == "repeated") == (stamp_ns == newest)
        if verdict in ("ok", "clock_reset"):
            newest = stamp_ns
        assert guard.newest_ns == newest


@given(
    st.lists(st.tuples(st.integers(0, 1000), st.floats(-0.4, 0.4)), max_size=40),
    st.integers(0, 1000),
)
def test_poses_agree_with_numpy_interp(samples, asked_ns):
    poses, xs, ys = OdometryRing(64, 1.0, 1.0), [], []
    for stamp_ns, x_m in sorted(dict(samples).items()):
        poses.push(stamp_ns, SE2(x_m, 0.0, 0.0).matrix())
        xs.append(stamp_ns)
        ys.append(x_m)
    T, why, _ = poses.pose_at(asked_ns)
    if xs and xs[0] <= asked_ns <= xs[-1]:
        assert T[0, 3] == pytest.approx(np.interp(asked_ns, xs, ys), abs=1e-12)
    else:
        assert T is None
        assert why in ("empty", "too_old", "too_new")

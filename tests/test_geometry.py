"""Rigid transforms and the camera: properties that hold for any pose."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge import geometry
from edge.config import Camera, Lidar
from edge.geometry import SE2, CameraModel, wrap_angle

metres = st.floats(-100, 100)
angles = st.floats(-math.pi, math.pi)
poses = st.builds(geometry.se3, metres, metres, metres, angles, angles, angles)
planar = st.builds(SE2, metres, metres, angles)
fractions = st.floats(0, 1)


def angle_between(T_a: np.ndarray, T_b: np.ndarray) -> float:
    cosine = (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1) / 2
    # From the chord, since arccos is blunt near 0.
    chord = np.linalg.norm(T_a[:3, :3] - T_b[:3, :3]) / math.sqrt(8)
    return 2 * math.asin(min(chord, 1.0)) if cosine > 0 else math.acos(max(cosine, -1.0))


@given(st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_angle(angle):
    wrapped = geometry.wrap_angle(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@given(poses)
def test_se3_is_a_rotation_and_a_translation(T):
    assert T.shape == (4, 4)
    assert T.dtype == np.float64
    assert T[3].tolist() == [0, 0, 0, 1]
    assert T[:3, :3].T @ T[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


@given(metres, metres, metres, angles, angles, angles)
def test_se3_is_yaw_after_pitch_after_roll(x, y, z, roll, pitch, yaw):
    parts = geometry.se3(x, y, z) @ geometry.se3(yaw_rad=yaw)
    parts = parts @ geometry.se3(pitch_rad=pitch) @ geometry.se3(roll_rad=roll)
    assert geometry.se3(x, y, z, roll, pitch, yaw) == pytest.approx(parts, abs=1e-12)


@given(poses, poses)
def test_inverse(T_a, T_b):
    assert geometry.invert(T_a) @ T_a == pytest.approx(np.eye(4), abs=1e-9)
    assert T_a @ geometry.invert(T_a) == pytest.approx(np.eye(4), abs=1e-9)
    both = geometry.invert(T_b) @ geometry.invert(T_a)
    assert geometry.invert(T_a @ T_b) == pytest.approx(both, abs=1e-9)


@given(poses)
def test_quaternion_round_trip(T):
    q = geometry.quaternion_of(T)
    assert math.hypot(*q) == pytest.approx(1.0)
    assert q[3] >= 0
    back = geometry.se3_from_quaternion(tuple(T[:3, 3]), q)
    assert back == pytest.approx(T, abs=1e-9)


@pytest.mark.parametrize(
    ("T", "q"),
    [
        (geometry.se3(), (0, 0, 0, 1)),
        (geometry.se3(yaw_rad=math.pi / 2), (0, 0, math.sqrt(0.5), math.sqrt(0.5))),
        (geometry.se3(roll_rad=math.pi), (1, 0, 0, 0)),
        (geometry.se3(pitch_rad=math.pi), (0, 1, 0, 0)),
        (geometry.se3(yaw_rad=math.pi), (0, 0, 1, 0)),
    ],
)
def test_quaternions_at_the_branches(T, q):
    assert np.abs(geometry.quaternion_of(T)) == pytest.approx(q, abs=1e-12)


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (0, 0, 0, math.nan), (math.inf, 0, 0, 1)])
def test_an_invalid_quaternion_is_refused(q):
    with pytest.raises(ValueError, match="not a rotation"):
        geometry.se3_from_quaternion((0, 0, 0), q)


@given(poses, fractions)
def test_interpolation_between_equal_poses_stays(T, fraction):
    assert geometry.interpolate(T, T, fraction) == pytest.approx(T, abs=1e-9)


@given(
    poses, st.floats(-0.17, 0.17), st.sampled_from(["roll_rad", "pitch_rad", "yaw_rad"]), fractions
)
def test_interpolation_turns_evenly_between_odometry_samples(T, turn, axis, fraction):
    T_b = T @ geometry.se3(1.0, **{axis: turn})
    between = geometry.interpolate(T, T_b, fraction)
    even = T @ geometry.se3(**{axis: fraction * turn})
    assert angle_between(between, even) < 1e-4
    assert between[:3, 3] == pytest.approx((1 - fraction) * T[:3, 3] + fraction * T_b[:3, 3])


@given(planar, metres)
def test_planar_pose_round_trip(pose, z):
    T = pose.matrix(z)
    back = geometry.se2_of(T)
    assert (back.x_m, back.y_m, T[2, 3]) == (pose.x_m, pose.y_m, z)
    assert geometry.wrap_angle(back.yaw_rad - pose.yaw_rad) == pytest.approx(0, abs=1e-9)


@given(planar, metres, metres)
def test_bearing_and_distance_are_polar_coordinates(pose, x, y):
    bearing, distance = pose.bearing_to(x, y), pose.distance_to(x, y)
    local = geometry.invert(pose.matrix()) @ (x, y, 0, 1)
    assert distance * math.cos(bearing) == pytest.approx(local[0], abs=1e-9)
    assert distance * math.sin(bearing) == pytest.approx(local[1], abs=1e-9)


sizes = st.integers(160, 2000)
fields_of_view = st.floats(0.2, 2.6)


@given(sizes, sizes, fields_of_view)
def test_camera_from_its_field_of_view(width, height, hfov):
    camera = CameraModel.from_hfov(width, height, hfov)
    assert camera.hfov_rad == pytest.approx(hfov)
    # The image's edges are half a pixel outside the outer pixels' centres.
    assert camera.bearing_of(-0.5) == pytest.approx(hfov / 2)
    assert camera.bearing_of(width - 0.5) == pytest.approx(-hfov / 2)
    assert camera.bearing_of((width - 1) / 2) == 0.0
    columns = np.array([-0.5, width - 0.5], np.float32)
    assert camera.bearing_of(columns) == pytest.approx([hfov / 2, -hfov / 2])


@pytest.mark.parametrize(
    ("camera", "wrong"),
    [
        ((640, 480, 525.0, 525.0, 319.5, 239.5), ""),
        ((64, 48, 3000.0, 3000.0, -500.0, 600.0), ""),  # a cut-out of a telescope's corner
        ((0, 480, 525.0, 525.0, 0.0, 239.5), "0x480 px"),
        ((2**31, 480, 525.0, 525.0, 319.5, 239.5), "2147483648x480 px"),
        ((640, 480, 1e300, 525.0, 319.5, 239.5), r"focal lengths 1e\+300, 525 px"),
        ((640, 480, 525.0, -525.0, 319.5, 239.5), "focal lengths"),
        ((640, 480, 525.0, 525.0, 319.5, math.nan), "principal point"),
        ((640, 480, 525.0, 525.0, math.inf, 239.5), "principal point"),
    ],
)
def test_an_impossible_camera_is_refused(camera, wrong):
    if not wrong:
        assert CameraModel(*camera).width_px == camera[0]
        return
    with pytest.raises(ValueError, match=f"not a camera: .*{wrong}"):
        CameraModel(*camera)


angles_deg = st.floats(-179.0, 179.0)


@given(metres, metres, st.floats(0.01, 3.0), angles_deg, st.floats(-89.0, 89.0), angles_deg)
def test_a_mount_is_the_pose_that_the_configuration_says(x, y, z, roll, pitch, yaw):
    """A mount survives a round trip; its camera looks along a LiDAR of the same mount."""
    mount = {"x_m": x, "y_m": y, "z_m": z, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
    T = Lidar(**mount).T_base_mount()
    assert T[:3, 3].tolist() == [x, y, z]
    back = (
        math.atan2(T[2, 1], T[2, 2]), math.asin(-T[2, 0]), math.atan2(T[1, 0], T[0, 0]),
    )  # fmt: skip
    assert np.degrees(back) == pytest.approx([roll, pitch, yaw], abs=1e-5)
    right, down, forward = (Camera(**mount).T_base_camera()[:3, k] for k in range(3))
    assert np.array([forward, -right, -down]) == pytest.approx(T[:3, :3].T, abs=1e-12)
    optical = geometry.optical_yaw_rad(Camera(**mount).T_base_camera())
    assert wrap_angle(optical - math.radians(yaw)) == pytest.approx(0.0, abs=1e-9)


@given(st.floats(0.5, 8.0), st.floats(0, 319), planar)
def test_a_back_projected_pixel_has_its_bearing(depth, u, pose):
    """Lifting a pixel and looking at it from the robot agree (VL-Nav eq. 2)."""
    camera = CameraModel.from_hfov(320, 256, 1.3)
    T = pose.matrix() @ geometry.to_optical(geometry.se3(0.0, 0.0, 0.6))
    optical = np.array([(u - camera.cx_px) / camera.fx_px * depth, 0.0, depth, 1.0])
    x, y, z, _ = T @ optical
    assert z == pytest.approx(0.6)
    assert pose.bearing_to(x, y) == pytest.approx(camera.bearing_of(u), abs=1e-9)

"""Public logs as robots' recordings: the logs that docs/recording.md lists as tried.

    python tests/public_logs.py redwood FOLDER out.mcap
    python tests/public_logs.py carmen FILE.log out.mcap

`redwood` is an RGB-D sequence with poses (Redwood, as Open3D's tests have it); `carmen` a log of
CARMEN (Intel Research Lab, Freiburg 079, …): a 2D LiDAR and odometry.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from bags import COMPRESSED, IMAGE, TF, Sent, compressed_image, write_mcap

from edge.bus.wire import messages
from edge.bus.wire.transforms import Transform, encode_transforms
from edge.geometry import SE2, CameraModel, invert, se3

START_NS = 1_700_000_000_000_000_000
# y is up in Redwood's world, and its floor is at 0.13 m.
T_MAP_REDWOOD = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, -0.13], [0, 0, 0, 1]], float)
_OPTICAL = "camera_rgb_optical_frame"
_LASER_M = 0.3


def redwood(folder: Path) -> Iterator[Sent]:
    """Five frames: JPEG, registered depth in millimetres, and poses as tf only."""
    lines = (folder / "trajectory.log").read_text().splitlines()
    for i in range(5):
        stamp_ns = START_NS + i * 200_000_000
        T = np.array([[float(v) for v in line.split()] for line in lines[5 * i + 1 : 5 * i + 5]])
        T_map_camera = T_MAP_REDWOOD @ T
        # Someone held it: the base is the floor below.
        T_map_base = SE2(*_forward(T_map_camera)).matrix()
        yield "/tf", TF, stamp_ns, encode_transforms([
            Transform(stamp_ns, "map", "base_link", T_map_base),
            Transform(stamp_ns, "base_link", _OPTICAL, invert(T_map_base) @ T_map_camera),
        ])  # fmt: skip
        camera = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
        info = messages.encode_camera_info(stamp_ns, _OPTICAL, camera)
        yield "/camera/rgb/camera_info", "sensor_msgs/msg/CameraInfo", stamp_ns, info
        depth = cv2.imread(str(folder / f"depth/{i:05d}.png"), cv2.IMREAD_UNCHANGED)
        image = messages.encode_image(stamp_ns, _OPTICAL, depth)
        yield "/camera/depth_registered/image", IMAGE, stamp_ns, image
        jpeg = (folder / f"color/{i:05d}.jpg").read_bytes()
        colour = compressed_image(stamp_ns, _OPTICAL, "jpeg", jpeg)
        yield "/camera/rgb/image_color/compressed", COMPRESSED, stamp_ns, colour


def _forward(T_map_camera: np.ndarray) -> tuple[float, float, float]:
    x_m, y_m = T_map_camera[:2, 3]
    ahead = T_map_camera[:2, 2]
    return float(x_m), float(y_m), math.atan2(ahead[1], ahead[0])


def carmen(log: Path) -> Iterator[Sent]:
    """Each FLASER line as a scan and the odometry of its corrected pose."""
    mount = Transform(START_NS, "base_link", "laser", se3(z_m=_LASER_M))
    yield "/tf_static", TF, START_NS, encode_transforms([mount])
    for line in log.read_text().splitlines():
        if not line.startswith("FLASER"):
            continue
        words = line.split()
        n = int(words[1])
        ranges = np.array(words[2 : 2 + n], np.float32)
        x_m, y_m, yaw_rad = map(float, words[2 + n : 5 + n])
        stamp_ns = START_NS + round(float(words[8 + n]) * 1e9)
        pose = SE2(x_m, y_m, yaw_rad)
        odometry = messages.encode_odometry(stamp_ns, pose.matrix(), 0.0, 0.0)
        yield "/odometry", "nav_msgs/msg/Odometry", stamp_ns, odometry
        step_rad = math.pi / n
        scan = messages.encode_laser_scan(
            stamp_ns, "laser", -math.pi / 2 + step_rad / 2, step_rad, 40.0, ranges
        )
        yield "/front_laser/scan", "sensor_msgs/msg/LaserScan", stamp_ns, scan


if __name__ == "__main__":
    kind, source, out = sys.argv[1:]
    write_mcap(Path(out), {"redwood": redwood, "carmen": carmen}[kind](Path(source)))

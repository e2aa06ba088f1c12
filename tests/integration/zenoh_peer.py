"""A camera and odometry of a standing robot, at 30 Hz without end: `zenoh_peer.py ENDPOINT`."""

from __future__ import annotations

import sys
import time

import numpy as np

from edge.bus import topics
from edge.bus.session import declare_publisher, open_session
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.geometry import SE2, CameraModel

CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)


def main(endpoint: str) -> None:
    settings = ZenohConfig(endpoint=endpoint)
    session = open_session(settings, "connect")
    out = {
        topic.key: declare_publisher(session, topic, settings)
        for topic in (topics.ODOMETRY, topics.CAMERA_INFO, topics.RGB, topics.DEPTH)
    }
    rgb, depth = np.full((24, 32, 3), 7, np.uint8), np.full((24, 32), 1500, np.uint16)
    while True:
        now_ns = time.time_ns()
        pose = SE2(1.0, 2.0, 0.0).matrix()
        out["odom"].put(messages.encode_odometry(now_ns, pose, 0.0, 0.0))
        out["camera/info"].put(messages.encode_camera_info(now_ns, "camera", CAMERA))
        out["camera/rgb"].put(messages.encode_image(now_ns, "camera", rgb))
        out["camera/depth"].put(messages.encode_image(now_ns, "camera", depth))
        time.sleep(1 / 30)


if __name__ == "__main__":
    main(sys.argv[1])

"""Other processes for the tests: `python zenoh_peer.py ROLE ENDPOINT`."""

from __future__ import annotations

import sys
import time

import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.session import BusError, declare_publisher, open_session
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.geometry import SE2, CameraModel

SETTINGS = ZenohConfig()
CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)


def robot(session: zenoh.Session) -> None:
    """Send the camera and odometry of a standing robot at 30 Hz without end."""
    out = {
        topic.key: declare_publisher(session, topic, SETTINGS)
        for topic in (topics.ODOMETRY, topics.CAMERA_INFO, topics.RGB, topics.DEPTH)
    }
    while True:
        now_ns = time.time_ns()
        pose = SE2(1.0, 2.0, 0.0).matrix()
        rgb, depth = np.full((24, 32, 3), 7, np.uint8), np.full((24, 32), 1500, np.uint16)
        out["odom"].put(messages.encode_odometry(now_ns, pose, 0.0, 0.0))
        out["camera/info"].put(messages.encode_camera_info(now_ns, "camera", CAMERA))
        out["camera/rgb"].put(messages.encode_image(now_ns, "camera", rgb))
        out["camera/depth"].put(messages.encode_image(now_ns, "camera", depth))
        time.sleep(1 / 30)


def listener(session: zenoh.Session) -> None:
    """Print the stamp of every received goal, and receive maps."""
    goals = session.declare_subscriber(
        SETTINGS.key(topics.GOAL.key), zenoh.handlers.RingChannel(64)
    )
    maps = session.declare_subscriber(SETTINGS.key(topics.MAP.key), zenoh.handlers.RingChannel(4))
    print("ready", flush=True)
    while True:
        while (sample := goals.try_recv()) is not None:
            print(messages.decode_pose_stamped(sample.payload.to_bytes())[0], flush=True)
        while maps.try_recv() is not None:
            pass
        time.sleep(0.01)


def main(role: str, endpoint: str) -> int:
    settings = ZenohConfig(endpoint=endpoint)
    try:
        session = open_session(settings, "listen" if role == "service" else "connect")
    except BusError as error:
        print(error, file=sys.stderr)
        return 2
    with session:
        {"robot": robot, "listener": listener, "service": lambda _: None}[role](session)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

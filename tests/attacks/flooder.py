"""Sends valid messages without a pause: `python flooder.py ENDPOINT odometry | goal_status`.

It runs at a low priority, so that the messages do the harm and not a missing core."""

from __future__ import annotations

import os
import sys
import time

import numpy as np

from edge.bus import topics
from edge.bus.session import open_session
from edge.bus.wire import messages
from edge.config import ZenohConfig


def odometry() -> bytes:
    """Return an odometry message with the pose of `absurd_sensors.batch`."""
    pose = np.eye(4)
    pose[:3, 3] = 0.111, 0.222, 0.333
    return messages.encode_odometry(time.time_ns(), pose, 0.0, 0.0)


def goal_status() -> bytes:
    return b'{"stamp": 1, "state": "accepted"}'


def main(endpoint: str, kind: str) -> None:
    os.nice(10)
    topic, make = {
        "odometry": (topics.ODOMETRY, odometry),
        "goal_status": (topics.GOAL_STATUS, goal_status),
    }[kind]
    settings = ZenohConfig(endpoint=endpoint)
    with open_session(settings, "connect") as session:
        publisher = session.declare_publisher(settings.key(topic.key))
        while True:
            publisher.put(make())


if __name__ == "__main__":
    main(*sys.argv[1:])

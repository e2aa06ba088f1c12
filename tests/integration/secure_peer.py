"""A service as Zenoh sees it: `python secure_peer.py SETTINGS`, the section `zenoh` as JSON.

Sends on every one of `KEYS` again and again, and prints `put KEY PAYLOAD` or `query KEY
PAYLOAD` for whatever reaches it from others.
"""

from __future__ import annotations

import logging
import sys
import time

import zenoh

from edge.bus import topics
from edge.bus.session import open_session
from edge.config import ZenohConfig

ROS = ("ros2/odom", "ros2/edge/path", "ros2/navigate_to_pose/_action/status")
"""Some keys of the adapter."""
KEYS = (*(topic.key for topic in topics.ALL), *ROS)


def main(text: str) -> None:
    logging.basicConfig(level=logging.INFO)
    settings = ZenohConfig.model_validate_json(text)
    keys = [settings.key(key) for key in KEYS]
    requests = [settings.key(key) for key in topics.REQUESTS]
    with open_session(settings, "listen") as session:
        heard = session.declare_subscriber(
            f"{settings.prefix}/**",
            zenoh.handlers.FifoChannel(4096),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        asked = [session.declare_queryable(k, zenoh.handlers.FifoChannel(64)) for k in requests]
        print("ready", flush=True)
        while True:
            while (sample := heard.try_recv()) is not None:
                print("put", sample.key_expr, sample.payload.to_string(), flush=True)
            for queryable in asked:
                while (query := queryable.try_recv()) is not None:
                    print("query", query.key_expr, query.payload.to_string(), flush=True)
                    with query:
                        query.reply(query.key_expr, b"{}")
            for key in keys:
                session.put(key, b"of the service", allowed_destination=zenoh.Locality.REMOTE)
            time.sleep(0.05)


if __name__ == "__main__":
    main(sys.argv[1])

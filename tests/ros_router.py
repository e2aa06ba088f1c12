"""What `rmw_zenohd` is to a ROS 2 graph: a router, in this process; and sessions that find it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from edge.bus.session import zenoh_session
from edge.config import Zenoh
from edge.host.ports import free_port


@contextmanager
def router() -> Iterator[int]:
    """Its port on this machine."""
    port = free_port()
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield port


@contextmanager
def ours(port: int) -> Iterator[zenoh.Session]:
    """A session as the service has it beside a router."""
    with zenoh_session(zenoh_settings(port), "listen") as session:
        yield session


def zenoh_settings(port: int) -> Zenoh:
    return Zenoh(endpoint=f"tcp/127.0.0.1:{port}", mode="client")

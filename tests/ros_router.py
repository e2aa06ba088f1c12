"""Stand-in for `rmw_zenohd`: a router in this process, and sessions that find it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh
from zenoh import ext

from edge.bus.ros2.names import Dialect
from edge.bus.session import zenoh_session
from edge.config import ZenohConfig
from edge.host.ports import free_port


@contextmanager
def router() -> Iterator[int]:
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
    """Open a session as the service does next to a router."""
    with zenoh_session(zenoh_settings(port), "listen") as session:
        yield session


def kept(session: zenoh.Session, dialect: Dialect, topic: str) -> ext.AdvancedPublisher:
    """Return a latched topic, as a bridge and the adapter publish it."""
    return ext.declare_advanced_publisher(
        session, dialect.data_key(0, topic, "", ""), cache=ext.CacheConfig(max_samples=1),
        publisher_detection=True,
    )  # fmt: skip


def zenoh_settings(port: int) -> ZenohConfig:
    return ZenohConfig(endpoint=f"tcp/127.0.0.1:{port}", mode="client")

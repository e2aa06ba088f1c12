"""`zenoh-ros2-sdk`, an implementation of rmw_zenoh that is not ours, as a peer in tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from ros_messages import STORE, from_ros

from edge.bus.ros2 import names

sdk = pytest.importorskip("zenoh_ros2_sdk")


@contextmanager
def peers(port: int) -> Iterator[None]:
    """Open the session of all its endpoints, with the router at a port."""
    from zenoh_ros2_sdk.session import ZenohSession

    shared = ZenohSession.get_instance("127.0.0.1", port)
    try:
        yield
    finally:
        shared.session.close()
        ZenohSession._instance = None


def definition(name: str) -> str:
    return STORE.generate_msgdef(name, ros_version=2)[0]


def publisher(port: int, topic: str, name: str, **options: Any) -> Any:
    options = {"type_hash": names.hash_from_table(name), **options}
    return sdk.ROS2Publisher(
        topic, name, definition(name), router_ip="127.0.0.1", router_port=port, **options
    )


def subscriber(
    port: int, topic: str, name: str, callback: Callable[[Any], None], **options: Any
) -> Any:
    return sdk.ROS2Subscriber(
        topic, name, callback, definition(name), router_ip="127.0.0.1", router_port=port,
        type_hash=names.hash_from_table(name), **options,
    )  # fmt: skip


class Republisher:
    """Publishes payloads as messages: the peer decodes and encodes each again."""

    def __init__(self, port: int, topic: str, name: str) -> None:
        self._name, self._publisher = name, publisher(port, topic, name)

    def put(self, payload: bytes) -> None:
        message = from_ros(payload, self._name)
        fields = [name for name, _ in STORE.fielddefs[self._name][1]]
        self._publisher.publish(**{name: getattr(message, name) for name in fields})

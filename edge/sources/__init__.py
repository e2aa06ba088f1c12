"""Sources of observations: sensor messages joined by stamp, live or recorded.

A source receives messages, converts them to `edge.sources.messages`, and passes them to a
`TimeSynchronizer`; later stages do not know the transport. To add one, write a class in a new file
and add a line to `REGISTRY`. A plugin needs only `source.kind: module:Class`. The class is called
with `source.options`, and with `config` and `session` if it has such parameters. Its interface is
`edge.loop.source.Source`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.config import Config
from edge.config.components import component_factory

if TYPE_CHECKING:
    from edge.loop.source import Source

REGISTRY = {
    "zenoh": "edge.sources.zenoh:ZenohSource",
    "ros2": "edge.sources.ros2:Ros2Source",
    "zmq": "edge.sources.zmq:ZmqSource",
    "camera": "edge.sources.camera:CameraSource",
}
"""Imported only if configured, because a source may need extra packages."""

NEEDS = (
    "poll()", "wait()", "close()", "counters", "epoch", "pose", "inbox.poll()", "inbox.overruns",
)  # fmt: skip
"""The interface of `edge.loop.source.Source`, for error messages."""


def find_source(config: Config) -> Callable[..., Source]:
    """Return a factory of the configured source: `make(config=, session=)`.

    Raises:
        ConfigError: see `edge.config.components.component_factory`.
    """
    kind, options, where = config.source.kind, config.source.options, config.locate("source")
    given = ("config", "session")
    known = {"config": config}
    return component_factory("source", kind, options, REGISTRY, where, NEEDS, given, known=known)

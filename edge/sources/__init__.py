"""What yields observations: sensor messages joined by stamp, live or recorded.

A source brings messages from somewhere as `edge.sources.messages` has them, and hands them to a
`TimeSynchronizer`; nothing behind it knows what they came on. A new one is a file with a class and
a line in `REGISTRY`; one's own needs neither, only `source.kind: module:Class`. The class is called
with `source.options`, and where it has parameters of these names with `config` and `session`; what
it must offer stands in `edge/loop/source.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.config import Config
from edge.config.named import find_named

if TYPE_CHECKING:
    from edge.loop.source import Source

REGISTRY = {
    "zenoh": "edge.sources.zenoh:ZenohSource",
    "ros2": "edge.sources.ros2:Ros2Source",
    "zmq": "edge.sources.zmq:ZmqSource",
}
"""Imported only where they are named: a source may need packages of its own."""

NEEDS = (
    "poll()", "wait()", "close()", "counters", "epoch", "pose", "inbox.poll()", "inbox.overruns",
)  # fmt: skip
"""What `edge.loop.source.Source` says."""


def find_source(config: Config) -> Callable[..., Source]:
    """What makes the source that the configuration names, as `make(config=, session=)`.

    Raises:
        ConfigError: see `edge.config.named.find_named`.
    """
    kind, options, where = config.source.kind, config.source.options, config.at("source")
    given = ("config", "session")
    known = {"config": config}
    return find_named("source", kind, options, REGISTRY, where, NEEDS, given, known=known)

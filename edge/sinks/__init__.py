"""Sinks, which receive every `edge.loop.result.TickResult`; configured by name in `sinks:`.

To add one, write a class in a new file and add a line to `REGISTRY`. A plugin needs only
`module:Class` in the configuration (docs/sinks.md).
"""

from __future__ import annotations

from collections.abc import Callable

from edge.config import Config
from edge.config.components import component_factory
from edge.loop.result import Sink

REGISTRY = {
    "zenoh": "edge.sinks.zenoh:ZenohSink",
    "ros2": "edge.sinks.ros2:Ros2Sink",
    "mcap": "edge.sinks.mcap:McapSink",
    "foxglove": "edge.sinks.foxglove:FoxgloveSink",
    "rerun": "edge.sinks.rerun:RerunSink",
}
"""Imported only if configured, because a sink may need extra packages."""


def find_sinks(config: Config) -> list[Callable[..., Sink]]:
    """Return a factory of each configured sink: `make(config=, session=)`.

    Raises:
        ConfigError: see `edge.config.components.component_factory`.
    """
    needs, given, known = ("tick()", "close()"), ("config", "session"), {"config": config}
    wheres = (config.locate(f"sinks.{i}") for i in range(len(config.sinks)))
    return [
        component_factory(
            "sink", sink.kind, sink.options, REGISTRY, where, needs=needs, given=given, known=known
        )
        for sink, where in zip(config.sinks, wheres, strict=True)
    ]

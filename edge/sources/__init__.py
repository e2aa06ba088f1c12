"""What yields observations: sensor messages joined by stamp, live or recorded.

A source brings messages from somewhere as `edge.sources.messages` has them, and hands them to a
`TimeSynchronizer`. Nothing behind a source knows what they came on. Another one is a file here and
a line in `REGISTRY`, or a class anywhere that `source.kind: module:Class` names.
"""

from __future__ import annotations

from zenoh import Session

from edge.config import Config
from edge.config.named import check_call, find_class
from edge.loop.source import Source

REGISTRY = {"zenoh": "edge.sources.zenoh:ZenohSource"}
"""Imported only where they are named: a robot needs what its own source takes."""


def make_source(config: Config, session: Session) -> Source:
    """The source that the configuration names.

    Raises:
        ConfigError: there is none of this name, it does not take these options, or the sensors do
            not fit the configuration.
    """
    named, where = config.source, f"{config.path}: source"
    make = find_class(REGISTRY.get(named.kind, named.kind), REGISTRY, f"{where}.kind")
    check_call(make, 2, named.options, f"{where}.options")
    return make(config, session, **named.options)

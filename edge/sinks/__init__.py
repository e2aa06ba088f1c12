"""Where results go: every sink takes `edge.loop.result.TickResult`, by its name in `sinks:`.

A new sink is a file with a class and a line in `REGISTRY`; one's own needs neither, only
`module:Class` in the configuration (docs/sinks.md).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from zenoh import Session

from edge.config import Config
from edge.config.named import check_call, find_class
from edge.loop.result import Sink

REGISTRY = {"zenoh": "edge.sinks.zenoh:ZenohSink"}
"""Imported only where they are named: a sink may need packages of its own."""


def find_sinks(config: Config) -> list[Callable[[Session], Sink]]:
    """What makes each sink that the configuration names, as `make(session)`.

    Raises:
        ConfigError: there is none of a name, or it does not take these options.
    """
    found = []
    for i, named in enumerate(config.sinks):
        where = f"{config.path}: sinks.{i}"
        make = find_class(REGISTRY.get(named.kind, named.kind), REGISTRY, f"{where}.kind")
        check_call(make, 2, named.options, f"{where}.options")
        found.append(partial(make, config, **named.options))
    return found

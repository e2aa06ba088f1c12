"""What yields observations: sensor messages joined by stamp, live or recorded.

A source brings messages from somewhere as `edge.sources.messages` has them, and hands them to a
`TimeSynchronizer`; nothing behind it knows what they came on. A new one is a file with a class and
a line in `REGISTRY`; one's own needs neither, only `source.kind: module:Class`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from edge.config import Config
from edge.config.named import check_call, find_class

if TYPE_CHECKING:
    from zenoh import Session

    from edge.loop.source import Source

REGISTRY = {"zenoh": "edge.sources.zenoh:ZenohSource"}
"""Imported only where they are named: a source may need packages of its own."""


def find_source(config: Config) -> Callable[[Session], Source]:
    """What makes the source that the configuration names, as `make(session)`.

    Raises:
        ConfigError: there is none of that name, or it does not take these options.
    """
    kind, options, where = config.source.kind, config.source.options, f"{config.path}: source"
    make = find_class(REGISTRY.get(kind, kind), REGISTRY, f"{where}.kind")
    check_call(make, 2, options, f"{where}.options")
    return partial(make, config, **options)

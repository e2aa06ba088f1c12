"""What yields observations: sensor messages joined by stamp, live or recorded.

A source brings messages from somewhere as `edge.sources.messages` has them, and hands them to a
`TimeSynchronizer`. Nothing behind a source knows what they came on. Another one is a file here and
a line in `REGISTRY`, or a class anywhere that `source.kind: module:Class` names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge.config import Config, own_class

if TYPE_CHECKING:
    import zenoh

    from edge.sources.base import Source

# By name, so that a robot needs to have installed only what its own source takes.
REGISTRY = {"zenoh": "edge.sources.zenoh:ZenohSource"}


def make_source(config: Config, session: zenoh.Session) -> Source:
    """The source that `source.kind` names, called with the session and the configuration.

    Raises:
        ConfigError: it cannot be imported, or the sensors do not fit the configuration.
    """
    kind = config.source.kind
    return own_class(REGISTRY.get(kind, kind), f"{config.path}: source.kind")(session, config)

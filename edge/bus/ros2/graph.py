"""Who is there: the endpoints of a ROS 2 graph, as their liveliness tokens tell."""

from __future__ import annotations

import logging

import zenoh

from edge.bus.ros2.names import NO_HASH, Endpoint, Kind, every_token, known_hash, parse_token

log = logging.getLogger("edge.bus.ros2")

_MOST = 8192


class Graph:
    """The endpoints of a domain; for one thread, which looks now and then.

    A token that goes unseen would be missed for good, so the ring has room for more of them than
    a robot has; whoever sends more than that is told of, and not followed.
    """

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._there: dict[str, Endpoint] = {}
        self._overrun = False
        self._tokens = session.liveliness().declare_subscriber(
            every_token(domain), zenoh.handlers.RingChannel(_MOST), history=True
        )

    def look(self) -> bool:
        """Take in who came and went since the last look; whether anybody did."""
        changed = 0
        while changed < _MOST and (sample := self._tokens.try_recv()) is not None:
            changed += 1
            key = str(sample.key_expr)
            if sample.kind == zenoh.SampleKind.DELETE:
                self._there.pop(key, None)
            elif len(self._there) < _MOST and (endpoint := parse_token(key)) is not None:
                self._there[key] = endpoint
        if changed >= _MOST and not self._overrun:
            self._overrun = True
            log.warning("ros2: more than %d endpoints: some are not seen", _MOST)
        return changed > 0

    def endpoints(self, kind: Kind, topic: str, not_of: str = "") -> list[Endpoint]:
        """Those of a topic, but for those of the session `not_of`."""
        return [
            e
            for e in self._there.values()
            if e.kind == kind and e.topic == topic and e.zid != not_of
        ]

    def hash_of(self, type_name: str, not_of: str = "") -> str | None:
        """What the graph calls the hash of a type; None where neither it nor the table knows.

        Others say, never our own tokens (`not_of`): those may be of a robot that was there before.
        """
        others = [e for e in self._there.values() if e.zid != not_of]
        for endpoint in others:
            if endpoint.type == type_name:
                return endpoint.hash
        if any(endpoint.hash == NO_HASH for endpoint in others):
            return NO_HASH
        return known_hash(type_name)

    def close(self) -> None:
        self._tokens.undeclare()

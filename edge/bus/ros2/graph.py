"""Who is there: the endpoints of a ROS 2 graph, as their liveliness tokens tell."""

from __future__ import annotations

import logging

import zenoh

from edge.bus.ros2.names import NO_HASH, Endpoint, Kind, every_token, known_hash, parse_token

log = logging.getLogger("edge.bus.ros2")

_MOST = 8192


class Graph:
    """The endpoints of a domain, but for those of our own session; for one thread, which looks
    now and then.

    A token that goes unseen would be missed for good, so the ring has room for more of them than
    a robot has; whoever sends more than that is told of, and not followed.
    """

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._zid = str(session.info.zid())
        self._there: dict[str, Endpoint] = {}
        self._by_topic: dict[tuple[Kind, str], list[Endpoint]] = {}
        self._hashes: dict[str, str] = {}
        self._told = False
        self._tokens = session.liveliness().declare_subscriber(
            every_token(domain), zenoh.handlers.RingChannel(_MOST), history=True
        )

    def look(self) -> bool:
        """Take in who came and went since the last look; whether anybody did."""
        changes = 0
        while changes < _MOST and (sample := self._tokens.try_recv()) is not None:
            changes += 1
            self._take(str(sample.key_expr), sample.kind == zenoh.SampleKind.DELETE)
        if changes == 0:
            return False
        if changes == _MOST and not self._told:
            self._told = True
            log.warning("ros2: more than %d endpoints: some are not seen", _MOST)
        self._index()
        return True

    def _take(self, key: str, is_gone: bool) -> None:
        if is_gone:
            self._there.pop(key, None)
        elif len(self._there) < _MOST:
            endpoint = parse_token(key)
            if endpoint is not None and endpoint.zid != self._zid:
                self._there[key] = endpoint

    def _index(self) -> None:
        """Anew each time: a dead robot's hash must not outlive it, and changes are rare."""
        self._by_topic, self._hashes = {}, {}
        for endpoint in self._there.values():
            self._by_topic.setdefault((endpoint.kind, endpoint.topic), []).append(endpoint)
            self._hashes.setdefault(endpoint.type, endpoint.hash)

    def endpoints(self, kind: Kind, topic: str) -> list[Endpoint]:
        """Those of a topic or service."""
        return self._by_topic.get((kind, topic), [])

    def hash_of(self, type_name: str) -> str | None:
        """What the graph calls the hash of a type; None where neither it nor the table knows."""
        if type_name in self._hashes:
            return self._hashes[type_name]
        return NO_HASH if NO_HASH in self._hashes.values() else known_hash(type_name)

    def close(self) -> None:
        self._tokens.undeclare()

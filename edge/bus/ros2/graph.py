"""Endpoints of a ROS 2 graph, discovered by their liveliness tokens."""

from __future__ import annotations

import logging

import zenoh

from edge.bus.ros2.names import NO_HASH, Endpoint, Kind, all_tokens, hash_from_table, parse_token

log = logging.getLogger("edge.bus.ros2")

_MAX_TOKENS = 8192


class Graph:
    """The endpoints of a ROS 2 domain, without those of our own session; for one thread.

    The ring has room for more tokens than a robot has, since a missed token is never sent again.
    If there are more, a warning is logged once and the rest is ignored.
    """

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._zid = str(session.info.zid())
        self._by_id: dict[str, Endpoint] = {}  # by token, which is unique
        self._by_topic: dict[tuple[Kind, str], list[Endpoint]] = {}
        self._hashes: dict[str, str] = {}  # type → hash
        self._warned = False
        self._tokens = session.liveliness().declare_subscriber(
            all_tokens(domain), zenoh.handlers.RingChannel(_MAX_TOKENS), history=True
        )

    def update(self) -> bool:
        """Process the tokens since the last poll; return True if any endpoint changed."""
        changes = 0
        while changes < _MAX_TOKENS and (sample := self._tokens.try_recv()) is not None:
            changes += 1
            self._apply(str(sample.key_expr), sample.kind == zenoh.SampleKind.DELETE)
        if changes == 0:
            return False
        if changes == _MAX_TOKENS:  # the ring was full
            self._warn()
        self._index()
        return True

    def _apply(self, key: str, is_gone: bool) -> None:
        """Add or remove the endpoint of a token."""
        if is_gone:
            self._by_id.pop(key, None)
            return
        endpoint = parse_token(key)
        if endpoint is None or endpoint.zid == self._zid:
            return
        if key in self._by_id or len(self._by_id) < _MAX_TOKENS:
            self._by_id[key] = endpoint
        else:
            self._warn()

    def _warn(self) -> None:
        """Log once that endpoints are ignored."""
        if not self._warned:
            self._warned = True
            log.warning("ros2: the ROS 2 graph has more than %d publishers, subscribers, servers "
                        "and clients: some are ignored", _MAX_TOKENS)  # fmt: skip

    def _index(self) -> None:
        """Rebuild the index: a dead robot's hash must not stay, and changes are rare."""
        self._by_topic, self._hashes = {}, {}
        for endpoint in self._by_id.values():
            self._by_topic.setdefault((endpoint.kind, endpoint.topic), []).append(endpoint)
            self._hashes.setdefault(endpoint.type, endpoint.hash)

    def endpoints(self, kind: Kind, topic: str) -> list[Endpoint]:
        """Return the endpoints of a topic or service."""
        return self._by_topic.get((kind, topic), [])

    def hash_of(self, type_name: str) -> str | None:
        """Return the hash of a type in this graph; None if neither graph nor table has it."""
        if type_name in self._hashes:
            return self._hashes[type_name]
        # One endpoint without a hash shows that the graph is of Humble, which has none at all.
        return NO_HASH if NO_HASH in self._hashes.values() else hash_from_table(type_name)

    def close(self) -> None:
        self._tokens.undeclare()

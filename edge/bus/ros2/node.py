"""A node of a ROS 2 graph, with publishers, subscriptions and service clients.

An endpoint is a publisher, subscription, service server or service client. In rmw_zenoh each
announces itself by a liveliness token; `ros2 topic list` lists these. The token contains the hash
of the endpoint's type. Hashes differ between ROS distributions, so an endpoint is declared again
when the graph shows another hash for its type. With `ros2.via` `bridge` or `adapter` there are no
tokens and hashes; Zenoh itself reports if there is a subscriber or server.
"""

from __future__ import annotations

import hashlib
import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any

import zenoh
from zenoh import ext

from edge.bus.ros2 import names
from edge.bus.ros2.graph import Graph
from edge.bus.ros2.names import RMW_ZENOH, Dialect, Endpoint, Kind, dialect_of
from edge.bus.session import Ring
from edge.config import Config

_IDS = itertools.count()  # of nodes and endpoints, in this process
_POLL_S = 0.2  # period of updates


class Ros2Node:
    """A node; for one thread, which must call `update` periodically.

    Args:
        domain: ROS 2 domain id.
        name: name of the node, in the root namespace.
        dialect: the naming scheme of the graph.

    Attributes:
        graph: the other endpoints; None if the dialect has no tokens.
        zid: id of the Zenoh session, for tokens.
        nid: number of the node in this process, for tokens.
    """

    def __init__(
        self, session: zenoh.Session, domain: int, name: str, dialect: Dialect = RMW_ZENOH
    ) -> None:
        self.session, self.domain, self.name, self.dialect = session, domain, name, dialect
        self.zid = str(session.info.zid())
        self.nid = next(_IDS)
        self.graph = Graph(session, domain) if dialect.has_tokens else None
        self._polled_s = 0.0
        self._endpoints: list[_Ros2Endpoint] = []
        self._token: zenoh.LivelinessToken | None = None
        if dialect.has_tokens:
            token = names.node_token(domain, self.zid, self.nid, name)
            self._token = session.liveliness().declare_token(token)

    def update(self) -> None:
        """Update the graph, and declare endpoints again whose type changed in it.

        Without a graph, publish the last message of latched topics to new subscribers.
        """
        now_s = time.monotonic()
        if now_s - self._polled_s < _POLL_S:
            return
        self._polled_s = now_s
        if self.graph is None:
            for endpoint in self._endpoints:
                endpoint.update()
        elif self.graph.update():
            for endpoint in self._endpoints:
                endpoint.declare_if_changed()

    def publisher(self, topic: str, type_name: str, latched: bool = False) -> Ros2Publisher:
        """Add a publisher; see `Ros2Publisher`."""
        return self._add(Ros2Publisher(self, topic, type_name, latched))

    def subscription(
        self, topic: str, types: Sequence[str], capacity: int, latched: bool = False
    ) -> Ros2Subscription:
        """Add a subscription; see `Ros2Subscription`."""
        return self._add(Ros2Subscription(self, topic, types, capacity, latched))

    def client(self, service: str, type_name: str, timeout_s: float) -> Ros2Client:
        """Add a service client; see `Ros2Client`."""
        return self._add(Ros2Client(self, service, type_name, timeout_s))

    def close(self) -> None:
        for endpoint in self._endpoints:
            endpoint.close()
        if self._token is not None:
            self._token.undeclare()
        if self.graph is not None:
            self.graph.close()

    def others(self, kind: Kind, topic: str) -> list[Endpoint]:
        """Return the endpoints of a topic in other sessions; empty without a graph."""
        return [] if self.graph is None else self.graph.endpoints(kind, topic)

    def _add(self, endpoint: Any) -> Any:
        self._endpoints.append(endpoint)
        endpoint.declare_if_changed()
        return endpoint


def open_node(config: Config, session: zenoh.Session, part: str) -> Ros2Node:
    """Open a node as `ros2` of the configuration says; `part` is the suffix of its name."""
    settings = config.ros2
    dialect = dialect_of(settings.via, config.zenoh.prefix)
    return Ros2Node(session, settings.domain, f"{settings.node}_{part}", dialect)


class _Ros2Endpoint:
    """Base of all endpoints: a token that follows the graph's type name and hash.

    Args:
        kind: see `edge.bus.ros2.names.Kind`: `MP` is a publisher, `MS` a subscription, `SS` a
            service server, `SC` a service client.
        topic: topic or service, with a leading slash.
        type_name: ROS 2 name of the type.
        qos: quality of service in the token, see `edge.bus.ros2.names`.

    Attributes:
        hash: the declared hash of the type; None before it is known, "" in a dialect without
            tokens.
    """

    def __init__(self, node: Ros2Node, kind: Kind, topic: str, type_name: str, qos: str) -> None:
        self.node, self.topic, self.type = node, topic, type_name
        self.hash: str | None = None
        self._kind, self._qos, self._eid = kind, qos, next(_IDS)
        self._token: zenoh.LivelinessToken | None = None
        self._sequence = 0
        self._gid = bytes(16)  # id of the endpoint in attachments

    def declare_if_changed(self) -> None:
        """Declare the endpoint, or declare it again if the graph has another type or hash."""
        node, type_name = self.node, self.wanted_type()
        type_hash = "" if node.graph is None else node.graph.hash_of(type_name)
        if type_hash is None or (type_name, type_hash) == (self.type, self.hash):
            return
        self.type, self.hash = type_name, type_hash
        if node.graph is None:
            self.declare()
            return
        endpoint = Endpoint(self._kind, node.zid, node.name, self.topic, self.type, self.hash)
        token = names.endpoint_token(node.domain, node.nid, self._eid, endpoint, self._qos)
        self._gid = hashlib.blake2b(token.encode(), digest_size=16).digest()
        self._sequence = 0
        self.declare()
        if self._token is not None:
            self._token.undeclare()
        self._token = node.session.liveliness().declare_token(token)

    def update(self) -> None:
        """Notice new subscribers, in a dialect without tokens."""

    def wanted_type(self) -> str:
        """Return the type to declare, which may depend on the graph."""
        return self.type

    def key(self) -> str:
        """Return the key of its messages or requests; the hash must be known."""
        return self.node.dialect.data_key(self.node.domain, self.topic, self.type, self.hash or "")

    def declare(self) -> None:
        """Open the Zenoh entity that the token announces, and close the previous one."""

    def attachment(self) -> bytes | None:
        """Return the attachment of the next message or request."""
        if not self.node.dialect.has_tokens:
            return None
        self._sequence += 1
        return names.attachment(self._sequence, time.time_ns(), self._gid)

    def close(self) -> None:
        if self._token is not None:
            self._token.undeclare()


class Ros2Publisher(_Ros2Endpoint):
    """Publishes payloads of one type.

    Args:
        topic: topic with a leading slash.
        type_name: ROS 2 name.
        latched: transient local: a late subscriber gets the last message. The bridge and the
            adapter get it when they subscribe, and then keep it for late subscribers.
    """

    def __init__(self, node: Ros2Node, topic: str, type_name: str, latched: bool) -> None:
        super().__init__(node, "MP", topic, type_name, names.LATCHED if latched else names.RELIABLE)
        self._latched, self._last, self._was_heard = latched, b"", False
        self._publisher: zenoh.Publisher | ext.AdvancedPublisher | None = None

    def put(self, payload: bytes) -> None:
        """Publish. Before the type's hash is known, a latched publisher only keeps the payload."""
        if self._latched:
            self._last = payload
        if self._publisher is not None:
            self._publisher.put(payload, attachment=self.attachment())

    def update(self) -> None:
        # Send the last message again when the first subscriber comes.
        was_heard, self._was_heard = self._was_heard, self.has_subscribers()
        if self._last and self._was_heard and not was_heard:
            self.put(self._last)

    def has_subscribers(self) -> bool:
        """Return True if there is a subscriber.

        Put messages of a latched topic without asking: the last one is kept for late subscribers.
        """
        if self.node.graph is None:
            return self._publisher is not None and self._publisher.matching_status.matching
        return bool(self.node.others("MS", self.topic))

    def declare(self) -> None:
        self._undeclare()
        key = self.key()
        # The settings of rmw_zenoh for reliable topics that keep the last few messages.
        drop = zenoh.CongestionControl.DROP
        if not (self._latched and self.node.dialect.has_tokens):
            self._publisher = self.node.session.declare_publisher(
                key, congestion_control=drop, express=True
            )
            return
        self._publisher = ext.declare_advanced_publisher(
            self.node.session, key, congestion_control=drop,
            cache=ext.CacheConfig(max_samples=1), publisher_detection=True,
        )  # fmt: skip
        if self._last:
            self.put(self._last)

    def close(self) -> None:
        super().close()
        self._undeclare()

    def _undeclare(self) -> None:
        if self._publisher is not None:
            self._publisher.undeclare()
            self._publisher = None


class Ros2Subscription(_Ros2Endpoint):
    """The newest messages of a topic, of several types; best effort, as usual for sensors.

    Args:
        topic: topic with a leading slash.
        types: accepted types. The first is announced until another one has a publisher.
        capacity: see `edge.bus.session.Ring`.
        latched: also receive messages published before.
    """

    def __init__(
        self, node: Ros2Node, topic: str, types: Sequence[str], capacity: int, latched: bool
    ) -> None:
        qos = names.LATCHED if latched else names.BEST_EFFORT
        super().__init__(node, "MS", topic, types[0], qos)
        self.types = tuple(types)
        ring_class: Callable[..., Ring] = _LatchedRing if latched else Ring
        self._ring = ring_class(node.session, node.dialect.any_key(node.domain, topic), capacity)

    @property
    def overruns(self) -> int:
        """Number of overruns; see `edge.bus.session.Ring`."""
        return self._ring.overruns

    def take(self) -> list[tuple[str, zenoh.ZBytes]]:
        """Return (type, payload) of the messages since the last poll, oldest first.

        The type comes from the key and may be a type that was not asked for. If keys have no types,
        the announced type is returned.
        """
        samples = self._ring.take()
        if self.node.graph is None:
            return [(self.type, s.payload) for s in samples]
        return [(names.type_of_key(str(s.key_expr)), s.payload) for s in samples]

    def wanted_type(self) -> str:
        for endpoint in self.node.others("MP", self.topic):
            if endpoint.type in self.types:
                return endpoint.type
        return self.type

    def close(self) -> None:
        super().close()
        self._ring.close()


class _LatchedRing(Ring):
    """A ring that also receives the messages that publishers keep for late subscribers."""

    def _declare(self, session: zenoh.Session, key: str, ring: Any) -> Any:
        history = ext.HistoryConfig(detect_late_publishers=True)
        return ext.declare_advanced_subscriber(session, key, ring, history=history)


class Ros2Client(_Ros2Endpoint):
    """Calls a service without blocking; the caller polls the answer.

    Args:
        service: name of the service, with a leading slash.
        type_name: ROS 2 name.
        timeout_s: longest time until the answer.
    """

    def __init__(self, node: Ros2Node, service: str, type_name: str, timeout_s: float) -> None:
        super().__init__(node, "SC", service, type_name, names.RELIABLE)
        self._timeout_s = timeout_s
        self._querier: zenoh.Querier | None = None

    def has_server(self) -> bool:
        """Return True if the service has a server and its type is known."""
        if self._querier is None or not self._querier.matching_status.matching:
            return False
        return self.node.graph is None or bool(self.node.others("SS", self.topic))

    def call(self, payload: bytes) -> PendingReply:
        """Send a request. If the type's hash is unknown, the returned reply is `done`."""
        if self._querier is None:
            return PendingReply(None)
        # Not a ring: it loses its last replies when the other side finishes.
        channel = zenoh.handlers.FifoChannel(4)
        return PendingReply(
            self._querier.get(channel, payload=payload, attachment=self.attachment())
        )

    def declare(self) -> None:
        self._undeclare()
        self._querier = self.node.session.declare_querier(
            self.key(), timeout=self._timeout_s, consolidation=zenoh.ConsolidationMode.NONE
        )

    def close(self) -> None:
        super().close()
        self._undeclare()

    def _undeclare(self) -> None:
        if self._querier is not None:
            self._querier.undeclare()
            self._querier = None


class PendingReply:
    """The pending answer of a service to one request.

    Attributes:
        done: True if there is nothing more to poll: the answer was returned, is an error, or did
            not come in time.
    """

    def __init__(self, replies: Any) -> None:
        self._replies = replies

    @property
    def done(self) -> bool:
        return self._replies is None

    def poll(self) -> bytes | None:
        """Return the answer, once; never blocks."""
        if self._replies is None:
            return None
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:  # the channel is closed and empty
            self._replies = None
            return None
        if reply is None:
            return None
        self._replies = None
        return None if reply.ok is None else reply.ok.payload.to_bytes()

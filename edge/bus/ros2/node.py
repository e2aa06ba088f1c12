"""A node of a ROS 2 graph, with publishers, subscriptions and clients of services.

In a graph that speaks rmw_zenoh every endpoint has a token, by which `ros2 topic list` shows it,
and which names its type's hash. That hash differs between distributions, so endpoints are declared
anew once the graph shows another than was thought. Beside a bridge or the adapter there is neither,
and whether somebody is there is what Zenoh's routing says.
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
_LOOK_S = 0.2


class Node:
    """For one thread. `look` must be called now and then.

    Args:
        name: in the root namespace.

    Attributes:
        graph: who else is there; None where nobody can tell.
    """

    def __init__(
        self, session: zenoh.Session, domain: int, name: str, dialect: Dialect = RMW_ZENOH
    ) -> None:
        self.session, self.domain, self.name, self.dialect = session, domain, name, dialect
        self.zid = str(session.info.zid())
        self.nid = next(_IDS)
        self.graph = Graph(session, domain) if dialect.has_tokens else None
        self._looked_s = 0.0
        self._endpoints: list[_Declared] = []
        self._token: zenoh.LivelinessToken | None = None
        if dialect.has_tokens:
            token = names.node_token(domain, self.zid, self.nid, name)
            self._token = session.liveliness().declare_token(token)

    def look(self) -> None:
        """Take in who came and went; endpoints follow what others call their types."""
        if self.graph is None:
            return
        now_s = time.monotonic()
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        if self.graph.look():
            for endpoint in self._endpoints:
                endpoint.settle()

    def publisher(self, topic: str, type_name: str, latched: bool = False) -> Publisher:
        """See `Publisher`."""
        return self._add(Publisher(self, topic, type_name, latched))

    def subscription(
        self, topic: str, types: Sequence[str], kept: int, latched: bool = False
    ) -> Subscription:
        """See `Subscription`."""
        return self._add(Subscription(self, topic, types, kept, latched))

    def client(self, service: str, type_name: str, timeout_s: float) -> Client:
        """See `Client`."""
        return self._add(Client(self, service, type_name, timeout_s))

    def close(self) -> None:
        for endpoint in self._endpoints:
            endpoint.close()
        if self._token is not None:
            self._token.undeclare()
        if self.graph is not None:
            self.graph.close()

    def others(self, kind: Kind, topic: str) -> list[Endpoint]:
        """The endpoints of a topic, but for those of this session; none where nobody can tell."""
        return [] if self.graph is None else self.graph.endpoints(kind, topic)

    def _add(self, endpoint: Any) -> Any:
        self._endpoints.append(endpoint)
        endpoint.settle()
        return endpoint


def open_node(config: Config, session: zenoh.Session, part: str) -> Node:
    """A node of ours, as `ros2` has it; `part` says whose it is."""
    settings = config.ros2
    dialect = dialect_of(settings.via, config.zenoh.prefix)
    return Node(session, settings.domain, f"{settings.node}_{part}", dialect)


class _Declared:
    """What all endpoints share: a token, which follows its type's name and hash.

    Attributes:
        hash: of the type, as it was declared; None before it is known.
    """

    def __init__(self, node: Node, kind: Kind, topic: str, type_name: str, qos: str) -> None:
        self.node, self.topic, self.type = node, topic, type_name
        self.hash: str | None = None
        self._kind, self._qos, self._eid = kind, qos, next(_IDS)
        self._token: zenoh.LivelinessToken | None = None
        self._sequence = 0
        self._gid = bytes(16)

    def settle(self) -> None:
        """Declare, or declare anew, where the graph calls the type otherwise than so far."""
        node, type_name = self.node, self.wanted_type()
        type_hash = "" if node.graph is None else node.graph.hash_of(type_name)
        if type_hash is None or (type_name, type_hash) == (self.type, self.hash):
            return
        self.type, self.hash = type_name, type_hash
        if node.graph is None:
            self.declare()
            return
        said = Endpoint(self._kind, node.zid, node.name, self.topic, self.type, self.hash)
        token = names.endpoint_token(node.domain, node.nid, self._eid, said, self._qos)
        self._gid = hashlib.blake2b(token.encode(), digest_size=16).digest()
        self._sequence = 0
        self.declare()
        if self._token is not None:
            self._token.undeclare()
        self._token = node.session.liveliness().declare_token(token)

    def wanted_type(self) -> str:
        return self.type

    def key(self) -> str:
        """Where its messages or requests go; the hash must be known."""
        return self.node.dialect.data_key(self.node.domain, self.topic, self.type, self.hash or "")

    def declare(self) -> None:
        """Open what the token promises, in the place of what was open."""

    def attachment(self) -> bytes | None:
        """For the next message or request."""
        if not self.node.dialect.has_tokens:
            return None
        self._sequence += 1
        return names.attachment(self._sequence, time.time_ns(), self._gid)

    def close(self) -> None:
        if self._token is not None:
            self._token.undeclare()


class Publisher(_Declared):
    """Publishes payloads of one type.

    Args:
        latched: who subscribes late, as transient local, gets the last message. Beside a bridge or
            the adapter, these keep it themselves, from when they first heard it.
    """

    def __init__(self, node: Node, topic: str, type_name: str, latched: bool) -> None:
        super().__init__(node, "MP", topic, type_name, names.LATCHED if latched else names.RELIABLE)
        self._latched, self._last = latched, b""
        self._publisher: zenoh.Publisher | ext.AdvancedPublisher | None = None

    def put(self, payload: bytes) -> None:
        """Send; before the type's hash is known, as nobody can be there, it only keeps the last."""
        if self._latched:
            self._last = payload
        if self._publisher is not None:
            self._publisher.put(payload, attachment=self.attachment())

    def heard(self) -> bool:
        """Whether somebody subscribes; of latched topics nobody asks."""
        if self.node.graph is None:
            return self._publisher is not None and self._publisher.matching_status.matching
        return bool(self.node.others("MS", self.topic))

    def declare(self) -> None:
        self._undeclare()
        key = self.key()
        # As rmw_zenoh does for what is reliable and keeps the last few.
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


class Subscription(_Declared):
    """The newest messages of a topic, of any of some types; best effort, as sensors want it.

    Args:
        types: what is understood; the first is announced as long as nobody publishes another.
        kept: see `edge.bus.session.Ring`.
        latched: also what was published before.
    """

    def __init__(
        self, node: Node, topic: str, types: Sequence[str], kept: int, latched: bool
    ) -> None:
        qos = names.LATCHED if latched else names.BEST_EFFORT
        super().__init__(node, "MS", topic, types[0], qos)
        self.types = tuple(types)
        make: Callable[..., Ring] = _LatchedRing if latched else Ring
        self._ring = make(node.session, node.dialect.any_key(node.domain, topic), kept)

    @property
    def overruns(self) -> int:
        """See `edge.bus.session.Ring`."""
        return self._ring.overruns

    def take(self) -> list[tuple[str, zenoh.ZBytes]]:
        """(type, payload) of what came since the last look, oldest first.

        The type is what the key says: any, also one that is not understood. Where keys say
        nothing, it is the one that is announced.
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
    """With what publishers keep for who comes late."""

    def _declare(self, session: zenoh.Session, key: str, ring: Any) -> Any:
        history = ext.HistoryConfig(detect_late_publishers=True)
        return ext.declare_advanced_subscriber(session, key, ring, history=history)


class Client(_Declared):
    """Asks a service; nothing waits for the answer but who polls it."""

    def __init__(self, node: Node, service: str, type_name: str, timeout_s: float) -> None:
        super().__init__(node, "SC", service, type_name, names.RELIABLE)
        self._timeout_s = timeout_s
        self._querier: zenoh.Querier | None = None

    def served(self) -> bool:
        """Whether the service is there, and how it is asked."""
        if self._querier is None or not self._querier.matching_status.matching:
            return False
        return self.node.graph is None or bool(self.node.others("SS", self.topic))

    def ask(self, payload: bytes) -> Answer:
        """Send a request. Its answer is over at once where the type's hash is unknown."""
        if self._querier is None:
            return Answer(None)
        # No ring: its last words are lost when the other side has nothing more to say.
        channel = zenoh.handlers.FifoChannel(4)
        return Answer(self._querier.get(channel, payload=payload, attachment=self.attachment()))

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


class Answer:
    """What a service says to one request.

    Attributes:
        over: nothing more will come: it was polled, or nobody answered, or with an error.
    """

    def __init__(self, replies: Any) -> None:
        self._replies = replies

    @property
    def over(self) -> bool:
        return self._replies is None

    def poll(self) -> bytes | None:
        """The answer, once; never blocks."""
        if self._replies is None:
            return None
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:  # all has come that will
            self._replies = None
            return None
        if reply is None:
            return None
        self._replies = None
        return None if reply.ok is None else reply.ok.payload.to_bytes()

"""Access rules of `config/secure` for `edge ros2-adapter`.

All clients declare the node's topics in sessions of their own. tests/ros2_adapter has the node
itself under these rules.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zenoh
from live_patience import PATIENCE_S, eventually
from secure_files import USERS, etc_edge, settings_of
from zenoh import ext

from edge.bus.ros2.names import NO_HASH, plain_dialect
from edge.bus.ros2.node import Ros2Node, Ros2Subscription
from edge.bus.ros2.topics import PUBLISHED, SUBSCRIBED
from edge.bus.session import open_session, zenoh_session
from edge.config import ZenohConfig
from edge.host.ports import free_port

ROS = plain_dialect("edge/ros2/")
ACTION = "/navigate_to_pose/_action/send_goal"
ENOUGH = 5


def key_of(topic: str) -> str:
    return ROS.data_key(0, topic, "", NO_HASH)


class Client:
    """The Zenoh side of the adapter's node (`passing.py`, `action.py`); it sends its name."""

    def __init__(self, session: zenoh.Session, who: str) -> None:
        self.who = who.encode()
        self._odometry = session.declare_publisher(key_of("/odom"))
        self._moored = ext.declare_advanced_publisher(
            session, key_of("/tf_static"), cache=ext.CacheConfig(max_samples=4),
            publisher_detection=True,
        )  # fmt: skip
        self._moored.put(self.who)
        self._path = session.declare_subscriber(key_of("/edge/path"), zenoh.handlers.RingChannel(8))
        self._action = session.declare_queryable(key_of(ACTION), self._answer, complete=True)
        self.paths = 0

    def _answer(self, query: zenoh.Query) -> None:
        query.reply(query.key_expr, self.who)

    def pass_on(self) -> None:
        self._odometry.put(self.who)
        while self._path.try_recv() is not None:
            self.paths += 1

    @property
    def is_heard(self) -> bool:
        """Return True if the odometry's subscriber has been discovered."""
        return self._odometry.matching_status.matching


class Service:
    """Recorder of the robot's messages to the service, by sender."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.node = Ros2Node(session, 0, "test", ROS)
        self.path = self.node.publisher("/edge/path", PUBLISHED["path"])
        self.action = self.node.client(ACTION, "", PATIENCE_S)
        self.odometry = self.hear("odom")
        self.moored = self.hear("tf_static", latched=True)

    def hear(self, name: str, latched: bool = False) -> Ros2Subscription:
        return self.node.subscription(f"/{name}", (SUBSCRIBED[name],), 64, latched)

    def answers(self) -> set[bytes]:
        every = zenoh.QueryTarget.ALL
        replies = self.session.get(key_of(ACTION), target=every, timeout=PATIENCE_S)
        return {reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None}


@contextmanager
def service(settings: ZenohConfig) -> Iterator[Service]:
    with zenoh_session(settings, "listen") as session:
        running = Service(session)
        yield running
        running.node.close()


@pytest.fixture(scope="module")
def etc(tmp_path_factory) -> Path:
    return etc_edge(tmp_path_factory.mktemp("etc-edge"))


def took(subscription: Ros2Subscription) -> list[bytes]:
    return [payload.to_bytes() for _, payload in subscription.take()]


@pytest.mark.parametrize("kind", ["certificates", "passwords"])
def test_only_the_adapter_may_publish_for_ros(etc, kind):
    """This also holds for a restarted service, which asks for earlier messages."""
    of = settings_of(etc, kind, free_port())
    clients: list[Client] = []
    with ExitStack() as stack:
        with service(of("adapter")) as running:
            for who in sorted(USERS):
                session = stack.enter_context(open_session(of(who), "connect"))
                clients.append(Client(session, who))
            all_is_passed(running, clients)
        with service(of("adapter")) as again:
            all_is_passed(again, clients)


def all_is_passed(service: Service, clients: list[Client]) -> None:
    (adapter,) = (client for client in clients if client.who == b"adapter")
    before, moved, moored = adapter.paths, [], []

    def exchange() -> bool:
        service.path.put(b"path")
        for client in clients:
            client.pass_on()
        moved.extend(took(service.odometry))
        moored.extend(took(service.moored))
        is_known = adapter.is_heard and service.action.has_server()
        paths = adapter.paths - before
        return bool(moored) and is_known and min(paths, len(moved)) >= ENOUGH

    eventually(exchange, "what the adapter may pass does not come")
    late = service.hear("tf_static", latched=True)
    moored.extend(eventually(lambda: took(late)))
    assert set(moved) == set(moored) == service.answers() == {adapter.who}

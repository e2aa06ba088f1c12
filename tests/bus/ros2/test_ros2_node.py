"""Our node in a graph with `zenoh-ros2-sdk`, an independent rmw_zenoh: each sees the other."""

from __future__ import annotations

import numpy as np
import pytest
import zenoh
from patience import PATIENCE_S, eventually
from ros_messages import STORE, header, to_ros
from ros_router import ours, router
from ros_sdk import definition, peers, publisher, sdk, subscriber

from edge.bus.ros2 import graph, names
from edge.bus.ros2.names import Endpoint
from edge.bus.ros2.node import Ros2Node
from edge.bus.wire import messages, navigation
from edge.geometry import SE2

POSE, IMAGE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Image"
GRID, COMPRESSED = "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/CompressedImage"


@pytest.fixture(scope="module")
def port():
    with router() as port, peers(port):
        yield port


@pytest.fixture
def session(port):
    with ours(port) as session:
        yield session


@pytest.fixture
def node(session):
    node = Ros2Node(session, 0, "edge_test")
    yield node
    node.close()


def dependencies(text: str) -> str:
    """Return a definition, followed by the definitions of its parts."""
    parts = ("unique_identifier_msgs/msg/UUID", "builtin_interfaces/msg/Time")
    return text + "".join(f"{'=' * 80}\nMSG: {p}\n{definition(p)}\n" for p in parts)


def listed(port: int) -> dict[str, list[str]]:
    """Return the output of `ros2 topic list -t`."""
    from zenoh_ros2_sdk.discovery import get_topic_names_and_types

    return dict(get_topic_names_and_types(0, router_port=port))


def looked(node: Ros2Node, what):
    """Return the graph's answer once the node has been discovered."""

    def ask():
        node._polled_s = 0.0
        node.update()
        return what()

    return eventually(ask)


def test_a_peer_hears_us_and_lists_our_topic(port, node):
    heard = []
    peer = subscriber(port, "/goal_pose", POSE, heard.append)
    mine = node.publisher("/goal_pose", POSE)
    assert looked(node, mine.has_subscribers)
    pose = messages.encode_pose_stamped(1_000_000_005, SE2(1.0, 2.0, 0.0))
    # The peer's token may arrive before its subscription: messages in between are lost.
    eventually(lambda: mine.put(pose) or heard)
    message = heard[0]
    assert (message.header.stamp.nanosec, message.pose.position.y) == (5, 2.0)
    assert listed(port)["/goal_pose"] == [POSE]
    peer.close()


def test_a_subscription_takes_the_type_that_its_peer_sends(port, node):
    subscription = node.subscription("/camera/image", (IMAGE, COMPRESSED), 4)
    assert subscription.type == IMAGE
    peer = publisher(port, "/camera/image", COMPRESSED)
    assert looked(node, lambda: subscription.type == COMPRESSED)
    message = STORE.types[COMPRESSED](header(3, "camera"), "jpeg", np.arange(4, dtype=np.uint8))
    peer.publish(header=message.header, format="jpeg", data=message.data)
    ((type_name, payload),) = eventually(subscription.take)
    assert (type_name, payload.to_bytes()) == (COMPRESSED, to_ros(message))
    peer.close()


def test_a_client_learns_an_unknown_type_from_its_server(session, node):
    name = "nav2_msgs/action/NavigateToPose_GetResult"
    client = node.client("/navigate_to_pose/_action/get_result", name, 1.0)
    assert (client.hash, client.has_server(), client.call(b"x").done) == (None, False, True)
    server = Endpoint("SS", "other", "/nav", client.topic, name, "RIHS01_ab")
    token = names.endpoint_token(0, 90, 91, server, names.RELIABLE)
    with session.liveliness().declare_token(token):
        assert looked(node, lambda: client.hash == "RIHS01_ab")
        assert not client.has_server(), "its token came before it"
        with session.declare_queryable(client.key(), zenoh.handlers.FifoChannel(1)):
            assert looked(node, client.has_server)
        assert looked(node, lambda: not client.has_server())


def test_a_service_of_a_peer_answers(port, node):
    name = "action_msgs/srv/CancelGoal"
    request = "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n"
    asked = []

    def answer(request):
        asked.append(bytes(request.goal_id.uuid))
        return store.types["action_msgs/srv/msg/CancelGoal_Response"](2)

    server = sdk.ROS2ServiceServer(
        "/nav/cancel", name, answer, dependencies(request), "int8 return_code", router_port=port,
        type_hash=names.hash_from_table(name),
    )  # fmt: skip
    store = server.session_mgr.store
    client = node.client("/nav/cancel", name, PATIENCE_S)
    assert looked(node, client.has_server)
    reply = client.call(navigation.encode_cancel(bytes(range(16))))
    payload = eventually(reply.poll)
    assert (payload[4], asked) == (2, [bytes(range(16))])
    assert (reply.done, reply.poll()) == (True, None)
    server.close()


@pytest.mark.parametrize("dialect", [names.BRIDGE, names.plain_dialect("edge/ros2/")])
def test_without_tokens_routing_shows_the_peers(port, session, dialect):
    node = Ros2Node(session, 0, "edge_test", dialect)
    mine, client = node.publisher("/goal_pose", POSE), node.client("/nav/cancel", POSE, 5.0)
    assert (mine.has_subscribers(), client.has_server()) == (False, False)
    with ours(port) as other:
        theirs = other.declare_subscriber(dialect.any_key(0, "/goal_pose"), lambda _: None)
        server = other.declare_queryable(client.key(), lambda _: None)
        eventually(lambda: mine.has_subscribers() and client.has_server())
        theirs.undeclare()
        server.undeclare()
        eventually(lambda: not (mine.has_subscribers() or client.has_server()))
    node.close()


@pytest.mark.parametrize("comes", ["at once", "one by one"])
def test_a_flood_of_tokens_is_bounded_and_logs_a_warning(session, port, monkeypatch, caplog, comes):
    monkeypatch.setattr(graph, "_MAX_TOKENS", 4)
    seen = graph.Graph(session, 0)
    with ours(port) as other:
        said = [Endpoint("MP", "z", "/n", f"/t{i}", POSE, "RIHS01_0") for i in range(9)]
        tokens = [names.endpoint_token(0, 0, i, e, names.RELIABLE) for i, e in enumerate(said)]
        open_tokens = []
        for token in tokens:
            open_tokens.append(other.liveliness().declare_token(token))
            if comes == "one by one":
                eventually(seen.update)
        eventually(lambda: (seen.update(), "more than 4 publishers" in caplog.text)[1])
        eventually(lambda: not seen.update())
        assert sum(bool(seen.endpoints("MP", e.topic)) for e in said) == 4
        del open_tokens
    seen.close()


def test_a_full_table_ignores_own_endpoints_without_a_warning(session, port, monkeypatch, caplog):
    monkeypatch.setattr(graph, "_MAX_TOKENS", 4)
    seen = graph.Graph(session, 0)
    with ours(port) as other:
        zids = ["z"] * 4 + [str(session.info.zid())]
        said = [Endpoint("MP", z, "/n", f"/t{i}", POSE, "RIHS01_0") for i, z in enumerate(zids)]
        open_tokens = []
        for i, endpoint in enumerate(said):
            token = names.endpoint_token(0, 0, i, endpoint, names.RELIABLE)
            open_tokens.append(other.liveliness().declare_token(token))
            eventually(seen.update)
        assert [bool(seen.endpoints("MP", e.topic)) for e in said] == [True] * 4 + [False]
        assert "more than 4 publishers" not in caplog.text
        del open_tokens
    seen.close()

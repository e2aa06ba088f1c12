"""Keys, tokens, attachments and hashes against `zenoh-ros2-sdk` and `rosbags`."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_messages import STORE

from edge.bus.ros2 import names
from edge.bus.ros2.names import Endpoint

MESSAGES = [name for name in names.HASHES if "/msg/" in name]


@pytest.mark.parametrize("name", MESSAGES)
def test_hashes_of_messages_are_those_of_their_definitions(name):
    assert names.hash_from_table(name) == STORE.hash_rihs01(name)


def test_a_type_with_disputed_hashes_has_none():
    assert names.hash_from_table("nav2_msgs/action/NavigateToPose_GetResult") is None


@pytest.mark.parametrize("name", names.HASHES)
def test_type_names_survive_a_round_trip(name):
    assert names.ros_name(names.dds_name(name)) == name
    key = names.data_key(3, "/a/b", name, "RIHS01_0")
    assert key.startswith("3/a/b/")
    assert names.type_of_key(key) == name


@pytest.mark.parametrize("kind", ["MP", "MS", "SS", "SC"])
def test_tokens_and_keys_are_those_of_an_independent_implementation(kind):
    keyexpr = pytest.importorskip("zenoh_ros2_sdk.keyexpr")
    entity = pytest.importorskip("zenoh_ros2_sdk.entity")
    node = entity.NodeEntity(domain_id=7, session_id="ab12", node_id=3, node_name="edge")
    other = entity.EndpointEntity(
        node=node, entity_id=4, kind=entity.EntityKind(kind), name="/front/scan",
        dds_type_name="sensor_msgs::msg::dds_::LaserScan_", type_hash="RIHS01_00",
        qos=names.RELIABLE, gid=bytes(16),
    )  # fmt: skip
    endpoint = Endpoint(
        kind, "ab12", "/edge", "/front/scan", "sensor_msgs/msg/LaserScan", "RIHS01_00"
    )
    token = names.endpoint_token(7, 3, 4, endpoint, names.RELIABLE)
    assert token == keyexpr.endpoint_liveliness_keyexpr(other)
    assert names.parse_token(token) == endpoint
    assert names.node_token(7, "ab12", 3, "edge") == keyexpr.node_liveliness_keyexpr(node)
    key = names.data_key(7, endpoint.topic, endpoint.type, endpoint.hash)
    assert key == keyexpr.topic_keyexpr(7, "/front/scan", other.dds_type_name, "RIHS01_00")


@pytest.mark.parametrize(
    ("via", "key", "wild"),
    [
        ("rmw_zenoh", "4/a/b/p::msg::dds_::T_/H", "4/a/b/*/*"),
        ("bridge", "a/b", "a/b"),
        ("adapter", "robots/1/ros2/a/b", "robots/1/ros2/a/b"),
    ],
)
def test_each_transport_has_its_keys(via, key, wild):
    dialect = names.dialect_of(via, "robots/1")
    assert dialect.data_key(4, "/a/b", "p/msg/T", "H") == key
    assert dialect.any_key(4, "/a/b") == wild
    assert dialect.has_tokens == (via == "rmw_zenoh")


def test_an_attachment_is_read_by_an_independent_implementation():
    sdk = pytest.importorskip("zenoh_ros2_sdk.attachment")
    gid = bytes(range(16))
    read = sdk.Attachment.from_bytes(names.attachment(5, 123, gid))
    assert (read.sequence_id, read.timestamp_ns, read.gid) == (5, 123, gid)


@pytest.mark.parametrize("qos", [names.RELIABLE, names.BEST_EFFORT, names.LATCHED])
def test_quality_of_service_is_read_by_an_independent_implementation(qos):
    sdk = pytest.importorskip("zenoh_ros2_sdk.qos")
    profile = sdk.QosProfile.decode(qos)
    assert (profile.reliability == sdk.QosReliability.RELIABLE) == (qos != names.BEST_EFFORT)
    latched = profile.durability == sdk.QosDurability.TRANSIENT_LOCAL
    assert latched == (qos == names.LATCHED)
    assert profile.history_depth == {names.RELIABLE: 10, names.BEST_EFFORT: 5}.get(qos, 1)


def test_a_token_of_a_node_in_a_namespace():
    token = (
        "@ros2_lv/0/z/1/2/MP/%/%ns%deep/cam/%ns%image/sensor_msgs::msg::dds_::Image_/H/::,1:,:,:,,"
    )
    endpoint = names.parse_token(token)
    assert (endpoint.node, endpoint.topic) == ("/ns/deep/cam", "/ns/image")


@given(st.text(alphabet="@/%:aMPros2_lvImage_", max_size=80))
def test_any_text_parses_to_a_typed_token_or_none(text):
    endpoint = names.parse_token(text)
    assert endpoint is None or endpoint.type


@pytest.mark.parametrize(
    "key",
    ["", "a", "@ros2_lv/0/z/1/1/NN/%/%/node", "@ros2_lv/0/z/1/2/XX/%/%/n/%t/a::b::dds_::C_/H/q",
     "@ros2_lv/0/z/1/2/MP/%/%/n/%t/no_type/H/q", "@ros2_lv/" + "x" * 2000],
)  # fmt: skip
def test_an_invalid_token_is_not_parsed(key):
    assert names.parse_token(key) is None

"""Naming schemes of a ROS 2 graph over Zenoh: rmw_zenoh and zenoh-bridge-ros2dds.

rmw_zenoh has keys with types, liveliness tokens, attachments and type hashes. An endpoint's token
announces it to other nodes; an attachment is data that Zenoh sends next to a message. The bridge
uses plain topic names. Sources: rmw_zenoh's docs/design.md, `liveliness_utils.cpp`,
`attachment_helpers.cpp`; zenoh-plugin-ros2dds' `route_publisher.rs`, `route_service_srv.rs`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

NO_HASH = "TypeHashNotSupported"
"""The text in place of a type hash in ROS 2 Humble, which has no type hashes."""

HASHES: dict[str, str] = {
    "geometry_msgs/msg/PoseStamped": (
        "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
    ),
    "sensor_msgs/msg/Image": ("d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"),
    "sensor_msgs/msg/CompressedImage": (
        "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
    ),
    "sensor_msgs/msg/PointCloud2": (
        "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
    ),
    "sensor_msgs/msg/LaserScan": (
        "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
    ),
    "nav_msgs/msg/Odometry": ("3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    "nav_msgs/msg/OccupancyGrid": (
        "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"
    ),
    "nav_msgs/msg/Path": ("1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"),
    "vision_msgs/msg/Detection2DArray": (
        "214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968"
    ),
    "vision_msgs/msg/Detection3DArray": (
        "793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018"
    ),
    "visualization_msgs/msg/MarkerArray": (
        "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"
    ),
    "tf2_msgs/msg/TFMessage": ("e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
    "action_msgs/msg/GoalStatusArray": (
        "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    ),
    "std_msgs/msg/Bool": ("feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9"),
    "std_msgs/msg/String": ("df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    "nav2_msgs/msg/CostmapFilterInfo": (
        "61ce391bf7690f76a331c01c9d5ce8ca71e6c99273b9fb75e48380f05c6dfdc8"
    ),
    "nav2_msgs/action/NavigateToPose_SendGoal": (
        "a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5"
    ),
    "action_msgs/srv/CancelGoal": (
        "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
    ),
}
"""Type hashes that are equal in all distributions since Iron. Others are read from tokens."""

Kind = Literal["NN", "MP", "MS", "SS", "SC"]
"""Node, publisher, subscription, service server, service client."""
KINDS: tuple[Kind, ...] = ("NN", "MP", "MS", "SS", "SC")

RELIABLE, BEST_EFFORT, LATCHED = "::,10:,:,:,,", "2::,5:,:,:,,", ":1:,1:,:,:,,"
"""Quality of service in a token: reliability:durability:history,depth:…

A latched topic is transient local: a late subscriber gets the last message.
"""

# Sequence number, time in ns, length of the endpoint's id (`gid`), the id.
_ATTACHMENT = struct.Struct("<qqB16s")
_MAX_TOKEN_CHARS = 1000


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher, subscription, service server or service client, as its token describes it.

    Attributes:
        kind: see `Kind`.
        zid: id of its Zenoh session.
        node: its node with the namespace: `/bt_navigator`.
        topic: topic or service, with a leading slash.
        type: ROS 2 name: `sensor_msgs/msg/Image`.
        hash: `RIHS01_` and 64 hexadecimal digits, or `NO_HASH`.
    """

    kind: Kind
    zid: str
    node: str
    topic: str
    type: str
    hash: str


def hash_from_table(type_name: str) -> str | None:
    """Return the hash of a type from the table; None if distributions differ."""
    digits = HASHES.get(type_name)
    return None if digits is None else f"RIHS01_{digits}"


def dds_name(type_name: str) -> str:
    """Return the DDS name of a ROS 2 type.

    >>> dds_name("sensor_msgs/msg/Image")
    'sensor_msgs::msg::dds_::Image_'
    """
    package, group, name = type_name.split("/")
    return f"{package}::{group}::dds_::{name}_"


def ros_name(dds: str) -> str:
    """Invert `dds_name`; return "" for any other text."""
    parts = dds.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return ""
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def data_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key to publish a topic or query a service."""
    return f"{domain}/{topic.lstrip('/')}/{dds_name(type_name)}/{type_hash}"


def any_key(domain: int, topic: str) -> str:
    """Return the key expression of a topic's messages of any type (see `type_of_key`)."""
    return f"{domain}/{topic.lstrip('/')}/*/*"


def type_of_key(key: str) -> str:
    """Return the message type from the key of a message; "" if the key has none."""
    parts = key.rsplit("/", 2)
    return ros_name(parts[1]) if len(parts) == 3 else ""


@dataclass(frozen=True, slots=True)
class Dialect:
    """The naming scheme of a graph.

    Attributes:
        data_key: see the function of this name.
        any_key: see the function of this name.
        has_tokens: True if endpoints and type hashes can be read from the graph. If False,
            messages and requests have no attachments either.
    """

    data_key: Callable[[int, str, str, str], str]
    any_key: Callable[[int, str], str]
    has_tokens: bool


RMW_ZENOH = Dialect(data_key, any_key, has_tokens=True)


def plain_dialect(prefix: str) -> Dialect:
    """Return a dialect of plain names behind a prefix; the other end handles the domain."""
    return Dialect(
        lambda domain, topic, type_name, type_hash: prefix + topic.lstrip("/"),
        lambda domain, topic: prefix + topic.lstrip("/"),
        has_tokens=False,
    )


BRIDGE = plain_dialect("")
"""Dialect of zenoh-bridge-ros2dds. Its own `namespace` setting, if any, precedes the names."""


def dialect_of(via: Literal["rmw_zenoh", "bridge", "adapter"], prefix: str) -> Dialect:
    """Return the dialect for `ros2.via`; the adapter's keys are below `zenoh.prefix`."""
    if via == "adapter":
        return plain_dialect(f"{prefix}/ros2/")
    return {"rmw_zenoh": RMW_ZENOH, "bridge": BRIDGE}[via]


def node_token(domain: int, zid: str, nid: int, node: str) -> str:
    """Return the token of a node in the root namespace.

    For the arguments see `endpoint_token`; `node` is the name of the node.
    """
    # `%` stands for `/`: the root enclave and the root namespace.
    return f"@ros2_lv/{domain}/{zid}/{nid}/{nid}/NN/%/%/{node}"


def endpoint_token(domain: int, nid: int, eid: int, endpoint: Endpoint, qos: str) -> str:
    """Return the token of an endpoint of a node in the root namespace.

    Args:
        domain: ROS 2 domain id.
        nid: number of the node in its session.
        eid: number of the endpoint in its session.
        endpoint: the endpoint.
        qos: `RELIABLE`, `BEST_EFFORT` or `LATCHED`.
    """
    node, topic = endpoint.node.lstrip("/"), endpoint.topic.replace("/", "%")
    return (
        f"@ros2_lv/{domain}/{endpoint.zid}/{nid}/{eid}/{endpoint.kind}/%/%/{node}/{topic}/"
        f"{dds_name(endpoint.type)}/{endpoint.hash}/{qos}"
    )


def all_tokens(domain: int) -> str:
    """Return the key expression of all tokens of a domain."""
    return f"@ros2_lv/{domain}/**"


def parse_token(key: str) -> Endpoint | None:
    """Parse an endpoint's token; None for a node's token and for anything else."""
    parts = key.split("/")  # as in `endpoint_token`; `_` are parts that are not needed
    if len(parts) != 13 or parts[0] != "@ros2_lv" or len(key) > _MAX_TOKEN_CHARS:
        return None
    _, _, zid, _, _, kind, _, namespace, node, topic, dds, type_hash, _ = parts
    type_name = ros_name(dds)
    if kind not in KINDS[1:] or not type_name:
        return None
    prefix = namespace.replace("%", "/").rstrip("/")
    topic = "/" + topic.replace("%", "/").lstrip("/")
    return Endpoint(kind, zid, f"{prefix}/{node}", topic, type_name, type_hash)


def attachment(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """Return the attachment of a message or request; `gid`: 16 bytes that name its endpoint."""
    return _ATTACHMENT.pack(sequence, time_ns, len(gid), gid)

"""ROS 2 messages by `rosbags`: those that it knows, and Nav2's action from its own texts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from edge.bus.wire.navigation import Result
from edge.geometry import SE2

_ACTION = {
    "NavigateToPose_Goal": "geometry_msgs/PoseStamped pose\nstring behavior_tree",
    "NavigateToPose_SendGoal_Request": (
        "unique_identifier_msgs/UUID goal_id\nnav2_msgs/NavigateToPose_Goal goal"
    ),
    "NavigateToPose_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp",
    "NavigateToPose_GetResult_Request": "unique_identifier_msgs/UUID goal_id",
    "HumbleResult": "int8 status\nuint8 structure_needs_at_least_one_member",
    "JazzyResult": "int8 status\nuint16 error_code",
    "KiltedResult": "int8 status\nuint16 error_code\nstring error_msg",
    "DockRobot_Goal": (
        "bool use_dock_id\nstring dock_id\ngeometry_msgs/PoseStamped dock_pose\nstring dock_type\n"
        "float32 max_staging_time\nbool navigate_to_staging_pose"
    ),
    "DockRobot_SendGoal_Request": (
        "unique_identifier_msgs/UUID goal_id\nnav2_msgs/DockRobot_Goal goal"
    ),
    "DockJazzyResult": "int8 status\nbool success\nuint16 error_code\nuint16 num_retries",
    "DockKiltedResult": (
        "int8 status\nbool success\nuint16 error_code\nuint16 num_retries\nstring error_msg"
    ),
    "UndockRobot_Goal": "string dock_type\nfloat32 max_undocking_time",
    "UndockRobot_SendGoal_Request": (
        "unique_identifier_msgs/UUID goal_id\nnav2_msgs/UndockRobot_Goal goal"
    ),
    "UndockJazzyResult": "int8 status\nbool success\nuint16 error_code",
    "UndockKiltedResult": "int8 status\nbool success\nuint16 error_code\nstring error_msg",
    "NavigateToPose_Feedback": (
        "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
        "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\n"
        "float32 distance_remaining"
    ),
    "NavigateToPose_FeedbackMessage": (
        "unique_identifier_msgs/UUID goal_id\nnav2_msgs/NavigateToPose_Feedback feedback"
    ),
}
_FILTER = {
    "CostmapFilterInfo": (
        "std_msgs/Header header\nuint8 type\nstring filter_mask_topic\nfloat32 base\n"
        "float32 multiplier"
    )
}
# From the branch `ros2`, as in Humble and later.
_VISION = {
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "Detection2D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nstring id"
    ),
    "Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
_CANCEL = {
    "CancelGoal_Request": "action_msgs/GoalInfo goal_info",
    "CancelGoal_Response": "int8 return_code\naction_msgs/GoalInfo[] goals_canceling",
}


def _store():
    store = get_typestore(Stores.ROS2_HUMBLE)
    packages = {
        "nav2_msgs": {**_ACTION, **_FILTER}, "action_msgs": _CANCEL, "vision_msgs": _VISION,
    }  # fmt: skip
    for package, texts in packages.items():
        for name, text in texts.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    return store


STORE = _store()


def from_ros(payload: bytes, name: str) -> Any:
    return STORE.deserialize_cdr(payload, name)


def to_ros(message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def header(stamp_ns: int, frame_id: str) -> Any:
    time = STORE.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return STORE.types["std_msgs/msg/Header"](time, frame_id)


def pose(at: SE2) -> Any:
    types, half = STORE.types, 0.5 * at.yaw_rad
    return types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](at.x_m, at.y_m, 0.0),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(half), math.cos(half)),
    )


def _farewell(name: str, n_fields: int) -> Callable[..., bytes]:
    kind = STORE.types[f"nav2_msgs/msg/{name}"]

    def encode(status: int, code: int, text: str) -> bytes:
        values = (0,) if name == "HumbleResult" else (code, text)[:n_fields]
        return to_ros(kind(status, *values))

    return encode


def _dock_farewell(name: str, n_fields: int, retries: tuple[int, ...] = (2,)):
    kind = STORE.types[f"nav2_msgs/msg/{name}"]

    def encode(status: int, code: int, text: str) -> bytes:
        return to_ros(kind(status, *(status == 4, code, *retries, text)[:n_fields]))

    return encode


FAREWELLS: dict[str, tuple[Callable[..., bytes], Result]] = {
    "humble": (_farewell("HumbleResult", 1), Result(6)),
    "jazzy": (_farewell("JazzyResult", 1), Result(6, 103)),
    "kilted": (_farewell("KiltedResult", 2), Result(6, 103, "no way")),
}
"""End of each distribution's action, as (encode(status, code, text), what is read of 6, 103 and
"no way")."""

DOCK_FAREWELLS: dict[str, tuple[Callable[..., bytes], Result]] = {
    "jazzy": (_dock_farewell("DockJazzyResult", 3), Result(6, 902)),
    "kilted": (_dock_farewell("DockKiltedResult", 4), Result(6, 902, "no dock")),
}
"""The same for docking, of 6, 902 and "no dock"."""

UNDOCK_FAREWELLS: dict[str, tuple[Callable[..., bytes], Result]] = {
    "jazzy": (_dock_farewell("UndockJazzyResult", 2, ()), Result(6, 902)),
    "kilted": (_dock_farewell("UndockKiltedResult", 3, ()), Result(6, 902, "no dock")),
}
"""The same for undocking."""

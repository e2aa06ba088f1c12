"""ROS 2 types of a robot's topics and action, by their names in `ros2.topics`."""

from __future__ import annotations

from edge.bus import topics
from edge.bus.wire.schemas import full_name

_SENSORS = (
    topics.RGB, topics.DEPTH, topics.CAMERA_INFO,
    topics.RGB2, topics.DEPTH2, topics.CAMERA_INFO2,
    topics.CLOUD, topics.SCAN, topics.ODOMETRY,
)  # fmt: skip
_TF = "tf2_msgs/msg/TFMessage"
_IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
COMPRESSED_ENDINGS = ("/compressed", "/compressedDepth")
"""Suffixes of compressed image topics of image_transport."""

SUBSCRIBED: dict[str, str] = {t.key: full_name(t.type) for t in _SENSORS} | {
    "tf": _TF,
    "tf_static": _TF,
}
"""Type of each topic that the robot publishes."""
PUBLISHED: dict[str, str] = {
    "goal": "geometry_msgs/msg/PoseStamped",
    "map": "nav_msgs/msg/OccupancyGrid",
    "path": "nav_msgs/msg/Path",
    "trajectory": "nav_msgs/msg/Path",
    "markers": "visualization_msgs/msg/MarkerArray",
    "detections": "vision_msgs/msg/Detection2DArray",
    "objects": "vision_msgs/msg/Detection3DArray",
    "keepout_mask": "nav_msgs/msg/OccupancyGrid",
    "keepout_info": "nav2_msgs/msg/CostmapFilterInfo",
    "answer": "std_msgs/msg/String",
}
"""Type of each topic that this service publishes."""
LATCHED = frozenset({"tf_static", "map", "trajectory", "keepout_mask", "keepout_info"})
"""Transient local topics: a late subscriber gets the last message."""
NAVIGATE_TO_POSE = "nav2_msgs/action/NavigateToPose"
DOCK_ROBOT, UNDOCK_ROBOT = "nav2_msgs/action/DockRobot", "nav2_msgs/action/UndockRobot"


def accepted_types(name: str, ros_name: str) -> tuple[str, ...]:
    """Return the accepted types of a topic of `SUBSCRIBED`, the most likely first.

    Args:
        name: key in `SUBSCRIBED`.
        ros_name: the topic; its suffix shows if images are compressed by image_transport.
    """
    if SUBSCRIBED[name] != _IMAGE:
        return (SUBSCRIBED[name],)
    is_compressed = ros_name.endswith(COMPRESSED_ENDINGS)
    return (COMPRESSED, _IMAGE) if is_compressed else (_IMAGE, COMPRESSED)

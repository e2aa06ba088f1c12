"""What a robot's topics and its action are in ROS 2, by the names that `ros2.topics` has."""

from __future__ import annotations

from edge.bus import topics
from edge.bus.wire.schemas import full_name

_SENSORS = (
    topics.RGB, topics.DEPTH, topics.CAMERA_INFO, topics.CLOUD, topics.SCAN, topics.ODOMETRY,
)  # fmt: skip
_TF = "tf2_msgs/msg/TFMessage"
_IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
COMPRESSED_ENDINGS = ("/compressed", "/compressedDepth")
"""Endings of a topic of pictures that image_transport compresses."""

HEARD: dict[str, str] = {t.key: full_name(t.type) for t in _SENSORS} | {"tf": _TF, "tf_static": _TF}
"""The type of each topic that the robot publishes."""
SAID: dict[str, str] = {
    "goal": "geometry_msgs/msg/PoseStamped",
    "map": "nav_msgs/msg/OccupancyGrid",
    "path": "nav_msgs/msg/Path",
    "trajectory": "nav_msgs/msg/Path",
    "markers": "visualization_msgs/msg/MarkerArray",
}
"""The type of each topic that we publish."""
LATCHED = frozenset({"tf_static", "map", "trajectory"})
"""Transient local: who comes late gets what was said before."""
NAVIGATE_TO_POSE = "nav2_msgs/action/NavigateToPose"


def heard_types(name: str, ros_name: str) -> tuple[str, ...]:
    """What is understood of a topic of `HEARD`, the likeliest first.

    Args:
        ros_name: those of image_transport say by their ending what they bring.
    """
    if HEARD[name] != _IMAGE:
        return (HEARD[name],)
    is_compressed = ros_name.endswith(COMPRESSED_ENDINGS)
    return (COMPRESSED, _IMAGE) if is_compressed else (_IMAGE, COMPRESSED)

"""Channels of a recording, with the schemas of Foxglove and ROS 2.

The sinks write them; the replay reads the journal and the channels with arrays.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import schemas


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of an MCAP file or of a Foxglove server."""

    topic: str
    encoding: Literal["cdr", "json"]
    schema: str
    schema_encoding: Literal["ros2msg", "jsonschema"]
    schema_text: str


def ros_channel(topic: str, type_name: str) -> Channel:
    """Return a channel of a ROS 2 message."""
    text = schemas.schema_text(type_name)
    return Channel(topic, "cdr", schemas.full_name(type_name), "ros2msg", text)


def json_channel(topic: str, name: str, schema: dict[str, Any] | None = None) -> Channel:
    """Return a channel of JSON objects; without a schema, of any objects."""
    text = json.dumps({"type": "object"} if schema is None else schema)
    return Channel(topic, "json", name, "jsonschema", text)


@cache
def topic_channel(topic: Topic) -> Channel:
    """Return the channel of a bus topic, with its own format."""
    if topic.type == "json":
        return json_channel(f"/{topic.key}", topic.key)
    return ros_channel(f"/{topic.key}", topic.type)


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


# JSON schemas of the messages.
_INTEGER, _NUMBER, _TEXT = {"type": "integer"}, {"type": "number"}, {"type": "string"}
_TIME = _object("time", sec=_INTEGER, nsec=_INTEGER)
_POINT = _object("foxglove.Point2", x=_NUMBER, y=_NUMBER)
_COLOUR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LOG = _object(
    "foxglove.Log", timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT, file=_TEXT,
    line=_INTEGER,
)  # fmt: skip
_OUTLINE = _object(
    "foxglove.PointsAnnotation", timestamp=_TIME, type=_INTEGER, points=_list(_POINT),
    outline_color=_COLOUR, outline_colors=_list(_COLOUR), fill_color=_COLOUR, thickness=_NUMBER,
)  # fmt: skip
_LABEL = _object(
    "foxglove.TextAnnotation", timestamp=_TIME, position=_POINT, text=_TEXT, font_size=_NUMBER,
    text_color=_COLOUR, background_color=_COLOUR,
)  # fmt: skip
_ANNOTATIONS = _object(
    "foxglove.ImageAnnotations", circles=_list({"type": "object"}), points=_list(_OUTLINE),
    texts=_list(_LABEL),
)  # fmt: skip
_JOURNAL = {
    **_object(
        "edge.Journal",
        entries=_list(_object("edge.Entry", n=_INTEGER, kind=_TEXT)),
        decisions=_object("edge.Decisions"),
    ),
    "required": ["entries"],
    "description": "docs/recording.md",
}

PICTURE = ros_channel("/camera/rgb/compressed", "sensor_msgs/CompressedImage")
DEPTH = topic_channel(topics.DEPTH)
CAMERA_INFO = topic_channel(topics.CAMERA_INFO)
PICTURE2 = ros_channel("/camera2/rgb/compressed", "sensor_msgs/CompressedImage")
DEPTH2 = topic_channel(topics.DEPTH2)
CAMERA_INFO2 = topic_channel(topics.CAMERA_INFO2)
CLOUD = topic_channel(topics.CLOUD)
ODOMETRY = topic_channel(topics.ODOMETRY)
TF = ros_channel("/tf", "tf2_msgs/TFMessage")
BOXES = json_channel("/detections", "foxglove.ImageAnnotations", _ANNOTATIONS)
BOXES2 = json_channel("/detections2", "foxglove.ImageAnnotations", _ANNOTATIONS)
EVENTS = json_channel("/events", "foxglove.Log", _LOG)
GOAL, MAP, STATUS, LATENCY, MISSION, TRAJECTORY, GOAL_STATUS = map(
    topic_channel,
    (
        topics.GOAL, topics.MAP, topics.STATUS, topics.LATENCY, topics.MISSION, topics.TRAJECTORY,
        topics.GOAL_STATUS,
    ),
)  # fmt: skip
PATH = ros_channel("/path", "nav_msgs/Path")
MARKERS = ros_channel("/markers", "visualization_msgs/MarkerArray")
SPANS = json_channel("/spans", "edge.Spans")
VISUAL = (
    PICTURE, DEPTH, CAMERA_INFO, CLOUD, ODOMETRY, TF, BOXES, EVENTS, GOAL, MAP, STATUS, LATENCY,
    MISSION, TRAJECTORY, GOAL_STATUS, PATH, MARKERS, SPANS,
    PICTURE2, DEPTH2, CAMERA_INFO2, BOXES2,
)  # fmt: skip
"""All channels but the journal, which is for the replay only."""

SECOND = {PICTURE: PICTURE2, DEPTH: DEPTH2, CAMERA_INFO: CAMERA_INFO2, BOXES: BOXES2}
"""Channel of the second camera, by that of the first."""

JOURNAL = json_channel("/journal", "edge.Journal", _JOURNAL)

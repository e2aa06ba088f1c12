"""Boxes and objects as vision_msgs, against `rosbags`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_messages import from_ros, to_ros

from edge.bus.wire.detections import Box3D, encode_boxes, encode_detections

KIND_2D, KIND_3D = "vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"
WORDS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
FLOATS = st.floats(-1e3, 1e3, width=32)
TRIPLES = st.tuples(FLOATS, FLOATS, FLOATS)


def test_nothing_found_is_a_message_too():
    two = from_ros(encode_detections(5, "camera", (), np.empty(0), np.empty((0, 4))), KIND_2D)
    three = from_ros(encode_boxes(5, "map", ()), KIND_3D)
    assert (two.header.frame_id, two.header.stamp.nanosec, two.detections) == ("camera", 5, [])
    assert (three.header.frame_id, three.detections) == ("map", [])


@given(st.lists(st.tuples(WORDS, st.floats(0, 1, width=32), *[FLOATS] * 4), max_size=4), WORDS)
def test_boxes_in_an_image(found, frame_id):
    names = [row[0] for row in found]
    score = np.array([row[1] for row in found], np.float32)
    xyxy_px = np.array([row[2:] for row in found], np.float32).reshape(-1, 4)
    payload = encode_detections(7, frame_id, names, score, xyxy_px)
    message = from_ros(payload, KIND_2D)
    assert to_ros(message) == payload
    for (name, p, x0, y0, x1, y1), box in zip(found, message.detections, strict=True):
        (result,) = box.results
        assert (result.hypothesis.class_id, result.hypothesis.score) == (name, p)
        assert (box.header.frame_id, box.id) == (frame_id, "")
        center = box.bbox.center.position
        assert (center.x, center.y) == pytest.approx((0.5 * (x0 + x1), 0.5 * (y0 + y1)))
        assert (box.bbox.size_x, box.bbox.size_y) == pytest.approx((x1 - x0, y1 - y0))


@given(st.lists(st.builds(Box3D, st.integers(0, 99), WORDS, FLOATS, TRIPLES, TRIPLES), max_size=4))
def test_objects_in_the_map(boxes):
    payload = encode_boxes(7, "map", boxes)
    message = from_ros(payload, KIND_3D)
    assert to_ros(message) == payload
    for sent, got in zip(boxes, message.detections, strict=True):
        (result,) = got.results
        center, size, at = got.bbox.center, got.bbox.size, result.pose.pose.position
        assert (result.hypothesis.class_id, result.hypothesis.score) == (sent.name, sent.score)
        assert (center.position.x, center.position.y, center.position.z) == sent.center_m
        assert (at.x, at.y, at.z) == sent.center_m
        assert (size.x, size.y, size.z) == sent.size_m
        assert (got.id, center.orientation.w) == (str(sent.id), 1.0)

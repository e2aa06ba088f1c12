"""The definitions that recordings carry are those of ROS 2."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from edge.bus import topics
from edge.bus.wire import schemas

STORE = get_typestore(Stores.ROS2_HUMBLE)
USED = sorted({topic.type for topic in topics.ALL} - {"json"})


@pytest.mark.parametrize("name", USED)
def test_our_schemas_have_the_same_fields_as_ros(name):
    parsed = get_types_from_msg(schemas.schema_text(name), schemas.full_name(name))
    assert schemas.full_name(name) in parsed
    for message, (_, fields) in parsed.items():
        assert fields == STORE.fielddefs[message][1], message

"""Markers of goals, paths and objects for RViz and Foxglove."""

from __future__ import annotations

import numpy as np
import pytest
from results import result
from rooms import KITCHEN

from edge.bus.wire import markers
from edge.geometry import SE2
from edge.memory import KnownObject, Place, RoomName, Site, Zone
from edge.sinks.drawings import drawing_of, markers_of
from edge.types import Instance

CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 2.0))
MUG = KnownObject(1, "mug", (1.0, 2.0, 0.5), 0.6, 3, 4.0)
CUP = Instance(
    2, "mug", np.zeros(3, np.float32), np.zeros((1, 3), np.float32), 0.5, 3, 0, 0, "seen"
)


@pytest.mark.parametrize(
    ("fields", "drawn"),
    [
        ({}, []),
        (
            {"site": Site((Place("dock", SE2(1.0, 2.0, 0.5)),))},
            [("places", markers.ARROW, ""), ("place names", markers.TEXT, "dock")],
        ),
        (
            {"site": Site((Zone("stairs", "keep_out", CORNERS),))},
            [("zones", markers.LINE_STRIP, ""), ("zone names", markers.TEXT, "stairs")],
        ),
        (
            {"rooms": (KITCHEN,), "site": Site((RoomName("kitchen", (1.0, 1.0)),))},
            [("rooms", markers.LINE_STRIP, ""), ("room names", markers.TEXT, "kitchen")],
        ),
        (
            {"objects": lambda: [MUG]},
            [("objects", markers.SPHERE_LIST, ""), ("object names", markers.TEXT, "mug")],
        ),
        (
            {"objects": lambda: [MUG], "instances": lambda: [CUP]},
            [("things", markers.CUBE, ""), ("names", markers.TEXT, "mug 0.50")],
        ),
    ],
)
def test_each_part_has_its_markers(fields, drawn):
    found = markers_of(drawing_of(result(**fields)))
    assert [(one.group, one.kind, one.text) for one in found] == drawn
    assert len({(one.group, one.id) for one in found}) == len(found)


def test_a_zone_outline_is_closed_and_coloured_by_kind():
    zones = (Zone("pit", "keep_out", CORNERS), Zone("flat", "stay_inside", CORNERS))
    out, _, inside, _ = markers_of(drawing_of(result(site=Site(zones))))
    assert out.points_m[:, :2].tolist() == [list(corner) for corner in (*CORNERS, CORNERS[0])]
    assert out.colour != inside.colour

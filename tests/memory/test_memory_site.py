"""Places, zones and room names: GeoJSON in and out, files, names."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from patience import eventually
from rooms import KITCHEN

from edge.geometry import SE2
from edge.memory import (
    KnownObject,
    Place,
    RoomName,
    Site,
    SiteError,
    SiteFile,
    Zone,
    item_of,
    memory_geojson,
    read_site,
    site_of,
    without_mapped,
    write_site,
)

DOCK = Place("dock", SE2(1.0, -2.0, math.pi / 2))
STAIRS = Zone("stairs", "keep_out", ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)))
OFFICE = RoomName("office", (3.0, 4.0))
NAME, KIND = "here: features.0.properties.name", "here: features.0.properties.kind"
AT = "here: features.0.geometry"
ALL = Site((DOCK, STAIRS, OFFICE))
TRIANGLE = [[[0, 0], [1, 0], [0, 1]]]


def feature(kind="place", name="dock", shape="Point", coordinates=(1.0, 2.0), **properties):
    return {
        "type": "Feature",
        "properties": {"kind": kind, "name": name, **properties},
        "geometry": {"type": shape, "coordinates": coordinates},
    }


def collection(*features):
    return {"type": "FeatureCollection", "features": list(features)}


def test_an_empty_site(tmp_path):
    assert read_site(tmp_path / "none.geojson") == Site() == site_of(collection())
    assert Site().geojson() == collection()
    assert Site().place("dock") is None
    assert Site().polygons_m("keep_out") == []


def test_all_kinds_survive_a_round_trip_through_a_file(tmp_path):
    path = tmp_path / "folder" / "site.geojson"
    write_site(path, ALL)
    assert read_site(path) == ALL
    assert json.loads(path.read_text())["type"] == "FeatureCollection"


coordinate = st.floats(-1000, 1000).map(lambda v: round(v, 3))


@given(
    x=coordinate, y=coordinate, deg=st.integers(-180, 180),
    name=st.from_regex(r"[b-z][a-z0-9]{0,20}( [a-z0-9]{1,9}){0,2}", fullmatch=True),
)  # fmt: skip
def test_a_place_survives_a_round_trip(x, y, deg, name):
    place = item_of(feature(name=name, coordinates=[x, y], heading_deg=deg))
    assert item_of(place.feature()) == place
    assert (place.pose.x_m, place.pose.y_m) == (x, y)
    assert place.pose.yaw_rad == pytest.approx(math.radians(deg))


@pytest.mark.parametrize("name", ["dock", "The Dock", " the  dock ", "my dock"])
def test_a_place_is_found_by_its_name(name):
    assert ALL.place(name) == DOCK


@pytest.mark.parametrize("heading_deg", [None, "north", 1e9])
def test_only_a_place_has_a_heading(tmp_path, heading_deg):
    data = collection(
        feature("room", "office", heading_deg=heading_deg),
        feature("keep_out", "stairs", "Polygon", TRIANGLE, heading_deg=heading_deg),
    )
    path = tmp_path / "site.geojson"
    path.write_text(json.dumps(data))
    assert [item.name for item in SiteFile(path).site.items] == ["office", "stairs"]


def test_the_error_of_one_feature_has_no_number():
    with pytest.raises(SiteError, match=r"^feature: keep_out dock: needs a Polygon, has a Point$"):
        item_of(feature("keep_out"))


def test_an_item_replaces_the_one_of_its_name():
    there = Place("dock", SE2(5.0, 5.0, 0.0))
    assert ALL.with_item(there).place("dock") == there
    assert len(ALL.with_item(there).items) == 3
    assert ALL.without("The Dock").places == ()


@pytest.mark.parametrize(
    ("before", "new"),
    [
        (Zone("stairs", "keep_out", ((0, 0), (1, 0), (1, 1))), Place("The stairs", SE2(0, 0, 0))),
        (Place("stairs", SE2(0, 0, 0)), Zone("stairs", "keep_out", ((0, 0), (1, 0), (1, 1)))),
    ],
)
def test_a_place_does_not_replace_a_zone_nor_a_zone_a_place(before, new):
    with pytest.raises(SiteError, match=r"is the name of a (zone|place or room) already"):
        Site((before,)).with_item(new)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "here: Input should be a valid dictionary or instance of _Collection"),
        (collection(feature(name="")), NAME + ": expected letters"),
        (collection(feature(name="a\x1b[31m")), NAME + ": expected letters"),
        (collection(feature(name="x" * 61)), NAME + ": String should"),
        (collection(feature(coordinates=[math.nan, 0])), AT + ".coordinates.0:"),
        (collection(feature(coordinates=[1e9, 0])), AT + ".coordinates.0:"),
        (collection(feature(coordinates=[1])), AT + ".coordinates:"),
        (collection(feature(), feature("keep_out", name="z")),
         "here: features.1: keep_out z: needs a Polygon, has a Point"),
        (collection(feature(shape="Polygon", coordinates=TRIANGLE)),
         "here: features.0: place dock: needs a Point, has a Polygon"),
        (collection(feature("room", shape="Polygon", coordinates=TRIANGLE)),
         "here: features.0: room dock: needs a Point, has a Polygon"),
        (collection(feature(shape="LineString")),
         AT + ".type: must be Point or Polygon, got 'LineString'"),
        (collection({**feature(), "geometry": {}}),
         AT + ".type: must be Point or Polygon, got none"),
        (collection(feature(heading_deg=None)), "here: features.0.properties.heading_deg: Input"),
        (collection(feature("stairs")), KIND + ": Input should be 'place', 'room'"),
        (collection(feature("keep_out", shape="Polygon", coordinates=[[[0, 0], [1, 0]]])),
         AT + ".coordinates.0:"),
        (collection(feature("keep_out", shape="Polygon", coordinates=[[[0, 0], [1, 0], [0, 0]]])),
         "here: features.0: zone dock: give at least three different corners"),
        (collection(feature(), feature(name="The dock")), "two features have the name 'dock'"),
    ],
)  # fmt: skip
def test_an_invalid_site_is_refused_in_one_line(data, message):
    with pytest.raises(SiteError) as error:
        site_of(data, "here")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[" * 100_000, b"\xff\xfe", b'{"type": 3}'])
def test_a_damaged_file_is_named(tmp_path, content):
    path = tmp_path / "site.geojson"
    path.write_bytes(content)
    with pytest.raises(SiteError, match=r"site\.geojson: "):
        read_site(path)
    assert path.read_bytes() == content


def test_an_unknown_name_is_refused_with_the_known_names():
    with pytest.raises(SiteError, match=r"no place or zone 'door' .known: dock, stairs, office"):
        ALL.without("door")


def test_changes_are_saved_and_start_is_not(tmp_path):
    path = tmp_path / "site.geojson"
    file = SiteFile(path)
    file.start = Place("start", SE2(0.0, 0.0, 0.0))
    file.change(ALL)
    file.close()
    assert read_site(path) == ALL
    assert file.known.place("start") is file.start
    assert file.known is file.known
    assert SiteFile(path).site == ALL


def test_a_folder_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    problems: list[str] = []
    file = SiteFile(tmp_path / "other", problems.append)
    file.path = tmp_path / "file" / "site.geojson"
    file.change(ALL)
    eventually(lambda: problems)
    file.close()
    assert "site.geojson: not saved: " in problems[0]


def test_an_export_of_nothing_is_an_empty_collection():
    assert memory_geojson(Site().geojson(), []) == {"type": "FeatureCollection", "features": []}


def test_an_export_has_places_zones_rooms_and_objects():
    mug = KnownObject(7, "mug", (1.0, 2.0, 0.75), 0.625, 3, 4.0)
    outlineless = replace(KITCHEN, polygon_m=np.zeros((0, 2)))
    rooms = [room.to_json() for room in (KITCHEN, outlineless)]
    collection = memory_geojson(ALL.geojson(), [mug.to_json()], rooms)
    kitchen = collection["features"].pop()
    assert (kitchen["properties"]["kind"], kitchen["properties"]["kinds"]) == ("room", ["kitchen"])
    (ring,) = kitchen["geometry"]["coordinates"]
    assert ring == [*KITCHEN.polygon_m.tolist(), KITCHEN.polygon_m[0].tolist()]
    assert collection["features"][:-1] == ALL.geojson()["features"]
    assert collection["features"][-1] == {
        "type": "Feature",
        "properties": {
            "kind": "object", "name": "mug", "id": 7, "confidence": 0.625, "hits": 3, "age_s": 4.0,
            "known_s": 0.0, "came_from": None, "room": "",
        },
        "geometry": {"type": "Point", "coordinates": [1.0, 2.0, 0.75]},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("objects", "rooms"), [(0, []), (1, [KITCHEN, replace(KITCHEN, id=4)]), (5000, [KITCHEN])]
)
def test_every_export_can_be_imported(tmp_path, objects, rooms):
    """Objects and outlines of rooms are left out: the robot maps them itself."""
    path = tmp_path / "all.geojson"
    mugs = [KnownObject(i, "mug", (1.0, 2.0, 0.75), 0.625, 3, 4.0) for i in range(objects)]
    exported = memory_geojson(
        ALL.geojson(), [one.to_json() for one in mugs], [room.to_json() for room in rooms]
    )
    path.write_text(json.dumps(exported, indent=1))
    assert read_site(path, imported=True) == ALL == site_of(without_mapped(exported))
    if objects:
        with pytest.raises(SiteError, match="features"):
            read_site(path)


@pytest.mark.parametrize("data", [None, [], {"features": 3}, collection({"properties": 7}, 5)])
def test_invalid_collections_are_left_unchanged(data):
    assert without_mapped(data) == data

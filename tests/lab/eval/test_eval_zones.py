"""Keep-out zones on the way, and the counter of entries."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.errors import UserError
from edge.lab.eval.arms import make_arms
from edge.lab.eval.drive import run_episode
from edge.lab.eval.episodes import make_episode, plan, read, sensing_settings, write
from edge.lab.eval.zone_entries import ZoneEntryCounter, distance_m
from edge.lab.eval.zones import with_zones
from edge.memory import Site, Zone, site_of

SQUARE = np.array([(1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0)])
RADIUS_M = 0.2


def entries(*places, zone=SQUARE) -> int:
    counter = ZoneEntryCounter([zone], RADIUS_M)
    for place in places:
        counter.update(*place)
    return counter.entries


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ((), 0),
        (((0.0, 0.5),), 0),
        (((1.5, 0.5), (1.5, 0.6)), 0),  # a start inside is no entry
        (((0.0, 0.5), (0.79, 0.5)), 0),
        (((0.0, 0.5), (0.85, 0.5)), 1),  # its edge is inside
        (((0.0, 0.5), (3.0, 0.5)), 1),  # right through, between two looks
        (((0.0, 0.5), (0.85, 0.5), (0.0, 0.5), (0.85, 0.5)), 2),
        (((0.0, -0.3), (3.0, -0.3)), 0),
    ],
)
def test_an_entry_is_counted_at_the_edge_of_the_robot(places, expected):
    assert entries(*places) == expected


corners = st.lists(
    st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=3, max_size=7, unique=True
)


@given(corners, st.integers(-60, 60), st.integers(-60, 60))
def test_the_distance_is_that_of_opencv(polygon, x, y):
    points = np.array(polygon, np.float32)
    signed = cv2.pointPolygonTest(points.reshape(-1, 1, 2), (float(x), float(y)), True)
    (found,) = distance_m(points.astype(np.float64), np.array([(float(x), float(y))]))
    if signed >= 0 or not math.isclose(found, 0.0):  # on an edge, OpenCV and we may differ
        assert found == pytest.approx(max(0.0, -signed), abs=1e-3)


def test_no_episodes_get_no_zones(config):
    assert with_zones(config, [], 0) == []


def test_each_zone_lies_on_the_path_and_off_the_start(config, tmp_path):
    # A zone depends on the episode's id, and so on the folder: 40 of them leave detours and none.
    episodes = plan(config, [], ["bed", "sofa"], 20, 0, 2.0)
    zoned = with_zones(config, episodes, 0)
    assert zoned == with_zones(config, episodes, 0) != with_zones(config, episodes, 1)
    assert {episode.ways for episode in zoned} == {"detour", "closed"}
    for episode in zoned:
        (corners_m,) = site_of(episode.site).polygons_m("keep_out")
        assert distance_m(corners_m, np.array([episode.start[:2]]))[0] >= RADIUS_M
    write(tmp_path / "e.jsonl", zoned)
    assert read(tmp_path / "e.jsonl") == zoned


def test_a_zone_needs_a_target(config):
    episode = make_episode(
        config.sim.world.model_dump(mode="json"), "small", (1.0, 2.0, 0.0), 3.0,
        sensing_settings(config), instruction="go to the bed, then to the sofa",
    )  # fmt: skip
    with pytest.raises(UserError, match="--zones: possible only for episodes with one target"):
        with_zones(config, [episode], 0)


def zoned(config, *polygons):
    zones = [Zone(f"zone {k}", "keep_out", polygon) for k, polygon in enumerate(polygons)]
    return make_episode(
        config.sim.world.model_dump(), "small", (1.0, 1.0, 0.0), 5.0, sensing_settings(config),
        "bed", site=Site(tuple(zones)).geojson(), ways="closed",
    )  # fmt: skip


def test_a_robot_keeps_out_of_a_closed_door(config):
    episode = zoned(config, ((3.7, 1.0), (4.3, 1.0), (4.3, 3.0), (3.7, 3.0)))
    (arm,) = make_arms(config, {})
    outcome = run_episode(arm, episode)
    assert (outcome.success, outcome.zone_entries, outcome.ways) == (False, 0, "closed")
    assert outcome.path_m > 1.0  # it looked for another way

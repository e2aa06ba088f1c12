"""The prior in the background, from objects and from the map cut into rooms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import DetectorSim, MappingConfig
from edge.geometry import se3
from edge.loop.scoring.prior import LEAST, MOST, LocationPrior
from edge.mapping.grid import RollingMap
from edge.mapping.points import HEIGHT_CODES
from edge.mapping.regions import NO_REGIONS, RegionMap, survey_regions
from edge.perception.prior.table import load
from edge.perception.prior.words import make_words
from edge.perception.tracking.tracked_objects import TrackedObjects

TABLE = load()
WORDS = make_words(TABLE, DetectorSim())
BY = ("cooccurrence", "rooms", "both")


def walls(*ends: tuple[float, float, float, float]) -> RegionMap:
    """Walls seen from (x, y) to (x, y), by a robot at (0, 0), as the cut of its map."""
    grid, points = RollingMap(MappingConfig(extent_m=30.0)), []
    for x0, y0, x1, y1 in ends:
        for f in np.linspace(0, 1, 400):
            points += [
                (x0 + f * (x1 - x0), y0 + f * (y1 - y0), z) for z in np.linspace(0, 0.99, 12)
            ]
    cloud = np.array(points, np.float32).reshape(-1, 3) - np.float32([0, 0, 0.6])
    for _ in range(2):
        grid.update_cloud(cloud, np.eye(4), se3(z_m=0.6))
    return survey_regions(grid.layers, grid.window, int(0.85 * HEIGHT_CODES))


def seen(*objects: tuple[str, float, float], confidence: float = 0.5) -> TrackedObjects:
    s = TrackedObjects(32)
    for i, (word, x_m, y_m) in enumerate(objects):
        if word not in s.words:
            s.words.append(word)
        s.xyz_m[i], s.word[i], s.confidence[i] = (x_m, y_m, 0.5), s.words.index(word), confidence
    s.n = s.generation = len(objects)
    return s


def prior(by: str) -> LocationPrior:
    return LocationPrior(by, TABLE, WORDS)


def lifts(p: LocationPrior, target: str, *places: tuple[float, float]) -> list[float]:
    xy_m, out = np.array(places, np.float32).reshape(-1, 2), np.full(9, 7, np.float32)
    p.likelihood_ratio(target, xy_m, len(places), out)
    assert (out[len(places) :] == 7).all()
    return out[: len(places)].tolist()


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize(
    ("objects", "target"),
    [
        ([], "toilet"),
        ([("toilet paper", 1.0, 0.0)], "zeppelin"),
        ([("zeppelin", 1.0, 0.0)], "toilet"),
        ([("toilet paper", 20.0, 0.0)], "toilet"),
    ],
)
def test_no_opinion(by, objects, target):
    p = prior(by)
    assert lifts(p, target) == []
    assert lifts(p, target, (0, 0)) == [1]
    p.step(walls((2, -2, 2, 2)), seen(*objects))
    assert lifts(p, target, (0, 0), (1, 1)) == [1, 1]
    assert lifts(p, target) == []


def test_objects_near_by_change_the_prior():
    p, empty = prior("cooccurrence"), NO_REGIONS
    p.step(empty, seen(("toilet paper", 1, 0), ("bed", -6, 0)))
    by_sink, by_bed, far = lifts(p, "toilet", (0, 0), (-5, 0), (0, 9))
    assert by_bed < far == 1 < by_sink
    hint = seen(("toilet paper", 1, 0), ("bed", -6, 0), confidence=0.05)
    hint.generation += 1
    p.step(empty, hint)
    assert 1 < lifts(p, "toilet", (0, 0))[0] < by_sink


def test_not_through_walls():
    p, objects = prior("cooccurrence"), seen(("toilet paper", 1, 0))
    p.step(walls((2, -2, 2, 2)), objects)
    near, behind = lifts(p, "toilet", (0.5, 0.5), (2.6, 0.0))
    assert behind == 1 < near


def test_rooms_change_the_prior_inside_them():
    """Bathroom objects stand at one end of a room of 5 m × 6 m."""
    room = walls((-1, -3, 4, -3), (4, -3, 4, 3), (4, 3, -1, 3), (-1, 3, -1, -3))
    p = prior("rooms")
    p.step(room, seen(("toilet", 3.5, 2.5), ("sink", 3.5, -2.5)))
    inside, outside = lifts(p, "toilet paper", (-0.5, 0.0), (-8.0, 0.0))
    assert outside == 1 < inside
    assert lifts(p, "bed", (-0.5, 0.0))[0] < 1


@given(
    objects=st.lists(
        st.tuples(
            st.sampled_from((*TABLE.classes[:30], "zeppelin")),
            st.floats(-4, 4, width=32),
            st.floats(-4, 4, width=32),
        ),
        max_size=20,
    ),
    by=st.sampled_from(BY),
    target=st.sampled_from(TABLE.classes),
)
def test_never_out_of_bounds_and_in_any_order(objects, by, target):
    empty, places = NO_REGIONS, ((0, 0), (1, 2), (3, -3))
    found = []
    for order in (objects, objects[::-1]):
        p = prior(by)
        p.step(empty, seen(*order))
        found.append(lifts(p, target, *places))
    assert found[0] == pytest.approx(found[1], rel=1e-4)
    assert all(LEAST <= lift <= MOST for lift in found[0])


def test_changed_objects_update_the_prior():
    p, view = prior("both"), walls((2, -2, 2, 2))
    objects = seen(("toilet paper", 1, 0))
    p.step(view, objects)
    first = lifts(p, "toilet", (0.5, 0.5))
    assert first == lifts(p, "toilet", (0.5, 0.5))
    assert lifts(p, "toilet", (-5, 0.5)) != first
    objects.n, objects.generation = 0, objects.generation + 1
    p.step(view, objects)
    assert lifts(p, "toilet", (0.5, 0.5)) == [1]


@pytest.mark.parametrize("by", BY)
def test_its_layer_has_its_value_at_each_place(by):
    p = prior(by)
    assert p.layer("toilet")().cells.size == 0
    room = walls((-1, -3, 4, -3), (4, -3, 4, 3), (4, 3, -1, 3), (-1, 3, -1, -3))
    objects = seen(("toilet paper", 3.5, 2.5), ("sink", 3.5, -2.5), ("bed", 0.0, 2.5))
    p.step(room, objects)
    assert p.layer("zeppelin")().cells.size == 0
    grid = p.layer("toilet")()
    drawn = np.argwhere(grid.cells)
    assert len(drawn) > 50
    decoded = LEAST * (MOST / LEAST) ** ((grid.cells[grid.cells > 0] - 1.0) / 254)
    for (y, x), lift in list(zip(drawn, decoded, strict=True))[::7]:
        place = grid.to_metres(np.array([x + 0.5, y + 0.5]))
        assert lifts(p, "toilet", place) == [pytest.approx(lift, rel=0.01)]
    assert grid.cells.max() > 128


def test_a_layer_is_a_snapshot_of_its_time():
    """As another thread may call for it, while the loop goes on."""
    p, view = prior("both"), walls((2, -2, 2, 2))
    objects = seen(("toilet paper", 1, 0))
    p.step(view, objects)
    at = (0.5, 0.5)
    before, (looked_at, kept) = lifts(p, "toilet", at), (p._xy_m, p._ratios["toilet"])
    early, same = p.layer("toilet"), p.layer("toilet")
    assert early is same  # nothing has changed: it is drawn once
    objects.xyz_m[:], objects.confidence[:] = 99.0, 0.0
    objects.n, objects.generation = 0, objects.generation + 1
    drawn = early()
    assert drawn.cells.max() > 128
    assert p._xy_m is looked_at
    assert p._ratios["toilet"] is kept
    assert before == kept.tolist()
    assert not p.layer("toilet")().cells.size

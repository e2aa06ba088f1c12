"""Where targets may be and what searches are expected to take, on maps small enough to reckon."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_plan_twins import plain_tours

from edge.geometry import SE2, Grid
from edge.mission.planning import belief
from edge.mission.planning.belief import BEYOND_M2, SIGHT_M, START_M, Prospects

INF, EXPLORE_M = math.inf, 10.0
NOWHERE = Prospects(np.zeros((0, 2)), np.zeros(0), np.zeros((1, 0)))


def prospects(*xy_m: tuple[float, float], area_m2=20.0, lift=((1.0,),)) -> Prospects:
    n = len(xy_m)
    area_m2 = np.broadcast_to(np.array(area_m2, float), n).copy()
    return Prospects(np.array(xy_m, float), area_m2, np.array(lift) * np.ones(n))


def searches(distance_m, way_m, places, sought):
    distance_m, way_m = np.array(distance_m, float), np.array(way_m, float)
    return belief.expected_searches(distance_m, way_m, places, np.array(sought), EXPLORE_M)


@pytest.mark.parametrize(
    ("places", "way_m"),
    [(NOWHERE, np.zeros((2, 0))), (prospects((1, 1)), [[INF], [INF]])],
)
def test_without_a_frontier_a_search_takes_what_is_configured(places, way_m):
    found = searches([[INF], [INF]], way_m, places, [True])
    np.testing.assert_array_equal(found.distance_m, [[INF], [INF]])
    np.testing.assert_array_equal(found.search_m, np.full((2, 1, 1), EXPLORE_M))


def test_nothing_to_look_for():
    empty = NOWHERE._replace(lift=np.zeros((0, 0)))
    found = searches(np.zeros((1, 0)), np.zeros((1, 0)), empty, np.zeros(0, bool))
    assert found.distance_m.shape == (1, 0)
    assert found.search_m.shape == (1, 0, 0)


@pytest.mark.parametrize("lift", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("area_m2", [1.0, 20.0])
def test_behind_one_frontier_or_beyond_it(area_m2, lift):
    """Ten metres farther with the chance that the frontier shows it not."""
    place = prospects((4, 0), area_m2=area_m2, lift=[[lift]])
    found = searches([[INF], [INF]], [[INF], [4.0]], place, [True])
    beyond_m = EXPLORE_M * BEYOND_M2 / (area_m2 * lift + BEYOND_M2)
    assert found.search_m[1, 0, 0] == pytest.approx(4.0 + beyond_m)
    assert found.distance_m[1, 0] == pytest.approx(4.0 + beyond_m)
    assert found.distance_m[0, 0] == SIGHT_M


def test_two_frontiers_by_hand():
    """The nearer one first, on to the other; as likely behind either: 2 m, or 2 + 6 m."""
    found = searches([[INF], [INF]], [[INF] * 2, [2.0, 4.0]], prospects((2, 0), (-4, 0)), [True])
    beyond_m = EXPLORE_M * BEYOND_M2 / (40.0 + BEYOND_M2)
    assert found.search_m[1, 0, 0] == pytest.approx((2.0 + 8.0) / 2 + beyond_m)
    assert found.distance_m[1, 0] == pytest.approx((2.0 + 4.0) / 2 + beyond_m)


def test_a_likelier_and_nearer_area_makes_a_target_cheaper():
    """The first target is more likely near, the second far; both are seen on either search."""
    way_m, lift = [[INF] * 2, [INF] * 2, [2.0, 8.0]], [[3.0, 0.5], [0.5, 3.0]]
    places = prospects((2, 0), (-8, 0), lift=lift)
    near, far = 0, 1
    here = searches(np.full((3, 2), INF), way_m, places, [True, True]).search_m[2]
    assert here[near, near] < here[near, far]
    assert here[far, far] < here[near, far]
    assert here[near, near] < here[far, near]


def test_from_a_known_object_the_search_begins_there():
    """An object 6 m off, a metre from the second frontier."""
    way_m = [[7.0, 1.0], [INF] * 2, [2.0, 6.0]]
    places = prospects((2, 0), (6, 1), area_m2=[1.0, 20.0], lift=[[1.0], [1.0]])
    found = searches([[0, INF], [INF, INF], [6.0, INF]], way_m, places, [False, True])
    assert found.search_m[0, 1, 1] < found.search_m[2, 1, 1]
    assert found.distance_m[0, 1] == found.distance_m[1, 0] < found.distance_m[2, 1]
    assert found.distance_m[2, 0] == 6.0
    assert np.isfinite(found.distance_m).all()


def test_frontiers_are_no_nearer_to_each_other_than_ways_say():
    """Back to back at a wall: 1 m apart as the crow flies, 9 m by way of the door."""
    found = searches([[INF], [INF]], [[INF] * 2, [1.0, 10.0]], prospects((0, 1), (0, 2)), [True])
    beyond_m = EXPLORE_M * BEYOND_M2 / (40.0 + BEYOND_M2)
    assert found.search_m[1, 0, 0] == pytest.approx((1.0 + 10.0) / 2 + beyond_m)


@settings(max_examples=100)
@given(seed=st.integers(0, 10_000), k=st.integers(1, 4), n=st.integers(1, 12))
def test_tours_agree_with_the_plain_twin(seed, k, n):
    rng = np.random.default_rng(seed)
    way_m, between_m = rng.uniform(0, 20, (k + 1, n)), rng.uniform(0, 20, (n, n))
    worth = rng.choice([0.5, 1.0, 2.0], (k, n))  # with ties
    behind = rng.dirichlet(np.ones(n), k)
    out = np.empty((k + 1, k, k))
    belief.tours(way_m, between_m, worth, behind, out)
    np.testing.assert_allclose(out, plain_tours(way_m, between_m, worth, behind, START_M))


def test_the_largest_are_reckoned_with(monkeypatch):
    monkeypatch.setattr(belief, "MOST_PROSPECTS", 2)
    places = prospects((1, 0), (2, 0), (3, 0), area_m2=[5.0, 1.0, 7.0], lift=[[1.0, 2.0, 3.0]])
    kept = places.largest()
    assert kept.xy_m.tolist() == [[1, 0], [3, 0]]
    assert (kept.area_m2.tolist(), kept.lift.tolist()) == ([5.0, 7.0], [[1.0, 3.0]])


def test_a_survey_of_a_map_with_a_wall():
    """A frontier beyond the wall is as far as the way round it, from the robot and the object."""
    cells = np.zeros((60, 60), np.int8)
    cells[29:31, :50] = 100
    snapshot = Grid(cells, (0.0, 0.0), 0.1)
    places = prospects((1.0, 4.0), lift=[[1.0], [1.0]])
    known = [np.array([[1.0, 5.0]]), np.zeros((0, 2))]
    found = belief.survey(snapshot, SE2(1.0, 2.0, 0.0), known, places, EXPLORE_M)
    beyond_m = EXPLORE_M * BEYOND_M2 / (20.0 + BEYOND_M2)
    assert found.search_m[2, 1, 1] > 8.0 + beyond_m
    assert found.search_m[0, 1, 1] == pytest.approx(1.0 + beyond_m, abs=0.3)
    assert found.distance_m[2, 0] > 8.0
    assert found.distance_m[0, 0] == 0.0
    assert found.distance_m[0, 1] == pytest.approx(1.0 + beyond_m, abs=0.3)

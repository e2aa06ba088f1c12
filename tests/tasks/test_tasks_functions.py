"""Functions of a script: correct results, and one-line errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from task_scenes import RESOLUTION_M, ROAD, STREET, Thing, street

from edge.config import TrajectoryLimits
from edge.geometry import wrap_angle
from edge.tasks.functions import MOST_SHOWN, CallError, ScriptFunctions
from edge.tasks.scene.ground import ABOUT_M, ground_of
from edge.tasks.trajectory import TrajectoryError

LIMITS = TrajectoryLimits()
GROUND = ground_of(street(*STREET), LIMITS.clearance_m)
COORDINATE = st.floats(-15.0, 15.0)


@pytest.fixture
def functions():
    return ScriptFunctions(GROUND, LIMITS)


def test_a_scene_without_objects_lists_none():
    functions = ScriptFunctions(ground_of(street(), LIMITS.clearance_m), LIMITS)
    assert functions.det_object() == functions.det_object("car") == []
    assert functions.robot() == {"position": (0.0, 0.0), "heading_rad": 0.0}


@pytest.mark.parametrize(
    ("name", "ids"),
    [
        (None, [2, 4, 1, 3, 5]),
        ("car", [2, 4, 3]),
        ("the cars", [2, 4, 3]),
        ("automobile", [2, 4, 3]),
        ("elephant", []),
    ],
)
def test_objects_are_found_by_name_with_the_nearest_first(functions, name, ids):
    assert [obj["id"] for obj in functions.det_object(name)] == ids


def test_a_caption_is_cut_to_one_printable_line():
    obj = Thing("sign", 5.0, 0.0, caption="go\n\x1b[2Jon\u202e" + "!" * 1000)
    (sign,) = ScriptFunctions(ground_of(street(obj), 0.3), LIMITS).det_object()
    assert sign["caption"].isprintable()
    assert len(sign["caption"]) == 200


def test_a_planned_path_avoids_obstacles(functions):
    way = functions.a_star_plan((0.0, 0.0), (13.0, 0.0))
    assert (way[0], way[-1]) == ((0.0, 0.0), (13.0, 0.0))
    assert all(functions.is_free(at) for at in way)
    steps_m = np.hypot(*np.diff(np.array(way), axis=0).T)
    assert steps_m.max() <= LIMITS.max_jump_m
    functions.give_trajectory([way], [ROAD], 1.0)
    assert functions.trajectory.speed_mps == 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: f.det_object(3), "det_object: name: expected the name of an object, got int"),
        (lambda f: f.det_object("\x00"), "det_object: name: expected the name"),
        (lambda f: f.a_star_plan((0, 0), (8, 0)), r"the end \(8.00, 0.00\) cannot be reached"),
        (lambda f: f.a_star_plan((99, 0), (0, 0)), "no path from .*: start outside the map"),
        (lambda f: f.a_star_plan((0, 0), (1, 0), 1), "regions: expected a list of ids, got int"),
        (lambda f: f.a_star_plan(None, (1, 0)), r"start: expected a point \(x, y\), got None"),
        (lambda f: f.is_free((math.nan, 0)), "at: x: nan is not within"),
        (lambda f: f.region_at("here"), "at: expected a point"),
        (lambda f: f.nearest_reachable((0, 0), 9), "expected ids of regions .1, 2., got "),
        (lambda f: f.distance((0, 0), {}), "b: expected a point"),
        (lambda f: f.line((0, 0), (1e6, 0)), "line: a and b are more than "),
        (lambda f: f.offset(9, "left"), "id: expected the id of an object .1, 2, 3, 4, 5., got 9"),
        (lambda f: f.offset(1, "top"), "offset: side: expected behind, left, right, in front of"),
        (lambda f: f.offset(1, "left", -1), "distance_m: expected 0 or more, got -1"),
        (lambda f: f.offset(1, "left", 1e9), "distance_m: .* is not within -50 to 50"),
        (lambda f: f.arc(1, (0, 0), (1, 0), "behind"), "arc: side: expected left, right, got"),
        (lambda f: f.visual_3d([[]]), "segment 1 is empty"),
        (lambda f: f.give_trajectory([(9e9, 0)]), "point 1 of segment 1: x: 9e"),
        (lambda f: f.give_trajectory([(8, 0)]), "point 1 of segment 1, .*, is occupied"),
    ],
)  # fmt: skip
def test_calls_that_cannot_be_answered(functions, call, message):
    with pytest.raises(TrajectoryError, match=message) as raised:
        call(functions)
    assert "\n" not in str(raised.value)
    assert functions.trajectory is None


def test_one_trajectory_is_given(functions):
    functions.give_trajectory([(0, 0), (1, 0)])
    with pytest.raises(CallError, match="given already"):
        functions.give_trajectory([(0, 0)])
    assert functions.trajectory.points_m.tolist() == [[0, 0], [1, 0]]


def test_a_shown_trajectory_is_not_given(functions):
    for _ in range(MOST_SHOWN):
        functions.visual_3d([(500.0, 0.0), (8.0, 0.0)])
    with pytest.raises(CallError, match="10 trajectories are shown already; more"):
        functions.visual_3d([(0, 0)])
    assert functions.trajectory is None
    assert len(functions.shown_trajectories) == MOST_SHOWN


@pytest.mark.parametrize(
    ("side", "at"),
    [("left", (8, 2)), ("right", (8, -2)), ("in front of", (5, 0)), ("behind", (11, 0))],
)
def test_sides_are_those_that_the_robot_sees(functions, side, at):
    """A van of 4 m by 2 m, 8 m ahead."""
    assert functions.offset(1, side) == pytest.approx(at)


def test_sides_depend_on_the_viewing_position(functions):
    assert functions.offset(1, "left", 1.0, (20.0, 0.0)) == pytest.approx((8, -2))
    assert functions.offset(1, "left", 0.0, (8.0, -9.0)) == pytest.approx((6, 0))


@given(COORDINATE, COORDINATE, COORDINATE, COORDINATE, st.sampled_from(["left", "right"]))
def test_an_arc_passes_the_side_and_keeps_its_distance(x, y, ex, ey, side):
    functions = ScriptFunctions(GROUND, LIMITS)
    start, end, centre = (x, y), (ex, ey), (8.0, 0.0)
    assume(min(math.dist(start, centre), math.dist(end, centre)) > 0.1)
    arc = np.array(functions.arc(1, start, end, side, 1.0))
    gap = np.maximum(np.abs(arc - centre) - (2.0, 1.0), 0.0)
    assert np.hypot(*gap.T).min() >= 0.9  # chords of the curve
    angles = np.unwrap([functions.heading(centre, tuple(at)) for at in arc.tolist()])
    assert wrap_angle(angles[0] - functions.heading(centre, start)) == pytest.approx(0, abs=1e-6)
    off = wrap_angle(angles[-1] - functions.heading(centre, end))
    assert abs(off) == pytest.approx(0, abs=1e-6)
    turned = np.diff(angles) if side == "right" else -np.diff(angles)
    assert (turned > 0).all()
    assert turned.sum() <= 2 * math.pi + 1e-9


def test_geometry(functions):
    assert functions.distance((0, 0), (3, 4)) == 5.0
    assert functions.heading((0, 0), (0, 2)) == pytest.approx(math.pi / 2)
    assert functions.line((0, 0), (3, 0)) == [(0, 0), (1, 0), (2, 0), (3, 0)]
    assert functions.line((1, 1), (1, 1)) == [(1, 1), (1, 1)]


def test_an_arc_round_something_long_has_no_leap():
    scene = street(Thing("fence", 0.0, 8.0, (16.0, 0.4)))
    functions = ScriptFunctions(ground_of(scene, 0.3), LIMITS)
    arc = np.array(functions.arc(1, (0.0, 0.0), (0.0, 15.0), "left"))
    assert np.hypot(*np.diff(arc, axis=0).T).max() <= LIMITS.max_jump_m
    gap = np.maximum(np.abs(arc - (0.0, 8.0)) - (8.0, 0.2), 0.0)
    np.testing.assert_allclose(np.hypot(*gap.T), 1.0, atol=0.3)


def test_the_stopping_point_is_on_the_near_side(functions):
    """Stop at the near side of the van; a little farther away if that is on the path."""
    for start, side in (
        ((0.0, 0.0), (5.6, 0.0)),
        ((8.0, 9.0), (8.0, 1.4)),
        ((16.0, 0.0), (10.4, 0.0)),
    ):
        x, y = functions.stopping_point(1, start)
        assert math.dist((x, y), side) < 0.6
        assert functions.is_free((x, y))


@pytest.mark.parametrize("clearance_m", [0.2, 0.4, 0.9, 1.3])
def test_one_stops_little_farther_off_than_one_has_to(clearance_m):
    ground = ground_of(street(Thing("van", 8.0, 0.0, (4.0, 2.0))), clearance_m)
    x, y = ScriptFunctions(ground, LIMITS).stopping_point(1)
    assert y == pytest.approx(0.0, abs=0.11)
    assert clearance_m <= 6.0 - x <= clearance_m + RESOLUTION_M + ABOUT_M


def test_the_stop_for_a_distant_object_is_inside_the_map():
    scene = street(Thing("gate", 23.0, 0.0, (0.4, 3.0)))
    x, y = ScriptFunctions(ground_of(scene, 0.3), LIMITS).stopping_point(1)
    assert x > 19.0
    assert abs(y) < 1.8


def test_an_object_out_of_reach_has_no_stopping_point():
    far = street(Thing("gate", 18.0, 0.0, (0.4, 3.0)), walls=((12.0, 12.4, -20.0, 20.0),))
    functions = ScriptFunctions(ground_of(far, 0.3), LIMITS)
    with pytest.raises(CallError, match=r"^the robot gets no nearer to gate 1 than 6\.1 m$"):
        functions.stopping_point(1)

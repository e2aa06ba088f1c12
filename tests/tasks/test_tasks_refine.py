"""Refinement: collision-free, near the given segments, smooth; refused without a path."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import BODY, LIMITS, Box, fill, scene

from edge.geometry import SE2
from edge.tasks.legs import RefineError
from edge.tasks.refine import CONTROL_M, SPACING_M, RefinedTrajectory, refine, refine_again
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.value_map import PathMargins, closed_cells

HOUSE: Box = (-1.0, -1.0, 1.0, 1.0)
WALL: Box = (-0.2, -10.0, 0.2, 10.0)
TO_THE_EAST = [np.array([[7.0, 0.0]])]
SOUTH_ABOUT = [np.array([[-3.0, -4.0], [3.0, -4.0], [7.0, 0.0]])]


def refined(
    where: Scene, segments=TO_THE_EAST, drivable=(1,), body=BODY, **more
) -> RefinedTrajectory:
    return refine(where, segments, drivable, body, LIMITS, **more)


def is_free(
    where: Scene, trajectory: RefinedTrajectory, clearance_m: float = BODY.clearance_m
) -> bool:
    cells = np.floor(where.occupancy.to_cells(trajectory.poses[:, :2])).astype(int)
    return not closed_cells(where.occupancy, clearance_m)[cells[:, 1], cells[:, 0]].any()


def test_a_robot_at_its_goal_stays():
    where = scene(pose=SE2(7.0, 0.0, 1.0))
    got = refined(where)
    assert got.poses.tolist() == [[7.0, 0.0, 0.0, 1.0]]
    assert got.times_s.tolist() == got.speeds_mps.tolist() == [0.0]


def test_a_free_line_is_a_line():
    got = refined(scene())
    assert got.poses[0].tolist() == [-7.0, 0.0, 0.0, 0.0]
    assert got.poses[-1, :2].tolist() == [7.0, 0.0]
    assert np.abs(got.poses[:, 1]).max() < 1e-9
    assert got.control_m == CONTROL_M[0]
    assert got.notes == ()
    # 0.8 m/s2 to 1 m/s and back: 1.25 s and 0.625 m each.
    assert got.times_s[-1] == pytest.approx(12.75 + 2.5, rel=1e-3)


def test_the_given_segments_decide_between_two_paths():
    where = scene(HOUSE)
    got = refined(where, SOUTH_ABOUT)
    assert is_free(where, got)
    middle = got.poses[np.argmin(np.abs(got.poses[:, 0]))]
    assert middle[1] == pytest.approx(-4.0, abs=BODY.tube_m)


@pytest.mark.parametrize("unseen", [None, (-1.4, -10.0, -0.6, -1.0)])
def test_a_circle_is_driven_around(unseen):
    """A loop is not cut short although it ends at its start, nor turned back at a bridge."""
    angle = np.linspace(math.pi, -math.pi, 40)
    circle = 3.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    where = scene(HOUSE)
    if unseen:
        fill(where.occupancy, unseen, -1)
        fill(where.regions_grid, unseen, 0)
    got = refined(where, [circle, np.array([[-7.0, 3.0]])])
    bearing = np.unwrap(np.arctan2(got.poses[:, 1], got.poses[:, 0]))
    assert is_free(where, got)
    assert bearing.min() < math.pi - 2 * math.pi + 0.2
    assert bearing.max() < math.pi + 0.2
    assert got.legs[got.leg[-1]].ends_segment


def test_a_short_unseen_bridge_is_driven_with_a_note():
    where = scene()
    for grid, value in ((where.occupancy, -1), (where.regions_grid, 0)):
        fill(grid, (0.0, -10.0, 0.6, 10.0), value)
    assert "0.6 m of the path are over ground that was not seen" in refined(where).notes
    for grid, value in ((where.occupancy, -1), (where.regions_grid, 0)):
        fill(grid, (0.0, -10.0, 1.6, 10.0), value)
    with pytest.raises(RefineError, match="no place within"):
        refined(where)


def test_the_path_keeps_to_the_chosen_regions():
    """A corridor in the north; the straight line is on the lawn."""
    where = scene(road=(-9.0, -1.0, -6.0, 4.0))
    for box in ((-9.0, 3.0, 9.0, 5.0), (6.0, -1.0, 9.0, 4.0)):
        fill(where.regions_grid, box, 1)
    got = refined(where)
    assert got.notes == ()
    assert got.poses[:, 1].max() > 3.0
    assert refined(where, drivable=()).notes == ()
    off = refined(where, drivable=(2,))
    assert "14.0 m of the path are over ground that was not chosen" in off.notes


def test_unchosen_ground_is_crossed_as_a_last_resort():
    where = scene(road=(-9.0, -9.0, -2.0, 9.0))
    fill(where.regions_grid, (2.0, -9.0, 9.0, 9.0), 1)
    (note,) = (note for note in refined(where).notes if "not chosen" in note)
    assert float(note.split()[0]) == pytest.approx(4.0, abs=0.3)


def test_a_bend_that_is_shut_is_passed_by():
    """Its corner is within the house, too far in to be moved: only the ends count."""
    where = scene((-3.0, -3.0, 3.0, 3.0))
    got = refined(where, [np.array([[0.0, 0.0], [0.0, 7.0]])])
    assert is_free(where, got)
    assert got.poses[-1, :2].tolist() == [0.0, 7.0]


def test_a_robot_too_near_is_led_out_first():
    where = scene((-7.5, 0.3, -6.5, 1.0))
    got = refined(where)
    assert got.poses[0, :2].tolist() == [-7.0, 0.0]
    assert got.notes[0].startswith("the robot is too close to an obstacle: moves 0.")
    assert is_free(where, replace(got, poses=got.poses[1:]))


@pytest.mark.parametrize(
    ("where", "segments", "words"),
    [
        (scene(WALL), TO_THE_EAST, r"no path to \(7.0, 0.0\): no place within 1 m of it"),
        (scene((5.0, -2.0, 9.0, 2.0)), TO_THE_EAST, "no path to"),
        (scene(), [np.array([[70.0, 0.0]])], r"no path to \(70.0, 0.0\)"),
        (scene(pose=SE2(50.0, 0.0, 0.0)), TO_THE_EAST, r"the robot at \(50.0, 0.0\) is outside"),
        (scene((-9.0, -2.0, -5.0, 2.0)), TO_THE_EAST, r"the robot at \(-7.0, 0.0\) is shut in"),
        # Open ground is near, behind a wall of one cell: the other side has no room.
        (
            scene((-9, 0, 9, 0.1), (-9, -9, 9, -0.3), pose=SE2(-7.0, -0.01, 0.0)),
            TO_THE_EAST,
            "is shut in",
        ),
    ],
)
def test_a_missing_path_is_refused_in_one_line(where, segments, words):
    with pytest.raises(RefineError, match=words) as refusal:
        refined(where, segments)
    assert "\n" not in str(refusal.value)


def test_a_blocked_trajectory_is_planned_again():
    where = scene()
    first = refined(where, [np.array([[0.0, 0.0]]), np.array([[7.0, 0.0]])])
    robot = int(np.argmin(np.abs(first.poses[:, 0] + 3.0)))
    later = scene((2.0, -1.0, 4.0, 1.0), pose=SE2(*first.poses[robot, [0, 1, 3]]))
    assert not is_free(later, first)
    again = refine_again(later, first, robot, BODY, LIMITS)
    assert is_free(later, again)
    np.testing.assert_array_equal(again.poses[0, :2], first.poses[robot, :2])
    np.testing.assert_array_equal(again.poses[-1, :2], first.poses[-1, :2])
    # Past the first segment's end there is but the second.
    beyond = int(np.argmin(np.abs(first.poses[:, 0] - 1.0)))
    last = refine_again(replace(later, pose=SE2(1.0, 0.0, 0.0)), first, beyond, BODY, LIMITS)
    assert len(last.legs) == 1
    with pytest.raises(RefineError, match="no path to"):
        refine_again(scene((1.0, -10.0, 2.0, 10.0)), first, robot, BODY, LIMITS)


@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.sampled_from([0.0, 0.2, 0.4]))
def test_nothing_refined_collides(seed, count, clearance_m):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-8.0, 7.0, (count, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(0.3, 3.0, (count, 2))], axis=1)
    where = scene(*map(tuple, boxes.tolist()), pose=SE2(-9.0, -9.0, 0.0))
    segments = [rng.uniform(-9.0, 9.0, (rng.integers(1, 6), 2)) for _ in range(3)]
    try:
        got = refined(where, segments, body=PathMargins(clearance_m, 1.0))
    except RefineError:
        return
    assert is_free(where, got, clearance_m)
    legs = np.diff(got.poses[:, :2], axis=0)
    assert np.hypot(*legs.T).max() <= SPACING_M + 1e-9
    np.testing.assert_allclose(
        np.column_stack([np.cos(got.poses[:-1, 3]), np.sin(got.poses[:-1, 3])]),
        legs / np.hypot(*legs.T)[:, None],
        atol=1e-9,
    )
    assert (np.diff(got.times_s) > 0.0).all()
    assert (np.diff(got.leg) >= 0).all()
    for segment in segments:
        away = np.hypot(*(got.poses[:, :2] - segment[-1]).T)
        assert away.min() <= 1.0 + 2.0 * got.control_m

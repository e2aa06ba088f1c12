"""Driving a refined trajectory: the moving goal, obstacles, the message."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from results import observation
from ros_messages import from_ros
from small_scenes import BODY, LIMITS, scene

from edge.config import MappingConfig, TrajectoryLimits
from edge.geometry import SE2, se3
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.tasks.follow import blocked_ahead_m, goal_ahead, index_at_goal, path_message
from edge.tasks.refine import RefinedTrajectory, refine
from edge.tasks.scene.ground import ground_of
from edge.tasks.scene.map_scene import scene_of_map, uninflated
from edge.tasks.trajectory import CoarseTrajectory, TrajectoryError, check
from edge.trajectory.smoothing import resample


def line() -> RefinedTrajectory:
    """From (-7, 0) to (7, 0)."""
    return refine(scene(), [np.array([[7.0, 0.0]])], {1}, BODY, LIMITS)


@pytest.mark.parametrize(
    ("robot", "look_ahead_m", "since_m", "goal_x_m"),
    [
        (SE2(-7.0, 0.0, 0.0), 1.5, -7.0, -5.5),
        # Aside of the path, and before its begin.
        (SE2(-5.0, 0.7, 2.0), 1.5, -7.0, -3.5),
        (SE2(-9.0, 0.0, 0.0), 1.5, -7.0, -5.5),
        # Its last pose, however far one looks.
        (SE2(6.5, 0.0, 0.0), 1.5, 5.0, 7.0),
        (SE2(7.0, 0.0, 0.0), 1.5, 7.0, 7.0),
        # The robot is not looked for behind where it was, nor farther ahead than it can have come.
        (SE2(-5.0, 0.0, 0.0), 1.0, -2.0, -1.0),
        (SE2(6.0, 0.0, 0.0), 1.0, -7.0, -3.0),
    ],
)
def test_the_goal_is_ahead_of_the_robot(robot, look_ahead_m, since_m, goal_x_m):
    trajectory = line()
    since = int(np.argmin(np.abs(trajectory.poses[:, 0] - since_m)))
    goal, index = goal_ahead(trajectory, robot, look_ahead_m, since)
    assert goal.x_m == pytest.approx(goal_x_m, abs=0.2)
    assert (goal.y_m, goal.yaw_rad) == (pytest.approx(0.0), pytest.approx(0.0))
    assert index >= since


def bend(corner_m: tuple[float, float]) -> RefinedTrajectory:
    """From (-7, 0) by a corner to (-7, 3)."""
    points = np.array([(-7.0, 0.0), corner_m, (-7.0, 3.0)])
    refined = line()
    path_m = resample(points, 0.1)
    return replace(refined, poses=np.pad(path_m, ((0, 0), (0, 2))))


@pytest.mark.parametrize("corner_m", [(-6.0, 1.5), (-5.0, 0.0), (-4.0, 1.5)])
def test_the_straight_line_to_the_goal_cuts_no_bend(corner_m):
    trajectory = bend(corner_m)
    path_m = trajectory.poses[:, :2]
    robot, index, seen = SE2(-7.0, 0.0, 0.0), 0, []
    for _ in range(200):
        goal, index = goal_ahead(trajectory, robot, 1.5, index)
        way_m = np.linspace((robot.x_m, robot.y_m), (goal.x_m, goal.y_m), 20)
        off_m = np.hypot(*(way_m[:, None] - path_m).transpose(2, 0, 1)).min(axis=1)
        seen.append(off_m.max())
        robot = SE2(*way_m[2], 0.0)
    assert max(seen) < 0.45
    assert (robot.x_m, robot.y_m) == (pytest.approx(-7.0, abs=0.1), pytest.approx(3.0, abs=0.1))


ARC = [(-5 + 2 * math.cos(a), 2 * math.sin(a)) for a in np.linspace(-math.pi, math.pi, 40)]


@pytest.mark.parametrize("step_m", [0.1, 0.3])
@pytest.mark.parametrize(
    "segments",
    [
        [[(-2.0, 0.0)], [(-6.0, 0.5)]],
        [[(0.0, 0.0)], [(-6.0, 0.0)]],
        [[(-2.0, 0.0), (-6.0, 0.3)]],
        [[(0.0, 0.0)], [(-3.0, 0.4)], [(0.0, 1.0)], [(-5.0, 1.4)]],
        [[(-6.9, 0.0)], [(-6.8, 0.0)], [(-7.0, 0.0)], [(0.0, 0.0)]],
        [ARC, [(5.0, 5.0)]],
    ],
)
def test_no_legs_end_is_passed_before_the_robot_was_there(segments, step_m):
    refined = refine(scene(), [np.array(s) for s in segments], {1}, BODY, LIMITS)
    robot, index, least_m = SE2(-7.0, 0.0, 0.0), 0, np.full(len(refined.legs), np.inf)
    ends_m = [
        leg.points_m[-1, :2] if leg.ends_segment else refined.poses[refined.leg <= k][-1, :2]
        for k, leg in enumerate(refined.legs)
    ]
    for _ in range(600):
        at_m = (robot.x_m, robot.y_m)
        least_m = np.minimum(least_m, [math.dist(at_m, end_m) for end_m in ends_m])
        goal, since = goal_ahead(refined, robot, 1.5, index)
        assert since >= index
        index = since
        assert (least_m[: refined.leg[index]] <= 0.2).all()
        away_m = robot.distance_to(goal.x_m, goal.y_m)
        share = min(step_m / max(away_m, 1e-9), 1.0)
        x_m, y_m = robot.x_m, robot.y_m
        robot = SE2(x_m + share * (goal.x_m - x_m), y_m + share * (goal.y_m - y_m), 0.0)
    assert robot.distance_to(*segments[-1][-1]) < 0.05


def test_a_reached_goal_ends_only_its_own_leg():
    refined = refine(scene(), [np.array([[-2.0, 0.0]]), np.array([[-6.0, 0.5]])], {1}, BODY, LIMITS)
    tip = int(np.argmax(refined.poses[:, 0]))
    for at, since, index in ((tip, 3, tip + 1), (tip - 4, 3, tip - 4), (tip + 9, 3, tip)):
        goal = SE2(*refined.poses[at, [0, 1, 3]])
        assert index_at_goal(refined, goal, since) == index
    last = len(refined.poses) - 1
    assert index_at_goal(refined, SE2(*refined.poses[-1, [0, 1, 3]]), last - 2) == last
    goal, index = goal_ahead(refined, SE2(-2.0, 0.0, 0.0), 1.5, tip - 9, last_index=tip)
    assert ((goal.x_m, goal.y_m), index) == (pytest.approx(refined.poses[tip, :2].tolist()), tip)


def test_a_single_pose_is_its_own_goal():
    trajectory = refine(scene(pose=SE2(7.0, 0.0, 1.0)), [np.array([[7.0, 0.0]])], {1}, BODY, LIMITS)
    assert goal_ahead(trajectory, SE2(7.0, 0.0, 1.0), 1.0) == (SE2(7.0, 0.0, 1.0), 0)


def mapped(*boxes: tuple[float, float, float, float]) -> MapView:
    """Boxes (x0, y0, x1, y1), seen by a LiDAR at the origin, in a map with a radius of 9 m."""
    grid = RollingMap(
        MappingConfig(input="cloud", resolution_m=0.1, extent_m=19.2, inflation_m=0.4)
    )
    for x0, y0, x1, y1 in boxes:
        x, y = np.meshgrid(np.arange(x0, x1, 0.05), np.arange(y0, y1, 0.05))
        cloud = np.stack((x, y, np.full_like(x, 0.5)), axis=-1).reshape(-1, 3).astype(np.float32)
        grid.update_cloud(cloud, np.eye(4), np.eye(4))
    return MapView(grid)


@pytest.mark.parametrize(
    ("boxes", "from_x_m", "expected_m"),
    [
        ([], -7.0, None),
        ([(2.0, -0.5, 3.0, 0.5)], -4.0, 5.6),
        ([(2.0, -0.5, 3.0, 0.5)], 0.0, 1.6),
        # Beyond the checked range; next to the path, near and far; behind the robot.
        ([(4.0, -0.5, 5.0, 0.5)], -7.0, None),
        ([(2.0, 0.2, 3.0, 0.5)], 0.0, 1.6),
        ([(2.0, 0.6, 3.0, 0.9)], 0.0, None),
        ([(2.0, -0.5, 3.0, 0.5)], 4.0, None),
        # The path away from a near obstacle is not blocked.
        ([(-0.3, 0.3, 0.2, 0.6)], 0.0, None),
        ([(-0.3, 0.3, 0.2, 0.6), (3.0, -0.5, 4.0, 0.5)], 0.0, 2.6),
    ],
)
def test_obstacles_on_the_path_are_found(boxes, from_x_m, expected_m):
    trajectory = line()
    index = int(np.argmin(np.abs(trajectory.poses[:, 0] - from_x_m)))
    got = blocked_ahead_m(trajectory, mapped(*boxes), index)
    assert got == (None if expected_m is None else pytest.approx(expected_m, abs=0.2))


def on_floor() -> RollingMap:
    """Free floor of 16 m by 16 m, with the robot at (-7, 0)."""
    grid = RollingMap(
        MappingConfig(input="cloud", resolution_m=0.1, range_m=17.0, extent_m=40.0, inflation_m=0.4)
    )
    x, y = np.meshgrid(np.arange(-8.0, 8.0, 0.1), np.arange(-8.0, 8.0, 0.1))
    cloud = np.stack((x + 7.0, y, np.full_like(x, -1.0)), axis=-1).reshape(-1, 3)
    for _ in range(3):
        grid.update_cloud(cloud.astype(np.float32), se3(x_m=-7.0), se3(z_m=1.0))
    return grid


@pytest.mark.parametrize("seed", range(8))
def test_a_refined_path_leads_around_zones_and_the_map_agrees(seed):
    rng, grid, changed = np.random.default_rng(seed), on_floor(), np.zeros(4, np.int64)
    zones = [rng.uniform((-4.0, -2.0), (4.0, 2.0)) + rng.uniform(-1.5, 1.5, (3, 2))]
    zones += [np.array([(-1.0, -0.5), (0.0, -0.7), (0.3, 0.9)])]
    grid.zones.set(zones, [], changed)
    view, at = MapView(grid), replace(observation(0), T_map_base=se3(x_m=-7.0))
    where = scene_of_map(view, at, [], BODY.clearance_m)
    straight = refine(scene(), [np.array([[7.0, 0.0]])], {1}, BODY, LIMITS)
    around = refine(where, [np.array([[7.0, 0.0]])], (), BODY, LIMITS)
    blocked = [blocked_ahead_m(path, view, k) for path in (straight, around) for k in (0, 60)]
    assert blocked[0] is not None
    assert blocked[2:] == [None, None]
    assert around.poses[-1, :2].tolist() == [7.0, 0.0]


def test_zones_hide_nothing_and_are_open_to_a_robot_inside():
    grid, changed = on_floor(), np.zeros(4, np.int64)
    grid.zones.set([np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])], [], changed)
    at = replace(observation(0), T_map_base=se3(x_m=-7.0))
    ground = ground_of(scene_of_map(MapView(grid), at, [], BODY.clearance_m), BODY.clearance_m)
    assert ground.has_line_of_sight((-5.0, 0.0), (5.0, 0.0))
    assert not ground.is_free(0.0, 0.0)
    with pytest.raises(TrajectoryError, match="is in a zone that is closed to the robot; the near"):
        check(CoarseTrajectory((np.array([[0.0, 0.0]]),)), ground, TrajectoryLimits())
    assert (uninflated(grid, SE2(0.0, 0.0, 0.0)).cells <= 0).all()


def test_outside_the_map_nothing_is_known():
    trajectory = line()
    trajectory.poses[:, 0] -= 40.0
    assert blocked_ahead_m(trajectory, mapped((2.0, -0.5, 3.0, 0.5))) is None


def test_the_trajectory_is_sent_as_a_path():
    trajectory = refine(scene(), [np.array([[0.0, 0.0], [0.0, 7.0]])], {1}, BODY, LIMITS)
    path = from_ros(path_message(trajectory, 10**9 + 5), "nav_msgs/msg/Path")
    assert (path.header.frame_id, path.header.stamp.nanosec) == ("map", 5)
    got = np.array(
        [
            (p.pose.position.x, p.pose.position.y, p.pose.position.z,
             2 * math.atan2(p.pose.orientation.z, p.pose.orientation.w))
            for p in path.poses
        ]
    )  # fmt: skip
    np.testing.assert_allclose(got, trajectory.poses, atol=1e-9)

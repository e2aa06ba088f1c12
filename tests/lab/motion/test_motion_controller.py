"""The controller in a closed loop with a small kinematic robot on a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge.geometry import SE2, Grid, wrap_angle
from edge.lab.motion.controller import STUCK_S, YAW_TOLERANCE_RAD, Controller
from edge.lab.motion.route import GIVE_UP_NS, GOAL_TOLERANCE_M
from edge.trajectory.pursuit import length_m
from edge.types import GoalStatus

RES_M = 0.05
STEP_NS = 50_000_000
CONFIG = simulated()


def room(width_m: float, height_m: float) -> np.ndarray:
    """Return a free room with walls one cell thick."""
    cells = np.zeros((round(height_m / RES_M), round(width_m / RES_M)), np.int8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 100, 100, 100, 100
    return cells


def wall(cells: np.ndarray, x_m: float, gap_m: tuple[float, float] | None) -> np.ndarray:
    """Return the same room with a wall across at x and a gap from one y to another."""
    cells = cells.copy()
    column = round(x_m / RES_M)
    kept = cells[:, column : column + 3].copy()
    cells[:, column : column + 3] = 100
    if gap_m is not None:
        rows = slice(round(gap_m[0] / RES_M), round(gap_m[1] / RES_M))
        cells[rows, column : column + 3] = kept[rows]
    return cells


def inflated(cells: np.ndarray, radius_m: float = 0.25) -> np.ndarray:
    """As the service publishes it."""
    free = (cells != 100).astype(np.uint8)
    near = cv2.distanceTransform(free, cv2.DIST_L2, 5) * RES_M <= radius_m
    return np.where(near, 100, cells).astype(np.int8)


@dataclass
class Walk:
    """A robot with the limits of the configuration, and its history."""

    pose: SE2
    controller: Controller = field(default_factory=lambda: Controller(CONFIG))
    v: float = 0.0
    w: float = 0.0
    now_ns: int = 10**9
    held: bool = False
    answers: list[GoalStatus] = field(default_factory=list)
    track: list[SE2] = field(default_factory=list)

    @property
    def blocked(self) -> list[tuple[float, float]]:
        """Return the positions at which the controller reported that it was stuck."""
        return [a.blocked for a in self.answers if a.blocked is not None]

    def map(self, cells: np.ndarray) -> None:
        """Return the service's map with the places closed at which the robot was stuck."""
        cells = cells.copy()
        for x, y in self.blocked:
            cv2.circle(cells, (int(x / RES_M), int(y / RES_M)), round(0.25 / RES_M), 100, -1)
        self.controller.on_map(Grid(cells, (0.0, 0.0), RES_M))

    def goal(self, stamp_ns: int, pose: SE2) -> None:
        self.answers += self.controller.on_goal(stamp_ns, pose)

    def step(self) -> None:
        command, answers = self.controller.step(self.pose, self.v, self.w, self.now_ns)
        self.answers += answers
        robot, dt = CONFIG.robot, STEP_NS / 1e9
        assert abs(command.v_mps) <= robot.max_speed_mps + 1e-9
        assert abs(command.w_radps) <= robot.max_turn_radps + 1e-9
        dv, dw = robot.max_accel_mps2 * dt, robot.max_turn_accel_radps2 * dt
        self.v += min(max(command.v_mps - self.v, -dv), dv)
        self.w += min(max(command.w_radps - self.w, -dw), dw)
        if self.held:
            self.v = self.w = 0.0
        yaw = self.pose.yaw_rad + 0.5 * self.w * dt
        self.pose = SE2(
            self.pose.x_m + self.v * dt * math.cos(yaw),
            self.pose.y_m + self.v * dt * math.sin(yaw),
            wrap_angle(self.pose.yaw_rad + self.w * dt),
        )
        self.track.append(self.pose)
        self.now_ns += STEP_NS

    def run(self, seconds: float) -> None:
        """Until the goal is decided, or the time is over."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.step()
            if self.answers and self.answers[-1].state != "accepted":
                return

    @property
    def states(self) -> list[tuple[int, str]]:
        return [(a.stamp_ns, a.state) for a in self.answers]

    def assert_kept_off(self, cells: np.ndarray) -> None:
        for p in self.track:
            assert cells[int(p.y_m / RES_M), int(p.x_m / RES_M)] != 100, p


def assert_at(pose: SE2, goal: SE2) -> None:
    assert pose.distance_to(goal.x_m, goal.y_m) <= GOAL_TOLERANCE_M
    assert abs(wrap_angle(pose.yaw_rad - goal.yaw_rad)) <= YAW_TOLERANCE_RAD


DOORWAY = wall(room(8.0, 4.0), 4.0, (1.6, 2.4))


@pytest.mark.parametrize("start_yaw", [0.0, 2.0, -3.1])
@pytest.mark.parametrize("goal", [SE2(7.0, 3.3, 1.5), SE2(4.5, 0.5, -1.5), SE2(4.6, 3.4, 3.0)])
def test_reaches_the_goal_through_a_doorway(start_yaw, goal):
    cells = inflated(DOORWAY)
    walk = Walk(SE2(1.0, 0.6, start_yaw))
    walk.map(cells)
    walk.goal(7, goal)
    walk.run(60)
    assert walk.states == [(7, "accepted"), (7, "reached")]
    assert_at(walk.pose, goal)
    assert (walk.v, walk.w) == (0.0, 0.0)
    walk.assert_kept_off(cells)
    # Not the long way round: the doorway's middle is the only detour.
    direct = math.dist((1.0, 0.6), (4.1, 2.0)) + math.dist((4.1, 2.0), (goal.x_m, goal.y_m))
    driven = length_m(np.array([(p.x_m, p.y_m) for p in walk.track]))
    assert driven < 1.25 * direct


@given(st.integers(0, 2**32 - 1))
def test_reaches_any_free_cell_among_random_boxes(seed):
    rng = np.random.default_rng(seed)
    cells = room(6.0, 5.0)
    for _ in range(6):
        r, c = rng.integers(10, 80), rng.integers(10, 100)
        cells[r : r + rng.integers(4, 12), c : c + rng.integers(4, 12)] = 100
    body = inflated(cells, CONFIG.robot.radius_m)
    cells = inflated(cells)
    free = (cells == 0).astype(np.uint8)
    _, regions = cv2.connectedComponents(free, connectivity=4)
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    spots = np.argwhere(regions == largest)
    (r0, c0), (r1, c1) = spots[rng.integers(len(spots), size=2)]
    goal = SE2((c1 + 0.5) * RES_M, (r1 + 0.5) * RES_M, float(rng.uniform(-3, 3)))
    walk = Walk(SE2((c0 + 0.5) * RES_M, (r0 + 0.5) * RES_M, float(rng.uniform(-3, 3))))
    walk.map(cells)
    walk.goal(1, goal)
    walk.run(90)
    assert walk.states == [(1, "accepted"), (1, "reached")]
    assert_at(walk.pose, goal)
    walk.assert_kept_off(body)


CLOSED_ROOM = wall(room(8.0, 4.0), 4.0, None)
NEXT_TO = SE2(1.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("cells", "goal", "reason"),
    [
        (None, SE2(7.0, 2.0, 0.0), "no map"),
        (np.zeros((0, 0), np.int8), SE2(7.0, 2.0, 0.0), "start outside the map"),
        (CLOSED_ROOM, SE2(7.0, 2.0, 0.0), "unreachable"),
        (CLOSED_ROOM, SE2(9.0, 2.0, 0.0), "goal outside the map"),
        (inflated(CLOSED_ROOM, 0.6), SE2(4.07, 2.0, 0.0), "goal blocked"),
    ],
)
def test_a_goal_without_a_path_fails_after_a_wait(cells, goal, reason):
    walk = Walk(NEXT_TO)
    if cells is not None:
        walk.map(cells)
    walk.goal(4, goal)
    begun_ns = walk.now_ns
    walk.run(30)
    assert walk.answers[-1] == GoalStatus(4, "failed", reason)
    waited_s = (walk.now_ns - begun_ns) / 1e9
    assert GIVE_UP_NS * 1e-9 <= waited_s <= GIVE_UP_NS * 1e-9 + 1.0
    assert walk.pose == NEXT_TO


def test_a_path_that_closes_is_planned_again_at_once():
    two_doors = wall(room(8.0, 4.0), 4.0, (1.6, 2.4))
    two_doors[8:20, 80:83] = 0
    walk = Walk(SE2(1.0, 2.0, 0.0))
    walk.map(inflated(two_doors))
    walk.goal(1, SE2(7.0, 2.0, 0.0))
    while walk.pose.x_m < 3.0:
        walk.step()
    assert abs(walk.pose.y_m - 2.0) < 0.3  # it was on its way through the nearer door
    one_door = two_doors.copy()
    one_door[32:48, 80:83] = 100
    walk.track.clear()
    walk.map(inflated(one_door))
    walk.run(60)
    assert walk.states[-1] == (1, "reached")
    walk.assert_kept_off(inflated(one_door))


def test_a_wall_across_the_path_stops_the_robot():
    walk = Walk(SE2(1.0, 2.0, 0.0))
    walk.map(inflated(DOORWAY))
    walk.goal(1, SE2(7.0, 2.0, 0.0))
    while walk.pose.x_m < 3.0:
        walk.step()
    walk.track.clear()
    walk.map(inflated(CLOSED_ROOM))
    walk.run(60)
    assert walk.answers[-1] == GoalStatus(1, "failed", "unreachable")
    walk.assert_kept_off(inflated(CLOSED_ROOM))


def test_start_in_an_obstacle_is_driven_out_of():
    cells = room(4.0, 4.0)
    cells[:, :20] = 100
    walk = Walk(SE2(0.8, 2.0, 3.0))
    walk.map(cells)
    walk.goal(1, SE2(3.0, 2.0, 0.0))
    walk.run(30)
    assert walk.states[-1] == (1, "reached")
    entered = next(k for k, p in enumerate(walk.track) if p.x_m > 1.02)
    walk.track = walk.track[entered:]
    walk.assert_kept_off(cells)


# CDR counts seconds in an int32: to 2038, and back to 1901.
LAST_NS, FIRST_NS = (2**31 - 1) * 10**9 + 999_999_999, -(2**31) * 10**9


@pytest.mark.parametrize(
    ("first", "second"),
    [(10, 20), (20, 10), (LAST_NS, 10), (10, FIRST_NS), (FIRST_NS, LAST_NS), (0, -1), (5, 5)],
    ids=str,
)
def test_the_newest_goal_replaces_the_earlier_one(first, second):
    before, goal = SE2(5.0, 1.0, 0.0), SE2(1.5, 3.0, 1.0)
    walk = Walk(SE2(1.0, 1.0, 0.0))
    walk.map(room(6.0, 4.0))
    walk.goal(first, before)
    for _ in range(40):
        walk.step()
    walk.goal(second, goal)
    walk.goal(first, before)
    assert walk.answers.pop() == GoalStatus(first, "failed", "replaced by a newer goal")
    walk.run(30)
    assert walk.states == [(first, "accepted"), (second, "accepted"), (second, "reached")]
    assert_at(walk.pose, goal)
    walk.goal(first, before)
    assert walk.answers[-1] == GoalStatus(first, "failed", "replaced by a newer goal")


def test_a_repeated_goal_is_answered_with_its_state():
    goal = SE2(2.0, 1.0, 0.0)
    walk = Walk(SE2(1.0, 1.0, 0.0))
    walk.map(room(4.0, 4.0))
    walk.goal(10, goal)
    walk.step()
    walk.goal(10, goal)
    walk.run(20)
    walk.goal(10, goal)
    walk.goal(10, goal)
    assert walk.states == [(10, s) for s in ("accepted", "accepted", *["reached"] * 3)]
    track = len(walk.track)
    walk.step()
    assert len(walk.answers) == 5
    assert walk.track[track] == walk.track[track - 1]


@pytest.mark.parametrize("bad", [SE2(math.nan, 0.0, 0.0), SE2(0.0, math.inf, 0.0)])
def test_a_goal_that_is_not_finite_is_refused(bad):
    walk = Walk(NEXT_TO)
    walk.goal(1, bad)
    assert walk.states == [(1, "failed")]


def test_a_held_robot_recovers_once_and_then_fails():
    walk = Walk(SE2(1.0, 2.0, 0.0), held=True)
    walk.map(room(6.0, 4.0))
    walk.goal(1, SE2(5.0, 2.0, 0.0))
    commands = []
    while walk.answers[-1].state == "accepted" and len(commands) < 1000:
        commands.append(walk.controller._last_command.v_mps)
        walk.step()
    ahead, behind = (1.2, 2.0), (0.8, 2.0)  # at its rim
    assert walk.answers[-1] == GoalStatus(1, "failed", "stuck", ahead)
    assert min(commands) < 0  # it backed up in between
    assert (walk.now_ns - 10**9) / 1e9 < 2 * STUCK_S
    assert walk.blocked == [ahead, behind, ahead]
    walk.goal(1, SE2(5.0, 2.0, 0.0))
    assert walk.answers[-1] == GoalStatus(1, "failed", "stuck")  # reported once


def test_a_robot_touching_a_corner_gets_free():
    """Neither the path nor the way back leads off the corner on its left."""
    walk, start, goal = Walk(SE2(1.0, 2.0, 0.25)), SE2(1.0, 2.0, 0.25), SE2(5.0, 3.0, 0.0)
    cells, corner_rad = room(6.0, 4.0), 0.25 + 0.5 * math.pi
    x, y = SE2(1.0, 2.0, corner_rad).ahead(0.25)
    cv2.circle(cells, (int(x / RES_M), int(y / RES_M)), 2, 100, -1)
    for stamp_ns in (1, 2):
        walk.controller.on_map(Grid(cells, (0.0, 0.0), RES_M))
        walk.goal(stamp_ns, goal)
        while walk.answers[-1].state == "accepted":
            along = math.cos(walk.pose.yaw_rad - corner_rad)
            in_contact = walk.pose.distance_to(start.x_m, start.y_m) < 0.05
            blocked = in_contact and (along if walk.v >= 0.0 else -along) > -0.6
            walk.v = 0.0 if blocked else walk.v
            before = walk.pose
            walk.step()
            if blocked:
                walk.v, walk.pose = 0.0, SE2(before.x_m, before.y_m, walk.pose.yaw_rad)
    assert (1, "failed") in walk.states
    assert walk.states[-1] == (2, "reached")


def test_a_held_robot_that_should_turn_was_blocked_nowhere():
    walk = Walk(SE2(1.0, 2.0, 0.0), held=True)
    walk.goal(1, SE2(1.0, 2.0, 3.0))
    walk.run(30)
    assert walk.answers[-1].reason == "stuck"
    assert walk.blocked == []


def test_a_pushing_robot_reports_it_but_a_slow_one_not():
    """Its wheels answer half a second late."""
    pushing, slow = (Walk(SE2(1.0, 2.0, 0.0), held=True) for _ in range(2))
    for walk in (pushing, slow):
        walk.map(room(6.0, 4.0))
        walk.goal(1, SE2(5.0, 2.0, 0.0))
        for step in range(20):
            walk.held = walk is pushing or step < 10
            walk.step()
    assert pushing.blocked == [(1.2, 2.0)]
    assert slow.blocked == []


def test_the_robot_drives_around_an_unmapped_obstacle():
    """A chair leg in the way: once the map shows it, the next path leads past it."""
    walk, goal = Walk(SE2(1.0, 2.0, 0.0)), SE2(5.0, 2.0, 0.0)
    leg = SE2(3.0, 2.0, 0.0)
    walk.goal(1, goal)
    for step in range(1200):
        if step % 10 == 0:
            walk.map(inflated(room(6.0, 4.0)))
        ahead = walk.pose.bearing_to(leg.x_m, leg.y_m)
        touches = walk.pose.distance_to(leg.x_m, leg.y_m) < 0.22 and abs(ahead) < math.pi / 2
        if touches and walk.v > 0.0:
            walk.v = 0.0
            walk.pose = SE2(
                walk.pose.x_m - 0.03 * math.cos(walk.pose.yaw_rad),
                walk.pose.y_m - 0.03 * math.sin(walk.pose.yaw_rad),
                walk.pose.yaw_rad,
            )
        walk.step()
        if walk.answers[-1].state != "accepted":
            break
    assert walk.states == [(1, "accepted"), (1, "accepted"), (1, "reached")]
    assert_at(walk.pose, goal)
    ((x, y),) = walk.blocked
    assert math.dist((x, y), (leg.x_m, leg.y_m)) < 0.1


def test_a_pose_reset_again_and_again_fails_without_progress():
    walk = Walk(SE2(1.0, 2.0, 0.0))
    walk.map(room(6.0, 4.0))
    walk.goal(1, SE2(5.0, 2.0, 0.0))
    for _ in range(4000):
        walk.step()
        if walk.pose.x_m > 2.0:
            walk.pose = SE2(1.0, 2.0, 0.0)
        if walk.answers[-1].state != "accepted":
            break
    assert walk.answers[-1] == GoalStatus(1, "failed", "no progress towards the goal")


def test_a_clock_that_is_set_back_is_a_new_run():
    walk = Walk(SE2(1.0, 2.0, 0.0))
    walk.map(room(6.0, 4.0))
    walk.goal(10**12, SE2(5.0, 2.0, 0.0))
    walk.now_ns = 10**12
    walk.step()
    walk.now_ns = 10**9
    walk.step()
    assert len(walk.controller.route.path_m) == 0
    walk.map(room(6.0, 4.0))
    walk.goal(5, SE2(2.0, 2.0, 0.0))
    walk.run(20)
    assert walk.states[-2:] == [(5, "accepted"), (5, "reached")]


@pytest.mark.parametrize("pose", [SE2(math.nan, 1.0, 0.0), SE2(1.0, 1.0, math.inf)])
def test_a_pose_that_is_not_finite_stops_the_robot(pose):
    walk = Walk(SE2(1.0, 1.0, 0.0))
    walk.map(room(4.0, 4.0))
    walk.goal(1, SE2(3.0, 3.0, 0.0))
    walk.step()
    command, answers = walk.controller.step(pose, 0.0, 0.0, walk.now_ns)
    assert not command.moves
    assert answers == []
    walk.run(30)
    assert walk.states[-1] == (1, "reached")


@pytest.mark.parametrize("resolution", [0.0, -1.0, math.nan, 1e-30, 1e-9, 100.0, math.inf])
def test_a_map_of_no_sensible_resolution_is_refused(resolution):
    controller = Controller(CONFIG)
    with pytest.raises(ValueError, match="resolution"):
        controller.on_map(Grid(room(2.0, 2.0), (0.0, 0.0), resolution))

"""The simulated body: limits, collisions, odometry."""

from __future__ import annotations

import math

import pytest
from collisions import collides
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge.config import RobotConfig, SimConfig
from edge.geometry import SE2
from edge.lab.sim.base import WorldError
from edge.lab.sim.house import House, build_house
from edge.lab.sim.robot import SUBSTEP_S, DriveTrain

ROBOT = RobotConfig()


def arena():
    corners = ([-5, -5], [5, -5], [5, 5], [-5, 5])
    walls = [
        {"start": a, "end": b} for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    pillar = {"category": "pillar", "at": [2.0, 0.0], "size": [0.4, 0.4, 1.0]}
    return build_house(
        House.model_validate(
            {"name": "arena", "start": [0, 0, 0], "walls": walls, "objects": [pillar]}
        ),
        simulated(),
    )


WORLD = arena()


def drive(sim: SimConfig | None = None, start: SE2 | None = None) -> DriveTrain:
    return DriveTrain(ROBOT, sim or SimConfig(), WORLD, start or SE2(0.0, 0.0, 0.0))


def test_the_robot_drives_an_arc():
    body = drive(start=SE2(-3.0, -3.0, 0.0))
    for _ in range(200):
        motion = body.step(0.05, 0.4, 0.4)
    # Once the speeds are reached the radius is v / w = 1 m.
    a = body.step(0.05, 0.4, 0.4).pose
    assert motion.v_mps == pytest.approx(0.4)
    for _ in range(round(2 * math.pi / 0.4 / 0.05)):
        motion = body.step(0.05, 0.4, 0.4)
    assert motion.pose.distance_to(a.x_m, a.y_m) < 0.05
    assert motion.collisions == 0


@given(
    st.lists(
        st.tuples(st.floats(-5, 5), st.floats(-9, 9), st.floats(0.005, 0.3)),
        min_size=1,
        max_size=25,
    )
)
def test_limits_hold_and_nothing_is_passed_through(commands):
    body = drive()
    for v_cmd, w_cmd, dt_s in commands:
        before, motion = body.motion, body.step(dt_s, v_cmd, w_cmd)
        assert abs(motion.v_mps) <= ROBOT.max_speed_mps + 1e-9
        assert abs(motion.w_radps) <= ROBOT.max_turn_radps + 1e-9
        assert abs(motion.w_radps - before.w_radps) <= ROBOT.max_turn_accel_radps2 * dt_s + 1e-9
        gained = abs(motion.v_mps) - abs(before.v_mps)
        assert gained <= ROBOT.max_accel_mps2 * dt_s + 1e-9
        moved = motion.pose.distance_to(before.pose.x_m, before.pose.y_m)
        assert moved <= ROBOT.max_speed_mps * dt_s + 1e-9
        assert not collides(WORLD, motion.pose.x_m, motion.pose.y_m, ROBOT.radius_m)
        assert motion.stamp_ns == before.stamp_ns + round(dt_s * 1e9)


def test_the_robot_stops_at_an_obstacle_and_gets_away():
    body = drive()
    for _ in range(100):
        motion = body.step(0.1, 0.5, 0.0)
    # The pillar's surface at 1.8 m, less the radius.
    assert motion.pose.x_m == pytest.approx(1.6, abs=0.06)
    assert motion.bumped
    assert motion.v_mps == 0.0 or motion.v_mps <= ROBOT.max_accel_mps2 * SUBSTEP_S + 1e-9
    assert motion.collisions == 1
    for _ in range(20):
        motion = body.step(0.1, -0.5, 0.0)
    assert motion.pose.x_m < 1.0
    assert not motion.bumped
    assert motion.collisions == 1


def test_drift_grows_with_the_path_and_repeats_with_the_seed():
    def run(seed: int) -> tuple[SE2, SE2]:
        body = drive(SimConfig(seed=seed, drift_m_per_m=0.05, drift_rad_per_rad=0.02))
        for k in range(80):
            motion = body.step(0.1, 0.3, 0.8 * math.sin(0.3 * k))
        return motion.pose, motion.odometry

    assert run(1) == run(1)
    pose, first = run(1)
    same, second = run(2)
    assert pose == same
    assert first != second
    assert 0.001 < first.distance_to(pose.x_m, pose.y_m) < 1.0


def test_a_start_in_an_obstacle_is_refused():
    with pytest.raises(WorldError, match=r"sim.start: \(2.00, 0.00\).*choose another"):
        drive(start=SE2(2.0, 0.0, 0.0))

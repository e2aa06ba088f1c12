"""The simulated robot: a differential drive that collides with obstacles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from edge.config import RobotConfig, SimConfig
from edge.geometry import SE2, wrap_angle
from edge.lab.sim.base import World, WorldError
from edge.lab.sim.people import PeopledWorld, person_clearance_m

SUBSTEP_S = 0.02  # longest time between two collision checks
# After a collision, further contact is part of it until the robot has moved this far away.
AWAY_M = 0.05


@dataclass(frozen=True, slots=True)
class MotionState:
    """State of the robot at one instant.

    Attributes:
        pose: true pose in `map`.
        odometry: pose by odometry, with drift.
        w_radps: turn rate.
        collisions: number of collisions so far.
        bumped: True while the robot stands where it collided.
        path_m: distance truly driven.
        person_contacts: number of the collisions that were with a person. All are the robot's
            fault: no person walks into it.
    """

    stamp_ns: int
    pose: SE2
    odometry: SE2
    v_mps: float
    w_radps: float
    collisions: int
    bumped: bool
    path_m: float
    person_contacts: int = 0


class DriveTrain:
    """Motion of the simulated robot: a disc with limited speed, turn rate and accelerations.

    The odometry drifts by a constant fraction of the distance driven and of the angle turned, drawn
    once from the seed. This models a wrong wheel radius, not noise that averages out.

    Raises:
        WorldError: the start is not free.
    """

    def __init__(
        self, robot: RobotConfig, sim: SimConfig, world: World, start: SE2, stamp_ns: int = 0
    ) -> None:
        clearance = world.plan.clearance_at(start.x_m, start.y_m)
        if clearance < robot.radius_m:
            raise WorldError(
                f"sim.start: ({start.x_m:.2f}, {start.y_m:.2f}) m in {world.name} is "
                f"{clearance:.2f} m from an obstacle, but the robot needs {robot.radius_m} m; "
                "choose another start"
            )
        rng = np.random.default_rng(sim.seed)
        self._robot, self._world = robot, world
        # Distance and angle by odometry, as factors on the true ones.
        self._scale = 1.0 + sim.drift_m_per_m * rng.standard_normal()
        self._turn_scale = 1.0 + sim.drift_rad_per_rad * rng.standard_normal()
        self._bumped_at = start  # pose at the newest collision
        self.motion = MotionState(stamp_ns, start, start, 0.0, 0.0, 0, False, 0.0)

    def step(self, dt_s: float, v_cmd_mps: float, w_cmd_radps: float) -> MotionState:
        """Drive towards a commanded speed and turn rate for `dt_s`."""
        count = max(1, math.ceil(dt_s / SUBSTEP_S - 1e-9))
        now = self.motion
        for _ in range(count):
            now = self._substep(now, dt_s / count, v_cmd_mps, w_cmd_radps)
        # In one assignment: other threads read pose and stamp, which belong together.
        self.motion = replace(now, stamp_ns=now.stamp_ns + round(dt_s * 1e9))
        if isinstance(self._world, PeopledWorld):
            self._world.advance(dt_s, now.pose)
        return self.motion

    def _substep(self, now: MotionState, dt_s: float, v_cmd: float, w_cmd: float) -> MotionState:
        """Return the state after `dt_s`; a blocked robot turns on the spot. The stamp stays."""
        robot = self._robot
        v = _towards(now.v_mps, v_cmd, robot.max_speed_mps, robot.max_accel_mps2 * dt_s)
        w = _towards(now.w_radps, w_cmd, robot.max_turn_radps, robot.max_turn_accel_radps2 * dt_s)
        pose = _advance(now.pose, v * dt_s, w * dt_s)
        before = self._world.plan.clearance_at(now.pose.x_m, now.pose.y_m)
        after = self._world.plan.clearance_at(pose.x_m, pose.y_m)
        # An object may have been moved onto the robot: then any way out is allowed.
        blocked = after < robot.radius_m and (before >= robot.radius_m or after < before)
        bumped = now.bumped
        if blocked and v != 0.0:
            v, bumped, self._bumped_at = 0.0, True, now.pose
            pose = _advance(now.pose, 0.0, w * dt_s)
        elif bumped and pose.distance_to(self._bumped_at.x_m, self._bumped_at.y_m) > AWAY_M:
            bumped = False
        touched = bumped and not now.bumped
        return MotionState(
            stamp_ns=now.stamp_ns,
            pose=pose,
            odometry=_advance(now.odometry, v * dt_s * self._scale, w * dt_s * self._turn_scale),
            v_mps=v,
            w_radps=w,
            collisions=now.collisions + touched,
            bumped=bumped,
            path_m=now.path_m + abs(v) * dt_s,
            person_contacts=now.person_contacts + (touched and self._is_at_person(pose)),
        )

    def _is_at_person(self, pose: SE2) -> bool:
        """Return True if a person is so near that a collision at this pose is with them."""
        if not isinstance(self._world, PeopledWorld):
            return False
        away_m = person_clearance_m(self._world.people, pose.x_m, pose.y_m)
        return away_m < self._robot.radius_m + AWAY_M


def _towards(now: float, wanted: float, limit: float, change: float) -> float:
    """Return the next speed: `wanted`, but within ±`limit` and at most `change` from `now`."""
    wanted = min(max(wanted, -limit), limit)
    return min(max(wanted, now - change), now + change)


def _advance(pose: SE2, forward_m: float, turn_rad: float) -> SE2:
    """Return the pose after an arc, approximated by its chord."""
    heading = pose.yaw_rad + 0.5 * turn_rad
    return SE2(
        pose.x_m + forward_m * math.cos(heading),
        pose.y_m + forward_m * math.sin(heading),
        wrap_angle(pose.yaw_rad + turn_rad),
    )

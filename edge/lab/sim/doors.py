"""Sliding doors in the doorways of a simulated house, which open and close over time.

A doorway is an opening under a lintel: a piece of wall that does not reach the floor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edge.geometry import SE2
from edge.lab.sim import kernels
from edge.lab.sim.base import World, WorldError
from edge.lab.sim.boxworld import BoxWorld, Primitive

OPENS_M = 1.5  # a door opens for a person this near, and does not close
_ROBOT_GAP_M = 0.3  # a door does not close on a robot that is nearer than this
_SPEED_MPS = 0.8
_OPEN_S, _SHUT_S = (15.0, 60.0), (10.0, 40.0)  # times that a door stays open and shut
_LINTEL_M = (1.8, 2.5)  # height of a lintel's lower edge
_WIDTH_M, _THICK_M = (0.6, 2.4), 0.05  # of a door
_COLOR = (150.0, 110.0, 74.0)
_AWAY_M = -100.0  # height of an open door: nothing sees it


@dataclass(eq=False, slots=True)
class SlidingDoor:
    """A door that slides into the wall at one side of its doorway.

    Attributes:
        jamb_m: end of the doorway at which it opens; the other end is where it slides to.
        along: unit vector from there, (x, y).
        clock_s: time since it began to open.
        shut_m: width of the doorway that it closes now.
    """

    jamb_m: tuple[float, float]
    along: tuple[float, float]
    width_m: float
    height_m: float
    open_s: float
    shut_s: float
    clock_s: float
    shut_m: float = 0.0

    def distance_m(self, x_m: float, y_m: float, width_m: float | None = None) -> float:
        """Return the distance from a point to the door; inf while it is open."""
        width_m = self.shut_m if width_m is None else width_m
        if width_m <= 0.0:
            return math.inf
        dx, dy = x_m - self.jamb_m[0], y_m - self.jamb_m[1]
        along, across = (
            dx * self.along[0] + dy * self.along[1],
            dy * self.along[0] - dx * self.along[1],
        )
        return math.hypot(max(-along, along - width_m, 0.0), max(abs(across) - 0.5 * _THICK_M, 0.0))

    def advance(
        self, dt_s: float, robot: SE2, robot_radius_m: float, people_m: Iterable[np.ndarray]
    ) -> None:
        """Open or close for `dt_s`. A door that is not shut yet does not close on a person."""
        self.clock_s = (self.clock_s + dt_s) % (self.open_s + self.shut_s)
        opens = self.clock_s < self.open_s or any(
            self.distance_m(xy_m[0], xy_m[1], self.width_m) < OPENS_M for xy_m in people_m
        )
        robot_m = self.distance_m(robot.x_m, robot.y_m, self.width_m) - robot_radius_m
        opens |= self.shut_m < self.width_m and robot_m < _ROBOT_GAP_M
        step_m = _SPEED_MPS * dt_s
        self.shut_m = min(max(self.shut_m + (-step_m if opens else step_m), 0.0), self.width_m)

    def body(self) -> Primitive:
        """Return the door as a solid, shut."""
        half_m = 0.5 * self.width_m
        size_m = (self.width_m, _THICK_M, self.height_m)
        yaw_rad = math.atan2(self.along[1], self.along[0])
        x_m, y_m = self.jamb_m[0] + half_m * self.along[0], self.jamb_m[1] + half_m * self.along[1]
        at = (x_m, y_m, 0.5 * self.height_m)
        return Primitive(kernels.BOX, at, size_m, _COLOR, yaw_rad=yaw_rad)

    def place(self, row: np.ndarray) -> None:
        """Write where the door is now to its row of `BoxWorld.geometry`."""
        half_m = 0.5 * self.shut_m
        row[kernels.X] = self.jamb_m[0] + half_m * self.along[0]
        row[kernels.Y] = self.jamb_m[1] + half_m * self.along[1]
        row[kernels.Z] = 0.5 * self.height_m if half_m > 0.0 else _AWAY_M
        row[kernels.HALF_X] = half_m


def make_doors(world: World, share: float, seed: int, robot: SE2) -> list[SlidingDoor]:
    """Return doors for a share of the doorways of a house. No door is shut where the robot is.

    Raises:
        WorldError: the world is a mesh.
    """
    if share == 0.0:
        return []
    if not isinstance(world, BoxWorld):
        raise WorldError(
            f"sim.doors: world {world.name} is a mesh, whose doorways are unknown; set sim.doors: 0"
        )
    rng = np.random.default_rng([seed, 4])
    lintels = [row for row in world.geometry[_lintels(world)] if _is_open_below(world, row)]
    order = rng.permutation(len(lintels))[: round(share * len(lintels))]
    doors = []
    for row in (lintels[k] for k in order.tolist()):
        sign = float(rng.choice((-1.0, 1.0)))
        along = (sign * float(row[kernels.COS]), sign * float(row[kernels.SIN]))
        half_m = float(row[kernels.HALF_X])
        jamb_m = (
            float(row[kernels.X]) - half_m * along[0],
            float(row[kernels.Y]) - half_m * along[1],
        )
        open_s, shut_s = float(rng.uniform(*_OPEN_S)), float(rng.uniform(*_SHUT_S))
        height_m = float(row[kernels.Z] - row[kernels.HALF_Z])
        clock_s = float(rng.uniform(0.0, open_s + shut_s))
        door = SlidingDoor(jamb_m, along, 2.0 * half_m, height_m, open_s, shut_s, clock_s)
        is_shut = (
            clock_s >= open_s and door.distance_m(robot.x_m, robot.y_m, door.width_m) > OPENS_M
        )
        door.shut_m = door.width_m if is_shut else 0.0
        doors.append(door)
    return doors


def door_clearance_m(doors: Iterable[SlidingDoor], x_m: float, y_m: float) -> float:
    """Return the distance from a point to the nearest door; inf if all are open."""
    return min((door.distance_m(x_m, y_m) for door in doors), default=math.inf)


def _lintels(world: BoxWorld) -> np.ndarray:
    """Return (p,) bool: the primitives that may be the wall above a door or a window."""
    g = world.geometry
    under_m, width_m = g[:, kernels.Z] - g[:, kernels.HALF_Z], 2.0 * g[:, kernels.HALF_X]
    is_box = (world.owner == 0) & (world.shape == kernels.BOX) & (g[:, kernels.HALF_Y] < 0.15)
    is_high = (_LINTEL_M[0] <= under_m) & (under_m <= _LINTEL_M[1])
    return is_box & is_high & (_WIDTH_M[0] <= width_m) & (width_m <= _WIDTH_M[1])


def _is_open_below(world: BoxWorld, lintel: np.ndarray) -> bool:
    """Return True if the floor below a lintel is free: it is no window's."""
    return world.plan.clearance_at(lintel[kernels.X], lintel[kernels.Y]) > 0.25 * _WIDTH_M[0]

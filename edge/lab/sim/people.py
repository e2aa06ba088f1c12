"""People who walk through a simulated world, around the robot, and the world's doors.

They appear in images, depth, object ids and LiDAR, and the robot can touch them. Any world can have
people, meshes too; their bodies are plain solids. They pass through each other, and doors open for
them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edge.config import Config
from edge.geometry import SE2, CameraModel, Grid
from edge.lab.sim import kernels
from edge.lab.sim.base import FloorPlan, LidarRays, World, WorldError, WorldObject
from edge.lab.sim.boxworld import BoxWorld, Primitive
from edge.lab.sim.doors import SlidingDoor, door_clearance_m, make_doors
from edge.trajectory.astar import Workspace, plan
from edge.trajectory.costmap import CostMap

if TYPE_CHECKING:
    from collections.abc import Sequence

PERSON_RADIUS_M = 0.2
_HEIGHT_M, _HEAD_M = 1.7, 0.24
_GAP_M = 0.4  # a person does not come nearer to the robot than this
_START_GAP_M = 1.5  # least distance from the robot's start
_CLEARANCE_M = 0.3  # distance from walls on a path and at its ends
_STANDING_CLEARANCE_M = 0.6  # a person who stands leaves room for the robot
_SPEEDS_MPS = (0.5, 1.4)
_PAUSES_S = (0.0, 4.0)  # at the end of a path
_PATIENCE_S = 2.0  # wait in front of the robot, then walk somewhere else
_STRIDE = 4  # cells of the floor plan along a cell of the paths
_COLORS = ((70.0, 90.0, 150.0), (150.0, 70.0, 60.0), (70.0, 120.0, 80.0), (60.0, 60.0, 66.0))


@dataclass(eq=False, slots=True)
class Person:
    """A person and their walk.

    Attributes:
        number: from 0. Of four, the second walks with the first, and the fourth stands.
        xy_m: place, (2,).
        speed_mps: walking speed.
        rng: draws goals and pauses.
        path_m: (n, 2) points still to pass.
        goal: index of the place at the end of the path.
        pause_s: time until the next path.
        blocked_s: time for which the robot has been in the way.
    """

    number: int
    xy_m: np.ndarray
    speed_mps: float
    rng: np.random.Generator
    path_m: np.ndarray
    goal: int
    pause_s: float = 0.0
    blocked_s: float = 0.0

    @property
    def stands(self) -> bool:
        """True for a person who never walks."""
        return self.number % 4 == 3


class _PeopledPlan(FloorPlan):
    """Floor plan of a world with its people and doors: only `clearance_at` includes them."""

    def __init__(
        self, plan: FloorPlan, people: Sequence[Person], doors: Sequence[SlidingDoor]
    ) -> None:
        self.grid, self.clearance_m = plan.grid, plan.clearance_m
        self._people, self._doors = people, doors

    def clearance_at(self, x_m: float, y_m: float) -> float:
        """See `FloorPlan.clearance_at`; people and doors are obstacles, too."""
        return min(
            FloorPlan.clearance_at(self, x_m, y_m),
            person_clearance_m(self._people, x_m, y_m),
            door_clearance_m(self._doors, x_m, y_m),
        )


def person_clearance_m(people: Sequence[Person], x_m: float, y_m: float) -> float:
    """Return the distance from a point to the nearest person's body; inf without people."""
    nearest = min((math.dist(p.xy_m, (x_m, y_m)) for p in people), default=math.inf)
    return max(0.0, nearest - PERSON_RADIUS_M)


class PeopledWorld:
    """World with people and moving doors in it; see `edge.lab.sim.base.World`.

    They depend only on `sim.seed`, simulated time and the robot's poses. The world without people
    is not changed.

    Raises:
        WorldError: no free floor for people.
    """

    def __init__(
        self, world: World, config: Config, start: SE2, doors: Sequence[SlidingDoor] = ()
    ) -> None:
        self._world, self._robot_radius_m = world, config.robot.radius_m
        self.name, self.start = world.name, world.start
        self.rooms, self.room_kinds = world.rooms, world.room_kinds
        self._spots_m, self._roomy = self._free_spots(world.plan, start)
        self._costs, self._workspace = _walking_costs(world.plan), Workspace()
        self.people: list[Person] = []
        for k in range(config.sim.people):
            self.people.append(self._new_person(k, config.sim.seed))
        self.doors = doors
        self.plan: FloorPlan = _PeopledPlan(world.plan, self.people, self.doors)
        first_id = len(world.objects) + 1
        bodies = [_body(first_id + p.number, p) for p in self.people]
        camera = config.sensors.camera
        self._crowd = BoxWorld(
            "people", [door.body() for door in self.doors], bodies, start, config.robot.height_m,
            (camera.depth_min_m, camera.depth_max_m),
        )  # fmt: skip
        self._person_of = self._crowd.owner[len(self.doors) :].astype(int) - first_id
        self._place_bodies()
        self.objects = [*world.objects, *self._crowd.objects]
        self._images: tuple[np.ndarray | None, np.ndarray, np.ndarray] | None = None
        self._ranges_m: np.ndarray | None = None

    def render(
        self,
        camera: CameraModel,
        T_map_camera: np.ndarray,
        out_rgb: np.ndarray | None,
        out_depth_m: np.ndarray,
        out_ids: np.ndarray,
    ) -> None:
        """See `edge.lab.sim.base.World`."""
        self._world.render(camera, T_map_camera, out_rgb, out_depth_m, out_ids)
        if self._images is None or self._images[1].shape != out_depth_m.shape:
            rgb = None if out_rgb is None else np.empty_like(out_rgb)
            self._images = rgb, np.empty_like(out_depth_m), np.empty_like(out_ids)
        rgb, depth_m, ids = self._images
        self._crowd.render(camera, T_map_camera, rgb, depth_m, ids)
        nearer = np.isfinite(depth_m) & ~(out_depth_m <= depth_m)
        out_depth_m[nearer], out_ids[nearer] = depth_m[nearer], ids[nearer]
        if out_rgb is not None and rgb is not None:
            out_rgb[nearer] = rgb[nearer]

    def cast(self, fan: LidarRays, T_map_lidar: np.ndarray, out_ranges_m: np.ndarray) -> None:
        """See `edge.lab.sim.base.World`."""
        self._world.cast(fan, T_map_lidar, out_ranges_m)
        if self._ranges_m is None:
            self._ranges_m = np.empty_like(out_ranges_m)
        self._crowd.cast(fan, T_map_lidar, self._ranges_m)
        np.fmin(out_ranges_m, self._ranges_m, out=out_ranges_m)

    def advance(self, dt_s: float, robot: SE2) -> None:
        """Let people walk and doors move for `dt_s`. No person walks into the robot."""
        for person in self.people:
            if not person.stands:
                self._walk(person, dt_s, robot)
        for door in self.doors:
            door.advance(dt_s, robot, self._robot_radius_m, (p.xy_m for p in self.people))
        self._place_bodies()

    def _place_bodies(self) -> None:
        """Write the places of people and doors to the solids that are rendered."""
        geometry, n = self._crowd.geometry, len(self.doors)
        for door, row in zip(self.doors, geometry, strict=False):  # the doors come first
            door.place(row)
        xy_m = np.array([p.xy_m for p in self.people]).reshape(-1, 2)
        geometry[n:, : kernels.Y + 1] = xy_m[self._person_of]

    def _walk(self, person: Person, dt_s: float, robot: SE2) -> None:
        """Move a person along their path, or choose the next path after a pause."""
        if person.pause_s > 0.0:
            person.pause_s -= dt_s
            return
        if not len(person.path_m):
            self._choose_path(person)
            return
        place, left_m, k = person.xy_m, person.speed_mps * dt_s, 0
        while k < len(person.path_m) and left_m > 0.0:
            step = person.path_m[k] - place
            length_m = math.hypot(*step)
            if length_m > left_m:
                place = place + step * (left_m / length_m)
                break
            place, left_m, k = person.path_m[k], left_m - length_m, k + 1
        keep_m = self._robot_radius_m + PERSON_RADIUS_M + _GAP_M
        after_m = robot.distance_to(*place)
        if after_m < keep_m and after_m < robot.distance_to(*person.xy_m):
            person.blocked_s += dt_s
            if person.blocked_s > _PATIENCE_S:
                person.blocked_s = 0.0
                self._choose_path(person)
            return
        person.blocked_s = 0.0
        person.xy_m, person.path_m = place, person.path_m[k:]
        if not len(person.path_m):
            person.pause_s = person.rng.uniform(*_PAUSES_S)

    def _choose_path(self, person: Person) -> None:
        """Draw a new goal; the second of four people walks to the goal of the first."""
        person.goal = int(person.rng.integers(len(self._spots_m)))
        if person.number % 4 == 1:
            person.goal = self.people[person.number - 1].goal
        x_m, y_m = self._spots_m[person.goal].tolist()
        found = plan(self._costs, (float(person.xy_m[0]), float(person.xy_m[1])), (x_m, y_m),
                     self._workspace)  # fmt: skip
        person.path_m = found.path_m
        person.pause_s = 0.0 if len(found.path_m) > 1 else 1.0

    def _new_person(self, number: int, seed: int) -> Person:
        rng = np.random.default_rng([seed, 3, number])
        spots = self._roomy if number % 4 == 3 else self._spots_m
        at = spots[int(rng.integers(len(spots)))]
        speed = float(rng.uniform(*_SPEEDS_MPS))
        if number % 4 == 1:  # next to the first of the pair, at the same speed
            first = self.people[number - 1]
            away_m = np.hypot(*(self._spots_m - first.xy_m).T)
            at = self._spots_m[int(np.argmin(np.abs(away_m - 2.5 * PERSON_RADIUS_M)))]
            speed = first.speed_mps
        return Person(number, at.copy(), speed, rng, np.empty((0, 2)), 0)

    def _free_spots(self, plan: FloorPlan, start: SE2) -> tuple[np.ndarray, np.ndarray]:
        """Return (n, 2) places where people walk to, and (m, 2) where they may stand."""
        reachable = plan.reachable(start.x_m, start.y_m, _CLEARANCE_M - 0.05)
        found = []
        for clearance_m in (_CLEARANCE_M, _STANDING_CLEARANCE_M):
            row, col = np.nonzero((reachable & (plan.clearance_m > clearance_m))[::8, ::8])
            xy_m = plan.grid.centres_m(8 * row, 8 * col)
            far = np.hypot(xy_m[:, 0] - start.x_m, xy_m[:, 1] - start.y_m) > _START_GAP_M
            found.append(xy_m[far])
        if not len(found[0]):
            raise WorldError(
                f"sim.people: world {self.name} has no free floor for people {_START_GAP_M} m or "
                "more from the robot's start; set sim.people: 0 or another sim.start"
            )
        return found[0], found[1] if len(found[1]) else found[0]


def with_people(world: World, config: Config, start: SE2) -> World:
    """Return the world with `sim.people` people and `sim.doors` in it; without any, the world."""
    doors = make_doors(world, config.sim.doors, config.sim.seed, start)
    return PeopledWorld(world, config, start, doors) if config.sim.people or doors else world


def _walking_costs(plan: FloorPlan) -> CostMap:
    """Return the free floor for people, in cells of `_STRIDE` cells of the plan."""
    free = (plan.clearance_m > _CLEARANCE_M - 0.05)[::_STRIDE, ::_STRIDE].astype(np.uint8)
    grid = Grid(free, plan.grid.origin_xy_m, _STRIDE * plan.grid.resolution_m)
    return CostMap(np.pad(free, 1), grid, min_weight=1, h_weight=1, unit=1)


def _body(object_id: int, person: Person) -> tuple[WorldObject, list[Primitive]]:
    """Return a person as an object with two solids: body and head."""
    wide_m, tall_m = 2.0 * PERSON_RADIUS_M, _HEIGHT_M - _HEAD_M
    color = _COLORS[person.number % len(_COLORS)]
    x_m, y_m = person.xy_m.tolist()
    parts = [
        Primitive(kernels.CYLINDER, (0.0, 0.0, 0.5 * tall_m), (wide_m, wide_m, tall_m), color),
        Primitive(
            kernels.ELLIPSOID, (0.0, 0.0, tall_m + 0.5 * _HEAD_M), (0.2, 0.2, _HEAD_M),
            (205.0, 160.0, 130.0),
        ),
    ]  # fmt: skip
    item = WorldObject(
        object_id, f"person-{object_id}", "person", "person", (x_m, y_m, 0.5 * _HEIGHT_M),
        (wide_m, wide_m, _HEIGHT_M), 0.0,
    )  # fmt: skip
    return item, [part.placed(x_m, y_m, 0.0, 0.0) for part in parts]

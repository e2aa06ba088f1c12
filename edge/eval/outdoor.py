"""Outdoor episodes: a street as LiDAR shows it, an instruction, and the trajectory that is meant.

    for number in range(200):
        episode = outdoor_episode(number)

Everything is known, not perceived: occupancy, regions and boxes are the street's own, points are a
LiDAR's of 64 rings. What no point fell on is not in the scene.

The reference is made by a rule, in the place of OpenNav's hand-drawn one (IV-B):

| said | it leads |
|---|---|
| go to A | to the nearest point to A that can be reached, on the side one comes from |
| drive past the left of A, then stop at B | by a point `BESIDE_M` beside A, on the side that the robot sees to the left of A as it stands; then as to B |
| go around the left of A, then stop at B | along an arc at that distance, from that side of A to behind it; then as to B |
| go to A, then stop at B | as to A, then as to B |

From point to point it is the cheapest way for one who keeps `COMFORT_M` away from things where there
is room, over drivable ground and no other.
"""  # noqa: E501 (a table)

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.geometry import SE2, Grid, se3
from edge.sim import kernels
from edge.sim.base import FLOOR_CLEARANCE_M, Fan
from edge.sim.boxworld import Part
from edge.sim.generator.draws import Dice
from edge.sim.street import Street, Thing, solids, street
from edge.tasks.scene import Region, Scene, SceneObject
from edge.tasks.value_map import closed_cells
from edge.trajectory import astar, smoothing
from edge.trajectory.costmap import CostMap, from_occupancy

CELL_M = 0.2
ROBOT_M, HEIGHT_M = 0.4, 1.0
BESIDE_M, COMFORT_M = 1.2, 1.0
RINGS, COLUMNS, RANGE_M = 64, 1024, 60.0
ELEVATION_RAD = math.radians(-24.8), math.radians(2.0)
"""Of an HDL-64E, whose scans SemanticKITTI holds."""
LIDAR_M = 1.73
LEAST_POINTS = 8
KINDS = ("to", "past", "around", "then")
_X_M, _Y_M = (-12.0, 44.0), (-20.0, 20.0)
_FROM_M, _TO_M = 7.0, 36.0  # how far from the robot a task's things are
_AHEAD_RAD = math.radians(60.0)  # and in which direction
_ASIDE_RAD = math.radians(8.0)
_PAST_RAD, _AROUND_RAD = (90.0,), (60.0, 90.0, 120.0, 150.0, 180.0)  # degrees, see `_beside`
_ORDER = ("nearest", "second", "third")
_TRIES = 200
_KEY = 17


@dataclass(frozen=True, slots=True, eq=False)
class OutdoorEpisode:
    """A task, and what it means.

    Attributes:
        kind: of `KINDS`.
        scene: without a camera; `map` is where the robot stands.
        cloud_m: (n, 3) float32, the whole scan in `map`.
        segments: (n, 2) float64 each, the points that the rule leads by; one who understands the
            instruction and knows no map would draw straight lines between them.
        regions: ids of the regions that may be driven over.
        reference_m: (n, 2) float64.
    """

    name: str
    kind: str
    instruction: str
    scene: Scene
    cloud_m: np.ndarray
    segments: tuple[np.ndarray, ...]
    regions: tuple[int, ...]
    reference_m: np.ndarray


def outdoor_episode(number: int) -> OutdoorEpisode:
    """The episode of a number, the same everywhere; kinds take turns.

    Streets are drawn until one has a task of that kind.
    """
    for attempt in range(_TRIES):
        drawn = street(number, attempt)
        scene, cloud_m = outdoor_scene(drawn)
        task = _task(Dice(_KEY, number, attempt), scene, KINDS[number % len(KINDS)])
        if task is not None:
            instruction, segments, reference_m = task
            return OutdoorEpisode(
                drawn.name, KINDS[number % len(KINDS)], instruction, scene, cloud_m, segments,
                tuple(scene.regions), reference_m,
            )  # fmt: skip
    raise AssertionError(f"no street of {_TRIES} has a task for episode {number}")


def outdoor_scene(drawn: Street) -> tuple[Scene, np.ndarray]:
    """The scene of a street, and the scan (n, 3) float32 in `map`."""
    floor, stood = solids(drawn)
    parts = floor + [part for _, mine in stood for part in mine]
    shape = np.array([part.shape for part in parts], np.uint8)
    pose = np.array([_row(part) for part in parts])
    cloud_m = _scan(shape, pose)
    occupancy = _occupancy(shape, pose)
    regions_grid = _regions_grid(drawn, occupancy)
    here = SE2(0.0, 0.0, 0.0)
    reachable = _reachable(occupancy, here)
    objects = {}
    seen = [(thing, _points_on(mine, cloud_m)) for thing, mine in stood]
    seen.sort(
        key=lambda item: math.dist((item[0].x_m, item[0].y_m), (drawn.start.x_m, drawn.start.y_m))
    )
    for thing, points_m in seen:
        at = drawn.to_map(thing.x_m, thing.y_m, thing.yaw_rad)
        if len(points_m) >= LEAST_POINTS and occupancy.cell_of(at.x_m, at.y_m) is not None:
            number = len(objects) + 1
            objects[number] = _object(number, thing, at, points_m, regions_grid, reachable)
    regions = {}
    for ground in drawn.grounds:
        cells = int((regions_grid.cells == ground.id).sum())
        if cells:
            regions[ground.id] = Region(ground.id, ground.label, cells * CELL_M**2)
    scene = Scene(0, here, objects, regions, occupancy, regions_grid, None, None, None, {})
    return scene, cloud_m


def phrase(scene: Scene, item: SceneObject) -> str | None:
    """What a person would call a thing and mean no other; None: too many are like it.

    By its colour where no other has it, else by its place in the row of its kind on one side.
    """
    like = [other for other in scene.objects.values() if other.label == item.label]
    if len(like) == 1:
        return f"the {item.label}"
    colour = item.caption.split()[0]
    if colour != item.label and [o.caption.split()[0] for o in like].count(colour) == 1:
        return f"the {colour} {item.label}"
    bearing = scene.pose.bearing_to(*item.position_m[:2])
    if not _ASIDE_RAD < abs(bearing) < math.pi / 2:
        return None
    row = [
        other for other in like
        if bearing * scene.pose.bearing_to(*other.position_m[:2]) > 0
    ]  # fmt: skip
    row.sort(key=lambda other: scene.pose.distance_to(*other.position_m[:2]))
    place = row.index(item)
    if place >= len(_ORDER):
        return None
    return f"the {_ORDER[place]} {item.label} on the {'left' if bearing > 0 else 'right'}"


def _task(
    dice: Dice, scene: Scene, kind: str
) -> tuple[str, tuple[np.ndarray, ...], np.ndarray] | None:
    """(instruction, segments, reference), or None where the scene has no such task."""
    named = {}
    for item in scene.objects.values():
        called = phrase(scene, item)
        if (
            called
            and item.nearest_m
            and _FROM_M < scene.pose.distance_to(*item.position_m[:2]) < _TO_M
        ):
            named[item.id] = called
    costmap = from_occupancy(
        _drivable(scene), clearance_m=ROBOT_M, near_m=COMFORT_M, unknown_cost=None
    )
    for first in dice.shuffled(sorted(named)):
        for last in dice.shuffled(sorted(named)):
            if (kind == "to") != (first == last):
                continue
            for side in dice.shuffled(("left", "right")):
                segments = _segments(scene, kind, scene.objects[first], scene.objects[last], side)
                reference_m = _way(costmap, scene.pose, segments) if segments else None
                if reference_m is not None:
                    return _words(kind, side, named[first], named[last]), segments, reference_m
    return None


def _words(kind: str, side: str, first: str, last: str) -> str:
    return {
        "to": f"go to {first}",
        "past": f"drive past the {side} of {first}, then stop at {last}",
        "around": f"go around the {side} of {first}, then stop at {last}",
        "then": f"go to {first}, then stop at {last}",
    }[kind]


def _segments(
    scene: Scene, kind: str, first: SceneObject, last: SceneObject, side: str
) -> tuple[np.ndarray, ...]:
    """The points that the rule leads by; () where it is not to be followed."""
    here = (scene.pose.x_m, scene.pose.y_m)
    if kind == "to":
        return (_stop(last, here)[None],)
    if kind == "then":
        way = _stop(first, here)[None]
        end = _stop(last, way[-1])[None]
        return (way, end) if math.dist(way[-1], end[-1]) > 3.0 else ()
    if kind == "past" and _away(scene, last) < _away(scene, first) + 3.0:
        return ()
    degrees = _PAST_RAD if kind == "past" else _AROUND_RAD
    way = np.array([_beside(scene.pose, first, side, math.radians(d)) for d in degrees])
    return way, _stop(last, way[-1])[None]


def _beside(pose: SE2, item: SceneObject, side: str, angle_rad: float) -> tuple[float, float]:
    """A point `BESIDE_M` off a thing's box; seen from the thing, it lies at an angle from the
    robot: 0 before it, a right angle on its side, pi behind it."""
    x_m, y_m = item.position_m[:2].tolist()
    back = math.atan2(pose.y_m - y_m, pose.x_m - x_m)
    # Who looks at the thing has its left to his left: clockwise as the thing looks back.
    toward = back - angle_rad if side == "left" else back + angle_rad
    turn = toward - item.heading_rad
    off_m = BESIDE_M + 0.5 * (
        abs(math.cos(turn)) * item.size_m[0] + abs(math.sin(turn)) * item.size_m[1]
    )
    return x_m + off_m * math.cos(toward), y_m + off_m * math.sin(toward)


def _way(costmap: CostMap, pose: SE2, segments: Sequence[np.ndarray]) -> np.ndarray | None:
    """The cheapest way by all points, pulled straight; None where one cannot be reached."""
    points = np.concatenate([[(pose.x_m, pose.y_m)], *segments])
    if not all(costmap.is_free(*point) for point in points.tolist()):
        return None
    pieces, workspace = [], astar.Workspace()
    for start, end in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
        plan = astar.plan(costmap, tuple(start), tuple(end), workspace)
        # A detour of twice the distance is not what anybody means.
        if not plan.ok or plan.cost_m > 3.0 * math.dist(start, end) + 5.0:
            return None
        pieces.append(smoothing.smooth(costmap, plan.path_m, CELL_M)[1 if pieces else 0 :])
    return np.concatenate(pieces)


def _stop(item: SceneObject, from_xy_m: Sequence[float]) -> np.ndarray:
    """Where one who comes from a point stops at a thing: of the points that can be reached, one for
    each region, the first on his way of those that are about as near to it as the nearest."""
    points = np.array(list(item.nearest_m.values()))
    gaps = _gaps_m(points, item.position_m, item.size_m, item.heading_rad)
    near = points[gaps < gaps.min() + 0.5]
    return near[int(np.argmin(np.hypot(*(near - from_xy_m).T)))]


def _gaps_m(
    points_m: np.ndarray, position_m: np.ndarray, size_m: np.ndarray, heading_rad: float
) -> np.ndarray:
    """(n,): how far points (n, 2) are from a box on the ground, 0 inside."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    local = np.abs((points_m - position_m[:2]) @ np.array([[c, -s], [s, c]]))
    return np.hypot(*np.maximum(local - 0.5 * size_m[:2], 0.0).T)


def _away(scene: Scene, item: SceneObject) -> float:
    return scene.pose.distance_to(*item.position_m[:2].tolist())


def _drivable(scene: Scene) -> Grid:
    """The occupancy, with all that is no region as occupied."""
    cells = np.where(scene.regions_grid.cells > 0, scene.occupancy.cells, np.int8(100))
    return replace(scene.occupancy, cells=cells)


def _scan(shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
    low, high = ELEVATION_RAD
    elevation = np.linspace(low, high, RINGS)[:, None]
    azimuth = (-math.pi + 2 * math.pi / COLUMNS * np.arange(COLUMNS))[None]
    parts = (
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation) + 0 * azimuth,
    )
    fan = Fan(np.stack(parts, axis=-1), low, (high - low) / (RINGS - 1), RANGE_M)
    ranges_m = np.empty((RINGS, COLUMNS), np.float32)
    T_map_lidar = se3(0.0, 0.0, LIDAR_M)
    kernels.cast_fan(
        shape, pose, T_map_lidar, fan.directions, fan.el_min_rad, fan.el_step_rad, ranges_m
    )
    hit = ranges_m <= fan.range_m
    points = fan.directions[hit] * ranges_m[hit][:, None] + T_map_lidar[:3, 3]
    return points.astype(np.float32)


def _occupancy(shape: np.ndarray, pose: np.ndarray) -> Grid:
    """Occupied where something is between the ground and the robot's height; else free."""
    columns, rows = (round((high - low) / CELL_M) for low, high in (_X_M, _Y_M))
    solid = np.zeros((rows, columns), np.uint8)
    origin = np.array([_X_M[0], _Y_M[0]])
    kernels.rasterise(shape, pose, FLOOR_CLEARANCE_M, HEIGHT_M, origin, CELL_M, solid)
    return Grid((solid * 100).astype(np.int8), (_X_M[0], _Y_M[0]), CELL_M)


def _regions_grid(drawn: Street, occupancy: Grid) -> Grid:
    rows, columns = np.indices(occupancy.cells.shape)
    x_m, y_m = np.moveaxis(drawn.to_road(occupancy.centres_m(rows, columns)), -1, 0)
    cells = np.zeros(occupancy.cells.shape, np.uint8)
    for ground in drawn.grounds:
        r = ground.rect
        cells[(x_m >= r.x0) & (x_m < r.x1) & (y_m >= r.y0) & (y_m < r.y1)] = ground.id
    return replace(occupancy, cells=cells)


def _reachable(occupancy: Grid, here: SE2) -> np.ndarray:
    """(h, w) bool: where a robot of radius `ROBOT_M` gets to."""
    is_open = (~closed_cells(occupancy, ROBOT_M)).astype(np.uint8)
    _, part = cv2.connectedComponents(is_open, connectivity=4)
    return part == part[occupancy.cell_of(here.x_m, here.y_m)]


def _object(
    number: int, thing: Thing, at: SE2, points_m: np.ndarray, regions: Grid, reachable: np.ndarray
) -> SceneObject:
    length, width, height = thing.size_m
    position_m, size_m = np.array([at.x_m, at.y_m, 0.5 * height]), np.array(thing.size_m)
    nearest = {}
    for region in np.unique(regions.cells[reachable & (regions.cells > 0)]).tolist():
        centres = regions.centres_m(*np.nonzero((regions.cells == region) & reachable))
        gaps = _gaps_m(centres, position_m, size_m, at.yaw_rad)
        nearest[region] = tuple(centres[int(np.argmin(gaps))].tolist())
    size = f"{length:.1f} x {width:.1f} x {height:.1f} m"
    return SceneObject(
        id=number,
        label=thing.label,
        caption=f"{thing.colour} {thing.label}, {size}".strip(),
        position_m=position_m,
        size_m=size_m,
        heading_rad=at.yaw_rad,
        points_m=points_m,
        nearest_m=nearest,
    )


def _points_on(parts: Sequence[Part], cloud_m: np.ndarray) -> np.ndarray:
    """The points (n, 3) of a scan that lie on one of these parts."""
    centers = np.array([part.center_m for part in parts], np.float32)
    halves = 0.5 * np.array([part.size_m for part in parts], np.float32) + 0.01
    reach = np.linalg.norm(halves, axis=1)[:, None]
    low, high = (centers - reach).min(axis=0), (centers + reach).max(axis=0)
    near = cloud_m[((cloud_m > low) & (cloud_m < high)).all(axis=1)]
    on = np.zeros(len(near), bool)
    for part, center, half in zip(parts, centers, halves, strict=True):
        c, s = math.cos(part.yaw_rad), math.sin(part.yaw_rad)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
        local = np.abs((near - center) @ turn) / half
        is_crown = part.shape == kernels.ELLIPSOID
        on |= (np.linalg.norm(local, axis=1) if is_crown else local.max(axis=1, initial=0.0)) <= 1.0
    return near[on]


def _row(part: Part) -> list[float]:
    half = [0.5 * extent for extent in part.size_m]
    return [*part.center_m, *half, math.cos(part.yaw_rad), math.sin(part.yaw_rad)]

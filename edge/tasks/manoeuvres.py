"""Points and cuts of paths for kinds of steps: onto ground, across it, once around, short of.

The planner `edge.tasks.rules` uses them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, pairwise

import cv2
import numpy as np

from edge.geometry import SE2
from edge.tasks.functions import PASSING_DISTANCE_M, CallError, Point, ScriptFunctions
from edge.tasks.scene.ground import ReachableGround, ground_of
from edge.tasks.scene.scene import SceneObject
from edge.tasks.sentences.phrases import ground_kind
from edge.tasks.sentences.steps import RouteLimits
from edge.trajectory.pursuit import length_m
from edge.trajectory.smoothing import resample

AVOID_M = 1.0
"""Distance that the robot's outline keeps from what it avoids, in addition to its clearance."""
INSIDE_M = 0.5
"""The robot stops this far inside the ground to which it was sent, if there is room."""
_ALONG_COS = math.cos(math.radians(60.0))  # of the largest angle between heading and object
_STEP_M = 0.1  # spacing of the points at which a path is measured


def regions_of(ground: ReachableGround, kinds: Sequence[str]) -> list[int]:
    """Return the ids of the regions of some kinds of ground."""
    regions = ground.scene.regions.values()
    return [region.id for region in regions if ground_kind(region.label) in kinds]


def limited_ground(
    ground: ReachableGround, limits: RouteLimits, clearance_m: float
) -> ReachableGround:
    """Return the ground without the cells that an instruction avoids.

    Raises:
        CallError: the robot stands there.
    """
    if not (limits.avoid or limits.avoid_ground):
        return ground
    scene = ground.scene
    cells, occupancy = scene.occupancy.cells.copy(), scene.occupancy
    centres_m = occupancy.centres_m(*np.indices(cells.shape).reshape(2, -1))
    for obj in limits.avoid:
        near = ground.outline(obj).gaps_m(centres_m) <= AVOID_M
        cells[near.reshape(cells.shape)] = 100
    cells[_mask(ground, limits.avoid_ground)] = 100
    closed = replace(scene, occupancy=replace(occupancy, cells=cells))
    limited = ground_of(closed, clearance_m)
    if not limited.reachable.any():
        raise CallError(f"the robot stands too near to what it is to {limits}")
    return limited


def _mask(ground: ReachableGround, kinds: Sequence[str]) -> np.ndarray:
    """Return the cells of some kinds of ground, (h, w) bool."""
    return np.isin(ground.scene.regions_grid.cells, regions_of(ground, kinds))


def point_on(ground: ReachableGround, kind: str, at: Point) -> Point:
    """Return the nearest place on a kind of ground, `INSIDE_M` from its border if possible."""
    mask = _mask(ground, (kind,))
    size = 2 * round(INSIDE_M / ground.scene.occupancy.resolution_m) + 1
    inside = cv2.erode(mask.view(np.uint8), np.ones((size, size), np.uint8)) > 0
    for cells in (inside & ground.reachable, mask & ground.reachable):
        centres_m = ground.scene.occupancy.centres_m(*np.nonzero(cells))
        if len(centres_m):
            x, y = centres_m[np.argmin(np.hypot(*(centres_m - at).T))].tolist()
            return x, y
    raise CallError(f"the robot cannot get onto the {kind}")


def points_across(ground: ReachableGround, kind: str, at: Point) -> list[Point]:
    """Return the nearest place on a kind of ground, and the place behind it on the other side."""
    ids = regions_of(ground, (kind,))
    if ground.region_at(*at) in ids:
        raise CallError(f"the robot is on the {kind} already; say where to go")
    found = [p for k in ids if (p := ground.nearest(*at, region=k)) is not None]
    if not found:
        raise CallError(f"the robot cannot get onto the {kind}")
    near = min(found, key=lambda p: math.dist(p, at))
    across = SE2(*near, math.atan2(near[1] - at[1], near[0] - at[0]))
    far = near
    for k in range(1, 1 + round(max(ground.scene.occupancy.cells.shape)
                                * ground.scene.occupancy.resolution_m / _STEP_M)):  # fmt: skip
        far = across.ahead(k * _STEP_M)
        if ground.region_at(*far) not in ids:
            break
    beyond = SE2(*far, across.yaw_rad).ahead(INSIDE_M)
    end = ground.nearest(*beyond, within_m=INSIDE_M)
    if end is None or ground.region_at(*end) in ids:
        raise CallError(f"the robot found no room on the other side of the {kind}")
    return [near, end]


def points_around(
    functions: ScriptFunctions, obj: SceneObject, side: str, at: Point, snap_m: float
) -> list[Point]:
    """Return points on a full circle around an object, from a point next to it back to that point.

    Raises:
        CallError: the robot cannot be at one of them.
    """
    ground = functions.ground
    found = []
    for point in functions.arc(obj.id, at, at, side, PASSING_DISTANCE_M):
        snapped = ground.nearest(*point, within_m=snap_m)
        if snapped is None or not ground.has_clear_view_of(obj, snapped):
            raise CallError(f"there is no room for the robot all around {obj.label} {obj.id}")
        found.append(snapped)
    return found


def points_along(
    functions: ScriptFunctions, obj: SceneObject, here: SE2, towards: Point | None, snap_m: float
) -> list[Point]:
    """Return points along the robot's side of an object, from the nearest one to an end of it.

    The end is the one towards a point, or else the one ahead of the robot.

    Raises:
        CallError: neither end is ahead, or the robot cannot be at one of the points.
    """
    (cx, cy), name = obj.position_m[:2].tolist(), f"{obj.label} {obj.id}"
    axis = SE2(cx, cy, obj.heading_rad)
    tx, ty = towards or here.ahead(1.0)
    origin = (cx, cy) if towards else (here.x_m, here.y_m)
    bearing_rad = math.atan2(ty - origin[1], tx - origin[0]) - axis.yaw_rad
    if towards is None and abs(math.cos(bearing_rad)) < _ALONG_COS:
        raise CallError(f"it is not clear in which direction to go along {name}; say to what")
    if math.cos(bearing_rad) < 0.0:
        axis = SE2(cx, cy, axis.yaw_rad + math.pi)
    length_m, width_m = obj.size_m[:2].tolist()
    dx, dy = here.x_m - cx, here.y_m - cy
    c, s = math.cos(axis.yaw_rad), math.sin(axis.yaw_rad)
    ahead_m = min(max(c * dx + s * dy, -0.5 * length_m), 0.5 * length_m)
    aside_m = math.copysign(0.5 * width_m + PASSING_DISTANCE_M, c * dy - s * dx)
    points = []
    for k in np.linspace(ahead_m, 0.5 * length_m, 1 + math.ceil(0.5 * length_m - ahead_m)):
        at = cx + k * c - aside_m * s, cy + k * s + aside_m * c
        snapped = functions.ground.nearest(*at, within_m=snap_m)
        if snapped is None or not functions.ground.has_clear_view_of(obj, snapped):
            raise CallError(f"there is no room for the robot all along {name}")
        points.append(snapped)
    return points


def path_straight_until(functions: ScriptFunctions, obj: SceneObject, here: SE2) -> list[Point]:
    """Return the path straight on until the robot is level with an object, or in front of it.

    Raises:
        CallError: the object is behind the robot, or something else is in the way.
    """
    at, (x, y) = (here.x_m, here.y_m), obj.position_m[:2].tolist()
    level_m = math.hypot(x - at[0], y - at[1]) * math.cos(here.bearing_to(x, y))
    if level_m <= _STEP_M:
        raise CallError(f"{obj.label} {obj.id} is not ahead of the robot")
    path = functions.line(at, here.ahead(level_m))
    dense = resample(np.array(path), _STEP_M)
    free = [functions.is_free(p) for p in dense.tolist()]
    blocked = next((k for k, ok in enumerate(free) if not ok and k), None)
    if blocked is None:
        return path
    end = (float(dense[blocked - 1, 0]), float(dense[blocked - 1, 1]))
    gap_m = functions.ground.outline(obj).gaps_m(dense[blocked - 1 : blocked])[0]
    if gap_m > PASSING_DISTANCE_M or blocked < 2:
        raise CallError(f"the path straight on is blocked after {math.dist(at, end):.1f} m")
    return functions.line(at, end)


def cut_before(
    functions: ScriptFunctions, path: list[Point], obj: SceneObject, gap_m: float
) -> list[Point]:
    """Return a path up to a distance from an object's outline.

    Raises:
        CallError: the path does not come from farther away to this distance.
    """
    dense = resample(np.array(path), _STEP_M)
    near = np.flatnonzero(functions.ground.outline(obj).gaps_m(dense) <= gap_m)
    name = f"{obj.label} {obj.id}"
    if not len(near):
        raise CallError(f"the robot gets no nearer than {gap_m:g} m to {name}")
    if near[0] == 0:
        raise CallError(f"the robot is nearer than {gap_m:g} m to {name} already")
    return cut_at(path, length_m(dense[: near[0] + 1]))


def cut_at(path: Sequence[Point], length_m: float) -> list[Point]:
    """Return the first `length_m` of a path; at most the entire path."""
    done = [0.0, *accumulate(math.dist(a, b) for a, b in pairwise(path))]
    n = next((k for k, m in enumerate(done) if m >= length_m), len(path))
    if n in (0, len(path)):
        return list(path[: n + 1])
    (x, y), (tx, ty) = path[n - 1], path[n]
    share = (length_m - done[n - 1]) / (done[n] - done[n - 1])
    return [*path[:n], (x + share * (tx - x), y + share * (ty - y))]

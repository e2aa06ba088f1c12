"""Makes instructions and their reference trajectories (OpenNav IV).

The paper draws them by hand; here a rule makes them.

| instruction | reference |
|---|---|
| go to A, stop at A | to the stop at A. Candidates are points with a free line to A, nearly as near to A as the nearest (`ABOUT_M`). The stop is the candidate nearest to where the robot comes from |
| drive past the left of A, then stop at B | by a point abeam of A, on its left as seen from the robot's start; then to the stop at B |
| go around the left of A, then stop at B, if B is behind A or on its other side | along an arc on that side of A, up to the direction of B; then to the stop at B |
| go to A, then stop at B | to the stop at A, then to the stop at B |

A stop at A is a point where the robot is at A when it stops. A point abeam of A is next to it, at a
right angle to the line from the robot's start, and leaves `ASIDE_M` between A and the robot. From
point to point the reference is the cheapest path over drivable ground. A cell is closed if the robot's
centre cannot be there, else open. Open cells within `COMFORT_M` of closed ones cost more. If a path is
longer than twice the straight line plus 5 m, the task is left out.

An object gets an unambiguous name:

| name | category |
|---|---|
| the car: there is only one; the red car: only one is red | specific |
| the second car on the left: counted from the nearest, if the order is clear | ambiguous |
| any instruction that leads past one object to another | high-level |

The module does not use the planner of `edge.tasks`, so the references are independent of it.
"""  # noqa: E501 (a table)

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import cv2
import numpy as np
from scipy.spatial import cKDTree

from edge import names
from edge.geometry import SE2, Grid
from edge.lab.sim.generator.rng import PortableRng
from edge.tasks.scene.value_map import closed_cells
from edge.trajectory import astar, smoothing
from edge.trajectory.costmap import CostMap, from_occupancy, from_weights
from edge.trajectory.pursuit import length_m

KINDS = ("to", "past", "around", "then")
"""Kinds of instructions: the rows of the first table above, from the top."""
Category = Literal["specific", "ambiguous", "high-level"]
CATEGORIES: tuple[Category, ...] = get_args(Category)
ASIDE_M = 0.8
"""Gap between an object and a robot that drives past or around it."""
COMFORT_M = 1.0
"""Distance from closed cells within which open cells cost more."""
ABOUT_M = 0.35
"""A candidate for a stop is farther from the object than the nearest one by at most this."""
MAX_STOP_M = 4.0
"""A stop farther from an object than this does not count as going to it."""
UNSEEN_M = 0.45
"""Ground that no frame shows, within this distance of ground that one shows, may be open or not."""
SAME_M = 1.0
"""The end of a task is certain if it moves by at most this when such ground is open."""
ESCAPE_M = 1.0
"""A robot on a closed cell begins at the nearest open cell, if it is within this distance."""
_AHEAD_RAD = math.radians(60.0)  # largest bearing of a task's objects
_ASIDE_RAD = math.radians(8.0)  # a smaller bearing is neither left nor right
_APART_M = 1.0  # least difference in distance between objects that are counted
_ARC_FROM_RAD = math.radians(60.0)  # angle of the first point of an arc; `_abeam` defines angles
_ARC_STEP_RAD = math.radians(30.0)  # between two points of an arc
# Smallest and largest angle of B in "go around A, then stop at B".
_AROUND_RAD = math.radians(150.0), math.radians(300.0)
_ORDER = ("nearest", "second", "third")
# The viewer's left is clockwise from the direction object → viewer.
_TURN_SIGN = {"left": -1.0, "right": 1.0}  # 1: the angles of `_abeam` count counterclockwise
_MIN_LEG_M = 3.0  # least distance between the two parts of an instruction
_OWN_CELLS = 1.5  # how far an object's occupied cells may be outside its outline


@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """An object that an instruction may name.

    Attributes:
        look: a word that distinguishes it from others of its class, such as its colour; "": none.
        at_m: (2,) float64, its middle in `map`.
        outline_m: (n, 2) float64, n >= 1, points of its outline on the ground, at most a cell
            apart.
    """

    id: int
    label: str
    look: str
    at_m: np.ndarray
    outline_m: np.ndarray


@dataclass(frozen=True, eq=False)
class ReferenceScene:
    """A place with its objects, and the pose of a robot.

    Attributes:
        occupancy: int8 cells, 100 for occupied. The robot can drive over all others if `drivable`.
        drivable: (h, w) bool, the same cells.
        reach_m: smallest and largest distance of a task's objects from the robot.
        unseen: (h, w) bool, cells that nothing shows; None: all is known.
    """

    pose: SE2
    landmarks: tuple[Landmark, ...]
    occupancy: Grid
    drivable: np.ndarray
    robot_m: float
    reach_m: tuple[float, float]
    unseen: np.ndarray | None = None

    @cached_property
    def if_open(self) -> ReferenceScene | None:
        """The same place if unseen ground within `UNSEEN_M` is open; None: all is known."""
        if self.unseen is None:
            return None
        away = cv2.distanceTransform(self.unseen.view(np.uint8), cv2.DIST_L2, 5)
        near = self.unseen & (away * self.occupancy.resolution_m <= UNSEEN_M)
        return replace(self, drivable=self.drivable | near, unseen=None)

    @cached_property
    def costmap(self) -> CostMap:
        """Costs of the robot's centre, which rise near obstacles."""
        closed = closed_cells(self.occupancy, self.robot_m) | ~self.drivable
        grid = replace(self.occupancy, cells=(closed * 100).astype(np.int8))
        return from_occupancy(grid, near_m=COMFORT_M, unknown_cost=None)

    @cached_property
    def reachable(self) -> np.ndarray:
        """(h, w) bool: True if the robot can get there."""
        # A weight of 0 means closed. The cost map has a border of one cell around the grid's.
        is_open = self.costmap.weight[1:-1, 1:-1] != 0
        begin = self.begin_m
        if begin is None:
            return np.zeros_like(is_open)
        _, part = cv2.connectedComponents(is_open.view(np.uint8), connectivity=4)
        return part == part[self.occupancy.cell_of(*begin)]

    @cached_property
    def stops_m(self) -> dict[int, np.ndarray]:
        """Cache of `_stop`: by id of an object, (n, 2) candidates for a stop."""
        return {}

    def gets_to(self, at_m: np.ndarray) -> bool:
        """Return True if the robot can get to a point."""
        cell = self.occupancy.cell_of(*at_m)
        return cell is not None and bool(self.reachable[cell])

    @cached_property
    def begin_m(self) -> tuple[float, float] | None:
        """Begin of the robot's paths: its place, or the nearest open cell; None: it is shut in."""
        here = (self.pose.x_m, self.pose.y_m)
        cell = self.costmap.cell_of(*here)
        if cell is None or self.costmap.weight[cell]:
            return None if cell is None else here
        nearest = astar.nearest_free(self.costmap, cell, here, ESCAPE_M)
        if nearest is None:
            return None
        # nearest: (row, column); its middle is half a cell further.
        x_m, y_m = self.costmap.metres_of(np.array([nearest[1] + 0.5, nearest[0] + 0.5])).tolist()
        return x_m, y_m


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryTask:
    """An instruction and its reference trajectory.

    Attributes:
        kind: one of `KINDS`.
        category: one of `CATEGORIES`.
        landmarks: ids of the objects that it names, in order.
        segments: by part of the instruction, (n, 2) float64: the points that the rule above
            prescribes, such as an arc or a stop. `reference_m` leads through all of them.
        reference_m: (n, 2) float64, from the robot's place.
        certain: False: the end would be elsewhere if unseen ground were open (`SAME_M`).
    """

    kind: str
    category: Category
    instruction: str
    landmarks: tuple[int, ...]
    segments: tuple[np.ndarray, ...]
    reference_m: np.ndarray
    certain: bool = True


def possible_tasks(place: ReferenceScene, kind: str, rng: PortableRng) -> Iterator[TrajectoryTask]:
    """Yield every task of a kind in a place, in random order."""
    named = {}  # by id of an object: its unambiguous name
    for landmark in place.landmarks:
        away_m = place.pose.distance_to(*landmark.at_m)
        within = place.reach_m[0] < away_m < place.reach_m[1]
        ahead = abs(place.pose.bearing_to(*landmark.at_m)) < _AHEAD_RAD
        if within and ahead and (words := referring_expression(place, landmark)):
            named[landmark.id] = words
    by_id = {landmark.id: landmark for landmark in place.landmarks}
    for first in rng.shuffled(sorted(named)):
        for last in rng.shuffled(sorted(named)):
            if (kind == "to") != (first == last):  # only "to" names a single object
                continue
            for side in rng.shuffled(("left", "right")):
                segments = _segments(place, kind, by_id[first], by_id[last], side)
                reference_m = _cheapest_path(place, segments) if segments else None
                if reference_m is None:
                    continue
                words = _instruction(kind, side, named[first], named[last])
                category = _category(kind, named[first])
                landmarks, certain = (first,) if kind == "to" else (first, last), True
                if place.if_open is not None:
                    others = _segments(place.if_open, kind, by_id[first], by_id[last], side)
                    certain = bool(others) and bool(
                        math.dist(others[-1][-1], segments[-1][-1]) <= SAME_M
                    )
                yield TrajectoryTask(
                    kind, category, words, landmarks, segments, reference_m, certain
                )
                break  # one side is enough


def referring_expression(place: ReferenceScene, landmark: Landmark) -> str | None:
    """Return an unambiguous name of an object; None if too many are like it."""
    # All objects that the word could mean, including this one.
    like = [other for other in place.landmarks if names.is_kind_of(other.label, landmark.label)]
    if len(like) == 1:
        return f"the {landmark.label}"
    if landmark.look and [other.look for other in like].count(landmark.look) == 1:
        return f"the {landmark.look} {landmark.label}"
    bearing, away_m = _bearing_and_distance(place, landmark)
    if not _ASIDE_RAD < abs(bearing) < math.pi / 2:
        return None
    before = 0  # number of such objects on the same side that are nearer
    for other in like:
        other_bearing, other_away_m = _bearing_and_distance(place, other)
        if other is landmark or other_away_m >= away_m + _APART_M:
            continue
        same_side = other_bearing * bearing > 0
        # Straight ahead or behind, a person may or may not count it.
        unclear = abs(other_bearing) <= _ASIDE_RAD or (
            same_side and abs(other_bearing) >= math.pi / 2
        )
        if unclear or (same_side and other_away_m > away_m - _APART_M):
            return None
        before += same_side
    if before >= len(_ORDER):
        return None
    return f"the {_ORDER[before]} {landmark.label} on the {'left' if bearing > 0 else 'right'}"


def box_outline_m(at_m: np.ndarray, size_m: np.ndarray, heading_rad: float) -> np.ndarray:
    """Return (n, 2) points around a box on the ground, 0.1 m apart."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    corners = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * size_m[:2]
    return smoothing.resample(corners @ np.array([[c, s], [-s, c]]) + at_m[:2], 0.1)


def _bearing_and_distance(place: ReferenceScene, landmark: Landmark) -> tuple[float, float]:
    """Return bearing [rad] and distance [m] from the robot."""
    return place.pose.bearing_to(*landmark.at_m), place.pose.distance_to(*landmark.at_m)


def _category(kind: str, name: str) -> Category:
    """Return the category of an instruction; `name` is that of its first object."""
    if kind != "to":
        return "high-level"
    return "ambiguous" if name.startswith(tuple(f"the {word} " for word in _ORDER)) else "specific"


def _instruction(kind: str, side: str, first: str, last: str) -> str:
    return {
        "to": f"go to {first}",
        "past": f"drive past the {side} of {first}, then stop at {last}",
        "around": f"go around the {side} of {first}, then stop at {last}",
        "then": f"go to {first}, then stop at {last}",
    }[kind]


def _segments(
    place: ReferenceScene, kind: str, first: Landmark, last: Landmark, side: str
) -> tuple[np.ndarray, ...]:
    """Return `TrajectoryTask.segments`; () if the rule cannot be followed."""
    here = np.array([place.pose.x_m, place.pose.y_m])
    if kind == "to":
        parts = [_stop(place, last, here)]
    elif kind == "then":
        parts = [_stop(place, first, here)]
    elif kind == "past":
        if (
            _bearing_and_distance(place, last)[1]
            < _bearing_and_distance(place, first)[1] + _MIN_LEG_M
        ):
            return ()
        parts = [_abeam(place, first, side, math.pi / 2)[None]]
    else:
        until_rad = _turn_rad(place, first, side, last.at_m)  # the angle of B
        if not _AROUND_RAD[0] <= until_rad <= _AROUND_RAD[1]:
            return ()
        angles_rad = np.arange(_ARC_FROM_RAD, until_rad, _ARC_STEP_RAD)
        parts = [np.array([_abeam(place, first, side, angle) for angle in angles_rad])]
    if kind != "to" and parts[0] is not None:
        parts.append(_stop(place, last, parts[0][-1]))
    if any(points is None for points in parts):
        return ()
    if kind == "then" and math.dist(parts[0][-1], parts[1][-1]) <= _MIN_LEG_M:
        return ()
    return tuple(parts)


def _abeam(place: ReferenceScene, landmark: Landmark, side: str, angle_rad: float) -> np.ndarray:
    """Return a point `ASIDE_M` off an object, in a direction relative to the robot.

    The angle is 0 on the robot's side of the object, a right angle on its `side`, and pi behind it.
    """
    toward = _direction_to_robot(place, landmark) + _TURN_SIGN[side] * angle_rad
    ray = np.array([math.cos(toward), math.sin(toward)])
    reach_m = float(((landmark.outline_m - landmark.at_m) @ ray).max())
    return landmark.at_m + (reach_m + ASIDE_M + place.robot_m) * ray


def _turn_rad(place: ReferenceScene, landmark: Landmark, side: str, at_m: np.ndarray) -> float:
    """Return the angle of a point around an object, as `_abeam` counts it, in [0, 2 pi)."""
    toward = math.atan2(at_m[1] - landmark.at_m[1], at_m[0] - landmark.at_m[0])
    return (_TURN_SIGN[side] * (toward - _direction_to_robot(place, landmark))) % math.tau


def _direction_to_robot(place: ReferenceScene, landmark: Landmark) -> float:
    """Return the direction from an object to the robot's start."""
    return math.atan2(place.pose.y_m - landmark.at_m[1], place.pose.x_m - landmark.at_m[0])


def _stop(place: ReferenceScene, landmark: Landmark, from_m: np.ndarray) -> np.ndarray | None:
    """Return the (1, 2) stop at an object, for a robot that comes from a point; None: no stop."""
    if landmark.id not in place.stops_m:
        place.stops_m[landmark.id] = _stops(place, landmark)
    near = place.stops_m[landmark.id]
    return near[np.argmin(np.hypot(*(near - from_m).T))][None] if len(near) else None


def _stops(place: ReferenceScene, landmark: Landmark) -> np.ndarray:
    """Return the (n, 2) candidates for a stop at an object.

    They have a free line to it, and are about as near to it as the nearest such point.
    """
    centres = place.occupancy.centres_m(*np.nonzero(place.reachable))
    within = MAX_STOP_M + ABOUT_M
    low, high = landmark.outline_m.min(axis=0) - within, landmark.outline_m.max(axis=0) + within
    centres = centres[((centres > low) & (centres < high)).all(axis=1)]
    gaps_m, nearest = cKDTree(landmark.outline_m).query(centres.reshape(-1, 2))
    others = _others(place, landmark)

    def has_clear_view_of(k: int) -> bool:
        return smoothing.line_is_free(others, centres[k], landmark.outline_m[nearest[k]])

    nearest_k = next((k for k in np.argsort(gaps_m, kind="stable") if has_clear_view_of(k)), None)
    if nearest_k is None or gaps_m[nearest_k] > MAX_STOP_M:
        return np.empty((0, 2))
    near = np.flatnonzero(gaps_m <= gaps_m[nearest_k] + ABOUT_M)
    return centres[[k for k in near if has_clear_view_of(k)]]


def _others(place: ReferenceScene, landmark: Landmark) -> CostMap:
    """Return a cost map that is closed at obstacles other than the object.

    Occupied cells within `_OWN_CELLS` of the object's outline are its own.
    """
    grid = place.occupancy
    outside = np.ones(grid.cells.shape, np.uint8)
    cells = np.floor(grid.to_cells(landmark.outline_m)).astype(np.int64)
    h, w = outside.shape
    column, row = cells[((cells >= 0) & (cells < (w, h))).all(axis=1)].T
    outside[row, column] = 0
    away = cv2.distanceTransform(outside, cv2.DIST_L2, 5)
    is_other = (grid.cells > 0) & (away > _OWN_CELLS)
    return from_weights(replace(grid, cells=(~is_other).astype(np.uint8)))


def _cheapest_path(place: ReferenceScene, segments: Sequence[np.ndarray]) -> np.ndarray | None:
    """Return the cheapest path by all points, smoothed; None if one cannot be reached."""
    costmap, begin = place.costmap, place.begin_m
    if begin is None:
        return None
    points = np.concatenate([[begin], *segments])
    if not all(map(place.gets_to, points)):
        return None
    pieces: list[np.ndarray] = []
    workspace = astar.Workspace()
    for start, end in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
        plan = astar.plan(costmap, tuple(start), tuple(end), workspace)
        if not plan.ok:
            return None
        piece = smoothing.smooth(costmap, plan.path_m, costmap.grid.resolution_m)
        if length_m(piece) > 2.0 * math.dist(start, end) + 5.0:
            return None
        pieces.append(piece[1:] if pieces else piece)
    here = (place.pose.x_m, place.pose.y_m)
    return np.concatenate([[here] if begin != here else np.empty((0, 2)), *pieces])

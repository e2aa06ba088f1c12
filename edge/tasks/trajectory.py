"""Coarse trajectories, and the checks that they must pass before the robot moves (OpenNav III-A3).

The writer of a trajectory is not trusted: a model may err, or a sign may mislead it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from edge.config import TrajectoryLimits
from edge.errors import UserError
from edge.geometry import FARTHEST_M
from edge.tasks.scene.ground import ESCAPE_M, ReachableGround
from edge.tasks.scene.value_map import IN_ZONE
from edge.text import one_line
from edge.trajectory.pursuit import CREEP_MPS

_SHOWN = 40  # most characters of a text from a script in a message
MAX_POINTS, MAX_SEGMENTS = 5_000, 50
"""Largest numbers of points and of segments of a trajectory that a script hands over."""


class TrajectoryError(UserError):
    """A trajectory that must not be driven; the message is also sent to the writer."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseTrajectory:
    """A trajectory as its writer gave it, before it is refined.

    Attributes:
        segments: (n, 2) float64 each, in `map`, n >= 1; each segment begins near the end
            of the segment before.
        regions: ids of the drivable regions in which it should stay; empty: any.
        speed_mps: requested speed; None: the robot's usual speed.
        heading_rad: heading at the end, such as towards the goal object; None: along the path.
    """

    segments: tuple[np.ndarray, ...]
    regions: tuple[int, ...] = ()
    speed_mps: float | None = None
    heading_rad: float | None = None

    @property
    def points_m(self) -> np.ndarray:
        """All points in a row, (n, 2) float64."""
        return np.concatenate([np.empty((0, 2)), *self.segments])


def coarse_of(
    segments: Any, regions: Any, speed_mps: Any, heading_rad: Any = None
) -> CoarseTrajectory:
    """Make a trajectory from the values that a script hands over, which may be anything.

    Args:
        segments: lists of points, or one list of points.
        regions: ids of regions; None: any.
        speed_mps: a number or None.
        heading_rad: a number or None.

    Raises:
        TrajectoryError: the values are not a trajectory.
    """
    segments = _items(segments, "segments", MAX_POINTS)
    if segments and _is_point(segments[0]):
        segments = [segments]
    if not 1 <= len(segments) <= MAX_SEGMENTS:
        raise TrajectoryError(
            f"the trajectory has {len(segments)} segments; give 1 to {MAX_SEGMENTS}"
        )
    rows = [_items(points, f"segment {k}", MAX_POINTS) for k, points in _enumerate_from_1(segments)]
    total = sum(map(len, rows))
    if not all(rows) or total > MAX_POINTS:
        empty = next((k for k, points in _enumerate_from_1(rows) if not points), None)
        what = f"segment {empty} is empty" if empty else f"the trajectory has {total} points"
        raise TrajectoryError(f"{what}; give 1 to {MAX_POINTS} points")
    arrays = tuple(_segment(points, k) for k, points in _enumerate_from_1(rows))
    chosen = _items(() if regions is None else regions, "regions", 255)
    for region in chosen:
        if type(region) is not int or not 0 < region <= 255:
            raise TrajectoryError(f"regions: expected ids from 1 to 255, got {shown(region)}")
    if speed_mps is not None:
        speed_mps = number(speed_mps, "speed_mps")
    if heading_rad is not None:
        heading_rad = math.remainder(number(heading_rad, "heading_rad"), math.tau)
    return CoarseTrajectory(arrays, tuple(dict.fromkeys(chosen)), speed_mps, heading_rad)


def check(coarse: CoarseTrajectory, ground: ReachableGround, limits: TrajectoryLimits) -> None:
    """Check that a trajectory may be refined and driven.

    Each point must be in the map, reachable, and clear of occupied cells. The step from the
    robot to the first point, and each step between points, must be at most `max_jump_m` long with
    nothing occupied in between. Within `ESCAPE_M` of the robot, points may be closer to an
    obstacle.

    Raises:
        TrajectoryError: the trajectory must not be driven; one line that names the first wrong
            point.
    """
    scene = ground.scene
    for k, points in _enumerate_from_1(coarse.segments):
        _check_points(points, k, ground)
    if unknown := [region for region in coarse.regions if region not in scene.regions]:
        there = ", ".join(map(str, scene.regions)) or "none"
        raise TrajectoryError(f"regions: there is no region {unknown[0]} (known: {there})")
    speed_mps = coarse.speed_mps
    # NaN fails this comparison too.
    if speed_mps is not None and not CREEP_MPS <= speed_mps <= limits.max_speed_mps:
        raise TrajectoryError(
            f"speed_mps: {speed_mps:g} is not within {CREEP_MPS:g} to {limits.max_speed_mps:g} m/s"
        )
    path_m = np.vstack([(scene.pose.x_m, scene.pose.y_m), coarse.points_m])
    steps_m = np.hypot(*np.diff(path_m, axis=0).T)
    for k, (step_m, a, b) in enumerate(zip(steps_m, path_m[:-1], path_m[1:], strict=True)):
        before = "the point before it" if k else "the robot"
        if step_m > limits.max_jump_m:
            raise TrajectoryError(
                f"{_point_name(coarse.segments, k)} is {step_m:.1f} m from {before}, at most "
                f"{limits.max_jump_m:g} m are allowed; join the two with a_star_plan or line"
            )
        if not ground.has_line_of_sight(tuple(a), tuple(b)) and math.dist(b, path_m[0]) > ESCAPE_M:
            raise TrajectoryError(
                f"an obstacle is between {_point_name(coarse.segments, k)} and "
                f"{before}; join the two with a_star_plan"
            )
    if (length_m := float(steps_m.sum())) > limits.max_length_m:
        raise TrajectoryError(
            f"the trajectory is {math.ceil(10 * length_m) / 10:g} m long, at most "
            f"{limits.max_length_m:g} m are allowed; give a shorter one"
        )


def number(value: Any, name: str, largest: float = FARTHEST_M) -> float:
    """Return a finite number from a script as a float.

    Raises:
        TrajectoryError: the value is not a number, or is larger than `largest`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TrajectoryError(f"{name}: expected a number, got {shown(value)}")
    if not abs(value) <= largest:  # also rejects NaN, and integers that no float can hold
        what = f"{value:g}" if isinstance(value, float) else "an integer"
        raise TrajectoryError(f"{name}: {what} is not within -{largest:g} to {largest:g}")
    return float(value)


def point(value: Any, name: str) -> tuple[float, float]:
    """Return a point (x, y) in `map` from a script, in metres; of (x, y, z) without its height.

    Raises:
        TrajectoryError: the value is not a point.
    """
    if not _is_point(value):
        raise TrajectoryError(f"{name}: expected a point (x, y), got {shown(value)}")
    return number(value[0], f"{name}: x"), number(value[1], f"{name}: y")


def _check_points(points: np.ndarray, segment: int, ground: ReachableGround) -> None:
    scene, occupancy = ground.scene, ground.scene.occupancy
    for i, (x, y) in _enumerate_from_1(points.tolist()):
        where = f"point {i} of segment {segment}, ({x:g}, {y:g})"
        cell = occupancy.cell_of(x, y)
        if cell is None:
            x0, x1, y0, y1 = occupancy.extent_m
            raise TrajectoryError(
                f"{where}, is outside the map (x {x0:g} to {x1:g}, y {y0:g} to {y1:g})"
            )
        near_robot = scene.pose.distance_to(x, y) <= ESCAPE_M and occupancy.cells[cell] <= 0
        if not (near_robot or ground.reachable[cell]):
            raise TrajectoryError(
                f"{where}, {_reason_not_reachable(ground, cell)}{_advice(ground, x, y)}"
            )


def _reason_not_reachable(ground: ReachableGround, cell: tuple[int, int]) -> str:
    if ground.costmap.grid.cells[cell]:
        return "cannot be reached from where the robot is"
    occupied = ground.scene.occupancy.cells[cell]
    if occupied < 0 and not ground.scene.regions_grid.cells[cell]:
        return "was never seen to be free"
    if occupied == IN_ZONE:
        return "is in a zone that is closed to the robot"
    return "is occupied" if occupied > 0 else "is too close to what is occupied"


def _advice(ground: ReachableGround, x_m: float, y_m: float) -> str:
    nearest = ground.nearest(x_m, y_m)
    if nearest is None:
        return ""
    return f"; the nearest reachable point is ({nearest[0]:.2f}, {nearest[1]:.2f})"


def _point_name(segments: Sequence[np.ndarray], index: int) -> str:
    named = chain.from_iterable(
        (f"point {i} of segment {k}" for i, _ in _enumerate_from_1(points))
        for k, points in _enumerate_from_1(segments)
    )
    return list(named)[index]


def _segment(points: list[Any], segment: int) -> np.ndarray:
    named = _enumerate_from_1(points)
    return np.array([point(value, f"point {i} of segment {segment}") for i, value in named])


def _is_point(value: Any) -> bool:
    numbers = isinstance(value, (list, tuple)) and len(value) in (2, 3)
    return numbers and all(isinstance(v, (int, float)) for v in value)


def _items(value: Any, name: str, most: int) -> list[Any]:
    if not isinstance(value, (list, tuple)):
        raise TrajectoryError(f"{name}: expected a list, got {shown(value)}")
    if len(value) > most:
        raise TrajectoryError(f"{name}: {len(value)} entries, at most {most} are allowed")
    return list(value)


def shown(value: Any) -> str:
    """Describe a value from a script in a few words; it may have any size and depth."""
    if isinstance(value, str):
        return repr(one_line(value, _SHOWN))
    return str(value) if isinstance(value, (float, bool)) or value is None else type(value).__name__


def _enumerate_from_1(values: Any) -> Any:
    """Enumerate from 1, as messages count."""
    return enumerate(values, 1)

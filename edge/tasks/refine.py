"""Refinement of a coarse trajectory into one that can be driven (OpenNav III-A4).

It runs A* over the value map, fits a spline, and adds headings, speeds and times. The value map
prefers the *tube*, a strip around the coarse trajectory, then the rest of the regions that were
chosen. Other ground has the weight `HIGH`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.tasks.legs import Leg, RefineError, cut_into_legs
from edge.tasks.scene.ground import ESCAPE_M
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.value_map import BRIDGE, HIGH, PathMargins, closed_cells, value_map
from edge.trajectory import astar, smoothing
from edge.trajectory.costmap import CostMap, from_weights
from edge.trajectory.pursuit import MotionLimits
from edge.trajectory.speeds import headings_rad, speeds_mps, times_s
from edge.trajectory.spline import b_spline

SPACING_M = 0.1
"""Largest distance between two points of a refined trajectory."""
CONTROL_M = (2.0, 1.0, 0.5, 0.25)
"""Distances between a spline's control points; the first gives the smoothest spline."""
MAX_COST_RATIO = 1.05
"""A spline may cost this factor more than the path that it smooths.

It must not be longer over ground that was not chosen or not seen.
"""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedTrajectory:
    """A trajectory to drive, and how it was made.

    Attributes:
        poses: (n, 4) float64: x, y, z [m] and heading [rad] in `map`, n >= 1. The z is 0.
        speeds_mps: (n,) float64; 0 at the last pose.
        times_s: (n,) float64, from 0 when the robot faces along the path.
        leg: (n,) int64, index into `legs`.
        legs: legs of the coarse trajectory that were refined.
        drivable: ids of the regions chosen for it.
        heading_rad: requested heading at the end; None: along the path.
        control_m: distance between the spline's control points; 0: the path is A*'s own, because
            every spline of `CONTROL_M` entered a closed cell or cost too much (`MAX_COST_RATIO`).
        notes: differences from the request, a line each.
    """

    poses: np.ndarray
    speeds_mps: np.ndarray
    times_s: np.ndarray
    leg: np.ndarray
    legs: tuple[Leg, ...]
    drivable: frozenset[int]
    heading_rad: float | None
    control_m: float
    notes: tuple[str, ...]


def refine(
    scene: Scene,
    segments: Sequence[np.ndarray],
    drivable: Collection[int],
    margins: PathMargins,
    limits: MotionLimits,
    heading_rad: float | None = None,
) -> RefinedTrajectory:
    """Run A* over the value map through the ends of the coarse segments, then fit a spline.

    A* runs once from the end of each segment to the end of the next. A segment that bends is also
    cut at its bends (`legs.cut_into_legs`), so that A* does not shorten a detour around something.
    The spline is the smoothest of `CONTROL_M` that enters no closed cell.

    Args:
        scene: what is around the robot.
        segments: each (n, 2) float64 in `map`.
        drivable: ids of the regions chosen; empty: any.
        margins: clearance, and radius of the tube around the coarse trajectory.
        limits: highest speeds and accelerations.
        heading_rad: heading of the last pose; None: along the path.

    Raises:
        RefineError: an end cannot be reached, or the robot is shut in.
    """
    legs = cut_into_legs(segments, (scene.pose.x_m, scene.pose.y_m), margins.tube_m)
    chosen = frozenset(drivable) or frozenset(scene.regions)
    return refine_legs(scene, legs, chosen, margins, limits, heading_rad)


def refine_again(
    scene: Scene,
    before: RefinedTrajectory,
    index: int,
    margins: PathMargins,
    limits: MotionLimits,
) -> RefinedTrajectory:
    """Refine the rest of a trajectory, from the robot's place, on the current map.

    `index` is the pose in `before` that the robot has reached (`follow.goal_ahead`).

    Raises:
        RefineError: see `refine`.
    """
    first, *rest = before.legs[before.leg[index] :]
    away = np.hypot(*(first.points_m - (scene.pose.x_m, scene.pose.y_m)).T)
    ahead = first.points_m[int(np.argmin(away)) :]
    legs = (Leg(ahead, first.ends_segment), *rest)
    return refine_legs(scene, legs, before.drivable, margins, limits, before.heading_rad)


def refine_legs(
    scene: Scene,
    legs: Sequence[Leg],
    drivable: frozenset[int],
    margins: PathMargins,
    limits: MotionLimits,
    heading_rad: float | None,
) -> RefinedTrajectory:
    """Refine a trajectory that is already cut into legs; see `refine`."""
    pose = scene.pose
    coarse = np.concatenate([[(pose.x_m, pose.y_m)], *(leg.points_m for leg in legs)])
    costmap = value_map(scene.occupancy, scene.regions_grid, drivable, coarse, margins)
    start_m = _find_start(costmap, scene, margins)
    costmap.weight[~_reachable(costmap, start_m)] = 0
    notes: list[str] = []
    if (escaped_m := math.dist(start_m, (pose.x_m, pose.y_m))) > 0.0:
        notes.append(f"the robot is too close to an obstacle: moves {escaped_m:.1f} m away first")
    kept_legs, ends = _find_ends(costmap, legs, margins.tube_m, notes)
    paths = _find_paths(costmap, start_m, ends)
    points, leg, control_m = _fit_spline(costmap, paths, kept_legs)
    if not control_m:
        notes.append(
            "not smoothed: every spline came too close to an obstacle, or left the chosen ground"
        )
    off_m = _length_m(costmap, points, costmap.weight == HIGH)
    unseen_m = _length_m(costmap, points, costmap.weight == BRIDGE)
    for length_m, kind in ((unseen_m, "seen"), (off_m, "chosen")):
        if length_m > 1e-6:
            notes.append(f"{length_m:.1f} m of the path are over ground that was not {kind}")
    if escaped_m > 0.0:
        points, leg = np.concatenate([[(pose.x_m, pose.y_m)], points]), np.append(leg[:1], leg)
    headings = headings_rad(points) if len(points) > 1 else np.array([pose.yaw_rad])
    if heading_rad is not None:
        headings[-1] = heading_rad
    speeds = speeds_mps(points, limits)
    return RefinedTrajectory(
        poses=np.column_stack([points, np.zeros(len(points)), headings]),
        speeds_mps=speeds,
        times_s=times_s(points, speeds, limits.accel_mps2),
        leg=leg,
        legs=kept_legs,
        drivable=drivable,
        heading_rad=heading_rad,
        control_m=control_m,
        notes=tuple(notes),
    )


def _find_start(costmap: CostMap, scene: Scene, margins: PathMargins) -> tuple[float, float]:
    """Return the start of the search: the robot's place, or the nearest open cell in view of it.

    Raises:
        RefineError: there is no such cell, or the robot is outside the map.
    """
    here = scene.pose.x_m, scene.pose.y_m
    cell = costmap.cell_of(*here)
    if cell is None:
        raise RefineError(f"the robot at {_xy_text(here)} is outside the map; wait for a newer map")
    if costmap.weight[cell]:
        return here
    nearest = astar.nearest_free(costmap, cell, here, ESCAPE_M)
    solid = closed_cells(scene.occupancy, 0.0)
    unoccupied = from_weights(
        replace(scene.occupancy, cells=np.where(solid, 0, 1).astype(np.uint8))
    )
    unoccupied.weight[cell] = 1  # the robot itself is there, so the cell is not an obstacle
    if nearest is None or not smoothing.line_is_free(unoccupied, here, _centre(costmap, nearest)):
        raise RefineError(
            f"the robot at {_xy_text(here)} is shut in: no place within {ESCAPE_M} m is "
            f"{margins.clearance_m:g} m clear of obstacles; drive the robot away from them, or set "
            "a smaller tasks.trajectory.clearance_m"
        )
    return _centre(costmap, nearest)


def _reachable(costmap: CostMap, start_m: tuple[float, float]) -> np.ndarray:
    """Return the cells with a path to `start_m`, bool as `costmap.weight`.

    Paths are 4-connected, because A* cuts no corners.
    """
    is_open = (costmap.weight != 0).view(np.uint8)
    _, part = cv2.connectedComponents(is_open, connectivity=4)
    return part == part[costmap.cell_of(*start_m)]


def _find_ends(
    costmap: CostMap, legs: Sequence[Leg], tube_m: float, notes: list[str]
) -> tuple[tuple[Leg, ...], list[tuple[float, float]]]:
    """Return the legs, and an end (x, y) for each: its last point, or the nearest open cell.

    That cell must be within `tube_m`. A leg without an end that need not be reached becomes part of
    the next leg. `notes` gets a line for each end that moved.

    Raises:
        RefineError: a segment has no such end.
    """
    kept_legs: list[Leg] = []
    ends: list[tuple[float, float]] = []
    before = np.empty((0, 2))
    for leg in legs:
        points = np.concatenate([before, leg.points_m])
        wanted = (float(points[-1, 0]), float(points[-1, 1]))
        end = _nearest_open(costmap, wanted, tube_m)
        if end is None and not leg.ends_segment:
            before = points
            continue
        if end is None:
            raise RefineError(
                f"no path to {_xy_text(wanted)}: no place within {tube_m:g} m of it can be "
                "reached; name another place, or wait until the path is free"
            )
        if end != wanted and leg.ends_segment:
            moved = math.dist(end, wanted)
            notes.append(
                f"{_xy_text(wanted)} is too close to an obstacle: stops {moved:.1f} m away"
            )
        kept_legs.append(Leg(points, leg.ends_segment))
        ends.append(end)
        before = np.empty((0, 2))
    return tuple(kept_legs), ends


def _nearest_open(
    costmap: CostMap, xy_m: tuple[float, float], within_m: float
) -> tuple[float, float] | None:
    """Return the point itself if its cell is open, else the centre of the nearest open cell.

    Returns:
        None if no open cell is near enough, or the point is outside the map.
    """
    cell = costmap.cell_of(*xy_m)
    if cell is None or costmap.weight[cell]:
        return None if cell is None else xy_m
    nearest = astar.nearest_free(costmap, cell, xy_m, within_m)
    return None if nearest is None else _centre(costmap, nearest)


def _find_paths(
    costmap: CostMap, start_m: tuple[float, float], ends: Sequence[tuple[float, float]]
) -> list[np.ndarray]:
    """Return a path (n, 2) for each leg."""
    paths, workspace = [], astar.Workspace()
    for start, end in zip([start_m, *ends[:-1]], ends, strict=True):
        plan = astar.plan(costmap, start, end, workspace)
        if not plan.ok:
            raise RefineError(
                f"no path from {_xy_text(start)} to {_xy_text(end)}: {plan.reason}; name a nearer "
                "place"
            )
        paths.append(plan.path_m)
    return paths


def _fit_spline(
    costmap: CostMap, paths: Sequence[np.ndarray], legs: Sequence[Leg]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit the smoothest spline that is no worse than the paths of A*.

    Returns:
        (n, 2) points; (n,) leg of each point; and the distance between the control points, 0 if no
        spline is good enough and the points are those of A*.
    """
    polyline, leg = _joined([smoothing.smooth(costmap, path, SPACING_M) for path in paths])
    max_cost_m = MAX_COST_RATIO * smoothing.polyline_cost_m(costmap, polyline)
    outside = costmap.weight >= BRIDGE
    max_outside_m = _length_m(costmap, polyline, outside)
    for control_m in CONTROL_M:
        control, control_leg = _repeat_at_ends(
            *_joined([smoothing.smooth(costmap, path, control_m) for path in paths]), legs
        )
        curve, at = b_spline(control, SPACING_M)
        if len(curve) < 2 or (
            smoothing.polyline_cost_m(costmap, curve) <= max_cost_m
            and _length_m(costmap, curve, outside) <= max_outside_m
        ):
            # A leg begins after the point where the previous leg ends.
            return curve, control_leg[np.minimum(at + 1, len(control) - 1)], control_m
    return polyline, leg, 0.0


def _joined(paths: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return one polyline without repeated points, and for each point the index of its path."""
    points = np.concatenate(paths)
    leg = np.repeat(np.arange(len(paths)), [len(path) for path in paths])
    moved = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)  # not repeated
    return points[moved], leg[moved]


def _repeat_at_ends(
    control_m: np.ndarray, leg: np.ndarray, legs: Sequence[Leg]
) -> tuple[np.ndarray, np.ndarray]:
    """Repeat the control points at the ends of segments, and between legs that double back.

    A spline leads through a point that counts three times. Otherwise it would cut the tip of a
    hairpin.

    Args:
        control_m: (n, 2) control points.
        leg: (n,) leg of each control point.
        legs: the legs.

    Returns:
        The control points and their legs, with these repetitions. The last of three equal points
        belongs to the next leg.
    """
    # Segment of each control point, and True at the last point of a segment but the last one.
    segment = np.cumsum([0, *(leg.ends_segment for leg in legs)])[leg]
    ends = np.append(np.diff(segment) > 0, False)
    # Also the ends of other legs where the path turns by more than 90 degrees.
    way_m = np.diff(control_m, axis=0)
    ends[1:-1] |= (np.diff(leg)[1:] > 0) & ((way_m[:-1] * way_m[1:]).sum(axis=1) < 0.0)
    repeats = np.where(ends, 3, 1)
    control_leg, last = np.repeat(leg, repeats), np.cumsum(repeats)[ends] - 1
    control_leg[last] = control_leg[last + 1]
    return np.repeat(control_m, repeats, axis=0), control_leg


def _length_m(costmap: CostMap, points_m: np.ndarray, cells: np.ndarray) -> float:
    """Return the length in metres of the parts of a polyline in some cells.

    `cells` is bool, as `costmap.weight`.
    """
    at = costmap.grid_of(0.5 * (points_m[:-1] + points_m[1:])).astype(np.int64)
    legs = np.hypot(*np.diff(points_m, axis=0).T)
    return float(legs[cells[at[:, 1], at[:, 0]]].sum())


def _centre(costmap: CostMap, cell: tuple[int, int]) -> tuple[float, float]:
    """Return the centre (x, y) of a cell (row, column) in `map`."""
    x_m, y_m = costmap.metres_of(np.array([cell[1] + 0.5, cell[0] + 0.5]))
    return float(x_m), float(y_m)


def _xy_text(xy_m: tuple[float, float]) -> str:
    return f"({xy_m[0]:.1f}, {xy_m[1]:.1f})"

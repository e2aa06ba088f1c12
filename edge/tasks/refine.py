"""Refinement of a coarse trajectory into one that can be driven (OpenNav III-A4).

It runs A* over the value map, fits a spline, and adds headings, speeds and times.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.tasks.ground import ESCAPE_M
from edge.tasks.legs import Leg, RefineError, cut
from edge.tasks.scene import Scene
from edge.tasks.speeds import headings_rad, speeds_mps, times_s
from edge.tasks.value_map import HIGH, PathMargins, closed_cells, value_map
from edge.trajectory import astar, smoothing
from edge.trajectory.costmap import CostMap, from_weights
from edge.trajectory.pursuit import MotionLimits
from edge.trajectory.spline import b_spline

SPACING_M = 0.1
"""Largest distance between two points of a refined trajectory."""
CONTROL_M = (2.0, 1.0, 0.5, 0.25)
"""Distances between a spline's control points; the first gives the smoothest spline."""
MOST_COST_RATIO = 1.05
"""A spline may cost this factor more than the path that it smooths.

It must not be longer over ground that was not chosen.
"""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedTrajectory:
    """A trajectory to drive, and how it was made.

    Attributes:
        poses: (n, 4) float64: x, y, z [m] and heading [rad] in `map`, n >= 1.
        speeds_mps: (n,) float64; 0 at the last pose.
        times_s: (n,) float64, from 0 when the robot faces along the path.
        leg: (n,) int64, index into `legs`.
        legs: legs of the coarse trajectory that were refined.
        drivable: ids of the regions chosen for it.
        heading_rad: requested heading at the end; None: along the path.
        cost_m: cost of the path in metres of the tube's ground (`value_map`).
        control_m: distance between the spline's control points; 0: the path is A*'s own, because
            every spline of `CONTROL_M` entered a closed cell or cost too much (`MOST_COST_RATIO`).
        off_region_m: length of the path over ground that was not chosen.
        notes: differences from the request, a line each.
    """

    poses: np.ndarray
    speeds_mps: np.ndarray
    times_s: np.ndarray
    leg: np.ndarray
    legs: tuple[Leg, ...]
    drivable: frozenset[int]
    heading_rad: float | None
    cost_m: float
    control_m: float
    off_region_m: float
    notes: tuple[str, ...]


def refine(
    scene: Scene,
    segments: Sequence[np.ndarray],
    drivable: Collection[int],
    body: PathMargins,
    limits: MotionLimits,
    speed_mps: float = 0.0,
    heading_rad: float | None = None,
) -> RefinedTrajectory:
    """Run A* over the value map through the ends of the coarse segments, then fit a spline.

    A* runs once from the end of each segment to the end of the next. A segment that bends is also
    cut at its bends (`legs.cut`), so that A* does not shorten a detour around something. The spline
    is the smoothest of `CONTROL_M` that enters no closed cell.

    Args:
        scene: what is around the robot.
        segments: each (n, 2 or 3) float64 in `map`; points without a height get 0.
        drivable: ids of the regions chosen; empty: any.
        body: clearance, and radius of the tube around the coarse trajectory.
        limits: highest speeds and accelerations.
        speed_mps: current speed of the robot.
        heading_rad: heading of the last pose; None: along the path.

    Raises:
        RefineError: points are invalid, an end cannot be reached, or the robot is shut in.
    """
    legs = cut(segments, (scene.pose.x_m, scene.pose.y_m), body.tube_m)
    chosen = frozenset(drivable) or frozenset(scene.regions)
    return refine_legs(scene, legs, chosen, body, limits, speed_mps, heading_rad)


def refine_again(
    scene: Scene,
    before: RefinedTrajectory,
    index: int,
    body: PathMargins,
    limits: MotionLimits,
    speed_mps: float = 0.0,
) -> RefinedTrajectory:
    """Refine the rest of a trajectory, from the robot's place, on the current map.

    `index` is the pose in `before` that the robot has reached (`follow.goal_ahead`).

    Raises:
        RefineError: see `refine`.
    """
    first, *rest = before.legs[before.leg[index] :]
    away = np.hypot(*(first.points_m[:, :2] - (scene.pose.x_m, scene.pose.y_m)).T)
    ahead = first.points_m[int(np.argmin(away)) :]
    legs = (Leg(ahead, first.ends_segment), *rest)
    return refine_legs(scene, legs, before.drivable, body, limits, speed_mps, before.heading_rad)


def refine_legs(
    scene: Scene,
    legs: Sequence[Leg],
    drivable: frozenset[int],
    body: PathMargins,
    limits: MotionLimits,
    speed_mps: float,
    heading_rad: float | None,
) -> RefinedTrajectory:
    """Refine a trajectory that is already cut into legs; see `refine`."""
    pose = scene.pose
    coarse = np.concatenate([[(pose.x_m, pose.y_m)], *(leg.points_m[:, :2] for leg in legs)])
    costmap = value_map(scene.occupancy, scene.regions_grid, drivable, coarse, body)
    begin = _begin(costmap, scene, body)
    costmap.weight[~_reachable(costmap, begin)] = 0
    notes: list[str] = []
    if (gone := math.dist(begin, (pose.x_m, pose.y_m))) > 0.0:
        notes.append(f"the robot is too close to an obstacle: moves {gone:.1f} m away first")
    kept, ends = _ends(costmap, legs, body.tube_m, notes)
    paths = _search(costmap, begin, ends)
    points, leg, control_m = _smooth(costmap, paths, kept)
    if not control_m:
        notes.append(
            "not smoothed: every spline came too close to an obstacle, or left the chosen ground"
        )
    cost_m = smoothing.polyline_cost_m(costmap, points)
    off_m = _length_at_m(costmap, points, HIGH)
    if off_m > 0.0:
        notes.append(f"{off_m:.1f} m of the path are over ground that was not chosen")
    if gone > 0.0:
        points, leg = np.concatenate([[(pose.x_m, pose.y_m)], points]), np.append(leg[:1], leg)
    heights_m = _heights_m(points, leg, kept)
    headings = headings_rad(points) if len(points) > 1 else np.array([pose.yaw_rad])
    if heading_rad is not None:
        headings[-1] = heading_rad
    speeds = speeds_mps(points, limits, speed_mps)
    return RefinedTrajectory(
        poses=np.column_stack([points, heights_m, headings]),
        speeds_mps=speeds,
        times_s=times_s(points, speeds, limits.accel_mps2),
        leg=leg,
        legs=kept,
        drivable=drivable,
        heading_rad=heading_rad,
        cost_m=cost_m,
        control_m=control_m,
        off_region_m=off_m,
        notes=tuple(notes),
    )


def _begin(costmap: CostMap, scene: Scene, body: PathMargins) -> tuple[float, float]:
    """Return the start of the search: the robot's place, or the nearest open cell in view of it."""
    here = scene.pose.x_m, scene.pose.y_m
    cell = costmap.cell_of(*here)
    if cell is None:
        raise RefineError(f"the robot at {_place(here)} is outside the map; wait for a newer map")
    if costmap.weight[cell]:
        return here
    nearest = astar.nearest_open(costmap, cell, here, ESCAPE_M)
    solid = closed_cells(scene.occupancy, 0.0)
    bare = from_weights(replace(scene.occupancy, cells=np.where(solid, 0, 1).astype(np.uint8)))
    bare.weight[cell] = 1  # the robot itself is there, so the cell is not an obstacle
    if nearest is None or not smoothing.line_is_free(bare, here, _centre(costmap, nearest)):
        raise RefineError(
            f"the robot at {_place(here)} is shut in: no place within {ESCAPE_M} m is "
            f"{body.clearance_m:g} m clear of obstacles; drive the robot away from them, or set a "
            "smaller tasks.trajectory.clearance_m"
        )
    return _centre(costmap, nearest)


def _reachable(costmap: CostMap, begin: tuple[float, float]) -> np.ndarray:
    """Return the cells with a path to `begin`, bool as `costmap.weight`.

    Paths are 4-connected, because A* cuts no corners.
    """
    is_open = (costmap.weight != 0).view(np.uint8)
    _, part = cv2.connectedComponents(is_open, connectivity=4)
    return part == part[costmap.cell_of(*begin)]


def _ends(
    costmap: CostMap, legs: Sequence[Leg], tube_m: float, notes: list[str]
) -> tuple[tuple[Leg, ...], list[tuple[float, float]]]:
    """Return the legs and their ends: the last point, or the nearest open cell in the tube.

    A leg whose end is closed and need not be reached becomes part of the next leg.
    """
    kept: list[Leg] = []
    ends: list[tuple[float, float]] = []
    before = np.empty((0, 3))
    for leg in legs:
        points = np.concatenate([before, leg.points_m])
        asked = (float(points[-1, 0]), float(points[-1, 1]))
        end = _nearest_open(costmap, asked, tube_m)
        if end is None and not leg.ends_segment:
            before = points
            continue
        if end is None:
            raise RefineError(
                f"no path to {_place(asked)}: no place within {tube_m:g} m of it can be reached; "
                "name another place, or wait until the path is free"
            )
        if end != asked and leg.ends_segment:
            moved = math.dist(end, asked)
            notes.append(f"{_place(asked)} is too close to an obstacle: stops {moved:.1f} m away")
        kept.append(Leg(points, leg.ends_segment))
        ends.append(end)
        before = np.empty((0, 3))
    return tuple(kept), ends


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
    nearest = astar.nearest_open(costmap, cell, xy_m, within_m)
    return None if nearest is None else _centre(costmap, nearest)


def _search(
    costmap: CostMap, begin: tuple[float, float], ends: Sequence[tuple[float, float]]
) -> list[np.ndarray]:
    """Return a path (n, 2) for each leg."""
    paths, workspace = [], astar.Workspace()
    for start, end in zip([begin, *ends[:-1]], ends, strict=True):
        plan = astar.plan(costmap, start, end, workspace)
        if not plan.ok:
            raise RefineError(
                f"no path from {_place(start)} to {_place(end)}: {plan.reason}; name a nearer place"
            )
        paths.append(plan.path_m)
    return paths


def _smooth(
    costmap: CostMap, paths: Sequence[np.ndarray], legs: Sequence[Leg]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return (points (n, 2), leg of each point, distance between the control points or 0)."""
    plain, leg = _joined([smoothing.smooth(costmap, path, SPACING_M) for path in paths])
    most_m = MOST_COST_RATIO * smoothing.polyline_cost_m(costmap, plain)
    most_off_m = _length_at_m(costmap, plain, HIGH)
    for control_m in CONTROL_M:
        control, of_control = _through_ends(
            *_joined([smoothing.smooth(costmap, path, control_m) for path in paths]), legs
        )
        curve, at = b_spline(control, SPACING_M)
        if len(curve) < 2 or (
            smoothing.polyline_cost_m(costmap, curve) <= most_m
            and _length_at_m(costmap, curve, HIGH) <= most_off_m
        ):
            # A leg begins after the point where the previous leg ends.
            return curve, of_control[np.minimum(at + 1, len(control) - 1)], control_m
    return plain, leg, 0.0


def _joined(paths: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return one polyline without repeated points, and for each point the index of its path."""
    points = np.concatenate(paths)
    leg = np.repeat(np.arange(len(paths)), [len(path) for path in paths])
    moved = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)
    return points[moved], leg[moved]


def _through_ends(
    control_m: np.ndarray, leg: np.ndarray, legs: Sequence[Leg]
) -> tuple[np.ndarray, np.ndarray]:
    """Repeat the control points at the ends of segments, and at legs that double back.

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
    segment = np.cumsum([0, *(leg.ends_segment for leg in legs)])[leg]
    ends = np.append(np.diff(segment) > 0, False)
    way_m = np.diff(control_m, axis=0)
    ends[1:-1] |= (np.diff(leg)[1:] > 0) & ((way_m[:-1] * way_m[1:]).sum(axis=1) < 0.0)
    times = np.where(ends, 3, 1)
    of_control, last = np.repeat(leg, times), np.cumsum(times)[ends] - 1
    of_control[last] = of_control[last + 1]
    return np.repeat(control_m, times, axis=0), of_control


def _length_at_m(costmap: CostMap, points_m: np.ndarray, weight: int) -> float:
    """Return the length of a polyline in cells of a weight."""
    cells = costmap.grid_of(0.5 * (points_m[:-1] + points_m[1:])).astype(np.int64)
    legs = np.hypot(*np.diff(points_m, axis=0).T)
    return float(legs[costmap.weight[cells[:, 1], cells[:, 0]] == weight].sum())


def _heights_m(points_m: np.ndarray, leg: np.ndarray, legs: Sequence[Leg]) -> np.ndarray:
    """Return the heights (n,) of the coarse trajectory, by the share of each leg that is done."""
    heights = np.zeros(len(points_m))
    before = legs[0].points_m[:1]
    for k, coarse in enumerate(legs):
        mine = leg == k
        way = np.concatenate([before, coarse.points_m])
        if mine.any():
            heights[mine] = np.interp(_shares(points_m[mine]), _shares(way[:, :2]), way[:, 2])
        before = way[-1:]
    return heights


def _shares(points_m: np.ndarray) -> np.ndarray:
    """Return the share (n,) of a polyline's length that lies before each point, from 0 to 1."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points_m, axis=0).T)))
    return along / max(along[-1], 1e-9)


def _centre(costmap: CostMap, cell: tuple[int, int]) -> tuple[float, float]:
    x_m, y_m = costmap.metres_of(np.array([cell[1] + 0.5, cell[0] + 0.5]))
    return float(x_m), float(y_m)


def _place(xy_m: tuple[float, float]) -> str:
    return f"({xy_m[0]:.1f}, {xy_m[1]:.1f})"

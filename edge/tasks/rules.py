"""Planner `rules`: instructions that a small grammar knows (`edge.tasks.reading`), turned into the
calls that a model's script would make. No server, and nothing is guessed.

The sides of a thing are those that the robot sees as it comes to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge.geometry import SE2
from edge.tasks.functions import BESIDE_M, SIDES_RAD, CallError, Functions, Point
from edge.tasks.reading import OF, Step, called, centre_m, read
from edge.tasks.scene import SceneObject
from edge.tasks.trajectory import TrajectoryError
from edge.text import one_line

SNAP_M = 1.0
"""How far a point of a way may be moved to where the robot can be."""
BEYOND_RAD = math.radians(45)
"""A thing is past when it is so far behind the side that the robot passes it on."""


def carry_out(instruction: str, functions: Functions, which: slice = slice(None)) -> list[Step]:
    """Hand over the trajectory that an instruction, or some of its steps, asks for.

    Args:
        which: of its steps; see `edge.tasks.reading.read`.

    Returns:
        What was understood; each step became one segment.

    Raises:
        TranslationError: the instruction is not understood; it names the part.
        TrajectoryError: it is understood, and cannot be done.
    """
    steps = read(instruction, functions.ground.scene, which)
    pose = functions.ground.scene.pose
    here, heading_rad = (pose.x_m, pose.y_m), pose.yaw_rad
    segments: list[list[Point]] = []
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        try:
            segments += _segment(step, following, SE2(*here, heading_rad), functions)
        except TrajectoryError as error:
            raise TrajectoryError(f"{one_line(step.said, 60)!r}: {error}") from None
        (x0, y0), (x1, y1) = ([here] + segments[-1])[-2:]
        here = segments[-1][-1]
        if (x0, y0) != (x1, y1):
            heading_rad = math.atan2(y1 - y0, x1 - x0)
    regions = {functions.region_at(at) for segment in segments for at in segment} - {0}
    functions.give_trajectory(segments, sorted(regions), heading_rad=_facing(steps[-1], here))
    return steps


def _facing(last: Step, at: Point) -> float | None:
    """The direction in which the robot looks at the end: at what it was sent to."""
    if last.kind not in ("to", "beside") or at == centre_m(last.things[0]):
        return None
    (x, y), (tx, ty) = at, centre_m(last.things[0])
    return math.atan2(ty - y, tx - x)


def _segment(
    step: Step, following: Step | None, here: SE2, functions: Functions
) -> list[list[Point]]:
    """The way of one step, in one segment from `here`."""
    at = (here.x_m, here.y_m)
    match step.kind:
        case "straight":
            end = here.ahead(step.distance_m)
            way = functions.line(at, end)
            blocked = next((p for p in way[1:] if not functions.is_free(p)), None)
            if blocked is not None:
                gone_m = math.dist(at, blocked)
                raise CallError(f"the way straight on is blocked after {gone_m:.1f} m")
            return [way]
        case "to":
            points = [functions.stopping_point(step.things[0].id, at)]
        case "beside":
            points = [_beside(step.things[0], step.side, at, functions)]
        case "between":
            middle = functions.ground.nearest(*_middle(step, functions), within_m=SNAP_M)
            if middle is None:
                raise CallError(f"{step} is no room for the robot")
            points = [middle]
        case _:
            return [_round(step, following, at, functions)]
    return [_through(at, points, functions)]


def _round(step: Step, following: Step | None, at: Point, functions: Functions) -> list[Point]:
    """Past a thing or around it; where no side is said, the shorter way."""
    ways, why = [], []
    for side in [step.side] if step.side else ["left", "right"]:
        try:
            ways.append(
                _through(at, _beside_points(step, following, at, side, functions), functions)
            )
        except TrajectoryError as error:
            why.append(str(error))
    if not ways:
        raise CallError(why[0])
    return min(ways, key=_length_m)


def _beside_points(
    step: Step, following: Step | None, at: Point, side: str, functions: Functions
) -> list[Point]:
    """Points on the arc past a side of a thing: past it till `BEYOND_RAD` behind that side, around
    it till what comes next, or its far side.

    The point at the side itself must be there, and on that side; others are left out where the
    robot cannot be.
    """
    thing = step.things[0]
    abeam = functions.offset(thing.id, side, BESIDE_M, at)
    end = functions.offset(thing.id, "behind", BESIDE_M, at)
    if step.kind == "around" and following and following.things not in ((), step.things):
        end = centre_m(following.things[0])
    arc = functions.arc(thing.id, at, end, side, BESIDE_M)
    looking_rad = functions.heading(at, centre_m(thing))
    points = [_beside(thing, side, at, functions)]
    k = min(range(len(arc)), key=lambda i: math.dist(arc[i], abeam))
    for point in arc[k + 1 :]:
        angle_rad = functions.heading(centre_m(thing), point)
        behind_rad = abs(math.remainder(angle_rad - looking_rad, math.tau))
        if step.kind == "past" and behind_rad < math.pi / 2 - BEYOND_RAD - 1e-6:
            break
        snapped = functions.ground.nearest(*point, within_m=SNAP_M)
        if snapped is not None and functions.ground.faces(thing, snapped):
            points.append(snapped)
    return points


def _through(at: Point, points: Sequence[Point], functions: Functions) -> list[Point]:
    """The cheapest way through points."""
    way = [at]
    for point in points:
        way += functions.a_star_plan(way[-1], point)[1:]
    return way


def _beside(thing: SceneObject, side: str, seen_from: Point, functions: Functions) -> Point:
    """Where the robot can be on a side of a thing, with nothing in between: at `BESIDE_M` from it,
    or nearer."""
    looking_rad = functions.heading(seen_from, centre_m(thing))
    for distance_m in (BESIDE_M, 0.6 * BESIDE_M, 0.3 * BESIDE_M):
        wanted = functions.offset(thing.id, side, distance_m, seen_from)
        found = functions.ground.nearest(*wanted, within_m=SNAP_M)
        if found is not None and functions.ground.faces(thing, found):
            away = SE2(*centre_m(thing), looking_rad + SIDES_RAD[side])
            if abs(away.bearing_to(*found)) < math.pi / 2:
                return found
    raise CallError(f"there is no room for the robot {side}{OF.get(side, '')} {called(thing)}")


def _middle(step: Step, functions: Functions) -> Point:
    """Half way between the outlines of two things."""
    a, b = step.things
    angle_rad = functions.heading(centre_m(a), centre_m(b))
    (px, py) = functions.ground.outline(a).beside(angle_rad, 0.0)
    (qx, qy) = functions.ground.outline(b).beside(angle_rad + math.pi, 0.0)
    return 0.5 * (px + qx), 0.5 * (py + qy)


def _length_m(way: Sequence[Point]) -> float:
    return float(np.hypot(*np.diff(np.array(way), axis=0).T).sum())

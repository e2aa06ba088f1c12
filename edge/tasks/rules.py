"""Planner `rules`: instructions that a small grammar knows (`edge.tasks.reading`), turned into the
calls that a model's script would make. No server, and nothing is guessed.

The sides of a thing are those that the robot sees as it comes to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from edge.geometry import SE2
from edge.tasks.functions import (
    BESIDE_M,
    MOST_PATH_POINTS,
    SIDES_RAD,
    TURNS,
    CallError,
    Functions,
    Point,
)
from edge.tasks.reading import OF, OTHER, Step, called, centre_m, read
from edge.tasks.scene import SceneObject
from edge.tasks.trajectory import TrajectoryError
from edge.text import one_line
from edge.trajectory.smoothing import resample

SNAP_M = 1.0
"""How far a point of a way may be moved to where the robot can be."""
BEYOND_RAD = math.radians(45)
"""A thing is past when it is so far behind the side that the robot passes it on."""
SNAPPED_RAD = math.radians(20)
"""By so much less a thing may be past where points were moved to where the robot can be."""
PAST_RAD = math.pi / 2 + BEYOND_RAD - SNAPPED_RAD
"""How far a way has come around a thing when it has passed it, see `_turned_rad`."""


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
            part = following is None and which.stop is not None
            segments += _segment(step, following, SE2(*here, heading_rad), functions, part)
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
    step: Step, following: Step | None, here: SE2, functions: Functions, part: bool = False
) -> list[list[Point]]:
    """The way of one step, in one segment from `here`.

    Args:
        part: the instruction goes on with what is not known yet; the robot has to be past a thing
            before, else it may have to turn back later.
    """
    at = (here.x_m, here.y_m)
    match step.kind:
        case "straight":
            most_m = 0.5 * MOST_PATH_POINTS * functions.limits.max_jump_m
            if step.distance_m > most_m:
                raise CallError(f"a way straight on has at most {most_m:g} m")
            end = here.ahead(step.distance_m)
            way = functions.line(at, end)
            blocked = next((p for p in way[1:] if not functions.is_free(p)), None)
            if blocked is not None:
                gone_m = math.dist(at, blocked)
                unseen = functions.ground.is_unseen(*blocked)
                what = "was not seen any farther than" if unseen else "is blocked after"
                raise CallError(f"the way straight on {what} {gone_m:.1f} m")
            return [way]
        case "to":
            points = [functions.stopping_point(step.things[0].id, at)]
        case "beside":
            points = [_beside(step.things[0], step.side, at, functions)]
        case "between":
            wanted = _middle(step, functions)
            middle = functions.ground.nearest(*wanted, within_m=SNAP_M)
            if middle is None:
                raise _no_room(str(step), [wanted], functions)
            points = [middle]
        case _:
            return [_round(step, following, at, functions, part)]
    return [_through(at, points, functions)]


def _round(
    step: Step, following: Step | None, at: Point, functions: Functions, part: bool
) -> list[Point]:
    """Past a thing or around it: the shortest way that does not turn back.

    Where no side is said, on either; past a thing that is long, as far as around it.
    """
    why: list[str] = []
    for kind in dict.fromkeys((step.kind, "around")):
        ways = []
        for side in [step.side] if step.side else ["left", "right"]:
            try:
                points = _beside_points(replace(step, kind=kind), following, at, side, functions)
                is_past = partial(_is_past, step.things[0], side)
                ways.append((side, _through(at, points, functions, is_past)))
            except TrajectoryError as error:
                why.append(str(error))
        for side, way in sorted(ways, key=lambda one: _length_m(one[1])):
            try:
                _check_side(step, following, side, way, functions, part)
            except TrajectoryError as error:
                why.append(str(error))
            else:
                return way
    raise CallError(why[0])


def _check_side(
    step: Step,
    following: Step | None,
    side: str,
    way: list[Point],
    functions: Functions,
    part: bool,
) -> None:
    """See that a way keeps to a side of a thing, and so does what follows.

    The way past a side may be closed behind it: it would only touch that side, turn back, and pass
    the thing on the other.

    Raises:
        TrajectoryError: it does not.
    """
    thing = step.things[0]
    turned_rad = _turned_rad(thing, side, way)
    if turned_rad.min() < -PAST_RAD:
        raise CallError(
            f"the robot gets to the {side} of {called(thing)} only past its {OTHER[side]}"
        )
    if part and turned_rad[-1] < PAST_RAD:
        raise CallError(
            f"it is not known yet whether the robot gets past the {side} of {called(thing)}"
        )
    asked = following and following.things == step.things and following.side == OTHER[side]
    if following is None or asked:
        return
    (x0, y0), (x1, y1) = way[-2:]
    here = SE2(x1, y1, math.atan2(y1 - y0, x1 - x0))
    try:
        (onward,) = _segment(following, None, here, functions)
    except TrajectoryError:
        return  # which is said of that step
    if _turned_rad(thing, side, [*way, *onward]).min() < -PAST_RAD:
        raise CallError(
            f"from the {side} of {called(thing)} the robot would have to turn back and pass its "
            f"{OTHER[side]} to go on ({following})"
        )


_FINE_M = 0.1
DETOUR = 4.0
"""Points on an arc lie side by side: the way between two that is so many times longer goes back."""


def _is_past(thing: SceneObject, side: str, way: Sequence[Point]) -> bool:
    return bool(_turned_rad(thing, side, way)[-1] >= PAST_RAD)


def _turned_rad(thing: SceneObject, side: str, way: Sequence[Point]) -> np.ndarray:
    """(n,): how far a way has come around the middle of a thing since its begin, positive towards
    the side; so it is a quarter turn abeam of that side, and half a turn behind the thing."""
    fine = resample(np.array(way), _FINE_M) - centre_m(thing)
    angle_rad = np.unwrap(np.arctan2(fine[:, 1], fine[:, 0]))
    return TURNS[side] * (angle_rad - angle_rad[0])


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


def _through(
    at: Point,
    points: Sequence[Point],
    functions: Functions,
    enough: Callable[[list[Point]], bool] = lambda way: False,
) -> list[Point]:
    """The cheapest way through points.

    Args:
        enough: whether the way so far may end where the next point is only a long detour away.
    """
    way = [at]
    for k, point in enumerate(points):
        leg = functions.a_star_plan(way[-1], point)
        if k and _length_m(leg) > DETOUR * math.dist(way[-1], point) and enough(way):
            break
        way += leg[1:]
    return way


def _beside(thing: SceneObject, side: str, seen_from: Point, functions: Functions) -> Point:
    """Where the robot can be on a side of a thing, with nothing in between: at `BESIDE_M` from it,
    or nearer."""
    looking_rad = functions.heading(seen_from, centre_m(thing))
    wanted = [functions.offset(thing.id, side, k * BESIDE_M, seen_from) for k in (1.0, 0.6, 0.3)]
    for point in wanted:
        found = functions.ground.nearest(*point, within_m=SNAP_M)
        if found is not None and functions.ground.faces(thing, found):
            away = SE2(*centre_m(thing), looking_rad + SIDES_RAD[side])
            if abs(away.bearing_to(*found)) < math.pi / 2:
                return found
    raise _no_room(f"{side}{OF.get(side, '')} {called(thing)}", wanted[::-1], functions)


def _no_room(where: str, points: Sequence[Point], functions: Functions) -> CallError:
    """The error for a place where the robot cannot be.

    Args:
        points: where it was to be, the nearest to the thing first: what is seen to be occupied
            hides what lies behind it.
    """
    ground = functions.ground
    for point in points:
        if ground.is_occupied(*point):
            break
        if ground.is_unseen(*point):
            return CallError(f"nobody has seen yet whether there is room for the robot {where}")
    return CallError(f"there is no room for the robot {where}")


def _middle(step: Step, functions: Functions) -> Point:
    """Half way between the outlines of two things."""
    a, b = step.things
    angle_rad = functions.heading(centre_m(a), centre_m(b))
    (px, py) = functions.ground.outline(a).beside(angle_rad, 0.0)
    (qx, qy) = functions.ground.outline(b).beside(angle_rad + math.pi, 0.0)
    return 0.5 * (px + qx), 0.5 * (py + qy)


def _length_m(way: Sequence[Point]) -> float:
    return float(np.hypot(*np.diff(np.array(way), axis=0).T).sum())

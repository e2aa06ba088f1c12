"""Planner `rules`: writes a trajectory for an instruction of a small grammar, without a model.

`edge.tasks.sentences.reading` reads the instruction.
The planner makes the calls that a model's script would make, and guesses nothing. The sides of an
object are named as the robot sees them when it comes to the object.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from edge.geometry import SE2
from edge.tasks.functions import (
    MOST_PATH_POINTS,
    PASSING_DISTANCE_M,
    SIDES_RAD,
    TURNS,
    CallError,
    Point,
    ScriptFunctions,
)
from edge.tasks.manoeuvres import (
    cut_at,
    cut_before,
    limited_ground,
    path_straight_until,
    point_on,
    points_across,
    points_along,
    points_around,
    regions_of,
)
from edge.tasks.scene.scene import SceneObject
from edge.tasks.sentences.object_phrases import centre_m, object_name
from edge.tasks.sentences.reading import parse_steps
from edge.tasks.sentences.steps import OF_SUFFIX, OTHER_SIDE, InstructionStep
from edge.tasks.trajectory import TrajectoryError
from edge.text import one_line
from edge.trajectory.pursuit import length_m
from edge.trajectory.smoothing import resample

PLACES = (1.0, 0.6, 0.3)
"""Distances next to an object that are tried, in units of `PASSING_DISTANCE_M`."""
SNAP_M = 1.0
"""Largest distance by which a point of a path is moved to a place that the robot can reach."""
BEYOND_RAD = math.radians(45)
"""The robot has passed an object when it is this angle beyond the object's side, as seen from the
object's centre."""
SNAPPED_RAD = math.radians(20)
"""Tolerance of `BEYOND_RAD`, because points may have been moved to reachable places."""
PAST_RAD = math.pi / 2 + BEYOND_RAD - SNAPPED_RAD
"""Angle by which a path has turned around an object that it has passed; see `_turned_rad`."""


def plan_by_rules(
    instruction: str, functions: ScriptFunctions, step_slice: slice = slice(None)
) -> list[InstructionStep]:
    """Hand over the trajectory for an instruction, or for some of its steps, to `functions`.

    The trajectory has one segment for each step.

    Returns:
        The steps that were understood.

    Raises:
        TranslationError: the instruction is not understood; the error names the part.
        TrajectoryError: the instruction is understood, but cannot be carried out.
    """
    steps = parse_steps(instruction, functions.ground.scene, step_slice)
    limits = steps[0].limits
    functions.ground = limited_ground(functions.ground, limits, functions.limits.clearance_m)
    functions.keep_to = tuple(regions_of(functions.ground, limits.keep_to))
    pose = functions.ground.scene.pose
    here, heading_rad = (pose.x_m, pose.y_m), pose.yaw_rad
    segments: list[list[Point]] = []
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        try:
            # Steps after the slice are not planned now, but will follow.
            more_follow = following is None and step_slice.stop is not None
            segments += _plan_step(step, following, SE2(*here, heading_rad), functions, more_follow)
        except TrajectoryError as error:
            raise TrajectoryError(f"{one_line(step.said, 60)!r}: {error}") from None
        (x0, y0), (x1, y1) = ([here] + segments[-1])[-2:]  # last piece of the path
        here = segments[-1][-1]
        if step.kind == "turn":
            heading_rad += step.turn_rad
        elif (x0, y0) != (x1, y1):
            heading_rad = math.atan2(y1 - y0, x1 - x0)
    regions = {functions.region_at(at) for segment in segments for at in segment} - {0}
    facing_rad = heading_rad if steps[-1].kind == "turn" else _facing(steps[-1], here)
    chosen = functions.keep_to or sorted(regions)
    functions.give_trajectory(segments, chosen, heading_rad=facing_rad)
    return steps


def _facing(last: InstructionStep, at: Point) -> float | None:
    """Return the robot's heading at the end: towards the object it was sent to, else None."""
    if last.kind not in ("to", "next to") or at == centre_m(last.objects[0]):
        return None
    (x, y), (tx, ty) = at, centre_m(last.objects[0])
    return math.atan2(ty - y, tx - x)


def _plan_step(
    step: InstructionStep,
    following: InstructionStep | None,
    here: SE2,
    functions: ScriptFunctions,
    more_follow: bool = False,
) -> list[list[Point]]:
    """Return the path of one step from `here`, as one segment.

    `following` is the next step, if it is known. `more_follow` is True if `following` is None, but
    other steps follow. The robot must then be completely past an object, or it may have to turn
    back later.
    """
    at = (here.x_m, here.y_m)
    match step.kind:
        case "turn":
            return [[at]]
        case "straight" if step.objects:
            return [path_straight_until(functions, step.objects[0], here)]
        case "straight":
            most_m = 0.5 * MOST_PATH_POINTS * functions.limits.max_jump_m
            if step.distance_m > most_m:
                raise CallError(
                    f"a straight path of {step.distance_m:g} m is too long: at most {most_m:g} m"
                )
            end = here.ahead(step.distance_m)
            path = functions.line(at, end)
            blocked = next((p for p in path[1:] if not functions.is_free(p)), None)
            if blocked is not None:
                gone_m = math.dist(at, blocked)
                unseen = functions.ground.is_unseen(*blocked)
                problem = "was seen only up to" if unseen else "is blocked after"
                raise CallError(f"the path straight on {problem} {gone_m:.1f} m")
            return [path]
        case "to":
            points = [functions.stopping_point(step.objects[0].id, at)]
        case "next to":
            places = [step.distance_m / PASSING_DISTANCE_M] if step.distance_m else PLACES
            points = [_place_next_to(step.objects[0], step.side, at, functions, places)]
        case "halfway":
            points = [functions.stopping_point(step.objects[0].id, at)]
        case "onto":
            points = [point_on(functions.ground, step.ground, at)]
        case "across":
            points = points_across(functions.ground, step.ground, at)
        case "along":
            towards = centre_m(following.objects[0]) if following and following.objects else None
            points = points_along(functions, step.objects[0], here, towards, SNAP_M)
        case "circle":
            return [_plan_circle(step, at, functions)]
        case "between":
            wanted = _point_between(step, functions)
            middle = functions.ground.nearest(*wanted, within_m=SNAP_M)
            if middle is None:
                raise _no_room_error(str(step), [wanted], functions)
            points = [middle]
        case _:
            return [_plan_past(step, following, at, functions, more_follow)]
    path = _plan_through(at, points, functions)
    if step.kind == "halfway":
        path = cut_at(path, 0.5 * length_m(path))
    elif step.kind == "to" and step.distance_m:
        path = cut_before(functions, path, step.objects[0], step.distance_m)
    return [path]


def _plan_circle(step: InstructionStep, at: Point, functions: ScriptFunctions) -> list[Point]:
    """Return the shorter path once around an object; without a given side, try both senses."""
    paths, errors = [], []
    for side in [step.side] if step.side else ["left", "right"]:
        try:
            points = points_around(functions, step.objects[0], side, at, SNAP_M)
            path = _plan_through(at, points, functions)
            if _turned_rad(step.objects[0], side, path)[-1] < math.tau - SNAPPED_RAD:
                name = object_name(step.objects[0])
                raise CallError(f"the robot cannot drive once around {name}")
            paths.append(path)
        except TrajectoryError as error:
            errors.append(error)
    if not paths:
        raise errors[0]
    return min(paths, key=length_m)


def _plan_past(
    step: InstructionStep,
    following: InstructionStep | None,
    at: Point,
    functions: ScriptFunctions,
    more_follow: bool,
) -> list[Point]:
    """Return the shortest path past an object or around it that does not turn back.

    Without a given side, try both. Past a long object, the path may go as far as one around it.
    """
    errors: list[str] = []
    for kind in dict.fromkeys((step.kind, "around")):  # "past" and then "around", or only "around"
        paths = []
        for side in [step.side] if step.side else ["left", "right"]:
            try:
                points = _side_points(replace(step, kind=kind), following, at, side, functions)
                is_past = partial(_is_past, step.objects[0], side)
                paths.append((side, _plan_through(at, points, functions, is_past)))
            except TrajectoryError as error:
                errors.append(str(error))
        for side, path in sorted(paths, key=lambda one: length_m(one[1])):
            try:
                _check_side(step, following, side, path, functions, more_follow)
            except TrajectoryError as error:
                errors.append(str(error))
            else:
                return path
    raise CallError(errors[0])


def _check_side(
    step: InstructionStep,
    following: InstructionStep | None,
    side: str,
    path: list[Point],
    functions: ScriptFunctions,
    more_follow: bool,
) -> None:
    """Check that a path keeps to one side of an object, also with the next step.

    The way past a side may be closed behind that side. Then the robot would touch the side, turn
    back, and pass the object on the other side.

    Raises:
        TrajectoryError: the path does not keep to the side.
    """
    obj = step.objects[0]
    turned_rad = _turned_rad(obj, side, path)
    if turned_rad.min() < -PAST_RAD:
        raise CallError(
            f"the robot can reach the {side} of {object_name(obj)} only past its {OTHER_SIDE[side]}"
        )
    if more_follow and turned_rad[-1] < PAST_RAD:
        raise CallError(
            f"it is not known yet if the robot can pass the {side} of {object_name(obj)}"
        )
    turns_back_on_purpose = (
        following and following.objects == step.objects and following.side == OTHER_SIDE[side]
    )
    if following is None or turns_back_on_purpose:
        return
    (x0, y0), (x1, y1) = path[-2:]
    here = SE2(x1, y1, math.atan2(y1 - y0, x1 - x0))
    try:
        (onward,) = _plan_step(following, None, here, functions)
    except TrajectoryError:
        return  # reported when that step is planned
    if _turned_rad(obj, side, [*path, *onward]).min() < -PAST_RAD:
        raise CallError(
            f"from the {side} of {object_name(obj)} the robot would have to turn back and pass "
            f"its {OTHER_SIDE[side]} to go on ({following})"
        )


_ANGLE_STEP_M = 0.1  # spacing of the points at which the angle of a path is measured
DETOUR = 4.0
"""If the path between two points of an arc is longer than their distance by more than this factor,
it leads back around the object. The path may then end at the first of these points."""


def _is_past(obj: SceneObject, side: str, path: Sequence[Point]) -> bool:
    """Return True if a path ends past an object."""
    return bool(_turned_rad(obj, side, path)[-1] >= PAST_RAD)


def _turned_rad(obj: SceneObject, side: str, path: Sequence[Point]) -> np.ndarray:
    """Return the angle (n,) by which a path has turned around an object's centre since its start.

    It is positive towards `side`: pi / 2 when the robot is abeam on that side, pi when it is behind
    the object.
    """
    offsets = resample(np.array(path), _ANGLE_STEP_M) - centre_m(obj)
    angle_rad = np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0]))
    return TURNS[side] * (angle_rad - angle_rad[0])


def _side_points(
    step: InstructionStep,
    following: InstructionStep | None,
    at: Point,
    side: str,
    functions: ScriptFunctions,
) -> list[Point]:
    """Return points on the arc past a side of an object, for a step from the place `at`.

    "past" goes to `BEYOND_RAD` behind the side. "around" goes to the next step's object, or to the
    far side. The point at the side itself must be reachable and on that side. Other points are left
    out if the robot cannot be there.
    """
    obj = step.objects[0]
    abeam = functions.offset(obj.id, side, PASSING_DISTANCE_M, at)
    end = functions.offset(obj.id, "behind", PASSING_DISTANCE_M, at)
    if step.kind == "around" and following and following.objects not in ((), step.objects):
        end = centre_m(following.objects[0])
    arc = functions.arc(obj.id, at, end, side, PASSING_DISTANCE_M)
    looking_rad = functions.heading(at, centre_m(obj))
    points = [_place_next_to(obj, side, at, functions)]
    k = min(range(len(arc)), key=lambda i: math.dist(arc[i], abeam))  # point of the arc at the side
    for point in arc[k + 1 :]:
        # Angle between the point and the far side, from the centre: pi / 2 at the side itself.
        angle_rad = functions.heading(centre_m(obj), point)
        behind_rad = abs(math.remainder(angle_rad - looking_rad, math.tau))
        if step.kind == "past" and behind_rad < math.pi / 2 - BEYOND_RAD - 1e-6:
            break
        snapped = functions.ground.nearest(*point, within_m=SNAP_M)
        if snapped is not None and functions.ground.has_clear_view_of(obj, snapped):
            points.append(snapped)
    return points


def _plan_through(
    at: Point,
    points: Sequence[Point],
    functions: ScriptFunctions,
    may_end: Callable[[list[Point]], bool] = lambda path: False,
) -> list[Point]:
    """Return the cheapest path through points.

    `may_end` returns True if the path so far may end, in case the next point needs a long detour.
    """
    path = [at]
    for k, point in enumerate(points):
        leg = functions.a_star_plan(path[-1], point)
        if k and length_m(leg) > DETOUR * math.dist(path[-1], point) and may_end(path):
            break
        path += leg[1:]
    return path


def _place_next_to(
    obj: SceneObject,
    side: str,
    seen_from: Point,
    functions: ScriptFunctions,
    distances: Sequence[float] = PLACES,
) -> Point:
    """Return a place for the robot on a side of an object, with a clear view of it.

    `distances` are tried in this order, in units of `PASSING_DISTANCE_M` from the object.
    """
    looking_rad = functions.heading(seen_from, centre_m(obj))
    places = [functions.offset(obj.id, side, k * PASSING_DISTANCE_M, seen_from) for k in distances]
    for point in places:
        found = functions.ground.nearest(*point, within_m=SNAP_M)
        if found is not None and functions.ground.has_clear_view_of(obj, found):
            away = SE2(*centre_m(obj), looking_rad + SIDES_RAD[side])
            if abs(away.bearing_to(*found)) < math.pi / 2:
                return found
    raise _no_room_error(
        f"{side}{OF_SUFFIX.get(side, '')} {object_name(obj)}", places[::-1], functions
    )


def _no_room_error(where: str, points: Sequence[Point], functions: ScriptFunctions) -> CallError:
    """Return the error for a place where the robot cannot be.

    `points` are the places that were tried, the nearest to the object first. An occupied place
    hides the places behind it.
    """
    ground = functions.ground
    for point in points:
        if ground.is_occupied(*point):
            break
        if ground.is_unseen(*point):
            return CallError(f"not seen yet if there is room for the robot {where}")
    return CallError(f"there is no room for the robot {where}")


def _point_between(step: InstructionStep, functions: ScriptFunctions) -> Point:
    """Return the point half way between the outlines of two objects."""
    a, b = step.objects
    angle_rad = functions.heading(centre_m(a), centre_m(b))
    (px, py) = functions.ground.outline(a).point_at(angle_rad, 0.0)
    (qx, qy) = functions.ground.outline(b).point_at(angle_rad + math.pi, 0.0)
    return 0.5 * (px + qx), 0.5 * (py + qy)

"""Functions that a writer of trajectories may call: all that a script can reach (OpenNav III-A1).

Every argument is treated as hostile. Every result is made of new numbers, texts, lists and
dictionaries, so a script cannot change the scene.
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from edge import names
from edge.config import TrajectoryLimits
from edge.errors import UserError
from edge.geometry import wrap_angle
from edge.tasks.legs import simplified
from edge.tasks.scene.ground import ReachableGround
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.trajectory import (
    CoarseTrajectory,
    TrajectoryError,
    check,
    coarse_of,
    number,
    point,
    shown,
)
from edge.text import bounded_repr, one_line
from edge.trajectory.smoothing import resample

MOST_CAPTION_CHARS = 200
"""Longest label or caption that a script or a model sees."""
MOST_SHOWN = 10
"""Most trajectories that `visual_3d` accepts."""
MOST_DETECTIONS = 4
"""Most names that scripts have detected for one instruction."""
MOST_PATH_POINTS = 1000
"""Most points of the path of one call."""
PASSING_DISTANCE_M = 1.0
"""Default distance from an object's outline when the robot passes it."""
SIDES_RAD = {"behind": 0.0, "left": math.pi / 2, "right": -math.pi / 2, "in front of": math.pi}
"""Direction of each side from the object's centre, relative to the direction of view."""
TURNS = {"left": -1.0, "right": 1.0}
"""Sense of rotation around an object that leads past its side: 1.0 is counter-clockwise."""
_ARC_STEP_RAD = math.radians(3)  # angle between two points of an arc, before it is simplified
_ARC_TOLERANCE_M = 0.1  # largest distance of a simplified arc from these points
_NEAR_STEP_M = 0.5  # largest distance of a reachable end from the requested one
_MAX_SIDE_DISTANCE_M = 50.0  # largest distance from an object that a script may ask for

Point = tuple[float, float]


class CallError(TrajectoryError, ValueError):
    """A call that cannot be answered; inside a script it is a ValueError."""


@dataclass(slots=True, eq=False)
class ScriptFunctions:
    """The functions over one scene, and what a script handed over through them.

    Attributes:
        keep_to: ids of regions that `a_star_plan` prefers if a call names none; empty: any.
        detect: returns the scene with the objects of a name that the frame at hand shows
            (`edge.tasks.scene.on_demand`); None: there is no detector for it.
        trajectory: the trajectory that `give_trajectory` received; None before.
        shown_trajectories: trajectories that `visual_3d` received, (n, 2) float64 each.
        detected: by name that was detected on demand, the ids of its objects.
        detecting_s: time of these detections.
    """

    ground: ReachableGround
    limits: TrajectoryLimits
    keep_to: tuple[int, ...] = ()
    detect: Callable[[str, Scene], Scene] | None = None
    trajectory: CoarseTrajectory | None = None
    shown_trajectories: list[np.ndarray] = field(default_factory=list)
    detected: dict[str, tuple[int, ...]] = field(default_factory=dict)
    detecting_s: float = 0.0

    def table(self) -> dict[str, Callable[..., Any]]:
        """Return the functions by the names that scripts use."""
        return {name: getattr(self, name) for name in NAMES}

    def det_object(self, name: Any = None) -> list[dict[str, Any]]:
        """Return the objects with a name or of a kind, the nearest first; None: all objects.

        A name that no object of the scene has is detected on the frame at hand (OpenNav algorithm
        1, line 12).
        """
        found = list(self._scene.objects.values())
        if name is not None:
            if not isinstance(name, str) or not names.is_name(name):
                raise CallError(
                    f"det_object: name: expected the name of an object, got {shown(name)}"
                )
            found = [obj for obj in found if names.is_kind_of(obj.label, name)]
            found = found or self._detect(name)
        found.sort(key=lambda obj: self._scene.pose.distance_to(*obj.position_m[:2]))
        return [_for_scripts(obj) for obj in found]

    def _detect(self, name: str) -> list[SceneObject]:
        """Detect a name on the frame at hand, add its objects to the scene, and return them."""
        if self.detect is None or name in self.detected:
            return []
        if len(self.detected) == MOST_DETECTIONS:
            raise CallError(
                f"det_object: {MOST_DETECTIONS} new names were detected already; use the objects "
                "that are known"
            )
        begin_s = time.monotonic()
        try:
            scene = self.detect(name, self._scene)
        except UserError as error:
            raise CallError(f"det_object: {error}") from None
        finally:
            self.detecting_s += time.monotonic() - begin_s
        new = tuple(sorted(scene.objects.keys() - self._scene.objects.keys()))
        self.detected[name] = new
        self.ground = replace(self.ground, scene=scene)
        return [scene.objects[id] for id in new]

    def a_star_plan(self, start: Any, end: Any, regions: Any = ()) -> list[Point]:
        """Return the cheapest path over open ground; it prefers `regions`, a list of ids.

        If the end is not on open ground, the path leads to the nearest such point within 0.5 m.
        """
        start_m, end_m = point(start, "start"), point(end, "end")
        chosen = self._regions(regions or self.keep_to)
        goal_m = self.ground.nearest(*end_m, within_m=_NEAR_STEP_M)
        if goal_m is None:
            raise CallError(f"a_star_plan: the end {_point_text(end_m)} cannot be reached")
        found = self.ground.plan(start_m, goal_m, chosen, 0.5 * self.limits.max_jump_m)
        if not found.ok:
            ends = f"from {_point_text(start_m)} to {_point_text(end_m)}"
            raise CallError(f"a_star_plan: no path {ends}: {found.reason}")
        if len(found.path_m) > MOST_PATH_POINTS:
            raise CallError(
                f"a_star_plan: the path has more than {MOST_PATH_POINTS} points; choose a nearer "
                "end"
            )
        return _points(found.path_m)

    def visual_3d(self, points: Any) -> None:
        """Accept a trajectory without driving it, for scripts of OpenNav. Nothing shows it."""
        if len(self.shown_trajectories) == MOST_SHOWN:
            raise CallError(
                f"visual_3d: {MOST_SHOWN} trajectories are shown already; more are not allowed"
            )
        self.shown_trajectories += coarse_of(points, (), None).segments

    def give_trajectory(
        self, segments: Any, regions: Any = (), speed_mps: Any = None, heading_rad: Any = None
    ) -> None:
        """Hand over the trajectory; it is checked at once. See `coarse_of` for the arguments."""
        if self.trajectory is not None:
            raise CallError("give_trajectory: a trajectory was given already; call it only once")
        regions = _without_texts(regions, self._scene)
        coarse = coarse_of(segments, regions, speed_mps, heading_rad)
        check(coarse, self.ground, self.limits)
        self.trajectory = coarse

    def robot(self) -> dict[str, Any]:
        """Return the robot's position and heading."""
        pose = self._scene.pose
        return {"position": (pose.x_m, pose.y_m), "heading_rad": pose.yaw_rad}

    def is_free(self, at: Any) -> bool:
        """Return True if the robot can be at a point and can get there."""
        return self.ground.is_free(*point(at, "at"))

    def nearest_reachable(self, at: Any, region: Any = None) -> Point:
        """Return the reachable point nearest to another."""
        at_m = point(at, "at")
        wanted = None if region is None else next(iter(self._regions([region])))
        found = self.ground.nearest(*at_m, region=wanted)
        if found is None:
            raise CallError(
                f"nearest_reachable: the robot can reach no point near {_point_text(at_m)}"
                f"{'' if wanted is None else f' in region {wanted}'}"
            )
        return found

    def region_at(self, at: Any) -> int:
        """Return the id of the drivable region at a point; 0 = none."""
        return self.ground.region_at(*point(at, "at"))

    def distance(self, a: Any, b: Any) -> float:
        """Return the distance between two points in metres."""
        return math.dist(point(a, "a"), point(b, "b"))

    def heading(self, a: Any, b: Any) -> float:
        """Return the direction from one point to another in radians, counter-clockwise from x."""
        (ax, ay), (bx, by) = point(a, "a"), point(b, "b")
        return math.atan2(by - ay, bx - ax)

    def line(self, a: Any, b: Any) -> list[Point]:
        """Return points on a straight line, close enough to each other for a trajectory."""
        ends = np.array([point(a, "a"), point(b, "b")])
        steps = math.ceil(2.0 * float(np.hypot(*(ends[1] - ends[0]))) / self.limits.max_jump_m)
        if steps > MOST_PATH_POINTS:
            longest_m = 0.5 * MOST_PATH_POINTS * self.limits.max_jump_m
            raise CallError(
                f"line: a and b are more than {longest_m:g} m apart; choose nearer ends"
            )
        fractions = np.linspace(0.0, 1.0, max(steps, 1) + 1)[:, None]
        return _points(ends[0] + fractions * (ends[1] - ends[0]))

    def offset(
        self, id: Any, side: Any, distance_m: Any = PASSING_DISTANCE_M, seen_from: Any = None
    ) -> Point:
        """Return a point on a side of an object, at a distance from its outline.

        The side is as seen from `seen_from`, by default from the robot.
        """
        obj = self._object(id)
        if not isinstance(side, str) or side not in SIDES_RAD:
            raise CallError(f"offset: side: expected {_choices(SIDES_RAD)}, got {shown(side)}")
        angle_rad = self._view_direction_rad(obj, seen_from) + SIDES_RAD[side]
        return self.ground.outline(obj).point_at(angle_rad, _side_distance_m(distance_m))

    def arc(
        self, id: Any, start: Any, end: Any, side: Any, distance_m: Any = PASSING_DISTANCE_M
    ) -> list[Point]:
        """Return points around an object from near one point to near another.

        The arc leads past the side that is seen from the first point. It is a full circle if both
        points are in the same direction.
        """
        obj = self._object(id)
        if not isinstance(side, str) or side not in TURNS:
            raise CallError(f"arc: side: expected {_choices(TURNS)}, got {shown(side)}")
        begin_rad, end_rad = (
            wrap_angle(self._view_direction_rad(obj, p) + math.pi)
            for p in (point(start, "start"), point(end, "end"))
        )
        turn = TURNS[side]
        sweep_rad = (turn * (end_rad - begin_rad)) % (2.0 * math.pi) or 2.0 * math.pi
        steps = math.ceil(sweep_rad / _ARC_STEP_RAD)
        angles_rad = begin_rad + turn * np.linspace(0.0, sweep_rad, steps + 1)
        outline, distance_m = self.ground.outline(obj), _side_distance_m(distance_m)
        around_m = np.array([outline.point_at(angle, distance_m) for angle in angles_rad.tolist()])
        corners_m = around_m[simplified(around_m, _ARC_TOLERANCE_M)]
        return _points(resample(corners_m, 0.5 * self.limits.max_jump_m))

    def stopping_point(self, id: Any, coming_from: Any = None) -> Point:
        """Return the point where the robot stops at an object if it comes from a point.

        By default it comes from its present place. See
        `edge.tasks.scene.ground.ReachableGround.stopping_point`.
        """
        pose = self._scene.pose
        here = (pose.x_m, pose.y_m)
        from_m = here if coming_from is None else point(coming_from, "coming_from")
        obj = self._object(id)
        found, gap_m = self.ground.stopping_point(obj, from_m)
        if found is None:
            nearer_than = f" than {gap_m:.1f} m" if gap_m < math.inf else ""
            raise CallError(f"the robot gets no nearer to {obj.label} {obj.id}{nearer_than}")
        return found

    @property
    def _scene(self) -> Scene:
        return self.ground.scene

    def _object(self, id: Any) -> SceneObject:
        if type(id) is not int or id not in self._scene.objects:
            raise CallError(
                f"id: expected the id of an object ({_choices(self._scene.objects)}), "
                f"got {bounded_repr(id, 40)}"
            )
        return self._scene.objects[id]

    def _regions(self, regions: Any) -> frozenset[int]:
        known = self._scene.regions
        if not isinstance(regions, (list, tuple)) or len(regions) > 255:
            raise CallError(f"regions: expected a list of ids, got {shown(regions)}")
        regions = _without_texts(regions, self._scene)
        for region in regions:
            if type(region) is not int or region not in known:
                raise CallError(
                    f"regions: expected ids of regions ({_choices(known)}), "
                    f"got {bounded_repr(region, 40)}"
                )
        return frozenset(regions)

    def _view_direction_rad(self, obj: SceneObject, seen_from: Any) -> float:
        """Return the direction of view from a point to an object, by default from the robot."""
        pose = self._scene.pose
        from_m = (pose.x_m, pose.y_m) if seen_from is None else point(seen_from, "seen_from")
        return self.heading(from_m, tuple(obj.position_m[:2].tolist()))


NAMES = (
    "det_object", "a_star_plan", "visual_3d", "give_trajectory", "robot", "is_free",
    "nearest_reachable", "region_at", "distance", "heading", "line", "offset", "arc",
    "stopping_point",
)  # fmt: skip


def _side_distance_m(distance_m: Any) -> float:
    distance_m = number(distance_m, "distance_m", _MAX_SIDE_DISTANCE_M)
    if distance_m < 0:
        raise CallError(f"distance_m: expected 0 or more, got {distance_m:g}")
    return distance_m


def _without_texts(regions: Any, scene: Scene) -> Any:
    """Return ids of regions with numbers in place of texts such as "1", as JSON has them."""
    if not isinstance(regions, (list, tuple)):
        return regions
    by_text = {str(region): region for region in scene.regions}
    return [by_text.get(one, one) if isinstance(one, str) else one for one in regions]


def signature(function: Callable[..., Any]) -> inspect.Signature:
    """Return a function's parameters and their defaults without types, for scripts and prompts.

    >>> signature(ScriptFunctions.region_at)
    <Signature (self, at)>
    """
    full = inspect.signature(function)
    parameters = [p.replace(annotation=p.empty) for p in full.parameters.values()]
    return full.replace(parameters=parameters, return_annotation=full.empty)


def describe_object(obj: SceneObject) -> dict[str, Any]:
    """Return an object as scripts and prompts see it (OpenNav III-A2)."""
    return {
        "id": obj.id,
        "label": one_line(obj.label, MOST_CAPTION_CHARS),
        "caption": one_line(obj.caption, MOST_CAPTION_CHARS),
        "position": _rounded(obj.position_m),
        "size": _rounded(obj.size_m),
        "heading_rad": round(float(obj.heading_rad), 3),
        "nearest_reachable": {region: _rounded(at) for region, at in obj.nearest_m.items()},
    }


def _for_scripts(obj: SceneObject) -> dict[str, Any]:
    """Describe an object. Region 1 is `nearest_reachable[1]`, and `["1"]` as in the prompt."""
    described = describe_object(obj)
    nearest = described["nearest_reachable"]
    described["nearest_reachable"] = {**nearest, **{str(k): at for k, at in nearest.items()}}
    return described


def _points(xy_m: np.ndarray) -> list[Point]:
    return [(x, y) for x, y in xy_m.tolist()]


def _rounded(values: Any) -> tuple[float, ...]:
    return tuple(round(float(value), 2) for value in values)


def _point_text(at_m: Point) -> str:
    return f"({at_m[0]:.2f}, {at_m[1]:.2f})"


def _choices(values: Any) -> str:
    return ", ".join(map(str, values)) or "none"

"""Episodes: a task, the scene that methods get for it, and the place as it truly is.

| source | the scene | the truth |
|---|---|---|
| `streets[0:200]` | known: boxes, occupancy and ground of the built-in street, where LiDAR shows them | the same |
| `kitti:FOLDER` | perceived: one frame of SemanticKITTI through the chain, by the labels' boxes and masks, or, with a detector, by nothing but image and scan | things by the labels of the frame's points; ground and what is occupied by those of all frames |
| `house:CONFIG` | known: outlines of what a camera sees from the start, the floor plan of the world | the same |

Streets 0-99 are for tuning, 100-199 are held. A street has one task, whose kinds take turns; a frame
or a start has `WANTED` of each category where it has so many.
"""  # noqa: E501 (a table)

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge.config import Config, load
from edge.errors import UserError
from edge.geometry import SE2, CameraModel, Grid, optical, se3
from edge.lab.eval import kitti, world_list
from edge.lab.eval.trajectories import outdoor
from edge.lab.eval.trajectories.meaning import KINDS, Place, Task, Thing, box_outline_m, tasks
from edge.lab.sim.base import World, WorldObject, free_poses
from edge.lab.sim.generator.draws import Dice
from edge.tasks import terrain
from edge.tasks.captions import place_of
from edge.tasks.chain import Chain
from edge.tasks.ground import reachable
from edge.tasks.objects import box_around
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.value_map import open_cells
from edge.text import one_line

KNOWN = "streets[0:200], kitti:FOLDER, house:CONFIG"
WANTED = {"specific": 3, "ambiguous": 3, "high-level": 4}
STARTS = 10
"""Of a house."""
_KEY = 18
_SPEC = re.compile(r"^streets\[(\d+):(\d+)\]$")
_MOST_STREETS = 10_000
_NO_NAMES = ("object", "structure", "vehicle")  # labels of SemanticKITTI that nobody would say
_KITTI_M, _HOUSE_M = (7.0, 45.0), (1.5, 12.0)  # how far from the robot a task's things are
_LEAST_HIGH_M, _MOST_OFF_M = 0.15, 0.5  # lower things are driven over, others hang on the wall
_EYE = CameraModel.from_hfov(320, 240, math.pi / 2)
_EYE_M = 1.0
_LEAST_PX = 40


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """
    Attributes:
        id: unique, and another one when the instruction or its reference changes.
        source: "streets", "kitti" or "house".
        world: the street, the frame or the start: episodes of one are not independent.
        scene: all that methods get besides the instruction.
        truth: int8, 100 where something is, whether or not the scene tells.
        robot_m: the robot's radius.
        things: of the place, for pictures.
        solid_m: (n, 2) float64 points of what truly is there, finer than `truth`; None: there are
            none, and `truth` is exact.
    """

    id: str
    source: str
    world: str
    task: Task
    scene: Scene
    truth: Grid
    robot_m: float
    things: tuple[Thing, ...]
    solid_m: np.ndarray | None = None


def episodes(
    specs: Sequence[str], limit: int | None = None, chain: Chain | None = None
) -> Iterator[Episode]:
    """What command lines name, in its order.

    Args:
        specs: each `KNOWN` shows a form.
        limit: at most so many of each.
        chain: finds what is in a frame of SemanticKITTI; None: the labels tell it. Other places
            are known as they are, and refused.

    Raises:
        UserError: one is of no such form, or cannot be read.
    """
    found = [_of(spec, chain) for spec in specs]  # a wrong one is told before the first is run
    for each in found:
        yield from itertools.islice(each, limit)


def _of(spec: str, chain: Chain | None) -> Iterator[Episode]:
    kind, colon, name = spec.partition(":")
    if chain is not None and kind != "kitti":
        raise UserError(
            f"{one_line(spec)}: it is known as it is: a detector sees kitti:FOLDER only"
        )
    if matched := _SPEC.match(spec):
        first, end = map(int, matched.groups())
        if not first < end <= first + _MOST_STREETS:
            raise UserError(f"{spec}: an empty range, or more than {_MOST_STREETS} streets")
        return _streets(range(first, end))
    if colon and name and kind == "kitti":
        folder = Path(name)
        return _kitti(folder, kitti.frames_in(folder), chain)
    if colon and name and kind == "house":
        return _house(load(name))
    raise UserError(f"{one_line(spec)}: not understood (forms: {KNOWN})")


def _episode(
    source: str,
    world: str,
    place: Place,
    task: Task,
    scene: Scene,
    solid_m: np.ndarray | None = None,
) -> Episode:
    content = json.dumps([world, task.instruction, np.round(task.reference_m, 2).tolist()])
    code = hashlib.sha256(content.encode()).hexdigest()[:8]
    words = one_line(task.instruction, 60).replace(" ", "-").replace(",", "")
    return Episode(
        f"{world}/{words}/{code}", source, world, task, scene, place.occupancy, place.robot_m,
        place.things, solid_m,
    )  # fmt: skip


def _drawn(place: Place, dice: Dice, wanted: Mapping[str, int] = WANTED) -> list[Task]:
    """So many tasks of each category, if a place has them; kinds of high-level ones take turns."""
    found: dict[str, list[Task]] = {category: [] for category in wanted}
    for task in tasks(place, "to", dice):
        if len(found[task.category]) < wanted[task.category]:
            found[task.category].append(task)
    turns = [tasks(place, kind, dice) for kind in KINDS if kind != "to"]
    high = (task for group in itertools.zip_longest(*turns) for task in group if task is not None)
    found["high-level"] = list(itertools.islice(high, wanted["high-level"]))
    return list(itertools.chain.from_iterable(found.values()))


# -- streets ------------------------------------------------------------------------------------


def _streets(numbers: range) -> Iterator[Episode]:
    for number in numbers:
        drawn = outdoor.outdoor_episode(number)
        yield _episode("streets", f"street-{number}", drawn.place, drawn.task, drawn.scene)


# -- SemanticKITTI ------------------------------------------------------------------------------


def _kitti(folder: Path, numbers: Sequence[int], chain: Chain | None) -> Iterator[Episode]:
    frames = kitti.read_frames(folder, numbers)
    whole = kitti.scene_of(frames, kitti.oracle(frames), kitti.CAR_RADIUS_M)
    sequence, solid_m = _sequence(folder), kitti.solid_m(frames)
    for number, frame in zip(numbers, frames, strict=True):
        scene = kitti.kitti_scene(folder, [number], chain, by_labels=chain is None)
        place = kitti_place(frame, whole)
        for task in _drawn(place, Dice(_KEY, number)):
            yield _episode("kitti", f"kitti-{sequence}-{number:06d}", place, task, scene, solid_m)


def _sequence(folder: Path) -> str:
    """A name of a sequence that no other has: its folder's, and a few digits of its poses."""
    poses = hashlib.sha256((folder / "poses.txt").read_bytes()).hexdigest()[:4]
    return f"{one_line(folder.resolve().name, 40)}-{poses}"


def kitti_place(frame: kitti.Frame, whole: Scene) -> Place:
    """What the labels tell of the things in a frame's picture.

    Args:
        whole: of all frames, for its ground and what is occupied.
    """
    seen = frame.observation
    T_map_lidar = seen.T_map_base @ seen.T_base_lidar
    points_m = (seen.cloud_m @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3]).astype(np.float32)
    things = []
    for label, mine in kitti.things_shown(frame):
        if label not in _NO_NAMES:
            middle, _, _ = box_around(points_m[mine])
            outline_m = np.unique(np.round(points_m[mine, :2].astype(float), 1), axis=0)
            things.append(Thing(len(things) + 1, label, "", middle[:2], outline_m))
    drivable = whole.regions_grid.cells > 0
    return Place(seen.pose, tuple(things), whole.occupancy, drivable, kitti.CAR_RADIUS_M, _KITTI_M)


# -- a house ------------------------------------------------------------------------------------


def _house(config: Config) -> Iterator[Episode]:
    world, radius_m = world_list.load(config), config.robot.radius_m
    for number, pose in enumerate(free_poses(world, STARTS, _KEY, radius_m)):
        scene = house_scene(world, pose, radius_m)
        things = tuple(
            Thing(item.id, item.label, "", item.position_m[:2], item.points_m[:, :2].astype(float))
            for item in scene.objects.values()
        )
        drivable = scene.regions_grid.cells > 0
        place = Place(pose, things, scene.occupancy, drivable, radius_m, _HOUSE_M)
        for task in _drawn(place, Dice(_KEY, number)):
            yield _episode("house", f"{world.name}-{number}", place, task, scene)


def house_scene(world: World, pose: SE2, radius_m: float) -> Scene:
    """What stands on the floor in view of a camera that looks all round, on the floor plan."""
    plan = world.plan.grid
    occupancy = Grid((plan.cells > 0).astype(np.int8) * 100, plan.origin_xy_m, plan.resolution_m)
    floor = reachable(occupancy.cells == 0, occupancy, pose).astype(np.uint8)
    regions, cells = terrain.regions_of(occupancy, floor, ("floor",))
    allowed = reachable(open_cells(occupancy, cells, radius_m), occupancy, pose)
    shown = _in_view(world, pose)
    items = [
        item
        for item in world.objects
        if item.id in shown
        and item.size_m[2] > _LEAST_HIGH_M
        and item.center_m[2] - 0.5 * item.size_m[2] < _MOST_OFF_M
    ]
    objects = {k: _house_object(k, item, pose, cells, allowed) for k, item in enumerate(items, 1)}
    return Scene(0, pose, objects, regions, occupancy, cells, None, None, None, {})


def _in_view(world: World, pose: SE2) -> set[int]:
    """Ids of what a camera sees that turns once round."""
    depth_m = np.empty((_EYE.height_px, _EYE.width_px), np.float32)
    ids, found = np.empty(depth_m.shape, np.uint16), set()
    for quarter in range(4):
        T = optical(SE2(pose.x_m, pose.y_m, pose.yaw_rad + quarter * math.pi / 2).matrix()
                    @ se3(z_m=_EYE_M))  # fmt: skip
        world.render(_EYE, T, None, depth_m, ids)
        seen, count = np.unique(ids, return_counts=True)
        found |= set(seen[count >= _LEAST_PX].tolist())
    return found - {0}


def _house_object(
    number: int, item: WorldObject, pose: SE2, regions: Grid, allowed: np.ndarray
) -> SceneObject:
    length, width, height = item.size_m
    heading_rad = item.yaw_rad
    if width > length:
        length, width, heading_rad = width, length, heading_rad + math.pi / 2
    position_m, size_m = np.array(item.center_m), np.array([length, width, height])
    outline_m = item.footprint_m
    if outline_m is None:
        outline_m = box_outline_m(position_m, size_m, heading_rad)
    points_m = np.column_stack([outline_m, np.full(len(outline_m), position_m[2])])
    size = f"{length:.1f} x {width:.1f} x {height:.1f} m"
    return SceneObject(
        number, item.label, f"{item.label}, {size}, {place_of(position_m, pose)}", position_m,
        size_m, heading_rad, points_m.astype(np.float32),
        terrain.nearest_points(points_m, regions, allowed),
    )  # fmt: skip

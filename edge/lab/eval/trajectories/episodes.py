"""Episodes of `edge eval trajectories`: a task, the scene that methods get, and the true place.

| source | the scene | the truth |
|---|---|---|
| `streets[0:200]` | known: boxes, occupancy and ground of the built-in street, if the LiDAR hits them | the same |
| `kitti:FOLDER` | perceived: one frame of SemanticKITTI through the detection pipeline, with boxes and masks from the labels; or, with a detector, from image and scan alone | objects from the labels of the frame's points; ground and occupancy from the labels of all frames |
| `house:CONFIG` | known: outlines of the objects that a camera sees from the start, and the floor plan | the same |

Streets 0-99 are for tuning, 100-199 for testing. A street has one task; the kinds take turns. A frame
or a start has at most `WANTED` tasks of each category.
"""  # noqa: E501 (a table)

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edge.config import Config, load
from edge.errors import UserError
from edge.geometry import SE2, CameraModel, Grid, se3, to_optical
from edge.lab.eval import kitti, world_list
from edge.lab.eval.trajectories import outdoor
from edge.lab.eval.trajectories.references import (
    KINDS,
    Landmark,
    ReferenceScene,
    TrajectoryTask,
    box_outline_m,
    possible_tasks,
)
from edge.lab.sim.base import World, WorldObject, free_poses
from edge.lab.sim.generator.rng import PortableRng
from edge.perception.embedding.text import PromptError
from edge.tasks.scene import terrain
from edge.tasks.scene.captions import place_of
from edge.tasks.scene.ground import reachable
from edge.tasks.scene.objects import box_around
from edge.tasks.scene.pipeline import PerceptionPipeline
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.scene.value_map import open_cells
from edge.tasks.sentences.reading import named_objects
from edge.text import one_line

PLACE_FORMS = "streets[0:200], kitti:FOLDER, house:CONFIG"
WANTED = {"specific": 3, "ambiguous": 3, "high-level": 4}
"""Most tasks of a frame or a start, by category."""
STARTS = 10
"""Starts in a house."""
_KEY = 18  # first part of the seeds here; `outdoor` has another
_SPEC = re.compile(r"^streets\[(\d+):(\d+)\]$")
_MAX_STREETS = 10_000
_TOGETHER = 20  # frames of SemanticKITTI (2 s) whose points together are the truth of each of them
_NO_NAMES = ("object", "structure", "vehicle")  # SemanticKITTI's labels that people do not use
# Smallest and largest distance of a task's objects from the robot.
_KITTI_M, _HOUSE_M = (7.0, 45.0), (1.5, 12.0)
_MIN_HEIGHT_M = 0.15  # a lower object does not block
_MAX_ABOVE_FLOOR_M = 0.5  # an object that begins higher hangs on a wall
# Camera of a robot in a house, its height, and the fewest pixels of an object that it sees.
_CAMERA = CameraModel.from_hfov(320, 240, math.pi / 2)
_CAMERA_HEIGHT_M = 1.0
_MIN_PX = 40


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryEpisode:
    """A task with its scene and the true place.

    Attributes:
        id: unique; changes with the instruction or its reference.
        source: "streets", "kitti" or "house".
        world: the street, the frame or the start. Episodes of one world are not independent.
        task: instruction and reference.
        scene: all that methods get in addition to the instruction.
        truth: int8 cells, 100 for occupied, even if the scene does not show it.
        robot_m: the robot's radius.
        landmarks: objects of the place, for pictures.
        solid_m: (n, 2) float64, true obstacle points, finer than `truth`; None: `truth` is exact.
    """

    id: str
    source: str
    world: str
    task: TrajectoryTask
    scene: Scene
    truth: Grid
    robot_m: float
    landmarks: tuple[Landmark, ...]
    solid_m: np.ndarray | None = None


def episodes(
    specs: Sequence[str], limit: int | None = None, pipeline: PerceptionPipeline | None = None
) -> Iterator[TrajectoryEpisode]:
    """Yield the episodes of the places that the command line names, in order.

    Each spec has a form of `PLACE_FORMS`, and at most `limit` episodes. The pipeline finds the
    objects in frames of SemanticKITTI; without one, they come from the labels. With a pipeline,
    other places are refused, as their objects are known.
    """
    sources = [_episodes_of(spec, pipeline) for spec in specs]  # check all before the first runs
    for source in sources:
        yield from itertools.islice(source, limit)


def _episodes_of(spec: str, pipeline: PerceptionPipeline | None) -> Iterator[TrajectoryEpisode]:
    kind, colon, name = spec.partition(":")
    if pipeline is not None and kind != "kitti":
        raise UserError(
            f"{one_line(spec)}: --detector works only with kitti:FOLDER; omit --detector"
        )
    if matched := _SPEC.match(spec):
        first, end = map(int, matched.groups())
        if not first < end <= first + _MAX_STREETS:
            raise UserError(
                f"{spec}: got {end - first} streets; give a range of 1 to {_MAX_STREETS}"
            )
        return _streets(range(first, end))
    if colon and name and kind == "kitti":
        folder = Path(name)
        return _kitti(folder, kitti.frames_in(folder), pipeline)
    if colon and name and kind == "house":
        return _house(load(name))
    raise UserError(f"{one_line(spec)}: no such place; give one of these forms: {PLACE_FORMS}")


def _episode(
    source: str,
    world: str,
    place: ReferenceScene,
    task: TrajectoryTask,
    scene: Scene,
    solid_m: np.ndarray | None = None,
) -> TrajectoryEpisode:
    content = json.dumps([world, task.instruction, np.round(task.reference_m, 2).tolist()])
    digest = hashlib.sha256(content.encode()).hexdigest()[:8]
    words = one_line(task.instruction, 60).replace(" ", "-").replace(",", "")
    return TrajectoryEpisode(
        f"{world}/{words}/{digest}", source, world, task, scene, place.occupancy, place.robot_m,
        place.landmarks, solid_m,
    )  # fmt: skip


def _draw_tasks(place: ReferenceScene, rng: PortableRng) -> list[TrajectoryTask]:
    """Draw at most the wanted number of tasks of each category; high-level kinds take turns."""
    found: dict[str, list[TrajectoryTask]] = {category: [] for category in WANTED}
    for task in possible_tasks(place, "to", rng):
        if len(found[task.category]) < WANTED[task.category]:
            found[task.category].append(task)
    # One task of each kind in turn, until all kinds have run out.
    by_kind = [possible_tasks(place, kind, rng) for kind in KINDS if kind != "to"]
    high = (task for group in itertools.zip_longest(*by_kind) for task in group if task is not None)
    found["high-level"] = list(itertools.islice(high, WANTED["high-level"]))
    return list(itertools.chain.from_iterable(found.values()))


# -- streets ------------------------------------------------------------------------------------


def _streets(numbers: range) -> Iterator[TrajectoryEpisode]:
    for number in numbers:
        episode = outdoor.outdoor_episode(number)
        yield _episode("streets", f"street-{number}", episode.place, episode.task, episode.scene)


# -- SemanticKITTI ------------------------------------------------------------------------------


def _kitti(
    folder: Path, numbers: Sequence[int], pipeline: PerceptionPipeline | None
) -> Iterator[TrajectoryEpisode]:
    """Yield the episodes of a sequence's frames.

    Only frames near each other are in memory: an entire sequence would need gigabytes.
    """
    sequence = _sequence(folder)
    for _, near in itertools.groupby(numbers, lambda number: number // _TOGETHER):
        frames = [kitti.read_frame(folder, number) for number in near]
        all_frames, solid_m = kitti.scene_of(frames), kitti.solid_m(frames)
        for frame in frames:
            number = frame.observation.seq
            scenes: dict[tuple[str, ...], Scene] = {}
            place = kitti_place(frame, all_frames, solid_m)
            for task in _draw_tasks(place, PortableRng(_KEY, number)):
                words = () if pipeline is None else named_objects(task.instruction)
                if words not in scenes:
                    scenes[words] = _kitti_scene(frame, pipeline, words)
                yield _episode(
                    "kitti", f"kitti-{sequence}-{number:06d}", place, task, scenes[words], solid_m
                )


def _kitti_scene(
    frame: kitti.KittiFrame, pipeline: PerceptionPipeline | None, words: tuple[str, ...]
) -> Scene:
    """Return the scene of a frame; a pipeline looks for `words`, as in `edge trajectory`.

    If the pipeline lacks one of the words, it looks for its own.
    """
    if pipeline is None:
        return kitti.scene_of([frame])
    for_words = pipeline._replace(tags=lambda observation: words)
    try:
        return kitti.scene_of([frame], for_words)
    except PromptError:
        return kitti.scene_of([frame], pipeline)


def _sequence(folder: Path) -> str:
    """Return a unique name of a sequence: its folder's, and a few digits of its poses' hash."""
    poses = hashlib.sha256((folder / "poses.txt").read_bytes()).hexdigest()[:4]
    return f"{one_line(folder.resolve().name, 40)}-{poses}"


def kitti_place(frame: kitti.KittiFrame, all_frames: Scene, solid_m: np.ndarray) -> ReferenceScene:
    """Return the labelled objects in a frame's picture, with the ground and occupancy around them.

    The ground is that of the scene of all frames near it, and the occupancy the points (n, 2) of
    labelled objects in them.
    """
    seen = frame.observation
    points_m = kitti.cloud_in_map(seen).astype(np.float32)
    landmarks = []
    for label, indices in kitti.objects_shown(frame):
        if label not in _NO_NAMES:
            middle, _, _ = box_around(points_m[indices])
            outline_m = np.unique(np.round(points_m[indices, :2].astype(float), 1), axis=0)
            landmarks.append(Landmark(len(landmarks) + 1, label, "", middle[:2], outline_m))
    drivable = all_frames.regions_grid.cells > 0
    occupancy = replace(all_frames.occupancy, cells=np.zeros(drivable.shape, np.int8))
    column, row = np.floor(occupancy.to_cells(solid_m)).astype(np.int64).T
    h, w = drivable.shape
    inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    occupancy.cells[row[inside], column[inside]] = 100
    return ReferenceScene(
        seen.pose, tuple(landmarks), occupancy, drivable, kitti.CAR_RADIUS_M, _KITTI_M,
        (all_frames.occupancy.cells < 0) & ~drivable,
    )  # fmt: skip


# -- a house ------------------------------------------------------------------------------------


def _house(config: Config) -> Iterator[TrajectoryEpisode]:
    world, radius_m = world_list.load(config), config.robot.radius_m
    for number, pose in enumerate(free_poses(world, STARTS, _KEY, radius_m)):
        scene = house_scene(world, pose, radius_m)
        landmarks = tuple(
            Landmark(
                item.id, item.label, "", item.position_m[:2], item.points_m[:, :2].astype(float)
            )
            for item in scene.objects.values()
        )
        drivable = scene.regions_grid.cells > 0
        place = ReferenceScene(pose, landmarks, scene.occupancy, drivable, radius_m, _HOUSE_M)
        for task in _draw_tasks(place, PortableRng(_KEY, number)):
            yield _episode("house", f"{world.name}-{number}", place, task, scene)


def house_scene(world: World, pose: SE2, radius_m: float) -> Scene:
    """Return the scene that a spinning camera sees: floor plan, and objects on the floor."""
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
        and item.size_m[2] > _MIN_HEIGHT_M
        and item.center_m[2] - 0.5 * item.size_m[2] < _MAX_ABOVE_FLOOR_M
    ]
    objects = {k: _house_object(k, item, pose, cells, allowed) for k, item in enumerate(items, 1)}
    # Without a picture, its camera, and outlines in it.
    return Scene(0, pose, objects, regions, occupancy, cells, None, None, None, {})


def _in_view(world: World, pose: SE2) -> set[int]:
    """Return the ids of the objects that a camera sees in four views around the robot."""
    depth_m = np.empty((_CAMERA.height_px, _CAMERA.width_px), np.float32)
    ids, found = np.empty(depth_m.shape, np.uint16), set()
    for quarter in range(4):
        T = to_optical(SE2(pose.x_m, pose.y_m, pose.yaw_rad + quarter * math.pi / 2).matrix()
                    @ se3(z_m=_CAMERA_HEIGHT_M))  # fmt: skip
        world.render(_CAMERA, T, None, depth_m, ids)
        seen, count = np.unique(ids, return_counts=True)
        found |= set(seen[count >= _MIN_PX].tolist())
    return found - {0}


def _house_object(
    number: int, item: WorldObject, pose: SE2, regions: Grid, allowed: np.ndarray
) -> SceneObject:
    """Return an object of the world as an object of the scene; its longer side is the length."""
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

"""Warm-up: compiles every kernel that the loop calls, before the loop starts.

Each kernel runs once on synthetic data with the types of its calls; numba caches the result on the
disk. With a filled cache this takes a second or two. Without one it takes tens of seconds, so it
reports its progress.
"""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from time import perf_counter

import numpy as np

from edge.bus.wire import kernels as wire_kernels
from edge.config import (
    Config,
    MappingConfig,
    PerceptionConfig,
    PlannerVitl,
    PolicyPlugin,
    RobotConfig,
    TasksConfig,
    TrajectoryLimits,
)
from edge.geometry import SE2, CameraModel, Grid, se3, to_optical
from edge.host.children import python_module
from edge.loop.goals.candidates import CandidatePool
from edge.loop.scoring.prior import LocationPrior
from edge.loop.scoring.room_surveyor import RoomSurveyor
from edge.mapping.grid import RollingMap
from edge.mapping.layers import read_only
from edge.mapping.view import MapView
from edge.memory import RoomMemory
from edge.mission.logic.automaton import Automaton
from edge.mission.logic.ltl import Formula
from edge.mission.planning.distances import distances
from edge.mission.planning.plan import MissionKnowledge
from edge.mission.planning.planner import make_planner
from edge.perception.detection import kernels
from edge.perception.prior.table import load
from edge.perception.prior.words import PriorWordIndex
from edge.perception.tracking import instance_kernels, look_kernels, place_index
from edge.perception.tracking.back_projection import BackProjector
from edge.perception.tracking.fusion import InstanceFusion
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.object_tracker import ObjectTracker
from edge.perception.tracking.track import MAX_POINTS, VOXEL_M
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.policies import make_policy
from edge.policies.base import PolicyInput, ScorerOutputs
from edge.tasks.refine import refine
from edge.tasks.scene.map_scene import scene_of_map
from edge.tasks.scene.objects import ObjectMap
from edge.tasks.scene.scene_builder import add_detections
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.write import write_trajectory
from edge.trajectory.pursuit import MotionLimits
from edge.types import Detections, Instance, Observation

log = logging.getLogger("edge.loop.warmup")

_REPORT_AFTER_S = 3.0  # a longer step is logged
_HELPER_S = 300.0  # longest wait for the helper at each of its steps
_WALL_M = 3.0  # distance of the wall in the synthetic image
_CAMERA_M = 0.6  # height of the camera
_CAMERA, _T_BASE_CAMERA = CameraModel.from_hfov(48, 40, 1.6), to_optical(se3(z_m=_CAMERA_M))
_CLEARANCE_M = 0.1
_HERE = SE2(0.0, 0.0, 0.0)


def warm_up(config: Config, progress: Callable[[str], None] = lambda what: None) -> float:
    """Run every kernel of this configuration once on synthetic data.

    Returns:
        Duration in seconds.
    """
    # A helper process compiles these while this process compiles the others, and then reads them
    # from the cache.
    shared = _shared_steps(config.perception.back_projection, planner_weights(config))
    steps: dict[str, Callable[[], object]] = {
        "mapping": lambda: warm_mapping(config.mapping),
        "rooms": lambda: warm_rooms(config),
        "policy": lambda: warm_policy(config),
        **shared,
        "tasks": warm_tasks,
    }
    started = perf_counter()
    with _helper(config) if _must_compile() else nullcontext() as helper:
        for i, (name, step) in enumerate(steps.items(), start=1):
            before = perf_counter()
            what = f"preparing kernels {i}/{len(steps)}: {name}"
            log.info(what)
            progress(what)
            if helper is not None and name in shared:
                with suppress(subprocess.TimeoutExpired):
                    helper.wait(_HELPER_S)
            step()
            if perf_counter() - before > _REPORT_AFTER_S:
                log.info("compiled %s kernels in %.0f s; the next start finds them in the cache",
                         name, perf_counter() - before)  # fmt: skip
    return perf_counter() - started


def _shared_steps(back_projection: str, weights: str) -> dict[str, Callable[[], object]]:
    """Return the steps of perception, planner and messages, which the helper does, too."""
    return {
        "perception": lambda: warm_perception((back_projection,)),
        "planner": lambda: warm_planner(weights),
        "messages": warm_messages,
    }


def planner_weights(config: Config) -> str:
    """Return the setting `mission.planner.weights`, `constant` for a planner without it."""
    return getattr(config.mission.planner, "weights", "constant")


def _must_compile() -> bool:
    """Return True if kernels must be compiled, which is so if a cheap one is not in the cache."""
    kernel = kernels.to_planes
    if kernel.signatures:  # this process has called it before
        return False
    plane = np.zeros((3, 16, 16), np.float32)
    kernel(np.zeros((16, 16, 3), np.uint8), np.float32(1 / 255), 0, 0, plane)
    return bool(kernel.stats.cache_misses)


@contextmanager
def _helper(config: Config) -> Iterator[subprocess.Popen[bytes]]:
    """Run the helper process. If it fails, this process compiles everything."""
    command = (
        *python_module("edge.loop.warmup"),
        config.perception.back_projection,
        planner_weights(config),
    )
    null = subprocess.DEVNULL
    helper = subprocess.Popen(command, stdin=null, stdout=null, stderr=null)
    try:
        yield helper
    finally:
        helper.kill()
        helper.wait()


def main(back_projection: str, weights: str) -> None:
    """Run as the helper: compile the kernels of the shared steps into the cache."""
    for step in _shared_steps(back_projection, weights).values():
        step()


def _depth_m() -> np.ndarray:
    """Return a depth image of a wall ahead over a bare floor."""
    rows = np.arange(_CAMERA.height_px) - _CAMERA.cy_px
    with np.errstate(divide="ignore"):
        floor_m = np.where(rows > 0.0, _CAMERA.fy_px * _CAMERA_M / rows, np.inf)
    return np.minimum(np.broadcast_to(floor_m[:, None], (40, 48)), _WALL_M).astype(np.float32)


def room() -> Observation:
    """Return an observation of a wall ahead over a bare floor."""
    return Observation(
        0, 0, np.eye(4), depth_m=_depth_m(), camera=_CAMERA, T_base_camera=_T_BASE_CAMERA
    )


def _as_cloud(observation: Observation) -> Observation:
    """Return an observation of random points in place of the depth image."""
    cloud_m = np.random.default_rng(0).uniform(0.5, _WALL_M, (64, 3)).astype(np.float32)
    return replace(observation, depth_m=None, cloud_m=cloud_m)


def _box_in(observation: Observation) -> Detections:
    """Return the detection of a box in the synthetic image."""
    box = np.array([[20, 6, 28, 20]], np.float32)
    return Detections(observation, box, np.ones(1, np.float32), np.zeros(1, np.int32), ("box",))


def _map_of(depth_m: np.ndarray, mapping: MappingConfig, extent_m: float) -> RollingMap:
    """Return a map of a depth image."""
    grid = RollingMap(mapping.model_copy(update={"extent_m": extent_m}))
    grid.update_depth(depth_m, _CAMERA, np.eye(4), _T_BASE_CAMERA)
    return grid


def warm_mapping(mapping: MappingConfig) -> None:
    """Compile the kernels that every map needs, on a small map."""
    depth_m = _depth_m()
    depth_m[8, 8] = np.nan  # a ray without a return
    grid = _map_of(depth_m, mapping, 1.0)
    grid.update_cloud(np.ones((4, 3), np.float32), np.eye(4), np.eye(4))
    grid.bumps.close(_HERE, (0.4, 0.0), 0.2, 0)
    grid.bumps.open_all()
    grid.travel_cost.step(_HERE)
    grid.travel_cost.nearest(0.0, 0.0, 0.5)
    grid.travel_cost.stopping_point(np.zeros((1, 3), np.float32), 0.5)
    grid.travel_cost.path_xy_m(0.0, 0.0)
    grid.gain.around(grid.frontiers.xy_m, np.zeros(1, np.int32), 1, np.zeros(1, np.float32))
    grid.gain.on_view(_HERE, 0.0, 1.0)
    grid.gain.best_spin(_HERE, 0.0, 1.0)
    grid.coverage.on_image(replace(room(), depth_m=None), 1.0, 1)
    grid.coverage.search(grid.travel_cost)
    grid.coverage.is_worth_visiting(SE2(0.0, 0.0, 0.0))
    points_m = read_only(grid.frontiers.xy_m)
    grid.unknown.ratio(points_m, 1, mapping.resolution_m, np.zeros(8, np.float32))
    grid.snapshot()
    grid.state_dict()
    moved = SE2(grid.window.n * grid.resolution_m, 0.0, 0.0).matrix()  # by one window
    grid.update_depth(depth_m, _CAMERA, moved, _T_BASE_CAMERA)


def warm_values(mapping: MappingConfig) -> None:
    """Compile the kernels of value maps."""
    observation, grid = room(), _map_of(_depth_m(), mapping, 1.0)
    grid.values.set_targets(("x",))
    for view in (replace(observation, depth_m=None), observation):
        profile = grid.values.range_profile(view)
        assert profile is not None
        grid.values.write_view(profile, ("x",), np.ones(1, np.float32))
        grid.values.write_directions(profile, "x", np.ones((1, 2), np.float32), np.ones(1), 1.0)
    grid.values.best(0, read_only(grid.frontiers.xy_m), 1, 0.5, np.zeros(8, np.float32))


def warm_perception(sources: Sequence[str] = ("depth", "cloud")) -> None:
    """Compile the kernels of detection, of back-projection and of both trackers.

    Args:
        sources: sources of 3-D points, as in `perception.back_projection`.
    """
    rgb = np.zeros((16, 16, 3), np.uint8)
    kernels.to_planes(rgb, np.float32(1 / 255), 0, 0, np.zeros((3, 16, 16), np.float32))
    boxes = np.array([[0, 0, 8, 8], [1, 1, 9, 9]], np.float32)
    scores = np.array([[0.9, 0.1], [0.5, 0.8]], np.float32)
    anchor, label, keep = np.zeros(2, np.int32), np.zeros(2, np.int32), np.zeros(2, np.int32)
    score, top, tau = np.zeros(2, np.float32), np.zeros(2, np.float32), np.float32(0.05)
    found, _ = kernels.candidates(boxes, scores, 1, tau, 1e3, anchor, label, score, top)
    kernels.best_per_class(scores, np.arange(2, dtype=np.int32), np.zeros((2, 2), np.float32))
    n = kernels.suppress(boxes, anchor, label, score, found, 0, 1, False, 0.5, keep)
    xyxy, cut = np.zeros((2, 4), np.float32), np.zeros(2, np.bool_)
    n = kernels.to_image(boxes, anchor, keep, n, 1.0, 0, 0, 16, 16, xyxy, cut)
    kernels.competing_scores(
        boxes, scores, np.ones((2, 1, 2), np.bool_), tau, top, anchor, label, keep, n, cut, 0.5,
        np.zeros(2, np.float32),
    )  # fmt: skip
    kernels.object_boxes(
        np.ones((16, 16), np.uint16), np.ones((16, 16), np.float32), np.zeros((1, 4), np.int32),
        np.zeros(1, np.int32), np.zeros(1, np.float32),
    )  # fmt: skip

    observation = replace(room(), cloud_m=np.ones((4, 3), np.float32))
    detections = _box_in(observation)
    for source in sources:
        settings = {"back_projection": source, "detector": {"kind": "sim"}}
        perception = PerceptionConfig.model_validate(settings)
        lifted, _ = BackProjector(perception).back_project(detections)
    clear = replace(lifted, valid=np.ones(1, np.bool_), n_points=np.ones(1, np.int32))
    objects = ObjectTracker(perception)
    objects.update(clear, clear)
    objects.has_competing_object("box", np.ones((1, 3), np.float32), 0.1)
    objects.clear()
    index = place_index.make_index(1)
    place_index.insert(index, 0, 0.0, 0.0)
    place_index.remove(index, 0)
    fusion = InstanceFusion(InstanceTracker(perception))
    fusion.update(clear, 0)
    fusion.update(clear, 1)
    fusion.expire(observation, detections.prompts)
    # Kernels that need more than one instance or image.
    points_m, support = np.zeros((1, 3), np.float32), np.ones(1, np.int32)
    instance_kernels.merge_points(points_m, support, points_m, VOXEL_M, MAX_POINTS)
    instance_kernels.core_points(points_m, support)
    instance_kernels.nearest(points_m, 0.0, 0.0)
    instance_kernels.least_gap(points_m, points_m)
    view = look_kernels.view_of(_CAMERA)
    look_kernels.visibility(0.0, 0.0, 1.0, points_m, 1, np.eye(4), view, _depth_m(), 6.0)


def warm_planner(weights: str) -> None:
    """Compile the planner's kernels for these weights."""
    automaton = Automaton(
        formula=Formula("ap", name="a"),
        propositions=("a",),
        delta=np.array([[1, 0], [1, 1]], np.int32),
        accepting=np.array([False, True]),
        steps_left=np.array([1, 0], np.int32),
    )
    make_planner(PlannerVitl.model_validate({"weights": weights}), automaton).plan(
        0, MissionKnowledge()
    )
    if weights == "distance":
        snapshot = Grid(np.zeros((4, 4), np.int8), (0.0, 0.0), 0.2)
        distances(snapshot, (0.1, 0.1), [np.array([[0.7, 0.7]])])


def warm_messages() -> None:
    """Compile the kernels of the codecs (payloads are read-only)."""
    wire_kernels.exact_millimetres(np.zeros(1, np.float32), np.zeros(1, np.uint16))
    points_m, depth_m = np.zeros((2, 3), np.float32), np.zeros((1, 1), np.float32)
    ranges_m, cloud = np.frombuffer(bytes(8), np.float32), np.frombuffer(bytes(24), np.uint8)
    scale, no_return = np.float32(1.0), np.uint16(1)
    wire_kernels.depth_of_integers(cloud, 0, 2, False, scale, no_return, depth_m)
    bits = points_m.view(np.uint32)
    wire_kernels.cloud_points(cloud, 0, 1, 2, 24, 12, (0, 4, 8), False, bits)
    wire_kernels.scan_points(ranges_m, 0.0, 0.1, 0.1, 1.0, 1.0, points_m)


def warm_rooms(config: Config) -> None:
    """Compile the kernels of rooms and prior."""
    grid, objects, table = RollingMap(config.mapping), TrackedObjects(1), load()
    grid.update_cloud(np.zeros((0, 3), np.float32), np.eye(4), np.eye(4))
    words = PriorWordIndex(table)
    rooms, prior = RoomMemory(table, words), LocationPrior("both", table, words)
    objects.words.append(table.classes[0])
    objects.n = 1
    RoomSurveyor(inline=True).step(rooms, MapView(grid), 0)
    rooms.update(objects.read_only(), 0)
    prior.step(rooms.survey.regions, objects.read_only())
    at_m, out = np.zeros((1, 2), np.float32), np.empty(1, np.float32)
    prior.likelihood_ratio(table.classes[0], at_m, 1, out)


def warm_tasks() -> None:
    """Do a small task: see a box, write a trajectory to it by the rules, and refine it.

    This compiles every kernel that a service calls for a task, with any configuration.
    """
    observation, objects = room(), ObjectMap()
    for frame in (observation, _as_cloud(observation)):
        add_detections(objects, _box_in(frame), 2.0 * _WALL_M)
    grid = _map_of(_depth_m(), MappingConfig(), 4.0 * _WALL_M)
    points_m = np.array([[_WALL_M, 0.0, 0.5]], np.float32)
    obj = Instance(1, "box", points_m[0], points_m, 1.0, 1, 0, 0)
    scene = scene_of_map(MapView(grid), observation, (obj,), _CLEARANCE_M)
    limits = TasksConfig(trajectory=TrajectoryLimits(clearance_m=_CLEARANCE_M))
    coarse = write_trajectory("go to the box", scene, limits).coarse
    margins, motion = PathMargins(_CLEARANCE_M), MotionLimits.of(RobotConfig())
    refine(scene, coarse.segments, coarse.regions, margins, motion)


def warm_policy(config: Config) -> None:
    """Score a map with one frontier and an image with one box.

    A policy plugin compiles its own kernels when it is made.
    """
    if config.value_source is not None:
        warm_values(config.mapping)
    if isinstance(config.policy, PolicyPlugin):
        return
    grid = RollingMap(config.mapping)
    pool = CandidatePool(8, config.policy.r_assoc_m)
    grid.frontiers.n = 1
    grid.values.set_targets(("x",))
    grid.window.placed = True
    grid.travel_cost.step(_HERE)
    pool.update(grid.frontiers, [], 0, 0)
    pool.measure(grid)
    pool.add_spin(grid, _HERE, 1.0, 0)
    found = _box_in(replace(room(), depth_m=None))
    observation, no_area = found.observation, (0, 0, 0, 0)
    context = PolicyInput(
        observation, observation.pose, MapView(grid), no_area, pool.read_only, found,
        ScorerOutputs(), found.prompts, found.prompts[0], 0,
    )  # fmt: skip
    make_policy(config.policy).score(context)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Background worker that writes and refines the trajectory of a task (see `follow.py`)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Union

import numpy as np

from edge.config import Config, MappingConfig, TasksConfig, WriterModel
from edge.errors import UserError
from edge.geometry import SE2
from edge.mapping.view import MapView
from edge.mission.language.tokens import TranslationError
from edge.tasks.functions import ScriptFunctions
from edge.tasks.ground import ground_of
from edge.tasks.ground_votes import GroundVotes
from edge.tasks.manoeuvres import limited_ground
from edge.tasks.map_scene import scene_of_map
from edge.tasks.object_phrases import AmbiguousObjectError
from edge.tasks.objects import ObjectMap
from edge.tasks.on_demand import FrameDetector
from edge.tasks.phrases import ground_kind
from edge.tasks.pipeline import GroundKinds, open_pipeline
from edge.tasks.prompt import system_prompt, task_text
from edge.tasks.reading import route_limits
from edge.tasks.refine import RefinedTrajectory, refine, refine_again
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.scene_builder import add_detections, add_ground
from edge.tasks.step_phrases import UnseenGroundError
from edge.tasks.value_map import PathMargins
from edge.tasks.write import PlanAttempt, write_trajectory
from edge.trajectory.pursuit import MotionLimits
from edge.types import Detections, Instance, Observation

log = logging.getLogger("edge.loop.behaviours.plan_worker")

NEARER_M = 0.15
"""Smallest approach to an object that is worth another trajectory."""
SAME_OBJECT_M = 3.0
"""If the id of the object at which the robot stopped is gone, the nearest object of the same label
replaces it, if that object is within this distance of the robot."""


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """The result of writing or refining a trajectory.

    Attributes:
        refined: The trajectory; None if there is none.
        error: Reason why there is no trajectory, one line.
        hopeless: True if no later try can succeed, even with more objects seen.
        ambiguous: Ids of the objects that a name may mean, if it is ambiguous.
        coarse_m: (n, 2) float64 in `map`, the trajectory as written; None if none was written.
        speed_mps: Speed that the instruction asks for; None if it asks for none.
        stops_at: Id and label of the object at which the trajectory ends; None if it ends at no
            object; see `edge.tasks.write.WrittenTrajectory`.
        stops: One item for each step of this trajectory: the (id, label) pairs of the objects at
            which the step ends. The last item belongs to step `n_done`. Empty if a model wrote
            the trajectory.
        grounds: Labels of the regions that were chosen for the trajectory.
        n_done: Number of steps of the task that are done at the end of the trajectory.
        understood: See `edge.tasks.facts.TaskStatus`.
        prompt: See `edge.tasks.facts.TaskStatus`.
        rounds: See `edge.tasks.facts.TaskStatus`.
    """

    refined: RefinedTrajectory | None = None
    error: str = ""
    hopeless: bool = False
    ambiguous: tuple[int, ...] = ()
    coarse_m: np.ndarray | None = None
    speed_mps: float | None = None
    stops_at: tuple[int, str] | None = None
    stops: tuple[tuple[tuple[int, str], ...], ...] = ()
    grounds: frozenset[str] = frozenset()
    n_done: int = 0
    understood: str = ""
    prompt: str = ""
    rounds: tuple[PlanAttempt, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMapUpdate:
    """A request to add the boxes of an image to an object map.

    Attributes:
        found: Boxes of the image. Its frame is held until `release_frame`.
        objects: Object map of the task.
        range_m: Largest distance of an object from the camera.
    """

    found: Detections
    objects: ObjectMap
    range_m: float


@dataclass(frozen=True, slots=True, eq=False)
class GroundUpdate:
    """A request to name the kinds of ground in an image.

    Attributes:
        observation: Frame with the image. It is held until `release_frame`.
        classifier: Names the kind in each pixel.
        votes: Votes of the task for kinds of ground.
        mapping: Settings of the map.
    """

    observation: Observation
    classifier: GroundKinds
    votes: GroundVotes
    mapping: MappingConfig


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """A request to the worker to write or refine a trajectory, with all data that it needs.

    Attributes:
        config: The configuration.
        instruction: Instruction of the task.
        n_driven: Number of steps already driven. The trajectory begins with the next step.
        ends: Candidates for the step at which the trajectory ends, counted from the start of the
            instruction. The worker tries them in this order, the largest first.
        n_steps: Total number of steps.
        view: The map.
        observation: Observation with the robot's pose.
        instances: Objects of the targets.
        objects: Object map of the task.
        ground: Votes of the task for kinds of ground; None: the ground has no kinds.
        found: Detections of the image for a model; None if it gets none.
        before: Earlier result, whose trajectory is refined again from `index` on. None: write a
            new trajectory.
        index: Index of the pose to refine from.
        reason: Reason for a new trajectory; "" for the first.
        nearer_to: Id and label of the object at which the robot stopped. The new trajectory leads
            nearer to this object on the current map. None for other requests.
        attempts: Attempts of the model. The worker appends them while it runs.
    """

    config: Config
    instruction: str
    n_driven: int
    ends: tuple[int, ...]
    n_steps: int
    view: MapView
    observation: Observation
    instances: Sequence[Instance]
    objects: ObjectMap
    ground: GroundVotes | None
    found: Detections | None
    before: PlanResult | None = None
    index: int = 0
    reason: str = ""
    nearer_to: tuple[int, str] | None = None
    attempts: list[PlanAttempt] = field(default_factory=list)


def log_line(result: PlanResult, refined: RefinedTrajectory, request: PlanRequest) -> str:
    """Return a line about a trajectory for the mission log."""
    length_m = float(np.hypot(*np.diff(refined.poses[:, :2], axis=0).T).sum())
    origin = result.understood or "written by the model"
    if request.before is not None:
        origin = "refined again"
    elif request.nearer_to is not None:
        origin = "to get nearer to the object at its end"
    notes = "".join(f"; {note}" for note in refined.notes)
    return f"trajectory of {length_m:.1f} m: {origin}{notes}"


Request = Union[ObjectMapUpdate, GroundUpdate, PlanRequest]


def run_request(request: Request) -> PlanResult | None:
    """Carry out a request. A `PlanRequest` never raises, because the task waits for a result."""
    if not isinstance(request, PlanRequest):
        try:
            _update(request)
        finally:
            release_frame(request)
        return None
    try:
        if request.nearer_to is not None:
            return _approach(request, request.nearer_to)
        if request.before is not None and request.before.refined is not None:
            return _refine(request, request.before, request.before.refined)
        return _write(request)
    except UserError as error:
        return PlanResult(error=str(error), hopeless=isinstance(error, TranslationError))
    except Exception as error:
        log.exception("writing a trajectory failed; please report it with this traceback")
        return PlanResult(error=f"a bug in edge: {type(error).__name__}: {error}")


def _update(request: ObjectMapUpdate | GroundUpdate) -> None:
    if isinstance(request, GroundUpdate):
        add_ground(request.votes, request.classifier, request.observation, request.mapping)
    else:
        add_detections(request.objects, request.found, request.range_m)


def release_frame(request: Request) -> None:
    """Release the frame of a request."""
    if isinstance(request, ObjectMapUpdate):
        request.found.observation.release()
    elif isinstance(request, GroundUpdate):
        request.observation.release()


def _write(request: PlanRequest) -> PlanResult:
    """Write a trajectory for as many steps as possible."""
    scene, result = _scene(request), PlanResult()
    for n_steps in request.ends:
        result = _write_up_to(n_steps, request, scene)
        if result.refined is not None or result.hopeless:
            break
    return result


def _write_up_to(n_steps: int, request: PlanRequest, scene: Scene) -> PlanResult:
    """Write a trajectory that ends with step `n_steps`, counted from the start."""
    config = request.config
    # An open slice tells `write_trajectory` that the robot stops at its end.
    steps = slice(request.n_driven, n_steps if n_steps < request.n_steps else None)
    limits, instruction = _task_settings(config).trajectory, request.instruction
    prompt = ""
    if isinstance(config.tasks.planner, WriterModel):
        prompt = f"{system_prompt()}\n\n{task_text(instruction, scene, limits, request.reason)}"
    result = PlanResult(prompt=prompt, n_done=n_steps)
    try:
        written = write_trajectory(
            instruction,
            scene,
            _task_settings(config),
            request.attempts.append,
            request.reason,
            partial(ScriptFunctions, detect=_frame_detector(request)),
            steps,
        )
        coarse, end_id = written.coarse, written.stops_at
        labels = {k: obj.label for k, obj in scene.objects.items()}
        stops_at = None if end_id is None else (end_id, labels[end_id])
        stops = tuple(tuple((k, labels[k]) for k in step) for step in written.stops)
        result = replace(
            result, coarse_m=coarse.points_m, speed_mps=coarse.speed_mps,
            understood=written.understood, stops_at=stops_at, stops=stops,
        )  # fmt: skip
        refined = refine(
            written.ground.scene, coarse.segments, coarse.regions, _margins(config),
            _motion_limits(config, result),
            heading_rad=coarse.heading_rad,
        )  # fmt: skip
    except UserError as error:
        ambiguous = error.things if isinstance(error, AmbiguousObjectError) else ()
        hopeless = isinstance(error, TranslationError) and not _may_appear(error, request)
        return replace(
            result, error=str(error), hopeless=hopeless,
            ambiguous=ambiguous, rounds=tuple(request.attempts),
        )  # fmt: skip
    grounds = frozenset(scene.regions[k].label for k in refined.drivable if k in scene.regions)
    return replace(result, refined=refined, rounds=tuple(request.attempts), grounds=grounds)


def _may_appear(error: TranslationError, request: PlanRequest) -> bool:
    """Return True if the network can name the ground that was not seen so far."""
    return (
        isinstance(error, UnseenGroundError)
        and request.ground is not None
        and error.kind in map(ground_kind, request.ground.kinds)
    )


def _frame_detector(request: PlanRequest) -> FrameDetector | None:
    """Return what detects a new name in the request's frame for a model's script.

    It opens the configured detector once more, for one picture: the service's own is in use. The
    simulator's detector cannot be opened twice.
    """
    config, seen = request.config, request.observation
    has_points = seen.cloud_m is not None or seen.depth_m is not None
    if seen.rgb is None or not has_points or config.perception.detector.kind == "sim":
        return None
    return FrameDetector(
        seen, lambda name: open_pipeline(config.perception, (name,)),
        _margins(config).clearance_m, config.mapping.range_m,
    )  # fmt: skip


def _refine(request: PlanRequest, before: PlanResult, refined: RefinedTrajectory) -> PlanResult:
    """Refine the rest of an earlier trajectory on the current map."""
    config = request.config
    scene, limits = _scene(request), _motion_limits(config, before)
    if not isinstance(config.tasks.planner, WriterModel):
        clearance_m = _margins(config).clearance_m
        avoided = route_limits(request.instruction, scene)
        scene = limited_ground(ground_of(scene, clearance_m), avoided, clearance_m).scene
    # The ids of regions are those of an earlier scene.
    chosen = {k for k, region in scene.regions.items() if region.label in before.grounds}
    refined = replace(refined, drivable=frozenset(chosen or scene.regions))
    refined = refine_again(scene, refined, request.index, _margins(config), limits)
    return replace(before, refined=refined)


def _approach(request: PlanRequest, obj: tuple[int, str]) -> PlanResult:
    """Write a trajectory nearer to an object that was far away, or hidden, before.

    The result has no trajectory if the approach is below `NEARER_M`.
    """
    scene = _scene(request)
    found = _find_again(obj, scene)
    if found is None:
        return PlanResult()
    instruction = f"go to object {found.id}"
    result = _write(replace(request, instruction=instruction, n_driven=0, ends=(1,), n_steps=1))
    if result.refined is None:
        return result
    x_m, y_m, _, yaw_rad = result.refined.poses[-1].tolist()
    if _distance_m(found, scene.pose) - _distance_m(found, SE2(x_m, y_m, yaw_rad)) < NEARER_M:
        return PlanResult()
    return result


def _find_again(obj: tuple[int, str], scene: Scene) -> SceneObject | None:
    """Return the object with this (id, label). If it is gone, return the nearest of its label."""
    object_id, label = obj
    if object_id in scene.objects:
        return scene.objects[object_id]
    same_label = [other for other in scene.objects.values() if other.label == label]
    nearest = min(same_label, key=lambda other: _distance_m(other, scene.pose), default=None)
    return None if nearest is None or _distance_m(nearest, scene.pose) > SAME_OBJECT_M else nearest


def _distance_m(obj: SceneObject, at: SE2) -> float:
    return float(np.hypot(*(obj.points_m[:, :2] - (at.x_m, at.y_m)).T).min())


def _scene(request: PlanRequest) -> Scene:
    radius_m = _margins(request.config).clearance_m
    return scene_of_map(
        request.view,
        request.observation,
        request.instances,
        radius_m,
        request.found,
        object_map=request.objects,
        ground=request.ground,
    )


def _task_settings(config: Config) -> TasksConfig:
    """Return the task settings, with a clearance of at least the map's inflation.

    A path inside the inflated cells would count as blocked.
    """
    tasks, trajectory = config.tasks, config.tasks.trajectory
    clearance_m = max(trajectory.clearance_m, config.mapping.inflation_m)
    trajectory = trajectory.model_copy(update={"clearance_m": clearance_m})
    return tasks.model_copy(update={"trajectory": trajectory})


def _margins(config: Config) -> PathMargins:
    return PathMargins(_task_settings(config).trajectory.clearance_m)


def _motion_limits(config: Config, result: PlanResult) -> MotionLimits:
    """Return the robot's limits, with the speed of the instruction if that is lower."""
    limits = MotionLimits.of(config.robot)
    wanted_mps = limits.speed_mps if result.speed_mps is None else result.speed_mps
    return replace(limits, speed_mps=min(wanted_mps, limits.speed_mps))

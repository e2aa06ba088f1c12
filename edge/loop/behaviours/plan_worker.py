"""Background worker that writes and refines the trajectory of a task (see `follow.py`)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Union

import numpy as np

from edge.config import Config, TasksConfig, WriterModel
from edge.errors import UserError
from edge.geometry import SE2
from edge.host.worker import Worker
from edge.loop.input_log import TASK, InputLog
from edge.mapping.view import MapView
from edge.mission.language.words.tokens import TranslationError
from edge.tasks.functions import ScriptFunctions
from edge.tasks.manoeuvres import limited_ground
from edge.tasks.prompt import system_prompt, task_text
from edge.tasks.refine import RefinedTrajectory, refine, refine_again
from edge.tasks.scene.ground import ground_of
from edge.tasks.scene.ground_votes import GroundVotes
from edge.tasks.scene.map_scene import scene_of_map
from edge.tasks.scene.objects import ObjectMap
from edge.tasks.scene.on_demand import FrameDetector
from edge.tasks.scene.pipeline import GroundKinds, open_pipeline
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.scene.scene_builder import add_detections, add_ground
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.sentences.object_phrases import AmbiguousObjectError, UnseenObjectError
from edge.tasks.sentences.phrases import ground_kind
from edge.tasks.sentences.reading import route_limits
from edge.tasks.sentences.step_phrases import UnseenGroundError
from edge.tasks.write import PlanAttempt, write_trajectory
from edge.trajectory.pursuit import MotionLimits
from edge.types import Detections, Instance, Observation

log = logging.getLogger("edge.loop.behaviours.plan_worker")

NEARER_M = 0.15
"""Smallest approach to an object that is worth another trajectory."""
GROUND_PERIOD_NS = 1_000_000_000
"""Least time between two images whose ground is named."""
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
            which the step ends. The last item belongs to step `n_done`. Empty if a model wrote the
            trajectory.
        grounds: Labels of the regions that were chosen for the trajectory.
        n_done: Number of steps of the task that are done at the end of the trajectory.
        understood: See `edge.tasks.facts.TaskStatus`, like `prompt`.
        rounds: Attempts of the model; recordings have this name.
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
class ImageUpdate:
    """A request to add an image to the surroundings of a task.

    Attributes:
        observation: Frame of the image. It is held until `release_frame`.
        add: Adds its objects or its kinds of ground.
    """

    observation: Observation
    add: Callable[[], object]


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """A request to the worker to write or refine a trajectory, with all data that it needs.

    Attributes:
        n_driven: Number of steps already driven. The trajectory begins with the next step.
        ends: Candidates for the step at which the trajectory ends, counted from the start of the
            instruction. The worker tries them in this order, the largest first.
        observation: Observation with the robot's pose.
        instances: Objects of the targets.
        objects: Object map of the task.
        votes: Votes of the task for kinds of ground; None: the ground has no kinds.
        found: Detections of the image for a model; None if it gets none.
        before: Earlier result, whose trajectory is refined again from `index` on. None: write a new
            trajectory.
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
    votes: GroundVotes | None
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


Request = Union[ImageUpdate, PlanRequest]


class PlanWorker:
    """The background worker of one task, with the objects and the ground that images showed.

    Args:
        input_log: Input log, which records the results.
        ground: Names the kinds of ground in images; None: all ground is of one kind.

    Attributes:
        request: Request for a trajectory whose result was not polled yet; None if there is none.
        objects: Objects that images showed. Only the worker's thread uses them.
        ground_votes: Votes for kinds of ground, likewise; None if all ground is of one kind.
    """

    def __init__(self, config: Config, input_log: InputLog, ground: GroundKinds | None) -> None:
        self._config, self._ground = config, ground
        self._inner_worker: Worker[Request, PlanResult] = Worker(
            "task", run_request, inline=config.loop.lockstep, drop=release_frame
        )
        self._worker: Any = input_log.wrap(TASK, self._inner_worker)
        self.request: PlanRequest | None = None
        self._ground_ns: int | None = None  # loop time of the newest image for `ground_votes`
        self._forget_surroundings()

    def submit(self, request: PlanRequest) -> None:
        """Write or refine a trajectory."""
        self.request = request
        self._worker.submit(request)

    def poll(self) -> tuple[PlanResult, PlanRequest] | None:
        """Return the result of the newest request, and the request; None if there is none yet."""
        result, request = self._worker.poll(), self.request
        if result is None or request is None:
            return None
        self.request = None
        return result, request

    def name_ground(self, observation: Observation, now_ns: int) -> None:
        """Name the ground that the image shows, at most once in `GROUND_PERIOD_NS`.

        Nothing waits for the network but the next request, so it gets no image while one waits.
        """
        votes, classifier, newest_ns = self.ground_votes, self._ground, self._ground_ns
        if votes is None or classifier is None or self.request is not None:
            return
        ranged = observation.depth_m is not None or observation.cloud_m is not None
        is_due = newest_ns is None or now_ns - newest_ns >= GROUND_PERIOD_NS
        pictured = observation.rgb is not None and observation.camera is not None
        if is_due and ranged and pictured and self._inner_worker.idle:
            self._ground_ns = now_ns
            observation.hold()
            add = partial(add_ground, votes, classifier, observation, self._config.mapping)
            self._inner_worker.submit(ImageUpdate(observation, add), "ground")

    def add_detections(self, found: Detections) -> None:
        """Add the detections to the objects."""
        perception, observation = self._config.perception, found.observation
        found = found.above(perception.tau_det)
        ranged = observation.depth_m is not None or observation.cloud_m is not None
        if len(found) and ranged and observation.camera is not None:
            observation.hold()
            range_m = perception.back_projection_max_range_m
            add = partial(add_detections, self.objects, found, range_m)
            self._inner_worker.submit(ImageUpdate(observation, add), "objects")

    def reconfigure(self, config: Config, ground: GroundKinds | None) -> None:
        """Use another configuration from the next request on; see `Behaviour.reconfigure`."""
        self._config = config
        if ground is not self._ground:
            self._ground = ground
            self._forget_surroundings()

    def on_pose_jump(self) -> None:
        """Drop the running request and all positions: they are in the old frame."""
        self._worker.discard_all()
        self.request = None
        self._forget_surroundings()

    def close(self) -> None:
        """Drop the running request and stop the worker."""
        self._worker.discard_all()
        self._worker.stop()

    def _forget_surroundings(self) -> None:
        self.objects = ObjectMap()
        self.ground_votes = None if self._ground is None else GroundVotes(self._ground.kinds)
        self._ground_ns = None


def is_by_model(config: Config) -> bool:
    """Return True if a language model writes trajectories, False if the rules do."""
    return isinstance(config.tasks.planner, WriterModel)


def run_request(request: Request) -> PlanResult | None:
    """Carry out a request. A `PlanRequest` never raises, because the task waits for a result."""
    if isinstance(request, ImageUpdate):
        try:
            request.add()
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


def release_frame(request: Request) -> None:
    """Release the frame of a request."""
    if isinstance(request, ImageUpdate):
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
    # An open slice means to `write_trajectory` that the robot stops at its end.
    steps = slice(request.n_driven, n_steps if n_steps < request.n_steps else None)
    limits, instruction = _task_settings(config).trajectory, request.instruction
    prompt = ""
    if is_by_model(config):
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
            written.reachable.scene, coarse.segments, coarse.regions, _margins(config),
            _motion_limits(config, result),
            heading_rad=coarse.heading_rad,
        )  # fmt: skip
    except UserError as error:
        ambiguous = error.ids if isinstance(error, AmbiguousObjectError) else ()
        hopeless = isinstance(error, TranslationError) and not _may_appear(error, request)
        return replace(
            result, error=str(error), hopeless=hopeless,
            ambiguous=ambiguous, rounds=tuple(request.attempts),
        )  # fmt: skip
    grounds = frozenset(scene.regions[k].label for k in refined.drivable if k in scene.regions)
    return replace(result, refined=refined, rounds=tuple(request.attempts), grounds=grounds)


def _may_appear(error: TranslationError, request: PlanRequest) -> bool:
    """Return True if the described object, or ground that the network can name, may be seen yet."""
    return isinstance(error, UnseenObjectError) or (
        isinstance(error, UnseenGroundError)
        and request.votes is not None
        and error.kind in map(ground_kind, request.votes.kinds)
    )


def _frame_detector(request: PlanRequest) -> FrameDetector | None:
    """Return what detects a new name in the request's frame for a model's script.

    It opens the configured detector once more, for one picture: the service's own is in use. The
    simulator's detector cannot be opened twice.
    """
    config, observation = request.config, request.observation
    has_points = observation.cloud_m is not None or observation.depth_m is not None
    if observation.rgb is None or not has_points or config.perception.detector.kind == "sim":
        return None
    return FrameDetector(
        observation, lambda name: open_pipeline(config.perception, (name,)),
        _margins(config).clearance_m, config.mapping.range_m,
    )  # fmt: skip


def _refine(request: PlanRequest, before: PlanResult, refined: RefinedTrajectory) -> PlanResult:
    """Refine the rest of an earlier trajectory on the current map."""
    config = request.config
    scene, limits = _scene_without_avoided(request), _motion_limits(config, before)
    # The ids of regions are those of an earlier scene.
    chosen = {k for k, region in scene.regions.items() if region.label in before.grounds}
    refined = replace(refined, drivable=frozenset(chosen or scene.regions))
    refined = refine_again(scene, refined, request.index, _margins(config), limits)
    return replace(before, refined=refined)


def _approach(request: PlanRequest, obj: tuple[int, str]) -> PlanResult:
    """Write a trajectory nearer to an object that was far away, or hidden, before.

    The result has no trajectory if the approach is below `NEARER_M`.
    """
    scene = _scene_without_avoided(request)
    found = _find_again(obj, scene)
    if found is None:
        return PlanResult()
    instruction = f"go to object {found.id}"
    nearer = replace(request, instruction=instruction, n_driven=0, ends=(1,), n_steps=1)
    result = _write_up_to(1, nearer, scene)
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
        ground=request.votes,
    )


def _scene_without_avoided(request: PlanRequest) -> Scene:
    """Return the scene in which what the rules read as "avoid …" is closed."""
    scene, config = _scene(request), request.config
    if is_by_model(config):
        return scene
    clearance_m = _margins(config).clearance_m
    avoided = route_limits(request.instruction, scene)
    return limited_ground(ground_of(scene, clearance_m), avoided, clearance_m).scene


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

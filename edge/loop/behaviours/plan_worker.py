"""Background planner of a task's trajectory: it writes and refines it (see `follow.py`)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from edge.config import Config, TasksConfig, WriterModel
from edge.errors import UserError
from edge.geometry import SE2
from edge.mapping.view import MapView
from edge.mission.language.tokens import TranslationError
from edge.tasks.objects import ObjectMap
from edge.tasks.prompt import system_prompt, task_text
from edge.tasks.reading import AmbiguousObjectError
from edge.tasks.refine import RefinedTrajectory, refine, refine_again
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.scene_builder import add_detections, scene_of_map
from edge.tasks.value_map import PathMargins
from edge.tasks.write import PlanAttempt, write_trajectory
from edge.trajectory.pursuit import MotionLimits
from edge.types import Detections, Instance, Observation

log = logging.getLogger("edge.loop.behaviours.plan_worker")

NEARER_M = 0.15
"""Smallest approach to an object that is worth another trajectory."""
AGAIN_M = 3.0
"""An object of the same label this near to the robot is taken as the object that it stopped at, if
the old id is gone."""


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
        stops_at: Id and label of the object at its end; see
        `edge.tasks.write.WrittenTrajectory`.
        stops: Ids and labels of the objects at the stop of each step; the last is that of step
            `n_done`. Empty if a model wrote the trajectory.
        n_done: Number of steps of the task that are done at its end.
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
    n_done: int = 0
    understood: str = ""
    prompt: str = ""
    rounds: tuple[PlanAttempt, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMapUpdate:
    """A request to add the boxes of an image, whose frame is held, to an object map."""

    found: Detections
    objects: ObjectMap
    range_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """A request to the worker to write or refine a trajectory, with all data that it needs.

    Attributes:
        config: The configuration.
        instruction: Instruction of the task.
        first: Number of steps of the instruction that were driven.
        ends: Numbers of steps that a trajectory may cover now, the largest first.
        n_steps: Total number of steps.
        view: The map.
        observation: Observation with the robot's pose.
        instances: Objects of the targets.
        objects: Object map of the task.
        found: Detections of the image for a model; None if it gets none.
        before: Earlier result, whose trajectory is refined again from `index` on. None: write a
            new trajectory.
        index: Index of the pose to refine from.
        reason: Reason for a new trajectory; "" for the first.
        nearer_to: Id and label of the object that the robot stopped at, to drive nearer to it on
            the current map; None for other requests.
        rounds: Answers of a model, added as they end.
    """

    config: Config
    instruction: str
    first: int
    ends: tuple[int, ...]
    n_steps: int
    view: MapView
    observation: Observation
    instances: Sequence[Instance]
    objects: ObjectMap
    found: Detections | None
    before: PlanResult | None = None
    index: int = 0
    reason: str = ""
    nearer_to: tuple[int, str] | None = None
    rounds: list[PlanAttempt] = field(default_factory=list)


def log_line(draft: PlanResult, refined: RefinedTrajectory, order: PlanRequest) -> str:
    """Return a line about a trajectory for the mission log."""
    length_m = float(np.hypot(*np.diff(refined.poses[:, :2], axis=0).T).sum())
    what = draft.understood or "written by the model"
    if order.before is not None:
        what = "refined again"
    elif order.nearer_to is not None:
        what = "to get nearer to the object at its end"
    notes = "".join(f"; {note}" for note in refined.notes)
    return f"trajectory of {length_m:.1f} m: {what}{notes}"


def run_request(order: ObjectMapUpdate | PlanRequest) -> PlanResult | None:
    """Carry out a request. Never raise, because the task waits for a result."""
    if isinstance(order, ObjectMapUpdate):
        try:
            add_detections(order.objects, order.found, order.range_m)
        finally:
            release_frame(order)
        return None
    try:
        if order.nearer_to is not None:
            return _nearer(order, order.nearer_to)
        if order.before is not None and order.before.refined is not None:
            return _refined(order, order.before, order.before.refined)
        return _written(order)
    except UserError as error:
        return PlanResult(error=str(error), hopeless=isinstance(error, TranslationError))
    except Exception as error:
        log.exception("writing a trajectory failed; please report it with this traceback")
        return PlanResult(error=f"a bug in edge: {type(error).__name__}: {error}")


def release_frame(item: ObjectMapUpdate | PlanRequest) -> None:
    """Release the frame of a request."""
    if isinstance(item, ObjectMapUpdate):
        item.found.observation.release()


def _written(order: PlanRequest) -> PlanResult:
    """Write a trajectory for as many steps as possible."""
    scene, draft = _scene(order), PlanResult()
    for upto in order.ends:
        draft = _written_up_to(upto, order, scene)
        if draft.refined is not None or draft.hopeless:
            break
    return draft


def _written_up_to(upto: int, order: PlanRequest, scene: Scene) -> PlanResult:
    config, which = order.config, slice(order.first, upto if upto < order.n_steps else None)
    limits, instruction = _tasks(config).trajectory, order.instruction
    asked = ""
    if isinstance(config.tasks.planner, WriterModel):
        asked = f"{system_prompt()}\n\n{task_text(instruction, scene, limits, order.reason)}"
    draft = PlanResult(prompt=asked, n_done=upto)
    try:
        written = write_trajectory(
            instruction, scene, _tasks(config), order.rounds.append, order.reason, which=which
        )
        coarse, thing = written.coarse, written.stops_at
        labels = {k: one.label for k, one in scene.objects.items()}
        stops_at = None if thing is None else (thing, labels[thing])
        stops = tuple(tuple((k, labels[k]) for k in step) for step in written.stops)
        draft = replace(
            draft, coarse_m=coarse.points_m, speed_mps=coarse.speed_mps,
            understood=written.understood, stops_at=stops_at, stops=stops,
        )  # fmt: skip
        refined = refine(
            scene, coarse.segments, coarse.regions, _body(config), _limits(config, draft),
            heading_rad=coarse.heading_rad,
        )  # fmt: skip
    except UserError as error:
        mistakable = error.things if isinstance(error, AmbiguousObjectError) else ()
        return replace(
            draft, error=str(error), hopeless=isinstance(error, TranslationError),
            ambiguous=mistakable, rounds=tuple(order.rounds),
        )  # fmt: skip
    return replace(draft, refined=refined, rounds=tuple(order.rounds))


def _refined(order: PlanRequest, before: PlanResult, refined: RefinedTrajectory) -> PlanResult:
    """Refine the rest of an earlier trajectory on the current map."""
    config = order.config
    limits = _limits(config, before)
    refined = refine_again(_scene(order), refined, order.index, _body(config), limits)
    return replace(before, refined=refined)


def _nearer(order: PlanRequest, thing: tuple[int, str]) -> PlanResult:
    """Write a trajectory nearer to an object that was far away, or hidden, before.

    The result has no trajectory if the approach is below `NEARER_M`.
    """
    scene = _scene(order)
    found = _found_again(thing, scene)
    if found is None:
        return PlanResult()
    there = f"go to object {found.id}"
    draft = _written(replace(order, instruction=there, first=0, ends=(1,), n_steps=1))
    if draft.refined is None:
        return draft
    x_m, y_m, _, yaw_rad = draft.refined.poses[-1].tolist()
    if _away_m(found, scene.pose) - _away_m(found, SE2(x_m, y_m, yaw_rad)) < NEARER_M:
        return PlanResult()
    return draft


def _found_again(thing: tuple[int, str], scene: Scene) -> SceneObject | None:
    """Return the object with this id. If it is gone, return the nearest object of its label."""
    number, label = thing
    if number in scene.objects:
        return scene.objects[number]
    alike = [one for one in scene.objects.values() if one.label == label]
    nearest = min(alike, key=lambda one: _away_m(one, scene.pose), default=None)
    return None if nearest is None or _away_m(nearest, scene.pose) > AGAIN_M else nearest


def _away_m(thing: SceneObject, at: SE2) -> float:
    return float(np.hypot(*(thing.points_m[:, :2] - (at.x_m, at.y_m)).T).min())


def _scene(order: PlanRequest) -> Scene:
    radius_m = _body(order.config).clearance_m
    return scene_of_map(
        order.view, order.observation, order.instances, radius_m, order.found, seen=order.objects
    )


def _tasks(config: Config) -> TasksConfig:
    """Return the task settings, with a clearance of at least the map's inflation.

    A path inside the inflated cells would count as blocked.
    """
    tasks, trajectory = config.tasks, config.tasks.trajectory
    clearance_m = max(trajectory.clearance_m, config.mapping.inflation_m)
    trajectory = trajectory.model_copy(update={"clearance_m": clearance_m})
    return tasks.model_copy(update={"trajectory": trajectory})


def _body(config: Config) -> PathMargins:
    return PathMargins(_tasks(config).trajectory.clearance_m)


def _limits(config: Config, draft: PlanResult) -> MotionLimits:
    limits = MotionLimits.of(config.robot)
    asked_mps = limits.speed_mps if draft.speed_mps is None else draft.speed_mps
    return replace(limits, speed_mps=min(asked_mps, limits.speed_mps))

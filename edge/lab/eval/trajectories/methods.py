"""The methods that `edge eval trajectories` compares, as in OpenNav's tables.

The writer (the rules, or a model) turns an instruction into a trajectory. Methods differ in the
writer's input, and in the use of its trajectory.

In the table, words are the instruction.

| method | input of the writer | then |
|---|---|---|
| ours | words, picture, map | refined on the value map |
| llm_tg | words and map alone: LLM-TG (Kwon et al. 2024) | refined on the value map |
| ours, not refined | words, picture, map | driven as written |
| vlt_code | words and picture: `a_star_plan` draws straight lines, nothing is checked | driven as written |
| a_star | as ours | A* on the occupancy to the end of that trajectory, by any path |

The rules use no picture, and known places have none. There `llm_tg` would be the same as `ours`, and
is left out.
"""  # noqa: E501 (a table)

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from edge.chat import ChatError, ChatTimeoutError
from edge.config import TasksConfig, WriterModel
from edge.errors import UnavailableError, UserError
from edge.lab.eval.trajectories.episodes import TrajectoryEpisode
from edge.mission.translate import TranslationError
from edge.tasks.functions import Point, ScriptFunctions
from edge.tasks.legs import RefineError
from edge.tasks.refine import refine
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.trajectory import TrajectoryError, coarse_of
from edge.tasks.write import WriteError, WrittenTrajectory, write_trajectory
from edge.text import one_line
from edge.trajectory.pursuit import MotionLimits

LIMITS = MotionLimits(speed_mps=1.5, turn_radps=1.0, accel_mps2=0.8, turn_accel_radps2=3.0)
"""Speed limits of the robot. They set the times of a refined trajectory, not its path."""
CAUSES: tuple[tuple[type[UserError], str], ...] = (
    (TranslationError, "not understood"),
    (RefineError, "not refined"),
    (TrajectoryError, "cannot be done"),
    (ChatTimeoutError, "too late"),
    (ChatError, "no answer"),
    (WriteError, "nothing written"),
)
"""Causes of refusals by error; the first match counts."""
REFUSALS = (*(cause for _, cause in CAUSES), "no way", "crashed")


class NoWayError(UserError):
    """A* found no path."""


Finish = Callable[[TrajectoryEpisode, WrittenTrajectory], np.ndarray]
"""Turns a written trajectory into a path (n, 2) float64 in `map`."""


class Method(NamedTuple):
    """A method of the comparison.

    Attributes:
        writing: input of the writer: "all" (instruction, picture and map), "no picture" or "no
            map".
        finish: turns the written trajectory into a path.
        ends: True for a method of table I, in which only the end counts.
    """

    writing: str
    finish: Finish
    ends: bool = False


class MethodResult(NamedTuple):
    """A method's result for an instruction.

    Attributes:
        path_m: (n, 2) float64. If the trajectory was refused: the robot's place.
        refused: one of `REFUSALS`; "" if there is a trajectory.
        reason: why it was refused, in one line; "" if there is a trajectory.
        seconds: time of writing and finishing.
    """

    path_m: np.ndarray
    refused: str
    reason: str
    seconds: float


@dataclass(slots=True, eq=False)
class MaplessFunctions(ScriptFunctions):
    """Script functions without a map: paths are straight lines, and none is refused."""

    def a_star_plan(self, start: Any, end: Any, regions: Any = ()) -> list[Point]:
        """Return a straight line."""
        return self.line(start, end)

    def give_trajectory(
        self, segments: Any, regions: Any = (), speed_mps: Any = None, heading_rad: Any = None
    ) -> None:
        """Hand over the trajectory without a check."""
        self.trajectory = coarse_of(segments, regions, speed_mps, heading_rad)


def _refine(episode: TrajectoryEpisode, written: WrittenTrajectory) -> np.ndarray:
    coarse, margins = written.coarse, PathMargins(episode.robot_m)
    refined = refine(episode.scene, coarse.segments, coarse.regions, margins, LIMITS)
    return refined.poses[:, :2]


def _as_written(episode: TrajectoryEpisode, written: WrittenTrajectory) -> np.ndarray:
    pose = episode.scene.pose
    return np.concatenate([[(pose.x_m, pose.y_m)], written.coarse.points_m])


def _plan_to_end(episode: TrajectoryEpisode, written: WrittenTrajectory) -> np.ndarray:
    pose, end = episode.scene.pose, written.coarse.points_m[-1]
    found = written.reachable.plan((pose.x_m, pose.y_m), (float(end[0]), float(end[1])))
    if not found.ok:
        raise NoWayError(f"no path to the end of the trajectory: {found.reason}")
    return found.path_m


METHODS: dict[str, Method] = {
    "ours": Method("all", _refine, ends=True),
    "llm_tg": Method("no picture", _refine, ends=True),
    "ours, not refined": Method("all", _as_written),
    "vlt_code": Method("no map", _as_written),
    "a_star": Method("all", _plan_to_end),
}


def methods_of(config: TasksConfig, scene: Scene | None = None) -> tuple[str, ...]:
    """Return the methods that differ for a writer, in a scene if one is given."""
    pictured = scene is None or scene.rgb is not None
    by_model = pictured and isinstance(config.planner, WriterModel)
    return tuple(name for name, method in METHODS.items()
                 if by_model or method.writing != "no picture")  # fmt: skip


def run_methods(
    episode: TrajectoryEpisode, names: Sequence[str], config: TasksConfig
) -> dict[str, MethodResult]:
    """Return the result of each method on an episode.

    Methods with the same input of the writer share what it wrote.

    Only the instruction, the scene and the robot's radius are used.

    Raises:
        UnavailableError: the interpreter of the scripts is missing.
    """
    written: dict[str, tuple[WrittenTrajectory | Exception, float]] = {}
    results = {}
    for name in names:
        method = METHODS[name]
        if method.writing not in written:
            written[method.writing] = _write(episode, method.writing, config)
        result, seconds = written[method.writing]
        begin_s = time.perf_counter()
        try:
            if isinstance(result, Exception):
                raise result
            path_m, refused, reason = method.finish(episode, result), "", ""
        except Exception as error:
            pose = episode.scene.pose
            path_m = np.array([(pose.x_m, pose.y_m)])
            refused, reason = _cause(error), one_line(error if str(error) else repr(error))
        results[name] = MethodResult(
            path_m, refused, reason, seconds + time.perf_counter() - begin_s
        )
    return results


def _write(
    episode: TrajectoryEpisode, writing: str, config: TasksConfig
) -> tuple[WrittenTrajectory | Exception, float]:
    """Return what was written or the error, and the time that it took [s]."""
    limits = config.trajectory.model_copy(update={"clearance_m": episode.robot_m})
    planner = config.planner
    if writing == "no picture":
        planner = planner.model_copy(update={"picture": False})
    config = config.model_copy(update={"trajectory": limits, "planner": planner})
    functions = MaplessFunctions if writing == "no map" else ScriptFunctions
    begin_s = time.perf_counter()
    try:
        written = write_trajectory(
            episode.task.instruction, episode.scene, config, make_functions=functions
        )
    except ChatError as error:  # a kind of UnavailableError, but only this episode is refused
        return error, time.perf_counter() - begin_s
    except UnavailableError:
        raise
    except Exception as error:
        return error, time.perf_counter() - begin_s
    return written, time.perf_counter() - begin_s


def _cause(error: Exception) -> str:
    if isinstance(error, NoWayError):
        return "no way"
    return next((cause for kind, cause in CAUSES if isinstance(error, kind)), "crashed")

"""Outcomes of the compared methods on episodes, as lines of files and as arrays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import cv2
import numpy as np

from edge.errors import UserError
from edge.geometry import Grid
from edge.lab.eval.json_lines_file import JsonLinesFile
from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.outcome import OUTCOMES_NAME
from edge.lab.eval.trajectories.episodes import TrajectoryEpisode
from edge.lab.eval.trajectories.methods import MethodResult
from edge.lab.eval.trajectories.references import Category
from edge.lab.eval.trajectory_metrics import (
    contacts,
    frechet_m,
    navigation_error_m,
    ndtw,
    point_contacts,
    resample_evenly,
)
from edge.trajectory.pursuit import length_m

EPISODES_NAME = "episodes.jsonl"
_DRAWN_M = 0.25  # distance between the points of a saved path
_OUTLINE_M = 0.05  # largest error of a simplified outline
DEEP_M = 0.2
"""Depth of a deep contact: less may be an error of map and poses."""
_UPSAMPLING = 4  # an outline leads through the middles of cells, so make them smaller first
_AT_M = 0.5
"""A path that ends farther from the object than the reference by at most this ends at it."""
_MARGIN_M = 4.0  # obstacles are saved within this distance of a reference

Polyline = list[list[float]]
"""Points [x, y] in `map`, in metres."""


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """The data of an episode that tables and pictures need.

    Attributes:
        source: see `TrajectoryEpisode`.
        world: see `TrajectoryEpisode`.
        kind: see `TrajectoryTask`.
        category: see `TrajectoryTask`.
        robot_m: the robot's radius.
        things: outlines of the objects that the instruction names.
        occupied: outlines of the obstacles near the reference.
        label: class of the object at the end.
        certain: see `TrajectoryTask`.
    """

    id: str
    source: str
    world: str
    kind: str
    category: Category
    instruction: str
    robot_m: float
    reference: Polyline
    things: list[Polyline]
    occupied: list[Polyline]
    label: str
    certain: bool


@dataclass(frozen=True, slots=True)
class TrajectoryOutcome:
    """The outcome of an episode with a method.

    Attributes:
        writer: "rules", or a model's name: what wrote the trajectory. Then the detector's name, if
            one found the objects. Models and detectors have a hash of their settings.
        success: there is a trajectory, and it ends within 1 m of the reference's end.
        error_m: navigation error, the distance between the ends.
        frechet_m: Fréchet distance.
        ndtw: normalised dynamic time warping; 1 for the same trajectory.
        contacts: collisions in the scene's map, as OpenNav counts them.
        true_contacts: collisions with the true obstacles.
        refused: one of `methods.REFUSALS`; "" if there is a trajectory.
        reason: why it was refused, in one line; "" if there is a trajectory.
        seconds: time of writing and refining.
        at_thing: it ends as near to the object as the reference (`_AT_M`), on any side.
        true_depth_m: how much nearer than the robot's radius it comes to a true obstacle.
    """

    episode: str
    method: str
    writer: str
    success: bool
    error_m: float
    frechet_m: float
    ndtw: float
    contacts: int
    true_contacts: int
    length_m: float
    refused: str
    reason: str
    seconds: float
    path: Polyline
    at_thing: bool
    true_depth_m: float

    @property
    def key(self) -> tuple[str, str, str]:
        """Key of the outcome: episode, method and writer."""
        return self.episode, self.method, self.writer


def facts_of(episode: TrajectoryEpisode) -> EpisodeFacts:
    """Return the data of an episode to save."""
    task = episode.task
    landmarks = {landmark.id: landmark for landmark in episode.landmarks}
    hulls = [
        cv2.convexHull(landmarks[k].outline_m.astype(np.float32))[:, 0].astype(float)
        for k in task.landmarks
    ]
    return EpisodeFacts(
        episode.id, episode.source, episode.world, task.kind, task.category, task.instruction,
        episode.robot_m, _plain(resample_evenly(task.reference_m, _DRAWN_M)), [*map(_plain, hulls)],
        [*map(_plain, _outlines(episode.truth, task.reference_m))],
        landmarks[task.landmarks[-1]].label, task.certain,
    )  # fmt: skip


def outcome_of(
    episode: TrajectoryEpisode, method: str, writer: str, result: MethodResult
) -> TrajectoryOutcome:
    """Compare a method's result with the reference and the true place."""
    path_m, reference_m, robot_m = result.path_m, episode.task.reference_m, episode.robot_m
    error_m = navigation_error_m(path_m, reference_m)
    # `solid_m` are the true obstacles as points; without them, the grid `truth` is exact.
    solid_m = episode.solid_m
    if solid_m is None:
        solid_m = episode.truth.centres_m(*np.nonzero(episode.truth.cells > 0))
    true_contacts, depth_m = point_contacts(path_m, solid_m, robot_m)
    if episode.solid_m is None:
        true_contacts = contacts(path_m, episode.truth, robot_m)
    outline_m = {one.id: one.outline_m for one in episode.landmarks}[episode.task.landmarks[-1]]
    end_m, wanted_m = (
        float(np.hypot(*(outline_m - at_m).T).min()) for at_m in (path_m[-1], reference_m[-1])
    )
    return TrajectoryOutcome(
        episode.id, method, writer, error_m <= REACHED_M and not result.refused,
        round(error_m, 4), round(frechet_m(path_m, reference_m), 4),
        round(ndtw(path_m, reference_m), 4),
        contacts(path_m, episode.scene.occupancy, robot_m), true_contacts,
        round(length_m(path_m), 2), result.refused, result.reason, round(result.seconds, 4),
        _plain(resample_evenly(path_m, _DRAWN_M)),
        at_thing=not result.refused and end_m <= wanted_m + _AT_M,
        true_depth_m=round(depth_m, 4),
    )  # fmt: skip


class ResultsFolder:
    """The saved episodes and outcomes of a folder. New ones are appended."""

    def __init__(self, path: Path) -> None:
        self._episodes = JsonLinesFile(
            path / EPISODES_NAME, EpisodeFacts, "an episode", attrgetter("id")
        )
        self._outcomes = JsonLinesFile(path / OUTCOMES_NAME, TrajectoryOutcome, "an outcome")
        self.facts, self.outcomes = self._episodes.known, self._outcomes.known

    def add(self, facts: EpisodeFacts) -> None:
        """Append an episode, if it is not there yet."""
        if facts.id not in self.facts:
            self._episodes.append(facts)

    def append(self, outcome: TrajectoryOutcome) -> None:
        """Append an outcome."""
        self._outcomes.append(outcome)


@dataclass(frozen=True, eq=False)
class TrajectoryResults:
    """Outcomes as arrays: M methods by E episodes.

    Attributes:
        methods: their names, with the writer's name if there are several writers.
        method_names: their names without that of the writer.
        ran: (M, E) bool.
        numbers: by a name of `_NUMBERS`, (M, E) float64, NaN without an outcome.
        outcomes: by (method, episode) as indices.
    """

    methods: tuple[str, ...]
    method_names: tuple[str, ...]
    facts: tuple[EpisodeFacts, ...]
    ran: np.ndarray
    numbers: dict[str, np.ndarray]
    outcomes: dict[tuple[int, int], TrajectoryOutcome]


def gather(
    facts: Iterable[EpisodeFacts], outcomes: Iterable[TrajectoryOutcome]
) -> TrajectoryResults:
    """Return outcomes as arrays.

    Raises:
        UserError: the episode of an outcome is not among the facts.
    """
    outcomes = list(outcomes)
    by_id = {one.id: one for one in facts}
    several = len({outcome.writer for outcome in outcomes}) > 1
    names = {_name(outcome, several): outcome.method for outcome in outcomes}
    # Episodes without any outcome are left out.
    ids = [one for one in by_id if any(outcome.episode == one for outcome in outcomes)]
    method_index, episode_index = ({key: k for k, key in enumerate(keys)} for keys in (names, ids))
    at: dict[tuple[int, int], TrajectoryOutcome] = {}
    for outcome in outcomes:
        if outcome.episode not in by_id:
            raise UserError(
                f"{EPISODES_NAME}: the episode {outcome.episode} is missing, but has an outcome; "
                "choose another --out"
            )
        index = method_index[_name(outcome, several)], episode_index[outcome.episode]
        at[index] = outcome
    shape = len(names), len(ids)
    numbers = {key: np.full(shape, math.nan) for key in _NUMBERS}
    for index, outcome in at.items():
        for key, read in _NUMBERS.items():
            numbers[key][index] = read(outcome)
    ran = ~np.isnan(numbers["success"])
    return TrajectoryResults(
        tuple(names), tuple(names.values()), tuple(by_id[k] for k in ids), ran, numbers, at
    )


# By name, the reader of an outcome's number.
_NUMBERS = {
    "success": lambda o: float(o.success),
    "error_m": lambda o: o.error_m,
    "frechet_m": lambda o: o.frechet_m,
    "ndtw": lambda o: o.ndtw,
    "collided": lambda o: float(o.contacts > 0),
    "truly collided": lambda o: float(o.true_contacts > 0),
    "deeply collided": lambda o: float(o.true_depth_m > DEEP_M),
    "at it": lambda o: float(o.at_thing),
    "refused": lambda o: float(bool(o.refused)),
    "seconds": lambda o: o.seconds,
}


def _name(outcome: TrajectoryOutcome, several: bool) -> str:
    """Return the method's name, with the writer's if there are several writers."""
    return f"{outcome.method} ({outcome.writer})" if several else outcome.method


def _outlines(grid: Grid, path_m: np.ndarray) -> list[np.ndarray]:
    """Return polygons (n, 2) [m] around the obstacles near a path."""
    low, high = path_m.min(axis=0) - _MARGIN_M, path_m.max(axis=0) + _MARGIN_M
    shape = grid.cells.shape[::-1]
    x0, y0 = np.clip(np.floor(grid.to_cells(low)), 0, shape).astype(int)
    x1, y1 = np.clip(np.ceil(grid.to_cells(high)), 0, shape).astype(int)
    cells = np.kron(grid.cells[y0:y1, x0:x1] > 0, np.ones((_UPSAMPLING, _UPSAMPLING), np.uint8))
    lines, _ = cv2.findContours(cells, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    tolerance = _UPSAMPLING * _OUTLINE_M / grid.resolution_m
    rounded = (cv2.approxPolyDP(line, tolerance, True)[:, 0] for line in lines)
    return [grid.to_metres((line + 0.5) / _UPSAMPLING + (x0, y0)) for line in rounded]


def _plain(points_m: np.ndarray | Sequence) -> Polyline:
    """Return points as lists, rounded to centimetres."""
    return np.round(np.asarray(points_m, float), 2).tolist()

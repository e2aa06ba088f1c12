"""The outcome of an episode with one arm, and the file of outcomes, `outcomes.jsonl`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from edge.lab.eval.arms import ExperimentArm
from edge.lab.eval.episodes import Episode, Length
from edge.lab.eval.json_lines_file import MAX_BYTES, JsonLinesFile, parser_of, read_lines
from edge.text import one_line

OUTCOMES_NAME = "outcomes.jsonl"
TIMINGS = ("wall_s", "tick_ms", "score_ms")
"""Fields that depend on the computer and differ from run to run."""

Failure = Literal[
    "never seen", "seen, not confirmed", "probable", "wrong thing", "stuck", "budget", "crashed"
]
FAILURES: tuple[Failure, ...] = get_args(Failure)
"""Kinds of failure; see `edge.lab.eval.ground_truth.GroundTruthLogger.failure`."""
RIGHT = "right"
"""Verdict on a right answer; `edge.lab.eval.questions` has the others."""


@dataclass(frozen=True, slots=True)
class EpisodeOutcome:
    """The end of an episode, judged by the simulator's ground truth.

    Attributes:
        target: name of the object to find; None for a mission.
        instruction: text of the mission.
        start: x and y [m], yaw [rad].
        success: the service reported `reached`, and each time the robot was within `REACHED_M` of
            the footprint of such an object.
        reason: why the episode ended, in one line.
        failure: one of `FAILURES`; None for a success.
        path_m: length of the driven path, by ground truth.
        wall_s: real time.
        distance_m: distance at the end to the nearest footprint of a target; None for a mission.
        left_m: metres left to drive at the end; None for a mission, and if there is no path.
        first_sight_s: time at which a target was first in view; None: never.
        first_sight_path_m: length of the path driven until then.
        wrong_stops: number of `reached` reports that were wrong.
        false_confirmations: number of confirmed instances that are not the target.
        goals: number of goals (poses to drive to) that the service sent.
        tick_ms: p50, p95 and max of the tick.
        score_ms: p95 of the stage that scores the candidates.
        trail: [x, y] of the robot every 0.25 m, in metres.
        goal_xy: [x, y, kind of candidate] of every goal, in metres.
        goal: number of the target among those of its session, from 1; None if the episode is no
            session.
        ways: see `Episode.ways`.
        zone_entries: number of times that the robot's footprint entered a keep-out zone; None
            without zones.
        views: number of views of a target: one object in one image (`edge.lab.eval.recall`).
        detected: number of these views in which the detector found it.
        person_contacts: number of the collisions that were with a person. All are the robot's
            fault: no person walks into it. None without people.
        ghost_s: longest time that a cell which a person left stayed occupied in view; None without
            people.
        answers: by name that was asked for, the answer's verdict (`edge.lab.eval.questions`).
    """

    episode: str
    arm: str
    arm_id: str
    world: str
    kind: str
    target: str | None
    instruction: str | None
    start: tuple[float, float, float]
    shortest_m: Length
    success: bool
    reason: str
    failure: Failure | None
    path_m: float = 0.0
    elapsed_s: float = 0.0
    wall_s: float = 0.0
    distance_m: float | None = None
    left_m: float | None = None
    collisions: int = 0
    first_sight_s: float | None = None
    first_sight_path_m: float | None = None
    wrong_stops: int = 0
    false_confirmations: int = 0
    goals: int = 0
    tick_ms: dict[str, float | None] = field(default_factory=dict)
    score_ms: float | None = None
    trail: list[list[float]] = field(default_factory=list)
    goal_xy: list[list[Any]] = field(default_factory=list)
    goal: int | None = None
    ways: str = ""
    zone_entries: int | None = None
    person_contacts: int | None = None
    ghost_s: float | None = None
    answers: dict[str, str] = field(default_factory=dict)
    views: int = 0
    detected: int = 0

    @property
    def key(self) -> tuple[str, str]:
        """Key of the outcome in its file: episode and hash of the arm."""
        return self.episode, self.arm_id


def crashed_outcomes(
    arm: ExperimentArm, episode: Episode, why: str, done: int = 0
) -> list[EpisodeOutcome]:
    """Build the outcomes of the parts of an episode that could not be run to their end."""
    crashed = crashed_outcome(arm, episode, why)
    if not episode.goals:
        return [crashed]
    parts = list(enumerate(zip(episode.parts, episode.goals, strict=True), start=1))
    return [
        replace(crashed, episode=part_id, target=goal, goal=k)
        for k, (part_id, goal) in parts[done:]
    ]


def crashed_outcome(
    arm: ExperimentArm, episode: Episode, why: str, wall_s: float = 0.0
) -> EpisodeOutcome:
    """Build the outcome of an episode that could not be run to its end."""
    world = str(
        episode.world.get("name") or episode.world.get("house") or episode.world.get("mesh")
    )
    return EpisodeOutcome(
        episode.id, arm.name, arm.id, world, str(episode.world.get("kind")), episode.target,
        episode.instruction, episode.start, episode.shortest_m, False, f"crashed: {one_line(why)}",
        "crashed", wall_s=wall_s,
    )  # fmt: skip


def read_outcomes(path: Path) -> list[EpisodeOutcome]:
    """Read the outcomes of a file, without a last line that was not written to its end."""
    advice = "`edge eval episodes --out DIR` writes this file"
    return read_lines(
        path, MAX_BYTES, parser_of(EpisodeOutcome), "an outcome", advice, "remove the line",
        complete=False,
    )  # fmt: skip


class OutcomeFile(JsonLinesFile[EpisodeOutcome]):
    """`outcomes.jsonl` of a folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / OUTCOMES_NAME, EpisodeOutcome, "an outcome", digits=4)

"""Outcomes of episodes as arrays: one row for each arm, one column for each episode."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from edge.errors import UserError
from edge.lab.eval.outcome import RIGHT, EpisodeOutcome
from edge.text import one_line


def _share_right(answers: dict[str, str]) -> float | None:
    return sum(verdict == RIGHT for verdict in answers.values()) / len(answers) if answers else None


# Fields of `EpisodeOutcome` that are numbers; None becomes NaN.
_FIELDS = (
    "success", "shortest_m", "path_m", "elapsed_s", "wall_s", "left_m", "collisions",
    "first_sight_s", "first_sight_path_m", "wrong_stops", "false_confirmations",
    "views", "detected", "zone_entries", "person_contacts", "ghost_s",
)  # fmt: skip
# By name, the reader of an outcome's number.
NUMBERS: dict[str, Callable[[EpisodeOutcome], float | None]] = {
    **{name: attrgetter(name) for name in _FIELDS},
    "tick_p95_ms": lambda outcome: outcome.tick_ms.get("p95"),
    "score_p95_ms": attrgetter("score_ms"),
    "answers_right": lambda outcome: _share_right(outcome.answers),
}


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of A arms on E episodes. A goal of a session is an episode of its own here.

    Attributes:
        arms: names of the arms, in the order of the outcomes.
        episodes: ids, sorted, so that the order of the runs does not matter.
        world: (E,) str, name of the world.
        kind: (E,) str, kind of world.
        target: (E,) str; "" for a mission with several targets.
        ways: (E,) str; see `edge.lab.eval.episodes.Episode`.
        shortest_m: (E,) float64, shortest path of the episode. In a session (several goals one
            after another) each arm starts a goal elsewhere, so its length differs by arm: this is
            the value of one arm; `numbers["shortest_m"]` has all.
        ran: (A, E) bool, True if there is an outcome.
        numbers: by name of `NUMBERS`, (A, E) float64, NaN if there is none.
        failure: (A, E) str, one of FAILURES; "" for a success or without an outcome.
        at: the outcomes, by indices (arm, episode).
        n_ignored: number of ignored outcomes. An outcome is ignored if there is a newer one of the
            same arm and episode, or if it is of earlier settings of its arm.
    """

    arms: tuple[str, ...]
    episodes: tuple[str, ...]
    world: np.ndarray
    kind: np.ndarray
    target: np.ndarray
    ways: np.ndarray
    shortest_m: np.ndarray
    ran: np.ndarray
    numbers: dict[str, np.ndarray]
    failure: np.ndarray
    at: dict[tuple[int, int], EpisodeOutcome]
    n_ignored: int = 0

    def __getitem__(self, name: str) -> np.ndarray:
        """Return (A, E) float64 of a number, by its name."""
        return self.numbers[name]

    @property
    def success(self) -> np.ndarray:
        """(A, E) bool; False without an outcome."""
        return self.numbers["success"] == 1.0


def gather(outcomes: Iterable[EpisodeOutcome]) -> Outcomes:
    """Return outcomes as arrays.

    The last outcome of an arm and episode counts, and only the newest settings of an arm
    (`arm_id` is a hash of them). The first goal of a session does not count: nothing can be
    remembered yet.

    Raises:
        UserError: two arms have different targets or shortest paths for one episode.
    """
    outcomes = [outcome for outcome in outcomes if outcome.goal != 1]
    newest_id = {o.arm: o.arm_id for o in outcomes}
    newest = {(o.arm, o.episode): o for o in outcomes if o.arm_id == newest_id[o.arm]}
    arms = tuple(dict.fromkeys(arm for arm, _ in newest))
    episodes = tuple(sorted({episode for _, episode in newest}, key=natural_key))
    at = {(arms.index(arm), episodes.index(e)): o for (arm, e), o in newest.items()}
    # By episode: an outcome of any arm, for what does not depend on the arm.
    first: dict[int, EpisodeOutcome] = {}
    for (_, e), outcome in at.items():
        _check_same_episode(first.setdefault(e, outcome), outcome)
        if outcome.failure != "crashed":  # a crash may lack the name of the world
            first[e] = outcome
    any_arm = [first[e] for e in range(len(episodes))]
    shape = len(arms), len(episodes)
    numbers = {name: np.full(shape, np.nan) for name in NUMBERS}
    ran, failure = np.zeros(shape, bool), np.full(shape, "", dtype="<U32")
    for index, outcome in at.items():
        ran[index], failure[index] = True, outcome.failure or ""
        for name, read_number in NUMBERS.items():
            value = read_number(outcome)
            numbers[name][index] = math.nan if value is None else value
    return Outcomes(
        arms, episodes,
        np.array([o.world for o in any_arm], dtype=str),
        np.array([o.kind for o in any_arm], dtype=str),
        np.array([o.target or "" for o in any_arm], dtype=str),
        np.array([o.ways for o in any_arm], dtype=str),
        np.array([o.shortest_m for o in any_arm], np.float64),
        ran, numbers, failure, at, len(outcomes) - len(at),
    )  # fmt: skip


def _check_same_episode(one: EpisodeOutcome, other: EpisodeOutcome) -> None:
    """Raise UserError if two arms ran different episodes under the same id."""
    # In a session the shortest path differs by arm.
    for key in ("target",) if other.goal else ("target", "shortest_m"):
        values = getattr(one, key), getattr(other, key)
        if values[0] != values[1]:
            raise UserError(
                f"episode {one_line(other.episode)}: {key} is {one_line(values[0])} for arm "
                f"{one_line(one.arm)} and {one_line(values[1])} for arm {one_line(other.arm)}; "
                "run both arms on the same file of episodes (--plan)"
            )


def natural_key(text: str) -> list[tuple[int, Any]]:
    """Return a sort key that compares numbers within texts as numbers.

    >>> sorted(["val-10", "val-9"], key=natural_key)
    ['val-9', 'val-10']
    """
    parts = re.findall(r"\d+|\D+", text)
    return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]


def baseline_of(outcomes: Outcomes, name: str | None) -> int:
    """Return the index of the baseline arm; by default the first.

    Raises:
        UserError: there is no such arm.
    """
    if name is None:
        return 0
    if name not in outcomes.arms:
        raise UserError(f"--baseline: no arm {name!r} (choices: {', '.join(outcomes.arms)})")
    return outcomes.arms.index(name)

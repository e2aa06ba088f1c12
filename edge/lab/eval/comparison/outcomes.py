"""Outcomes of episodes as arrays: one row for each arm, one column for each episode."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from edge.errors import FileError, UserError
from edge.host.files import read_regular
from edge.lab.eval.outcome import FAILURES, MAX_BYTES
from edge.text import bounded_repr, one_line, read_json_object

OTHER = "other"
"""Kind of a failure that is none of `FAILURES`."""
RIGHT = "right"
"""Verdict on a right answer (`edge.lab.eval.questions`)."""

Record = dict[str, Any]
"""A line of `outcomes.jsonl`: one episode with one arm."""


def _p95(record: Record, key: str) -> float | None:
    """Return a 95th percentile: of several percentiles in the record, or the only one there."""
    times = record.get(key)
    return times.get("p95") if isinstance(times, dict) else times


def _share_right(answers: dict[str, str]) -> float | None:
    return sum(verdict == RIGHT for verdict in answers.values()) / len(answers) if answers else None


# By name, the reader of a record's number; `edge.lab.eval.outcome.EpisodeOutcome` has the fields. A
# missing number or null becomes NaN.
NUMERIC_FIELDS: dict[str, Callable[[Record], Any]] = {
    "success": lambda r: r["success"],
    "shortest_m": lambda r: r["shortest_m"],
    "path_m": lambda r: r["path_m"],
    "elapsed_s": lambda r: r["elapsed_s"],
    "wall_s": lambda r: r.get("wall_s"),
    "left_m": lambda r: r.get("left_m"),
    "collisions": lambda r: r.get("collisions"),
    "first_sight_s": lambda r: r.get("first_sight_s"),
    "first_sight_path_m": lambda r: r.get("first_sight_path_m"),
    "wrong_stops": lambda r: r.get("wrong_stops"),
    "false_confirmations": lambda r: r.get("false_confirmations"),
    "tick_p95_ms": lambda r: _p95(r, "tick_ms"),
    "score_p95_ms": lambda r: _p95(r, "score_ms"),
    "revisited_m2": lambda r: r.get("revisited_m2"),
    "views": lambda r: r.get("views"),
    "detected": lambda r: r.get("detected"),
    "zone_entries": lambda r: r.get("zone_entries"),
    "person_contacts": lambda r: r.get("person_contacts"),
    "ghost_s": lambda r: r.get("ghost_s"),
    "answers_right": lambda r: _share_right(r.get("answers") or {}),
}


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of A arms on E episodes. A goal of a session is an episode of its own here.

    Attributes:
        arms: names of the arms, in the order of the records.
        episodes: ids, sorted, so that the order of the runs does not matter.
        world: (E,) str, name of the world.
        kind: (E,) str, kind of world.
        target: (E,) str; "" for a mission with several targets.
        ways: (E,) str; see `edge.lab.eval.episodes.Episode`.
        rooms: (E,) float64, number of rooms of the world; NaN if unknown (`with_rooms`).
        shortest_m: (E,) float64, shortest path of the episode. In a session (several goals one
            after another) each arm starts a goal elsewhere, so its length differs by arm: this is
            the value of one arm; `numbers["shortest_m"]` has all.
        ran: (A, E) bool, True if there is a record.
        numbers: by name of `NUMERIC_FIELDS`, (A, E) float64, NaN if there is none.
        failure: (A, E) str, one of FAILURES or OTHER; "" for a success or without a record.
        records: by indices (arm, episode); no entry without a record.
        n_ignored: number of ignored records. A record is ignored if there is a newer one of the
            same arm and episode, or if it is of earlier settings of its arm.
    """

    arms: tuple[str, ...]
    episodes: tuple[str, ...]
    world: np.ndarray
    kind: np.ndarray
    target: np.ndarray
    ways: np.ndarray
    rooms: np.ndarray
    shortest_m: np.ndarray
    ran: np.ndarray
    numbers: dict[str, np.ndarray]
    failure: np.ndarray
    records: dict[tuple[int, int], Record]
    n_ignored: int = 0

    def __getitem__(self, name: str) -> np.ndarray:
        """Return (A, E) float64 of a number, by its name."""
        return self.numbers[name]

    @property
    def success(self) -> np.ndarray:
        """(A, E) bool; False without a record."""
        return self.numbers["success"] == 1.0


def read_records(path: Path) -> list[Record]:
    """Read the records of a file. A last line without its end, from an interrupted run, is ignored.

    Raises:
        FileError: the file cannot be read.
        UserError: a line is not a record.
    """
    try:
        content = read_regular(path, MAX_BYTES)
    except OSError as error:
        raise FileError(
            f"{path}: cannot be read: {error.strerror or error}; `edge eval episodes --out DIR` "
            "writes this file"
        ) from None
    records = []
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        if line.strip():
            try:
                records.append(_check(read_json_object(line)))
            except (KeyError, TypeError, ValueError) as error:
                what = (
                    f"the field {error} is missing"
                    if isinstance(error, KeyError)
                    else one_line(error)
                )
                raise UserError(
                    f"{path}: line {number}: not an outcome: {what}; remove the line"
                ) from None
    return records


def _check(record: Record) -> Record:
    """Return the record if it is valid."""
    for key in ("episode", "arm", "world", "kind"):
        if not isinstance(record[key], str):
            raise ValueError(f"{key}: expected a text, got {bounded_repr(record[key], 40)}")
    if not (math.isfinite(float(record["shortest_m"])) and record["shortest_m"] >= 0):
        raise ValueError(
            f"shortest_m: expected a length in m, got {bounded_repr(record['shortest_m'], 40)}"
        )
    for name, read_number in NUMERIC_FIELDS.items():
        value = read_number(record)
        if value is not None and not isinstance(value, (bool, int, float)):
            raise ValueError(f"{name}: expected a number, got {bounded_repr(value, 40)}")
    return record


def gather(records: Iterable[Record]) -> Outcomes:
    """Return records as arrays.

    The last record of an arm and episode counts, and only the newest settings of an arm
    (`arm_id` is a hash of them). The first goal of a session does not count: nothing can be
    remembered yet.

    Raises:
        UserError: two arms have different targets or shortest paths for one episode.
    """
    records = [record for record in records if record.get("goal") != 1]
    newest_id = {r["arm"]: r.get("arm_id") for r in records}
    kept = [r for r in records if r.get("arm_id") == newest_id[r["arm"]]]
    newest = {(r["arm"], r["episode"]): r for r in kept}
    arms = tuple(dict.fromkeys(arm for arm, _ in newest))
    episodes = tuple(sorted({episode for _, episode in newest}, key=natural_key))
    at = {(arms.index(arm), episodes.index(e)): r for (arm, e), r in newest.items()}
    # By episode: a record of any arm, for what does not depend on the arm; {} until one is found.
    episode_records: list[Record] = [{} for _ in episodes]
    for (_, e), record in at.items():
        _check_same_episode(episode_records[e], record)
        # The record of a crash may lack the name of the world.
        if not episode_records[e] or record.get("failure") != "crashed":
            episode_records[e] = record
    shape = len(arms), len(episodes)
    numbers = {name: np.full(shape, np.nan) for name in NUMERIC_FIELDS}
    ran, failure = np.zeros(shape, bool), np.full(shape, "", dtype="<U32")
    for (a, e), record in at.items():
        ran[a, e] = True
        for name, read_number in NUMERIC_FIELDS.items():
            value = read_number(record)
            numbers[name][a, e] = math.nan if value is None else float(value)
        if not record["success"]:
            kind = record.get("failure")
            failure[a, e] = kind if kind in FAILURES else OTHER
    return Outcomes(
        arms, episodes,
        np.array([r["world"] for r in episode_records], dtype=str),
        np.array([r["kind"] for r in episode_records], dtype=str),
        np.array([r.get("target") or "" for r in episode_records], dtype=str),
        np.array([r.get("ways") or "" for r in episode_records], dtype=str),
        np.full(len(episode_records), np.nan),
        np.array([r["shortest_m"] for r in episode_records], np.float64),
        ran, numbers, failure, at, len(records) - len(at),
    )  # fmt: skip


def _check_same_episode(one: Record, other: Record) -> None:
    """Raise UserError if two arms ran different episodes under the same id."""
    # In a session the shortest path differs by arm.
    for key in ("target",) if other.get("goal") else ("target", "shortest_m"):
        if one and one.get(key) != other.get(key):
            raise UserError(
                f"episode {one_line(other['episode'])}: {key} is {one_line(one.get(key))} for arm "
                f"{one_line(one['arm'])} and {one_line(other.get(key))} for arm "
                f"{one_line(other['arm'])}; run both arms on the same file of episodes (--plan)"
            )


def with_rooms(outcomes: Outcomes, rooms: Mapping[str, int | None]) -> Outcomes:
    """Return the outcomes with the number of rooms of each world, given by name."""
    counts = [rooms.get(name) for name in outcomes.world.tolist()]
    known = np.array([math.nan if n is None else float(n) for n in counts])
    return replace(outcomes, rooms=known)


def natural_key(text: str) -> list[tuple[int, Any]]:
    """Return a sort key that compares numbers within texts as numbers.

    >>> sorted(["val-10", "val-9"], key=natural_key)
    ['val-9', 'val-10']
    """
    parts = re.findall(r"\d+|\D+", text)
    return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]


def clusters(outcomes: Outcomes, at_least: int = 10) -> tuple[np.ndarray, str]:
    """Return the clusters of episodes that the bootstrap resamples.

    They are the worlds, as the episodes of one world are not independent.

    With fewer than `at_least` worlds, episodes are resampled. Such intervals do not generalise to
    other worlds.

    Returns:
        (E,) int, the cluster of each episode, and the unit: "world" or "episode".
    """
    worlds, index = np.unique(outcomes.world, return_inverse=True)
    if len(worlds) >= at_least:
        return index.ravel(), "world"
    return np.arange(len(outcomes.episodes)), "episode"


def baseline_of(outcomes: Outcomes, name: str | None) -> int:
    """Return the index of the baseline arm; by default the first.

    Raises:
        UserError: there is no such arm.
    """
    arms: Sequence[str] = outcomes.arms
    if name is None:
        return 0
    if name not in arms:
        raise UserError(f"--baseline: no arm {name!r} (choices: {', '.join(arms)})")
    return arms.index(name)

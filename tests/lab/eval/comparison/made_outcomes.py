"""Outcomes made up: as `edge eval episodes` writes them, with no robot driven."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge.lab.eval.outcome import FAILURES, EpisodeOutcome


def record(episode: str = "house-0/bed/0", arm: str = "hvl", **changes: Any) -> EpisodeOutcome:
    """Return a success in 10 m with an optimum of 5 m; `changes` replace its fields."""
    fields: dict[str, Any] = {
        "episode": episode, "arm": arm, "arm_id": "c0ffee", "world": "house-0",
        "kind": "procthor", "target": "bed", "instruction": None, "start": (1.0, 1.0, 0.0),
        "shortest_m": 5.0, "success": True, "reason": "reached", "failure": None, "path_m": 10.0,
        "elapsed_s": 30.0, "wall_s": 1.5, "distance_m": 0.8, "left_m": 0.0, "collisions": 0,
        "first_sight_s": 12.0, "first_sight_path_m": 4.0, "wrong_stops": 0,
        "false_confirmations": 0, "goals": 3, "tick_ms": {"p50": 1.0, "p95": 2.0, "max": 9.0},
        "score_ms": 0.5, "trail": [[1.0, 1.0], [3.0, 1.0], [3.0, 2.0]],
        "goal_xy": [[3.0, 1.0, "frontier"], [3.0, 2.0, "instance"]],
    }  # fmt: skip
    return EpisodeOutcome(**{**fields, **changes})


def failure(episode: str = "house-0/bed/0", arm: str = "hvl", **changes: Any) -> EpisodeOutcome:
    """One that used its path up and never saw the object."""
    fields = {
        "success": False, "reason": "path limit", "failure": "never seen", "path_m": 40.0,
        "distance_m": 4.0, "left_m": 5.0, "first_sight_s": None, "first_sight_path_m": None,
    }  # fmt: skip
    return record(episode, arm, **{**fields, **changes})


def many(
    columns: dict[str, float], worlds: int, seed: int = 0, each: int = 4, spread: float = 0.5
) -> list[EpisodeOutcome]:
    """Outcomes of `columns` on `each` episodes a world.

    Args:
        worlds: number of worlds.
        seed: of the random numbers.
        each: episodes in a world.
        columns: how many times the shortest way each needs, about.
        spread: of how much harder one world is than another.
    """
    rng, records = np.random.default_rng(seed), []
    for w in range(worlds):
        hardness = math.exp(spread * rng.normal())
        for k in range(each):
            target, shortest = ("bed", "sofa", "toilet")[k % 3], rng.uniform(4, 15)
            for column, times in columns.items():
                about = {
                    "world": f"house-{w}", "target": target, "shortest_m": shortest,
                    "start": [*rng.uniform(1, 4, 2).tolist(), 0.0],
                    "trail": (rng.normal(0, 0.1, (60, 2)).cumsum(axis=0) + 4).tolist(),
                }  # fmt: skip
                path = shortest * (1 + (times - 1) * hardness * rng.exponential())
                name = f"house-{w}/{target}/{k}"
                if path > 5 * shortest:
                    kind = FAILURES[int(rng.integers(len(FAILURES)))]
                    records.append(failure(name, column, **about, failure=kind))
                else:
                    sight = 0.6 * path
                    records.append(
                        record(name, column, **about, path_m=path, first_sight_path_m=sight)
                    )
    return records

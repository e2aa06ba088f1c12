"""Two runs choose the same goals, tick for tick, as were recorded in `tests/data/same_goals.json`.

Where a policy, the map or the simulator is meant to change, look at what has become different,
and record again: `PYTHONPATH=tests python tests/loop/test_same_goals.py`.
"""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path

import pytest
from simulated import simulated

from edge.lab.eval.closed_loop import ClosedLoop
from edge.types import Goal

RECORDED = Path(__file__).parents[1] / "data" / "same_goals.json"
TARGETS = {"hvl": "F bed & F television", "nearest_frontier": "F refrigerator"}
TICKS = 180


def goals_of(policy: str) -> list[list]:
    """Return [number of ticks, goal or None] in order, with false detections."""
    config = simulated(
        {
            "policy": {"kind": policy},
            "loop": {"lockstep": True},
            "sim": {"lockstep": True},
            "sensors": {"camera": {"width_px": 160, "height_px": 128}},
            "mission": {"instruction": TARGETS[policy], "translator": {"kind": "ltl"}},
            "perception": {"detector": {"kind": "sim", "seed": 3, "false_positive_rate": 0.04}},
        }
    )
    loop, goals = ClosedLoop(config), []
    for _ in range(TICKS):
        loop.step()
        goals.append(goal_fields(loop.service.goals.goal))
    return [[len(list(same)), goal] for goal, same in groupby(goals)]


def goal_fields(goal: Goal | None) -> list | None:
    """Return stamp, kind, id, target, and pose and candidate rounded to a micrometre."""
    if goal is None:
        return None
    at = goal.pose
    places = [float(v) for v in (at.x_m, at.y_m, at.yaw_rad, *goal.candidate_xy_m)]
    who = [goal.stamp_ns, goal.kind, goal.candidate_id, goal.target]
    return who + [round(place, 6) for place in places]


@pytest.mark.parametrize("policy", sorted(TARGETS))
def test_same_goals(policy):
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))[policy]
    for (ticks, goal), (ticks_then, goal_then) in zip(goals_of(policy), recorded, strict=True):
        assert (ticks, goal and goal[:4]) == (ticks_then, goal_then and goal_then[:4])
        # The last digit may be rounded otherwise on another computer.
        assert goal is None or goal[4:] == pytest.approx(goal_then[4:], abs=2e-6)


if __name__ == "__main__":
    runs = (
        f'"{policy}": [\n' + ",\n".join(map(json.dumps, goals_of(policy))) + "\n]"
        for policy in sorted(TARGETS)
    )
    RECORDED.write_text("{" + ",\n".join(runs) + "}\n", encoding="utf-8")

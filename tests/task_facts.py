"""Tasks at every stage, made by the real writer and refined, for tests of pages and messages."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

from task_scenes import STREET, street

from edge.config import TasksConfig
from edge.tasks.facts import StepState, StepStatus, TaskStatus
from edge.tasks.refine import RefinedTrajectory, refine
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.write import PlanAttempt, WrittenTrajectory, write_trajectory
from edge.trajectory.pursuit import MotionLimits

INSTRUCTION = "go past the left of the van, then stop at the gate"
SAID = ("go past the left of the van", "stop at the gate")
LIMITS = MotionLimits(speed_mps=1.0, turn_radps=1.0, accel_mps2=0.8, turn_accel_radps2=3.0)
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(1)>\x1b[2J\u202e\ud800'\""


@cache
def written() -> tuple[WrittenTrajectory, RefinedTrajectory]:
    scene = street(*STREET)
    by_rules = write_trajectory(INSTRUCTION, scene, TasksConfig())
    coarse = by_rules.coarse
    body = PathMargins(clearance_m=0.3, tube_m=1.0)
    return by_rules, refine(scene, coarse.segments, coarse.regions, body, LIMITS)


def steps(*states: StepState) -> tuple[StepStatus, ...]:
    return tuple(map(StepStatus, SAID, states))


def looking(**fields: Any) -> TaskStatus:
    return replace(
        TaskStatus(
            INSTRUCTION, "looking", "rules", missing=("van", "gate"),
            steps=steps("looked for", "looked for"),
        ),
        **fields,
    )  # fmt: skip


def driving(index: int = 40, **fields: Any) -> TaskStatus:
    """Return a task that was written by the rules and is driven."""
    by_rules, refined = written()
    task = TaskStatus(
        INSTRUCTION, "driving", "rules", understood=by_rules.understood,
        coarse_m=by_rules.coarse.points_m, refined=refined, index=index, refinements=1,
        notes=refined.notes, steps=steps("under way", "under way"),
    )  # fmt: skip
    return replace(task, **fields)


def by_a_model(said: str = HOSTILE, **fields: Any) -> TaskStatus:
    """Return a model's task, accepted at the second answer, with hostile names."""
    rounds = (
        PlanAttempt(said, "", "", f"the answer has no ```python block: {said}"),
        PlanAttempt(said, f"# {said}\nprint(1)\ngive_trajectory([(1, 0)])", f"1\n{said}", ""),
    )
    more: dict[str, Any] = {
        "writer": f"model {said}", "understood": "", "prompt": f"You plan.\n{said}",
        "rounds": rounds, "notes": (said,), "steps": (StepStatus(said, "under way"),),
    }  # fmt: skip
    return driving(**{**more, **fields})

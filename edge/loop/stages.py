"""The stage table: every stage of a tick, in order, with the budget it is held to.

The loop times these, `edge bench` and the reports hold them to their budgets.
`detect` runs on its own worker; it is timed and budgeted, but no tick waits for it.

Budgets are the reference computer's (`edge.host.calibration`), and grow with how much slower a
calibrated computer is; on any other they do not count. What is called a deadline is real time, and
the same everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage.

    Attributes:
        budget_ms: what its p95 should stay under on the reference computer.
        reads, writes: what it takes and what it makes, for people.
        code: where it lives, a path of this project.
        in_tick: whether its time is part of the tick.
        deadline: whether the budget is one: a camera's period is as long for a slow computer.
    """

    name: str
    budget_ms: float
    reads: str
    writes: str
    code: str
    in_tick: bool = True
    deadline: bool = False

    def budget_on(self, slowdown: float | None) -> float | None:
        """Return the budget in ms on a computer this many times slower than the reference.

        On a computer whose speed is not known (None) only a deadline is a budget.
        """
        if self.deadline:
            return self.budget_ms
        return None if slowdown is None else self.budget_ms * slowdown


STAGES: tuple[Stage, ...] = (
    Stage("ingest", 1.0, "source", "Observation", "edge/sources"),
    Stage("check", 0.2, "Observation", "what it is good for", "edge/loop/plausibility.py"),
    Stage(
        "detect",
        33.0,
        "rgb, prompts",
        "Detections",
        "edge/perception",
        in_tick=False,
        deadline=True,
    ),
    Stage("map", 1.5, "depth or cloud, pose", "grid, frontiers, changed region", "edge/mapping"),
    Stage("lift", 0.5, "Detections", "Instances", "edge/perception/tracking/lift.py"),
    Stage("candidates", 0.4, "grid, Instances", "Candidates", "edge/loop/candidates.py"),
    Stage("score", 0.3, "Candidates, Detections", "scored Candidates", "edge/policies"),
    Stage("plan", 0.1, "Instances, goal status", "active target", "edge/mission/run.py"),
    Stage("select", 0.3, "scored Candidates", "Goal or none, answers", "edge/loop/goal.py"),
    Stage("publish", 0.3, "Goal, status, latency", "TickResult", "edge/loop/publish.py"),
)
TICK_BUDGET_MS = 3.0
TICK_DEADLINE_MS = 33.0
MEMORY_BUDGET_MB = 700.0
READY_BUDGET_S = 10.0

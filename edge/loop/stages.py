"""The stage table: every stage of a tick, in order, with its time budget.

The loop measures the stages; `edge bench` and the reports compare them with their budgets.
`detect` runs on its own worker. It has a budget, but no tick waits for it.

Budgets are those of the reference computer (`edge.host.calibration`). On a calibrated computer they
are multiplied by its slowdown. On a computer without calibration they do not apply. A deadline is
real time and is the same on all computers.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of a tick.

    Attributes:
        budget_ms: Budget of its 95th percentile on the reference computer.
        code: Path of its code in this project.
        in_tick: True if its time is part of the tick.
        deadline: True if the budget is a deadline, such as the period of a camera.
    """

    name: str
    budget_ms: float
    code: str
    in_tick: bool = True
    deadline: bool = False

    def budget_on(self, slowdown: float | None) -> float | None:
        """Return the budget in ms on a computer that is `slowdown` times slower than the reference.

        If the speed is unknown (None), only a deadline has a budget.
        """
        if self.deadline:
            return self.budget_ms
        return None if slowdown is None else self.budget_ms * slowdown


STAGES: tuple[Stage, ...] = (
    Stage("ingest", 1.0, "edge/sources"),
    Stage("check", 0.2, "edge/loop/checks/plausibility.py"),
    Stage("detect", 33.0, "edge/perception", in_tick=False, deadline=True),
    Stage("map", 1.5, "edge/mapping"),
    Stage("lift", 0.5, "edge/perception/tracking/back_projection.py"),
    Stage("candidates", 0.4, "edge/loop/goals/candidates.py"),
    Stage("score", 0.3, "edge/policies"),
    Stage("plan", 0.1, "edge/mission/run.py"),
    Stage("select", 0.3, "edge/loop/goals/goal.py"),
    Stage("publish", 0.3, "edge/loop/publish.py"),
)
INGEST, CHECK, DETECT, MAP, LIFT, CANDIDATES, SCORE, PLAN, SELECT, PUBLISH = range(len(STAGES))
"""Indices into `STAGES`."""
TICK_BUDGET_MS = 3.0
"""Budget of the tick's 95th percentile on the reference computer."""
TICK_DEADLINE_MS = 33.0
"""Longest permitted duration of a tick on every computer: the period of a camera."""
MEMORY_BUDGET_MB = 700.0
"""Budget of the process's memory."""
READY_BUDGET_S = 10.0
"""Budget of the time from the start to the first tick, with compiled kernels."""

"""Benchmark: cost of a driven task in each tick: position, obstacles and the goal ahead."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / "tests" / folder) for folder in ("", "drives")]
from test_loop_task import closed, until


def test_task_step(benchmark):
    """Measure a step while the robot drives; each sixth step checks the path ahead."""
    benchmark.extra_info["budget"] = "task_step"
    loop = until(closed("go straight for 3 metres"), "driving")
    service = loop.service
    contexts, plan = [], service.behaviour.plan
    service.behaviour.plan = lambda context, images: (
        contexts.append(context),
        plan(context, images),
    )

    def drive() -> tuple[tuple, dict]:
        loop.step()
        assert service.behaviour.phase == "driving"
        return (contexts[-1],), {}

    def step(context) -> None:
        plan(context, 0)
        service.behaviour.select(context, service.perception.scores, 0)

    benchmark.pedantic(step, setup=drive, rounds=25, warmup_rounds=1)

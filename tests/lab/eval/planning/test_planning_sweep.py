"""Running a comparison: the same results on any number of processes, and skipped runs."""

from __future__ import annotations

import numpy as np
import pytest

from edge.lab.eval.planning import sweep
from edge.lab.eval.planning.sweep import Settings, run_tasks
from edge.lab.eval.planning.templates import generate

SETTINGS = Settings(("vitl", "random-valid", "optimal"), (0.3, 1.0), episodes=2)


def same(a, b) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("outcome", "explorations", "steps", "bound")
    )


def test_processes_give_the_same_results():
    tasks = generate(12)
    assert same(run_tasks(tasks, SETTINGS, workers=2), run_tasks(tasks, SETTINGS))


def test_batches_and_company_make_no_difference(monkeypatch):
    tasks = generate(60)
    whole = run_tasks(tasks, SETTINGS)
    monkeypatch.setattr(sweep, "BATCH_EPISODES", 1)
    assert same(run_tasks(tasks, SETTINGS), whole)
    one = run_tasks(tasks[7:8], SETTINGS._replace(planners=("vitl",)))
    np.testing.assert_array_equal(one.explorations[0, :, 0], whole.explorations[0, :, 7])


def test_a_failure_in_a_process_ends_the_run():
    with pytest.raises(KeyError, match="nobody"):
        run_tasks(generate(3), SETTINGS._replace(planners=("nobody",)), workers=2)

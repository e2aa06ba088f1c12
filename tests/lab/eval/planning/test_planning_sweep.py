"""Running a comparison: the same results however it is spread, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest

from edge.lab.eval.planning import optimum, sweep
from edge.lab.eval.planning.sweep import NOT_RUN, Settings, run_tasks
from edge.lab.eval.planning.templates import generate

SETTINGS = Settings(("vitl", "random-valid", "optimal"), (0.3, 1.0), episodes=2)


def same(a, b) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("outcome", "explorations", "steps", "bound")
    )


def test_no_tasks():
    assert run_tasks([], SETTINGS).outcome.shape == (3, 2, 0, 2)


def test_progress_counts_all_tasks():
    seen = []
    run_tasks(generate(30), SETTINGS, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 30


def test_processes_give_the_same_results():
    tasks = generate(12)
    assert same(run_tasks(tasks, SETTINGS, jobs=2), run_tasks(tasks, SETTINGS))


def test_batches_and_company_make_no_difference(monkeypatch):
    tasks = generate(60)
    whole = run_tasks(tasks, SETTINGS)
    monkeypatch.setattr(sweep, "BATCH_EPISODES", 1)
    assert same(run_tasks(tasks, SETTINGS), whole)
    one = run_tasks(tasks[7:8], SETTINGS._replace(planners=("vitl",)))
    np.testing.assert_array_equal(one.explorations[0, :, 0], whole.explorations[0, :, 7])


def test_seed_is_the_luck():
    tasks = generate(30)
    assert not same(run_tasks(tasks, SETTINGS._replace(seed=1)), run_tasks(tasks, SETTINGS))


def test_optimum_of_what_is_too_large_is_left_out(monkeypatch):
    monkeypatch.setattr(optimum, "MAX_VALUES", 1)
    results = run_tasks(generate(3), SETTINGS)
    assert (results.outcome[2] == NOT_RUN).all()
    assert results.complete[:2].all()


def test_a_failure_in_a_process_ends_the_run():
    with pytest.raises(KeyError, match="nobody"):
        run_tasks(generate(3), SETTINGS._replace(planners=("nobody",)), jobs=2)

"""Changes of a task's facts, and its thinned trajectory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_facts import by_a_model, looking, written

from edge.tasks.facts import same_text, thinned


def test_no_task_is_the_same_as_none():
    assert same_text(None, None)
    assert not same_text(None, looking())
    assert not same_text(looking(), None)


def test_progress_leaves_the_text_unchanged():
    task = by_a_model()
    assert same_text(task, replace(task, index=task.index + 7, coarse_m=task.coarse_m.copy()))


@pytest.mark.parametrize(
    "change",
    [
        {"phase": "failed"}, {"rounds": ()}, {"refined": None}, {"coarse_m": None}, {"notes": ()},
        {"coarse_m": np.zeros((1, 2))}, {"refinements": 2}, {"missing": ("van",)}, {"prompt": ""},
        {"steps": ()},
    ],
    ids=lambda change: next(iter(change)),
)  # fmt: skip
def test_any_other_change_alters_the_text(change):
    task = by_a_model()
    assert not same_text(task, replace(task, **change))


@given(st.integers(1, 300), st.integers(1, 500), st.data())
def test_a_thinned_trajectory_keeps_its_end_and_progress(n, most, data):
    index = data.draw(st.integers(0, n - 1))
    poses = np.column_stack([np.arange(n), np.arange(n) * 2, np.zeros(n), np.arange(n) / n])
    drawn, at = thinned(replace(written()[1], poses=poses), index, most)
    assert len(drawn) <= most
    assert drawn[-1].tolist() == poses[-1, [0, 1, 3]].tolist()
    behind = drawn[:, 0] <= index
    assert at == np.count_nonzero(behind) - 1

"""Figures of a comparison, worked out by hand on a small one; the table and the JSON of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.lab.eval.planning.executor import COMPLETE, VIOLATED
from edge.lab.eval.planning.report import rows_of
from edge.lab.eval.planning.sweep import SweepResults


def results_of(planners, outcome, explorations, steps, bound, p_obs=(0.5,)) -> SweepResults:
    shape = (len(planners), len(p_obs), len(bound), 1)

    def array(data, dtype):
        return np.array(data, dtype).reshape(shape)

    return SweepResults(
        tuple(planners), tuple(p_obs), array(outcome, np.int8), array(explorations, np.int32),
        array(steps, np.int32), np.array(bound, np.int32),
    )  # fmt: skip


@pytest.fixture
def results():
    c, v = COMPLETE, VIOLATED
    return results_of(
        ["vitl", "optimal", "clairvoyant", "in-order"],
        [[c, c, c], [c, c, v], [c, c, c], [v, v, v]],
        [[4, 2, 9], [2, 2, 0], [0, 0, 0], [7, 0, 0]],
        [[4, 4, 9], [2, 3, 0], [2, 2, 3], [7, 0, 0]],
        [2, 2, 3],
    )


def test_figures(results):
    vitl, best, clairvoyant, in_order = rows_of(results)
    assert (vitl.runs, vitl.complete.value, vitl.explorations.value) == (3, 1.0, 5.0)
    assert vitl.steps_to_bound.value == pytest.approx(17 / 7)
    # The optimum did not complete the third task.
    assert vitl.explorations_to_optimum.value == pytest.approx(6 / 4)
    assert (best.runs, best.explorations_to_optimum.value) == (3, 1.0)
    assert clairvoyant.steps_to_bound[:] == (1.0, 1.0, 1.0)
    assert math.isnan(clairvoyant.explorations_to_optimum.value)  # it knows more
    assert (in_order.complete.value, in_order.outcomes) == (0.0, {"violated": 3})
    assert math.isnan(in_order.explorations.value)


def test_several_p_obs_have_a_row_for_all():
    two = results_of(["vitl"], [0, 0, 0, 1], [1, 2, 3, 9], [1, 2, 3, 9], [1, 1], (0.5, 1.0))
    rows = rows_of(two)
    assert [row.p_obs for row in rows] == [0.5, 1.0, None]
    assert [row.runs for row in rows] == [2, 2, 4]
    assert rows[-1].explorations.value == 2.0
    assert rows[-1].complete.value == 0.75

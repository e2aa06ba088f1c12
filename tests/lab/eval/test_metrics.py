from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.metrics import episode_soft_spl, episode_spl


@pytest.mark.parametrize(
    ("success", "shortest", "path", "expected"),
    [
        ([], [], [], []),
        ([True], [2.0], [2.0], [1.0]),
        ([True], [2.0], [4.0], [0.5]),
        # A driven path shorter than the raster's shortest one earns no bonus.
        ([True], [2.0], [1.9], [1.0]),
        ([True], [0.0], [0.0], [1.0]),
        ([False], [2.0], [2.0], [0.0]),
        ([True, False, True, True], [1, 1, 2, 3], [1, 1, 4, 3], [1.0, 0.0, 0.5, 1.0]),
    ],
)
def test_spl(success, shortest, path, expected):
    found = episode_spl(np.array(success, bool), np.array(shortest, float), np.array(path, float))
    assert found.tolist() == expected


@pytest.mark.parametrize(
    ("success", "shortest", "path", "left", "expected"),
    [
        (True, 4.0, 8.0, 0.5, 0.5),
        (True, 4.0, 8.0, 3.0, 0.5),
        (False, 4.0, 8.0, 2.0, 0.25),
        (False, 4.0, 4.0, 50.0, 0.0),
        (False, 4.0, 4.0, math.inf, 0.0),
        (True, 4.0, 8.0, math.nan, 0.5),
        (False, 0.0, 0.0, 0.0, 1.0),
    ],
)
def test_soft_spl(success, shortest, path, left, expected):
    found = episode_soft_spl(*(np.array([x]) for x in (success, shortest, path, left)))
    assert found[0] == pytest.approx(expected, nan_ok=True)


LENGTHS = st.floats(0.0, 100.0)


@given(st.booleans(), LENGTHS, LENGTHS, LENGTHS)
def test_soft_spl_is_never_below_spl(success, shortest, path, left):
    arrays = [np.array([x]) for x in (success, shortest, path)]
    hard, soft = episode_spl(*arrays)[0], episode_soft_spl(*arrays, np.array([left]))[0]
    assert 0.0 <= hard <= soft <= 1.0

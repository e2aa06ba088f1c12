from __future__ import annotations

import pytest

from edge.eval.metrics import spl, success_rate


@pytest.mark.parametrize(
    ("successes", "shortest", "path", "sr", "expected"),
    [
        ([], [], [], 0.0, 0.0),
        ([True], [2.0], [2.0], 1.0, 1.0),
        ([True], [2.0], [4.0], 1.0, 0.5),
        # A driven path shorter than the raster's shortest one earns no bonus.
        ([True], [2.0], [1.9], 1.0, 1.0),
        ([True], [0.0], [0.0], 1.0, 1.0),
        ([False], [2.0], [2.0], 0.0, 0.0),
        ([True, False, True, True], [1, 1, 2, 3], [1, 1, 4, 3], 0.75, 0.625),
    ],
)
def test_success_rate_and_spl(successes, shortest, path, sr, expected):
    assert success_rate(successes) == pytest.approx(sr)
    assert spl(successes, shortest, path) == pytest.approx(expected)


def test_lengths_must_agree():
    with pytest.raises(ValueError, match="shorter"):
        spl([True, True], [1.0], [1.0, 1.0])

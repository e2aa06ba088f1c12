"""Figures by hand, pairing, and the causes of lost SPL."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from made_outcomes import failure, many, record

from edge.errors import UserError
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.comparison.statistics import METRICS, compare, excess_m, pair

FEW = 400  # resamples


def figures(*records) -> dict[str, float]:
    """By metric, of a single column."""
    (found,) = compare(gather(records), resamples=FEW).figures.values()
    return {key: figure.interval.value for key, figure in found.items()}


def test_nothing():
    comparison = compare(gather([]))
    assert comparison.figures == {}
    assert comparison.pairs == ()


def test_every_metric_by_hand():
    found = figures(
        record("1", shortest_m=5.0, path_m=10.0, collisions=1, tick_ms={"p95": 2.0}),
        record("2", shortest_m=6.0, path_m=6.0, elapsed_s=60.0, first_sight_s=0.0,
               tick_ms={"p95": 3.0}, false_confirmations=2),
        failure("3", shortest_m=8.0, path_m=16.0, elapsed_s=90.0, left_m=4.0,
                tick_ms={"p95": 99.0}, wrong_stops=2),
        failure("4", shortest_m=8.0, path_m=48.0, elapsed_s=100.0, left_m=20.0, wrong_stops=1,
                tick_ms={"p95": 4.0}, first_sight_s=30.0),
    )  # fmt: skip
    assert found == {
        "sr": pytest.approx(2 / 4),
        "spl": pytest.approx((0.5 + 1.0) / 4),
        "soft_spl": pytest.approx((0.5 + 1.0 + 0.5 * 0.5 + 0.0) / 4),
        "path_m": pytest.approx(80.0 / 4),
        "success_path_m": pytest.approx(16.0 / 2),
        "elapsed_s": pytest.approx(280.0 / 4),
        "collisions": pytest.approx(1 / 4),
        "seen": pytest.approx(3 / 4),
        "first_sight_s": pytest.approx((12.0 + 0.0 + 30.0) / 3),
        "wrong_stops": pytest.approx(2 / 4),
        "false_confirmations": pytest.approx(2 / 4),
        "zone_entries": pytest.approx(math.nan, nan_ok=True),
        "person_contacts": pytest.approx(math.nan, nan_ok=True),
        "ghost_s": pytest.approx(math.nan, nan_ok=True),
        "answers_right": pytest.approx(math.nan, nan_ok=True),
        "tick_p95_ms": pytest.approx(3.5),
        "score_p95_ms": pytest.approx(0.5),
    }
    assert set(found) == set(METRICS)


def test_columns_are_compared_on_the_episodes_that_both_ran():
    records = [
        record("1", "base", path_m=10.0), record("1", "new", path_m=5.0, elapsed_s=15.0),
        failure("2", "base"), record("2", "new", path_m=10.0),
        record("3", "base"), failure("4", "new"),
    ]  # fmt: skip
    outcomes = gather(records)
    found = pair(outcomes, 1, 0, FEW)
    assert (found.arm, found.n, found.missing, found.both) == ("new", 2, 2, 1)
    assert found.sr.value == pytest.approx(0.5)
    assert found.spl.value == pytest.approx(0.5)  # 1.0 - 0.5, and 0.5 - 0
    assert found.spl_ratio.value == pytest.approx(1.5 / 0.5)
    assert found.path_ratio.value == pytest.approx(5.0 / 10.0)
    assert found.time_ratio.value == pytest.approx(15.0 / 30.0)
    assert (found.won, found.lost) == (2, 0)
    assert compare(outcomes, "base", resamples=FEW).pairs[0].n == 2
    assert [p.arm for p in compare(outcomes, "new", resamples=FEW).pairs] == ["base"]


@given(st.integers(0, 2**32 - 1), st.integers(1, 14), st.sets(st.integers(0, 27), max_size=9))
@example(22067742, 1, {0, 2})
@example(22067742, 1, {2})
def test_swapped_columns_negate_differences_and_invert_ratios(seed, worlds, left_out):
    records = many({"a": 1.5, "b": 2.0}, worlds, seed, each=2)
    outcomes = gather([r for k, r in enumerate(records) if k not in left_out] + records[:2])
    there, back = pair(outcomes, 0, 1, FEW), pair(outcomes, 1, 0, FEW)
    for one, other in ((there.sr, back.sr), (there.spl, back.spl), (there.soft_spl, back.soft_spl)):
        assert (one.value, one.low, one.high) == pytest.approx(
            (-other.value, -other.high, -other.low), nan_ok=True
        )
    ratios = there.spl_ratio.value, back.spl_ratio.value
    if 0.0 in ratios:  # of a column that never got there, none is a multiple
        assert math.isnan(sum(ratios))
    else:
        assert ratios[0] == pytest.approx(1 / ratios[1], nan_ok=True)
    assert (there.n, there.won, there.lost) == (back.n, back.lost, back.won)


def test_pairing_shows_differences_that_hard_worlds_hide():
    """Worlds differ far more than columns do."""
    comparison = compare(gather(many({"a": 2.0, "b": 1.6}, 40, each=6, spread=1.2)), "a")
    (found,) = comparison.pairs
    assert found.spl.low > 0.0
    a, b = (comparison.figures[name]["spl"].interval for name in ("a", "b"))
    assert (found.spl.high - found.spl.low) < (a.high - a.low) + (b.high - b.low)


@pytest.mark.parametrize(
    ("path", "sight", "left", "search", "approach"),
    [
        (10.0, 4.0, 5.0, 4.0, 1.0),  # 4 m there and 5 to go, where 5 were enough; then 6 for 5
        (10.0, 0.0, 5.0, 0.0, 5.0),  # in view from the start
        (10.0, 5.0, 5.0, 5.0, 0.0),
        (10.0, 4.0, 0.5, 0.0, 5.0),  # the raster's ways are not exact: never less than nothing
        (10.0, 9.0, 8.0, 5.0, 0.0),  # nor more than all
        (10.0, None, math.nan, 5.0, 0.0),  # reached though never in view
        (4.8, 4.0, 1.0, 0.0, 0.0),
    ],
)
def test_excess_is_the_searchs_or_the_approachs(path, sight, left, search, approach):
    outcomes = gather([record(path_m=path, first_sight_path_m=sight)])
    assert excess_m(outcomes, np.array([[left]])) == (
        pytest.approx(search),
        pytest.approx(approach),
    )


def test_an_unknown_baseline():
    with pytest.raises(UserError, match="no arm 'c'"):
        compare(gather([record()]), "c")

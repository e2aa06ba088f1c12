"""How much likelier a room holds one thing if it holds another."""

from __future__ import annotations

import numpy as np
import pytest

from edge.perception.prior import table as cooccurrence


def test_the_table_holds_together():
    table = cooccurrence.load()
    both = table.rooms_with_both
    np.testing.assert_array_equal(both, both.T)
    assert (both <= np.minimum.outer(table.rooms_with, table.rooms_with)).all()
    assert table.rooms_with.max() <= table.n_rooms
    assert len(table.index) == len(both)


@pytest.mark.parametrize(
    ("a", "b", "low", "high"),
    [
        ("toilet", "sink", 1.5, 10),
        ("bed", "pillow", 1.5, 10),
        ("toilet", "bed", 0.0, 0.2),
        ("tv", "sofa", 1.2, 10),
        ("bed", "bed", 1, 1),
        ("couch", "sofa", 1, 1),
        ("zeppelin", "bed", 1, 1),
    ],
)
def test_lift(a, b, low, high):
    lift = cooccurrence.load().lift([a, b])
    assert lift[0, 1] == lift[1, 0]
    assert low <= lift[0, 1] <= high
    assert lift[0, 0] == lift[1, 1] == 1


@pytest.mark.parametrize(("both", "lift"), [(20, 22 / 12), (10, 1.0), (0, 2 / 12)])
def test_small_counts_are_drawn_towards_one(both, lift):
    """Ten rooms with both by chance, and two more for what was not seen."""
    counts = np.array([[50, both], [both, 20]])
    table = cooccurrence.Table(100, {"bed": 0, "vase": 1}, counts.diagonal(), counts)
    assert table.lift(["bed", "vase"])[0, 1] == pytest.approx(lift)


def test_lift_of_nothing():
    assert cooccurrence.load().lift([]).shape == (0, 0)

"""Coarse trajectories in legs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.tasks.legs import cut_into_legs

ORIGIN = (0.0, 0.0)


def ends(segments, start=ORIGIN, tube_m=1.0) -> list[tuple[float, float, bool]]:
    """Return the end of each leg, and True if a segment ends there."""
    legs = cut_into_legs([np.array(segment, float) for segment in segments], start, tube_m)
    return [(*leg.points_m[-1, :2].tolist(), leg.ends_segment) for leg in legs]


@pytest.mark.parametrize(
    ("segments", "expected"),
    [
        ([[[4, 0]]], [(4, 0, True)]),
        # The robot's own place, once more.
        ([[[0, 0]]], [(0, 0, True)]),
        ([[[4, 0], [8, 0]], [[8, 4]]], [(8, 0, True), (8, 4, True)]),
        # A corner within a segment, and one that is no more than noise.
        ([[[4, 0], [4, 4], [4, 8]]], [(4, 0, False), (4, 8, True)]),
        ([[[2, 0.3], [4, -0.3], [6, 0.3], [8, 0]]], [(8, 0, True)]),
        # There and back again.
        ([[[5, 0], [0, 0]]], [(5, 0, False), (0, 0, True)]),
        # Three bends of 30 degrees: the second is the one that makes 45.
        ([[[4, 0], [7.46, 2], [9.46, 5.46], [9.46, 9.46]]], [(7.46, 2, False), (9.46, 9.46, True)]),
    ],
)
def test_a_leg_ends_at_a_turn(segments, expected):
    assert ends(segments) == expected


def test_a_circle_is_cut_in_eight():
    angle = np.linspace(-math.pi, math.pi, 65)
    circle = 3 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert 5 <= len(cut_into_legs([circle], (-3.0, 0.0), 0.5)) <= 9


@given(
    st.lists(
        st.lists(st.tuples(*[st.floats(-30, 30)] * 2), min_size=1, max_size=8),
        min_size=1, max_size=4,
    )
)  # fmt: skip
def test_legs_joined_are_the_segments(segments):
    legs = cut_into_legs([np.array(segment) for segment in segments], ORIGIN, 1.0)
    joined = np.concatenate([leg.points_m for leg in legs])
    np.testing.assert_array_equal(joined[:, :2], np.concatenate([np.array(s) for s in segments]))
    assert sum(leg.ends_segment for leg in legs) == len(segments)
    assert all(len(leg.points_m) for leg in legs)

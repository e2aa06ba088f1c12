"""Every kind of goal has a mark in the picture."""

from __future__ import annotations

from typing import get_args

from edge.lab.report.marks import GOAL_STYLES
from edge.types import CandidateKind


def test_every_kind_of_goal_but_a_trajectory_has_a_mark():
    assert set(GOAL_STYLES) | {"trajectory"} == set(get_args(CandidateKind))

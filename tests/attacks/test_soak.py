"""A quarter of an hour of missions in one house, in one service, in simulated time."""

from __future__ import annotations

import pytest
from fresh_process import run_fresh

pytestmark = pytest.mark.slow

MAY_GROW_MB = 25
MAY_TOUCH = 2  # the map rounds to cells: now and then the robot grazes a corner


def test_every_present_thing_is_found_and_nothing_grows():
    told = run_fresh("mission_soak.py")
    assert told["wrong"] == []
    assert told["collisions"] <= MAY_TOUCH
    settled_mb, end_mb = told["resident_mb"]
    assert end_mb <= settled_mb + MAY_GROW_MB
    settled, end = told["descriptors"]
    assert end == settled

"""Floods of valid messages: a read takes one ring at most, and ticks go on. No times."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from live_patience import eventually
from live_service import flood, live

pytestmark = pytest.mark.slow

ODOMETRY_RING = 64  # the least there is: the flood need not be fast
TICKS = 60


def noting(sizes: list[int], look: Callable[[], list]) -> Callable[[], list]:
    """`look`, with how much it took noted."""

    def noted() -> list:
        took = look()
        sizes.append(len(took))
        return took

    return noted


def test_a_flood_of_odometry_leaves_the_loop_its_ticks():
    with live({"source": {"odometry_ring": ODOMETRY_RING}}) as service:
        source, looks = service.running.source, []
        ring = next(r for topic, r in source._rings.items() if topic.key == "odom")
        ring.take = noting(looks, ring.take)
        with flood(service.running.config, "odometry"):
            eventually(lambda: source.counters["overrun"] >= 3, "the flood is too slow")
            service.is_resumed(TICKS)
        assert max(looks) == ODOMETRY_RING
        assert source.counters["malformed"] == 0
        assert service.running.service.error_boundary.failures == {}


def test_two_floods_of_answers_leave_the_loop_its_ticks():
    with live({}) as service:
        inbox, looks = service.running.source.inbox, []
        inbox.poll = noting(looks, inbox.poll)
        with flood(service.running.config, "goal_status", "goal_status"):
            eventually(lambda: inbox._ring.overruns >= 3, "the flood is too slow")
            service.is_resumed(TICKS)
        assert max(looks) == 64
        assert service.running.service.error_boundary.failures == {}
        # Messages of other processes must not fill the memory.
        assert len(service.running.sinks[0]._worker._waiting) <= 300

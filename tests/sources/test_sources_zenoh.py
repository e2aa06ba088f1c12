"""The source and the inbox under senders that never let their rings run empty."""

from __future__ import annotations

from itertools import count, repeat

import numpy as np
import pytest
from fake_zenoh import Flooded
from simulated import simulated

from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.sources.goal_status import GoalStatusInbox
from edge.sources.zenoh import ZenohSource


def odometry(n: int) -> bytes:
    return messages.encode_odometry(n * 1_000_000, np.eye(4), 0.0, 0.0)


@pytest.mark.parametrize("ring", [64, 256])
def test_one_poll_takes_at_most_a_ring_of_odometry(ring):
    config = simulated({"source": {"odometry_ring": ring}, "mission": {"target": "bed"}})
    source = ZenohSource(config, Flooded("edge/odom", map(odometry, count(1))))
    for look in range(1, 4):
        assert source.poll() is None
        assert source.counters["received"] == look * ring
        assert source.counters["overrun"] == look - 1
    assert source.wait(60.0)
    assert source.counters["received"] == 4 * ring
    assert source.counters["malformed"] == 0


def test_one_poll_takes_at_most_a_ring_of_answers():
    accepted = b'{"stamp": %d, "state": "accepted"}'
    inbox = GoalStatusInbox(
        Flooded("edge/goal_status", (accepted % n for n in count(1))), ZenohConfig()
    )
    assert [answer.stamp_ns for answer in inbox.poll()] == list(range(1, 65))
    assert [answer.stamp_ns for answer in inbox.poll()] == list(range(65, 129))


def test_a_flood_of_no_answers_is_as_bounded():
    inbox = GoalStatusInbox(Flooded("edge/goal_status", repeat(b"[]")), ZenohConfig())
    assert inbox.poll() == []
    assert inbox.malformed == 64

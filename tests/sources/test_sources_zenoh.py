"""The source and the inbox under senders that never let their rings run empty."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest
import zenoh
from simulated import simulated

from edge.sources.goal_status import GoalStatusInbox
from edge.sources.zenoh import ZenohSource
from edge.wire import messages


class Flooded:
    """A session that always has one more message under one key."""

    def __init__(self, key: str, make) -> None:
        self.key, self.make, self.sent = key, make, count(1)

    def declare_subscriber(self, key: str, ring: object) -> Flooded:
        return self if key == self.key else Flooded(self.key, lambda n: None)

    def undeclare(self) -> None: ...

    def try_recv(self) -> object | None:
        payload = self.make(next(self.sent))
        return None if payload is None else Sample(zenoh.ZBytes(payload))


class Sample:
    def __init__(self, payload: zenoh.ZBytes) -> None:
        self.payload = payload


def odometry(n: int) -> bytes:
    return messages.encode_odometry(n * 1_000_000, np.eye(4), 0.0, 0.0)


@pytest.mark.parametrize("ring", [64, 256])
def test_a_look_takes_no_more_odometry_than_the_ring_holds(ring):
    config = simulated({"source": {"odometry_ring": ring}, "mission": {"target": "bed"}})
    source = ZenohSource(Flooded("edge/odom", odometry), config)
    for look in range(1, 4):
        assert source.poll() is None
        assert source.counters["received"] == look * ring
        assert source.counters["overrun"] == look - 1
    assert source.wait(60.0)
    assert source.counters["received"] == 4 * ring
    assert source.counters["malformed"] == 0


def test_a_look_takes_no_more_answers_than_the_ring_holds():
    accepted = b'{"stamp": %d, "state": "accepted"}'
    inbox = GoalStatusInbox(Flooded("edge/goal_status", lambda n: accepted % n), "edge")
    assert [answer.stamp_ns for answer in inbox.poll()] == list(range(1, 65))
    assert [answer.stamp_ns for answer in inbox.poll()] == list(range(65, 129))


def test_a_flood_of_no_answers_is_as_bounded():
    inbox = GoalStatusInbox(Flooded("edge/goal_status", lambda n: b"[]"), "edge")
    assert inbox.poll() == []
    assert inbox.malformed == 64

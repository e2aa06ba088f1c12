"""Message filters of the relay, and its pass-through."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from live_patience import eventually

from edge.bus import topics
from edge.bus.session import Ring, zenoh_session
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.geometry import SE2
from edge.host.ports import free_port
from edge.lab.eval.soak import relay

NS = 1_000_000_000
IMAGE = messages.encode_image(7 * NS, "camera", np.full((4, 6, 3), 9, np.uint8))


def odometry(stamp_ns: int, x_m: float = 1.0) -> bytes:
    return messages.encode_odometry(stamp_ns, SE2(x_m, 2.0, 0.5).matrix(), 0.3, 0.1)


def test_a_frozen_camera_may_continue_its_stamps():
    second = relay.restamped(IMAGE, 8 * NS)
    for go_on, expected_ns in ((False, 7 * NS), (True, 8 * NS)):
        alter = relay.freeze(go_on)
        alter(topics.RGB, IMAGE)
        (sent,) = alter(topics.RGB, second[:-1] + b"\0")
        assert messages.peek_stamp_ns(sent) == expected_ns
        assert sent[20:] == IMAGE[20:]
        assert alter(topics.ODOMETRY, odometry(NS)) == (odometry(NS),)


def test_only_the_named_topic_is_dropped():
    alter = relay.drop((topics.ODOMETRY,))
    assert alter(topics.ODOMETRY, odometry(NS)) == ()
    assert alter(topics.RGB, IMAGE) == (IMAGE,)


def test_another_clock_is_all_sensors():
    alter = relay.shift_stamps(3600.0)
    for topic, payload in ((topics.RGB, IMAGE), (topics.ODOMETRY, odometry(7 * NS))):
        assert messages.peek_stamp_ns(alter(topic, payload)[0]) == 3607 * NS
    assert alter(topics.LABELS, b"[]") == (b"[]",)


@pytest.mark.parametrize("payload", [b"", b"\0", IMAGE], ids=["empty", "byte", "image"])
def test_garbage_is_sent_before_each_intact_message(payload):
    alter = relay.add_garbage(np.random.default_rng(0))
    sent = [alter(topics.RGB, payload) for _ in range(50)]
    assert {pair[1] for pair in sent} == {payload}
    assert len({pair[0] for pair in sent}) > 10
    assert any(pair[0] != payload for pair in sent)


def test_the_relay_passes_both_ways_until_it_is_cut():
    robot, service = (ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}") for _ in range(2))
    stop = threading.Event()
    with zenoh_session(service, "listen") as at_service:
        seen = Ring(at_service, service.key(topics.ODOMETRY.key), 16)
        between = relay.Relay(robot, service, stop)
        try:
            with zenoh_session(robot, "connect") as at_robot:
                commands = Ring(at_robot, robot.key(topics.CMD_VEL.key), 16)

                def passes() -> list[bytes]:
                    at_robot.put(robot.key(topics.ODOMETRY.key), odometry(NS))
                    between.step()
                    return [sample.payload.to_bytes() for sample in seen.take()]

                def commanded() -> bool:
                    at_service.put(service.key(topics.CMD_VEL.key), b"go")
                    return any(s.payload.to_bytes() == b"go" for s in commands.take())

                assert odometry(NS) in eventually(passes)
                eventually(commanded)
                between.offset_m = 40.0
                eventually(lambda: odometry(NS, 41.0) in passes())
                between.offset_m = 0.0
                between.delay(0.05)
                eventually(lambda: odometry(NS) in passes())
                between.cut()
                seen.take()
                met = []
                between.alter = lambda topic, payload: met.append(topic) or (payload,)
                eventually(lambda: passes() == [] and len(met) > 3)
                between.alter = None
                between.connect()
                between.delay(0.0)
                eventually(lambda: odometry(NS) in passes())
        finally:
            between.close()

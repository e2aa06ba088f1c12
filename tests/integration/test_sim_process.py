"""The simulated robot as a process of its own, over real Zenoh."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh
from live_patience import PATIENCE_S

from edge.bus import topics
from edge.bus.session import declare_publisher, open_session
from edge.bus.wire import messages
from edge.config import Config, parse
from edge.host.ports import free_port

SIMULATE = """
import json, sys
from edge.config import parse
from edge.host.signals import stop_on_signals
from edge.lab.sim.process import main
sys.exit(main(parse(json.loads(sys.argv[1])), stop_on_signals()))
"""


def settings(**sim: object) -> dict:
    camera = {"width_px": 64, "height_px": 48}
    return {
        "perception": {"detector": {"kind": "sim"}},
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}", "prefix": "test/sim"},
        "sensors": {"camera": camera, "lidar": {"rings": 4, "columns": 90}},
        "sim": {"step_s": 0.1, **sim},
    }


@contextmanager
def simulator(data: dict) -> Iterator[subprocess.Popen]:
    process = subprocess.Popen([sys.executable, "-c", SIMULATE, json.dumps(data)])
    try:
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0, "SIGTERM ends it cleanly"
    finally:
        process.kill()
        process.wait()


class Peer:
    """Plays service and controller: listens, reads everything, sends commands."""

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        self._prefix = config.zenoh.prefix
        self._all = session.declare_subscriber(
            f"{self._prefix}/**", zenoh.handlers.FifoChannel(4096)
        )
        self._commands = declare_publisher(session, topics.CMD_VEL, config.zenoh)

    def drive(self, stamp_ns: int, v_mps: float, w_radps: float) -> None:
        self._commands.put(messages.encode_twist_stamped(stamp_ns, v_mps, w_radps))

    def read(self) -> Iterator[tuple[str, bytes]]:
        """Yield (topic key, payload) of the simulator's messages for up to `PATIENCE_S`."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            sample = self._all.try_recv()
            if sample is None:
                time.sleep(0.001)
                continue
            key = str(sample.key_expr).removeprefix(f"{self._prefix}/")
            if key != topics.CMD_VEL.key:
                yield key, sample.payload.to_bytes()
        pytest.fail(f"the simulator sent nothing of what was waited for in {PATIENCE_S} s")


def run_lockstep(data: dict, steps: int) -> list[dict[str, bytes]]:
    """Return each instant's messages by topic; send a command after each."""
    config, instants, seen = parse(data), [], {}
    with open_session(config.zenoh, "listen") as session:
        peer = Peer(session, config)
        with simulator(data):
            for key, payload in peer.read():
                seen[key] = payload
                if key != topics.RGB.key:
                    continue
                stamp_ns = messages.peek_stamp_ns(payload)
                if not instants or stamp_ns != messages.peek_stamp_ns(instants[-1]["odom"]):
                    instants.append(seen)
                seen = {}
                if len(instants) == steps:
                    break
                peer.drive(stamp_ns, 0.4, 0.5)
    return instants


def test_lockstep_sends_one_complete_instant_a_command_and_repeats_exactly():
    data = settings(lockstep=True, seed=3, depth_noise=0.002, drift_m_per_m=0.02)
    first = run_lockstep(data, 12)
    absent = (topics.SCAN, topics.SEGMENTATION2)
    expected = {topic.key for topic in topics.PLAYED if topic not in absent}
    expected = {key for key in expected if not key.startswith("camera2/")}
    assert [messages.peek_stamp_ns(instant["odom"]) for instant in first] == [
        10**9 + k * 10**8 for k in range(12)
    ]
    for instant in first:
        assert set(instant) == expected
        truth = json.loads(instant["sim/ground_truth"])
        odometry = messages.decode_odometry(instant["odom"])
        stamps = {
            messages.peek_stamp_ns(instant[topic.key])
            for topic in (
                topics.RGB,
                topics.DEPTH,
                topics.SEGMENTATION,
                topics.CLOUD,
                topics.ODOMETRY,
            )
        }
        assert stamps == {truth["stamp_ns"]}
        assert odometry.v_mps == pytest.approx(truth["v_mps"])
    assert json.loads(first[-1]["sim/ground_truth"])["path_m"] > 0.2
    labels = json.loads(first[0]["sim/labels"])
    assert "trash can" in labels
    header = messages.decode_image_header(first[0]["camera/depth"])
    depth = np.empty((48, 64), np.uint16)
    messages.decode_image_into(first[0]["camera/depth"], header, depth)
    assert 300 < np.median(depth[depth > 0]) < 8000
    second = run_lockstep({**data, "zenoh": settings()["zenoh"]}, 12)
    assert first == second


def test_real_time_drives_on_command_and_stops_when_commands_stop():
    data = settings()
    config, fastest, stamps = parse(data), 0.0, []
    with open_session(config.zenoh, "listen") as session:
        peer = Peer(session, config)
        with simulator(data):
            for key, payload in peer.read():
                if key == topics.RGB.key and fastest < 0.6:
                    peer.drive(messages.peek_stamp_ns(payload), 0.0, 0.6)
                if key != topics.ODOMETRY.key:
                    continue
                odometry = messages.decode_odometry(payload)
                stamps.append(odometry.stamp_ns)
                fastest = max(fastest, odometry.w_radps)
                if fastest >= 0.6 and odometry.w_radps == 0.0:
                    break
    assert fastest == 0.6
    assert (np.diff(stamps) > 0).all()

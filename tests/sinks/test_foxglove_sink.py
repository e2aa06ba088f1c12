"""The sink `foxglove`, seen by a client that speaks its protocol."""

from __future__ import annotations

import json
import struct
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from patience import eventually
from results import result
from simulated import simulated
from websockets.sync.client import connect

from edge.config import ConfigError
from edge.errors import UnavailableError
from edge.geometry import SE2, CameraModel
from edge.recording import channels
from edge.sinks import find_sinks
from edge.sinks.encoder import ResultEncoder
from edge.sinks.foxglove import FoxgloveSink
from edge.types import Observation

_MESSAGE = struct.Struct("<BIQ")  # opcode 1, subscription, time
CAMERA = CameraModel(40, 30, 30.0, 30.0, 20.0, 15.0)


class Client:
    """Client that subscribes to some advertised topics and keeps their messages."""

    def __init__(self, socket) -> None:
        self.advertised: dict[str, dict] = {}
        self.came: dict[str, list[tuple[int, bytes]]] = {}
        self._socket = socket
        self._topics: dict[int, str] = {}

    def read(self, timeout_s: float = 0.1) -> None:
        try:
            said = self._socket.recv(timeout=timeout_s)
        except TimeoutError:
            return
        if isinstance(said, bytes):
            opcode, subscription, time_ns = _MESSAGE.unpack_from(said)
            assert opcode == 1
            came = self.came.setdefault(self._topics[subscription], [])
            came.append((time_ns, said[_MESSAGE.size :]))
        elif (told := json.loads(said))["op"] == "advertise":
            self.advertised.update({channel["topic"]: channel for channel in told["channels"]})

    def subscribe(self, *topics: str) -> None:
        wanted = []
        for topic in topics:
            n = len(self._topics)
            self._topics[n] = topic
            wanted.append({"id": n, "channelId": self.advertised[topic]["id"]})
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@contextmanager
def client(sink: FoxgloveSink):
    url = f"ws://127.0.0.1:{sink.port}"
    with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        yield Client(socket)


@pytest.fixture
def sink():
    one = FoxgloveSink(simulated(), port=0)
    yield one
    one.close()


def tick(k: int):
    seen = Observation(
        k, k * 10**8, SE2(1.0, 2.0, 0.5).matrix(), rgb=np.zeros((30, 40, 3), np.uint8),
        depth_m=np.ones((30, 40), np.float32), camera=CAMERA,
    )  # fmt: skip
    return result(k * 10**8, observation=seen, pose=seen.pose)


def test_without_clients_nothing_is_encoded(sink):
    sink.tick(tick(1))
    eventually(lambda: sink._worker.idle)
    assert sink.status() == {"port": sink.port, "dropped": 0, "failed": 0, "problem": ""}
    moment = sink._encoder.capture(tick(2))
    assert (moment.bytes, list(sink._encoder.encode(moment))) == (0, [])


def test_a_client_gets_only_its_subscribed_topics(sink):
    with client(sink) as foxglove:
        eventually(lambda: foxglove.read() or len(foxglove.advertised) == len(channels.VISUAL))
        assert foxglove.advertised.keys() == {channel.topic for channel in channels.VISUAL}
        depth = foxglove.advertised["/camera/depth"]
        assert (depth["encoding"], depth["schemaName"]) == ("cdr", "sensor_msgs/msg/Image")
        assert depth["schema"] == channels.DEPTH.schema_text
        wanted = ("/camera/depth", "/map", "/mission", "/detections")
        foxglove.subscribe(*wanted)
        eventually(lambda: sink._is_subscribed(channels.DEPTH))
        k = 0

        def came() -> bool:
            nonlocal k
            k += 1
            sink.tick(tick(k))
            foxglove.read()
            return {"/camera/depth", "/map", "/mission"} <= foxglove.came.keys()

        eventually(came)
        assert "/camera/rgb/compressed" not in foxglove.came
        time_ns, payload = foxglove.came["/camera/depth"][0]
        assert time_ns % 10**8 == 0
        assert b"16UC1" in payload
        assert json.loads(foxglove.came["/mission"][0][1])["phase"] == "searching"


def test_arrays_that_wait_are_bounded_by_their_size(monkeypatch):
    monkeypatch.setattr(FoxgloveSink, "_is_subscribed", lambda self, channel: True)
    monkeypatch.setattr("edge.sinks.foxglove._MOST_PENDING_BYTES", 10_000)
    blocked, waiting = threading.Event(), []
    encode = ResultEncoder.encode

    def slow(self, snapshot):
        blocked.wait()
        waiting.append(snapshot.bytes)
        return encode(self, snapshot)

    monkeypatch.setattr(ResultEncoder, "encode", slow)
    sink = FoxgloveSink(simulated(), port=0)
    for k in range(50):
        sink.tick(tick(k))
    blocked.set()
    eventually(lambda: len(waiting) == 50)
    assert 10_000 <= sum(waiting) < 20_000
    eventually(lambda: sink._pending_bytes == 0)
    sink.close()


def test_a_port_that_is_taken(sink):
    config = simulated(
        {"sinks": [{"kind": "foxglove", "options": {"port": sink.port, "host": "127.0.0.1"}}]}
    )
    with pytest.raises(UnavailableError, match=rf"cannot listen on 127\.0\.0\.1 port {sink.port}"):
        [make(config=config, session=None) for make in find_sinks(config)]


def test_a_host_open_to_others_logs_a_warning(caplog):
    FoxgloveSink(simulated(), port=0).close()
    assert caplog.records == []
    FoxgloveSink(simulated(), port=0, host="0.0.0.0").close()
    assert "everyone who can connect to 0.0.0.0 port" in caplog.text


def test_without_the_sdk_the_error_names_the_package(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "foxglove", None)
    with pytest.raises(ConfigError, match=r"pip install 'edge-vln\[foxglove\]'"):
        FoxgloveSink(simulated(), port=0)

"""Sessions as the service and its peers open them."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from itertools import repeat
from types import SimpleNamespace
from typing import get_args

import pytest
import zenoh
from fake_zenoh import Flooded
from live_patience import PATIENCE_S, eventually

from edge.bus import session as bus
from edge.bus import topics, zenoh_file
from edge.config import ZenohConfig
from edge.config.loop import TopicName
from edge.host.ports import free_port


@pytest.fixture
def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def value(config: zenoh.Config, key: str):
    return json.loads(config.get_json(key))


@pytest.mark.parametrize(
    ("mode", "role", "zenoh_mode", "listens", "connects"),
    [
        ("peer", "listen", "peer", True, False),
        ("peer", "connect", "client", False, True),
        ("client", "listen", "client", False, True),
        ("client", "connect", "client", False, True),
    ],
)
def test_mode_and_role_set_the_endpoints_of_a_session(mode, role, zenoh_mode, listens, connects):
    endpoint = "tcp/127.0.0.1:17447"
    settings = ZenohConfig(endpoint=endpoint, mode=mode)
    config = bus.session_config(settings, role)
    assert value(config, "mode") == zenoh_mode
    assert value(config, "listen/endpoints") == [endpoint] * listens
    assert value(config, "connect/endpoints") == [endpoint] * connects
    assert value(config, "scouting/multicast/enabled") is False
    assert value(config, "transport/shared_memory/enabled") is False
    assert value(config, "connect/exit_on_failure") is False


@pytest.mark.parametrize("kind", [bus.Ring, bus.QueryRing])
@pytest.mark.parametrize(
    ("kept", "sent", "taken", "overruns"),
    [
        (4, 0, [0, 0, 0], 0),
        (4, 3, [3, 0, 0], 0),
        (4, 4, [4, 0, 0], 0),  # full for a late client
        (4, 6, [4, 2, 0], 0),
        (4, 11, [4, 4, 3], 1),
        (4, None, [4, 4, 4], 2),
        (1, None, [1, 1, 1], 0),
    ],
)
def test_one_read_takes_at_most_a_ring_and_reports_overruns(
    kind, kept, sent, taken, overruns, caplog
):
    payloads = repeat(b"") if sent is None else repeat(b"", sent)
    ring = kind(Flooded("edge/odom", payloads), "edge/odom", kept)
    assert [len(ring.take()) for _ in taken] == taken
    assert ring.overruns == overruns
    assert len([r for r in caplog.records if "edge/odom" in r.getMessage()]) == min(overruns, 1)


def test_a_client_waits_until_a_listener_appears(free_endpoint):
    settings, opened, told = ZenohConfig(endpoint=free_endpoint), [], []
    thread = threading.Thread(
        target=lambda: opened.append(bus.open_session(settings, "connect", report=told.append)),
        daemon=True,
    )
    thread.start()
    eventually(lambda: len(told) > 1)
    assert thread.is_alive()
    with bus.open_session(settings, "listen"):
        thread.join(PATIENCE_S)
        assert opened
        opened[0].close()


@pytest.mark.parametrize("role", ["listen", "connect"])
@pytest.mark.parametrize(
    "endpoint",
    [
        "nonsense", "", "tcp/", "/127.0.0.1:7447", "tcp/127.0.0.1:port", "tcp/127.0.0.1",
        "tcp/127.0.0.1:70000", "tcp/robot:7447:1", "tcp/a b:7447", "tcp//robot:7447", "tcp/:7447",
        "tcp/[::1:7447", "tcp:127.0.0.1:7447", "carrier-pigeon/home:1", "http://127.0.0.1:7447",
    ],
)  # fmt: skip
def test_an_invalid_endpoint_is_named_in_one_line(endpoint, role):
    """Without this check, a connecting Zenoh client would wait without an error."""
    with pytest.raises(bus.BusError) as caught:
        bus.open_session(ZenohConfig(endpoint=endpoint, mode="client"), role)
    assert str(caught.value).startswith(f"zenoh.endpoint: cannot {role}")
    assert endpoint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unresolvable_host_is_given_up(monkeypatch):
    settings, told = ZenohConfig(endpoint="tcp/no.such.host.invalid:7447", mode="client"), []
    why = "zenoh.endpoint: tcp/no.such.host.invalid:7447: no address is known for "
    stop = threading.Event()
    stop.set()
    with pytest.raises(bus.ConnectInterrupted) as stopped:
        bus.open_session(settings, "connect", stop, report=told.append)
    assert "no address is known" in stopped.value.unknown
    assert told[0].startswith(why)
    assert told[0].endswith("; trying again for up to 30 s")
    monkeypatch.setattr(bus, "HOST_S", 0.0)
    with pytest.raises(bus.BusError) as given_up:
        bus.open_session(settings, "connect")
    assert str(given_up.value).startswith(why)


@pytest.mark.parametrize("topic", topics.ALL, ids=lambda t: t.key)
def test_every_topic_can_be_published_with_its_qos(topic):
    class Session:
        def declare_publisher(self, key, **qos):
            return key, qos

    own = {"odom": "base/odom", "mission": "goal", "goal": "mission"}
    key, qos = bus.declare_publisher(Session(), topic, ZenohConfig(prefix="fleet/r1", topics=own))
    assert key == f"fleet/r1/{own.get(topic.key, topic.key)}"
    blocks = qos["congestion_control"] == zenoh.CongestionControl.BLOCK
    assert blocks == (topic.qos == "block")
    assert (qos["reliability"] == zenoh.Reliability.RELIABLE) == (topic.qos != "drop")
    assert (qos["priority"] == zenoh.Priority.DATA) == (topic.qos == "drop")


def test_every_topic_can_be_renamed():
    keys = {topic.key for topic in topics.ALL} | set(topics.REQUESTS)
    assert set(get_args(TopicName)) == keys


def test_only_the_tick_of_lockstep_may_wait_for_a_slow_peer():
    assert [topic.key for topic in topics.ALL if topic.qos == "block"] == ["tick"]


@pytest.mark.parametrize(("exact", "wait_s"), [(False, zenoh_file.BLOCKED_S), (True, 5.0)])
def test_a_blocked_peer_is_disconnected_after_a_limit(exact, wait_s):
    config = bus.session_config(ZenohConfig(), "listen", exact)
    key = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    assert value(config, key) == wait_s * 1e6


def test_closing_gives_up_on_a_blocked_peer(monkeypatch, caplog):
    go = threading.Event()
    stuck = SimpleNamespace(close=lambda: go.wait(PATIENCE_S))
    monkeypatch.setattr(bus, "open_session", lambda *_: stuck)
    monkeypatch.setattr(bus, "CLOSE_S", 0.01)
    with bus.zenoh_session(ZenohConfig(endpoint="tcp/here:1"), "listen") as session:
        assert session is stuck
    assert "a peer at tcp/here:1 accepts no data: the session is given up" in caplog.text
    go.set()


LEFT_OPEN = """
import builtins, sys
from edge.bus.session import zenoh_session
from edge.config import ZenohConfig
builtins.opened = zenoh_session(ZenohConfig(endpoint=sys.argv[1], shared_memory=False), "listen")
builtins.opened.__enter__()
"""


def test_the_interpreter_exits_with_an_open_session(free_endpoint):
    subprocess.run([sys.executable, "-c", LEFT_OPEN, free_endpoint], check=True, timeout=PATIENCE_S)


def test_an_oversized_message_is_dropped_but_its_sender_stays_connected(free_endpoint):
    settings = ZenohConfig(endpoint=free_endpoint, shared_memory=False)
    with (
        # `keep_zenoh_timeout`: a slow peer is not disconnected.
        bus.open_session(
            settings, "listen", keep_zenoh_timeout=True, most_bytes=1_000_000
        ) as service,
        bus.open_session(settings, "connect", keep_zenoh_timeout=True) as client,
    ):
        heard = service.declare_subscriber("a/key", zenoh.handlers.RingChannel(8))
        publisher = client.declare_publisher(
            "a/key", congestion_control=zenoh.CongestionControl.BLOCK
        )
        eventually(lambda: publisher.matching_status.matching)
        for size in (900_000, 2_000_000, 7):
            publisher.put(bytes(size))
        sizes = []

        def is_through() -> bool:
            while (sample := heard.try_recv()) is not None:
                sizes.append(len(sample.payload))
            return 7 in sizes

        eventually(is_through)
        assert sizes == [900_000, 7]

"""A peer that is stopped (SIGSTOP) and takes nothing any more costs only itself."""

from __future__ import annotations

import json
import signal
import subprocess
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
import zenoh
from edge_processes import write_config
from live_patience import PATIENCE_S, eventually
from viewer_peer import ALIVE

from edge.bus import topics
from edge.bus.client import send_request
from edge.bus.requests import RequestServer
from edge.bus.session import declare_publisher, open_session
from edge.config import ZenohConfig
from edge.loop.requests.handlers import mission_verbs

pytestmark = pytest.mark.slow

PEER = Path(__file__).with_name("viewer_peer.py")
PREFIX, KEY = "edge", "edge/mission/request"
BEAT_S = 0.1
FLOWS = ("status", "map", "cmd_vel", "odom", "mission")


@pytest.fixture
def start_viewer(endpoint, script) -> Callable[[], subprocess.Popen]:
    def start() -> subprocess.Popen:
        viewer = script(PEER, endpoint)
        assert viewer.stdout.readline() == "ready\n"
        return viewer

    return start


def let_go(session: zenoh.Session) -> threading.Event:
    """Set once the service has let a viewer go."""
    gone = threading.Event()

    def changed(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            gone.set()

    session.liveliness().declare_subscriber(ALIVE, changed)
    return gone


class Ears:
    """Hears topics, and counts their longest silences in beats of a pulse of its own.

    Args:
        speakers: processes; a beat at which one of them has work counts for nothing, as it may be
            waiting for a core. One that Zenoh holds up has none.
    """

    def __init__(
        self, session: zenoh.Session, keys: Iterable[str], speakers: Iterable[psutil.Process]
    ) -> None:
        self._speakers = tuple(speakers)
        self.silences = dict.fromkeys(keys, 0)
        self._since = dict.fromkeys(keys, 0)
        self._subscribers = [
            session.declare_subscriber(f"{PREFIX}/{key}", lambda _, key=key: self._hear(key))
            for key in keys
        ]

    def _hear(self, key: str) -> None:
        self._since[key] = 0

    def beat(self) -> None:
        if any(speaker.status() == psutil.STATUS_RUNNING for speaker in self._speakers):
            return
        for key, beats in self._since.items():
            self._since[key] = beats + 1
            self.silences[key] = max(self.silences[key], beats + 1)


def test_a_stopped_viewer_delays_nothing_else(edge, endpoint, tmp_path, start_viewer):
    """Before it is let go, for its silence, all else flows on and requests are answered."""
    config = write_config(
        tmp_path,
        zenoh={"endpoint": endpoint},
        mission={"target": "unicorn"},
        report={"map_hz": 10, "status_hz": 10},
    )
    service = edge("run", config).says("ready:")
    sim = edge("sim", config)
    service.says("frontier")
    with (
        open_session(ZenohConfig(endpoint=endpoint), "connect") as session,
        open_session(ZenohConfig(endpoint=endpoint), "connect") as asking,
        ThreadPoolExecutor(1) as pool,
    ):
        speakers = [psutil.Process(it.process.pid) for it in (service, sim)]
        ears = Ears(session, (*FLOWS, "answer"), speakers)
        viewer, gone = start_viewer(), let_go(session)
        viewer.send_signal(signal.SIGSTOP)
        paused: list[bool] = []

        def request() -> None:
            while not gone.is_set():
                do = ("pause", "resume")[len(paused) % 2]
                paused.append(
                    send_request(asking, KEY, {"do": do}, PATIENCE_S, "mission")["paused"]
                )
                session.put(f"{PREFIX}/answer", b"")

        ordering = pool.submit(request)
        while not gone.wait(BEAT_S):
            ears.beat()
            assert not ordering.done(), ordering.exception()
        ordering.result(PATIENCE_S)
        assert paused == [n % 2 == 0 for n in range(len(paused))]
        # It is 2 without a stopped viewer, and 50 to 100 if the service waits for one.
        assert max(ears.silences.values()) < 40, ears.silences
    second = start_viewer()
    second.send_signal(signal.SIGSTOP)
    with open_session(ZenohConfig(endpoint=endpoint), "connect") as session:
        maps = session.declare_subscriber(f"{PREFIX}/map", zenoh.handlers.FifoChannel(1000))
        for _ in range(20):  # by then nothing more fits between the service and the viewer
            eventually(maps.try_recv)
    assert service.stop(signal.SIGTERM) == 0, service.output
    assert "accepts no data: the session is given up" in service.output
    assert "Traceback" not in service.output


def test_a_stopped_client_holds_up_no_other_answer(endpoint, start_viewer, monkeypatch):
    answered, send = [], RequestServer._send

    def noted(server: RequestServer, query: zenoh.Query, reply: bytes, is_error: bool) -> None:
        send(server, query, reply, is_error)
        answered.append(reply)

    monkeypatch.setattr(RequestServer, "_send", noted)
    # `exact`, so that the one that is stopped is waited for as long as can be.
    with (
        open_session(ZenohConfig(endpoint=endpoint), "listen", keep_zenoh_timeout=True) as session,
        open_session(ZenohConfig(endpoint=endpoint), "connect") as asking,
        ThreadPoolExecutor(1) as pool,
    ):
        server = RequestServer(session, KEY, mission_verbs(dict), lambda *_: {})
        viewer = start_viewer()
        viewer.stdin.write("\n")
        viewer.stdin.flush()
        unanswered = eventually(server.poll)
        viewer.send_signal(signal.SIGSTOP)
        maps = declare_publisher(session, topics.MAP, ZenohConfig())
        for _ in range(200):  # 200 MB: more than fits in between
            maps.put(bytes(1_000_000))
        answered.clear()
        # Larger than the queue of its priority, which may be empty although the maps wait.
        unanswered.answer({"n": "stopped", "filler": "." * 20_000_000})
        for n in range(10):
            answer = pool.submit(send_request, asking, KEY, {"do": "pause"}, PATIENCE_S, "mission")
            eventually(server.poll).answer({"n": n})
            assert answer.result(PATIENCE_S) == {"n": n}
        eventually(lambda: len(answered) == 11)
        order = [json.loads(answer)["n"] for answer in answered]
        assert set(order) == {*range(10), "stopped"}
        assert order[0] != "stopped"
        server.close()
        viewer.kill()  # or closing the session would wait for it

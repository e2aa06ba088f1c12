"""A client that is stopped (SIGSTOP) and takes nothing any more costs only itself."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import zenoh
from live_patience import PATIENCE_S, eventually

from edge.bus import topics
from edge.bus.client import send_request
from edge.bus.requests import RequestServer
from edge.bus.session import declare_publisher, open_session
from edge.config import ZenohConfig
from edge.loop.requests.handlers import mission_verbs

pytestmark = pytest.mark.slow

PEER = Path(__file__).with_name("viewer_peer.py")
KEY = "edge/mission/request"


@pytest.fixture
def start_viewer(endpoint, script) -> Callable[[], subprocess.Popen]:
    def start() -> subprocess.Popen:
        viewer = script(PEER, endpoint)
        assert viewer.stdout.readline() == "ready\n"
        return viewer

    return start


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

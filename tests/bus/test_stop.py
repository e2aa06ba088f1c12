"""Requests to stop pass all queues, and any of them stops."""

from __future__ import annotations

import errno
import json
import os
import threading
from collections.abc import Iterator

import pytest
from patience import PATIENCE_S, eventually

from edge.bus import topics
from edge.bus.client import RefusedError, send_request
from edge.bus.requests import RequestServer
from edge.bus.session import open_session
from edge.bus.stop import StopServer, stop_requests
from edge.bus.verbs import Request, Verb
from edge.config import ZenohConfig
from edge.host import stop_latch
from edge.host.ports import free_port
from edge.host.stop_latch import StopLatch


@pytest.fixture
def settings() -> ZenohConfig:
    return ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}")


@pytest.fixture
def latch(settings, tmp_path, monkeypatch) -> Iterator[StopLatch]:
    monkeypatch.setattr(stop_latch, "WITHDRAWN_S", 0.0)
    latch = StopLatch(tmp_path / "stop.json")
    with open_session(settings, "listen") as session:
        server = StopServer(session, settings, stop_requests(latch))
        # All other requests: a full queue, which no loop serves.
        hold = threading.Event()
        slow = Verb(("n",), prepare=lambda fields: hold.wait(PATIENCE_S))
        verbs = {"new": slow, "status": Verb(("n",))}
        others = RequestServer(
            session, settings.key(topics.MISSION_REQUEST), verbs, lambda request, now_ns: {}
        )
        latch.others = others
        yield latch
        hold.set()
        others.close()
        server.close()


@pytest.mark.parametrize("payload", [None, b"", b"[", b"[1]", b'{"why": 7}', b"\xff" * 70_000])
def test_any_request_to_stop_stops(latch, settings, payload):
    with open_session(settings, "connect") as session:
        (reply,) = session.get(settings.key(topics.STOP_REQUEST), payload=payload)
        assert json.loads(reply.ok.payload.to_bytes())["stopped"]
    assert latch.reason == "by request"


def test_a_stop_works_while_the_request_queue_is_full(latch, settings, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError(errno.EIO, "broken disk")

    mission = settings.key(topics.MISSION_REQUEST)
    with open_session(settings, "connect") as session:
        answers = [
            session.get(mission, payload=json.dumps({"do": do, "n": n}), timeout=PATIENCE_S)
            for n in range(200)
            for do in ("new", "status")
        ]
        key = settings.key(topics.STOP_REQUEST)
        assert send_request(session, key, {"why": "button"}, PATIENCE_S, "stop")["kept"]
        assert isinstance(eventually(latch.others.poll), Request)  # the others still wait
        key = settings.key(topics.RELEASE_REQUEST)
        assert not send_request(session, key, {}, PATIENCE_S, "release")["stopped"]
        latch.stop("again")
        monkeypatch.setattr(os, "pwrite", fail)
        with pytest.raises(RefusedError, match="still stopped"):
            send_request(session, key, {}, PATIENCE_S, "release")
        del answers

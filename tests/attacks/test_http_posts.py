"""Fuzzing of the HTTP request port: valid requests are accepted, all others refused.

The next request is answered in each case.
"""

from __future__ import annotations

import json
import random
import socket
from collections.abc import Iterator
from contextlib import suppress

import pytest
from decoders import mutate
from hypothesis import given
from hypothesis import strategies as st
from live_patience import PATIENCE_S
from simulated import simulated

from edge.bus.request_queue import RequestQueue
from edge.bus.verbs import Verb
from edge.host.credentials import BearerToken
from edge.host.service_manager import SystemdNotifier
from edge.host.web_server import serve
from edge.live.view import LiveView
from edge.loop.monitoring.service_health import ServiceHealth

HERE, TOKEN = "127.0.0.1", "a-token-of-the-tests"
GOOD = b'{"do": "pause"}'
SEEDS = (
    GOOD,
    b'{"do": "new", "instruction": "find the sofa"}',
    b'{"do": "new", "formula": "F sofa"}',
    json.dumps({"do": "new", "instruction": "<b>\u202e"}).encode(),
)


class Port:
    """HTTP port whose requests a test takes.

    Attributes:
        done: requests that reached the loop.
    """

    def __init__(self, port: int) -> None:
        self.port, self.done = port, list[str]()

    def head(self, length: int, token: str = TOKEN) -> bytes:
        return (
            f"POST /mission/request HTTP/1.1\r\nHost: {HERE}\r\nConnection: close\r\n"
            f"Authorization: Bearer {token}\r\nContent-Type: application/json\r\n"
            f"Content-Length: {length}\r\n\r\n"
        ).encode()

    def say(self, request: bytes) -> bytes:
        """All answers; a client that sends no more gets one at once."""
        with socket.create_connection((HERE, self.port), PATIENCE_S) as sock:
            answer = b""
            with suppress(ConnectionResetError, BrokenPipeError):
                sock.sendall(request)
                sock.shutdown(socket.SHUT_WR)
                while part := sock.recv(1 << 16):
                    answer += part
        return answer

    def is_running(self) -> None:
        answer = self.say(self.head(len(GOOD)) + GOOD)
        assert answer.startswith(b"HTTP/1.1 200 "), answer
        assert self.done.pop() == "pause"


@pytest.fixture(scope="module")
def port() -> Iterator[Port]:
    view = LiveView(simulated({"mission": {"target": "bed"}}), ServiceHealth(SystemdNotifier({})))
    with serve(
        view.pages(), HERE, 0, BearerToken(TOKEN.encode()), forms=view.forms(), public=("/",)
    ) as number:
        there = Port(number)

        def handle(request, now_ns):
            there.done.append(request.do)
            return {}

        verbs = {"new": Verb(("instruction", "formula")), "pause": Verb(stops_robot=True)}
        queue = RequestQueue("x", verbs, handle)
        view.open({"mission/request": _Served(queue)})
        yield there
        queue.close()


class _Served:
    """Request queue that is served right after each query."""

    def __init__(self, queue: RequestQueue) -> None:
        self._queue = queue

    def accept(self, payload, reply) -> None:
        self._queue.accept(payload, reply)
        self._queue.serve(0)


def test_an_empty_connection_does_no_harm(port):
    assert port.say(b"") == b""
    port.is_running()


@given(st.binary(max_size=300))
def test_any_bytes_do_nothing(port, request):
    port.say(request)
    port.say(b"POST /mission/request HTTP/1.1\r\n" + request)
    assert port.done == []
    port.is_running()


@given(st.sampled_from(SEEDS), st.randoms(use_true_random=False))
def test_changed_bodies_are_answered_in_json(port, seed, chance):
    body = mutate(seed, chance)
    answer = port.say(port.head(len(body)) + body)
    head, _, said = answer.partition(b"\r\n\r\n")
    status = int(head.split()[1])
    assert status in ((200, 409) if body else (409,))
    assert ("error" in json.loads(said)) == (status == 409)
    port.done.clear()
    port.is_running()


@given(st.sampled_from(SEEDS), st.randoms(use_true_random=False))
def test_changed_requests_do_nothing_without_the_token(port, seed, chance):
    head = mutate(port.head(len(seed), "not-the-token-at-all"), random.Random(chance.random()))
    port.say(head + seed)
    assert port.done == []
    port.is_running()

"""The small HTTP server, over real connections."""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from http import HTTPStatus
from http.client import HTTPConnection

import pytest
from patience import PATIENCE_S

from edge.errors import UnavailableError
from edge.host.credentials import Token
from edge.host.pages import MOST_OPEN, Page, json_page, serve

HERE = "127.0.0.1"


def ask(port: int, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    connection = HTTPConnection(HERE, port, timeout=PATIENCE_S)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


def test_without_a_port_there_is_none():
    with serve({}, HERE, None) as port:
        assert port is None


def test_pages_are_made_when_they_are_asked_for():
    counted = iter(range(9))
    pages = {
        "/count": lambda: json_page({"n": next(counted)}),
        "/down": lambda: Page(b"no", "text/plain", HTTPStatus.SERVICE_UNAVAILABLE),
        "/broken": lambda: 1 // 0,
    }
    with serve(pages, HERE, 0) as port:
        assert [json.loads(ask(port, "/count?x=1")[1])["n"] for _ in range(2)] == [0, 1]
        assert ask(port, "/down") == (503, b"no")
        assert ask(port, "/down", "HEAD") == (503, b"")
        assert ask(port, "/down", "POST")[0] == 405
        status, text = ask(port, "/else")
        assert (status, b"/count" in text) == (404, True)
        with pytest.raises(OSError, match=r"closed|reset"):  # RemoteDisconnected is one
            ask(port, "/broken")
        assert ask(port, "/down")[0] == 503
    with pytest.raises(ConnectionRefusedError):
        ask(port, "/down")


@pytest.mark.parametrize(
    ("path", "stranger", "known"),
    [
        ("/probe", (503, b""), (503, b"why")),
        ("/page", (401, b"who asks must know the token\n"), (200, b"secret")),
        ("/else", (401, b"who asks must know the token\n"), (404, None)),
    ],
)
def test_without_the_token_probes_tell_their_status_and_nothing_else_is_told(path, stranger, known):
    pages = {
        "/probe": lambda: Page(b"why", "text/plain", HTTPStatus.SERVICE_UNAVAILABLE),
        "/page": lambda: Page(b"secret", "text/plain"),
    }
    with serve(pages, HERE, 0, Token(b"right"), ("/probe",)) as port:
        assert ask(port, path) == ask(port, path, Authorization="Bearer wrong") == stranger
        status, body = ask(port, path, Authorization="Bearer right")
        assert (status, body if known[1] else None) == known


def test_whoever_is_refused_is_told_how_to_ask():
    with serve({}, HERE, 0, Token(b"right")) as port:
        connection = HTTPConnection(HERE, port, timeout=PATIENCE_S)
        connection.request("GET", "/")
        assert connection.getresponse().getheader("WWW-Authenticate") == 'Bearer realm="edge"'
        connection.close()


def test_those_who_keep_connections_open_lock_nobody_out():
    with serve({"/": lambda: Page(b"here", "text/plain")}, HERE, 0) as port:
        idle = [socket.create_connection((HERE, port)) for _ in range(3 * MOST_OPEN)]
        for sock in idle[::2]:
            sock.sendall(b"GET / HTTP/1.1\r\nX: ")
        assert ask(port, "/") == (200, b"here")
        for sock in idle:
            sock.close()


@pytest.mark.parametrize(
    "nonsense", [b"\x00\xff\r\n\r\n", b"GET\r\n\r\n", b"A" * 70000 + b"\r\n\r\n"]
)
def test_nonsense_is_refused(nonsense):
    with serve({"/": lambda: Page(b"here", "text/plain")}, HERE, 0) as port:
        with socket.create_connection((HERE, port), PATIENCE_S) as sock:
            sock.sendall(nonsense)
            with suppress(ConnectionResetError):  # what it has not read, it does not wait for
                assert b"here" not in sock.recv(1 << 16)
        assert ask(port, "/") == (200, b"here")


@pytest.mark.parametrize("host", ["no.such.host.invalid", "x" * 64])
def test_a_host_that_is_none_is_one_line(host):
    with (
        pytest.raises(UnavailableError, match=rf"^http.port: cannot listen on {host} port "),
        serve({}, host, 0),
    ):
        pass


def test_a_port_that_is_taken_is_one_line_with_what_to_do():
    with (
        serve({}, HERE, 0) as port,
        pytest.raises(UnavailableError, match=rf"^http.port: .*{port}.*in use; set http.port"),
        serve({}, HERE, port),
    ):
        pass

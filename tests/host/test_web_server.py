"""The small HTTP server, over real connections."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from http import HTTPStatus
from http.client import HTTPConnection

import pytest
from patience import PATIENCE_S

from edge.errors import UnavailableError
from edge.host import web_server
from edge.host.credentials import BearerToken
from edge.host.web_server import MOST_BYTES, MOST_OPEN, HttpResponse, json_response, serve

HERE = "127.0.0.1"
LONGEST_LINE = 65536


def ask(port: int, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    connection = HTTPConnection(HERE, port, timeout=PATIENCE_S)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


def test_without_a_port_no_server_starts():
    with serve({}, HERE, None) as port:
        assert port is None


def test_pages_are_made_on_request():
    counted = iter(range(9))
    pages = {
        "/count": lambda: json_response({"n": next(counted)}),
        "/down": lambda: HttpResponse(b"no", "text/plain", HTTPStatus.SERVICE_UNAVAILABLE),
    }
    with serve(pages, HERE, 0) as port:
        assert [json.loads(ask(port, "/count?x=1")[1])["n"] for _ in range(2)] == [0, 1]
        assert ask(port, "/down") == (503, b"no")
        assert ask(port, "/down", "HEAD") == (503, b"")
        assert ask(port, "/down", "POST")[0] == 405
        status, text = ask(port, "/else")
        assert (status, b"/count" in text) == (404, True)
    with pytest.raises(ConnectionRefusedError):
        ask(port, "/down")


def test_a_failing_page_returns_500_and_logs_once(caplog):
    def broken(*args: bytes) -> HttpResponse:
        raise ValueError("two\nlines")

    told = b"failed: ValueError: two lines; see the service's log\n"
    with serve(
        {"/page": broken}, HERE, 0, BearerToken(b"right"), ("/page",), {"/form": broken}
    ) as port:
        for _ in range(3):
            assert ask(port, "/page") == (500, b"")
            assert ask(port, "/page", Authorization="Bearer right") == (500, b"/page " + told)
            assert post(port) == (500, b"/form " + told)
    warned = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert warned == [f"{path} failed: ValueError: two lines" for path in ("/page", "/form")]


@pytest.mark.parametrize(
    ("path", "stranger", "known"),
    [
        ("/probe", (503, b""), (503, b"why")),
        ("/page", (401, b"a token is required: Authorization: Bearer TOKEN\n"), (200, b"secret")),
        ("/else", (401, b"a token is required: Authorization: Bearer TOKEN\n"), (404, None)),
    ],
)
def test_without_the_token_only_the_status_of_probes_is_returned(path, stranger, known):
    pages = {
        "/probe": lambda: HttpResponse(b"why", "text/plain", HTTPStatus.SERVICE_UNAVAILABLE),
        "/page": lambda: HttpResponse(b"secret", "text/plain"),
    }
    with serve(pages, HERE, 0, BearerToken(b"right"), ("/probe",)) as port:
        assert ask(port, path) == ask(port, path, Authorization="Bearer wrong") == stranger
        status, body = ask(port, path, Authorization="Bearer right")
        assert (status, body if known[1] else None) == known


def test_idle_connections_do_not_lock_out_others():
    with serve({"/": lambda: HttpResponse(b"here", "text/plain")}, HERE, 0) as port:
        idle = [socket.create_connection((HERE, port)) for _ in range(3 * MOST_OPEN)]
        for sock in idle[::2]:
            sock.sendall(b"GET / HTTP/1.1\r\nX: ")
        assert ask(port, "/") == (200, b"here")
        for sock in idle:
            sock.close()


@pytest.mark.parametrize("silent", [2 * MOST_OPEN, 0])
def test_a_running_post_is_not_cut_off_by_others(silent):
    """Connections without the token are closed first, then idle ones with it."""
    begun, go_on = threading.Event(), threading.Event()

    def take(body: bytes) -> HttpResponse:
        begun.set()
        assert go_on.wait(PATIENCE_S)
        return HttpResponse(b"taken", "text/plain")

    known = b"GET / HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer right\r\n\r\n"
    pages = {"/": lambda: HttpResponse(b"here", "text/plain")}
    with (
        serve(pages, HERE, 0, BearerToken(b"right"), forms={"/form": take}) as port,
        ThreadPoolExecutor() as pool,
        ExitStack() as opened,
    ):
        posted = pool.submit(post, port)
        assert begun.wait(PATIENCE_S)
        for _ in range(silent):
            opened.enter_context(socket.create_connection((HERE, port)))
        for _ in range(2 * MOST_OPEN):  # each connection with the token is accepted
            sock = opened.enter_context(socket.create_connection((HERE, port), PATIENCE_S))
            sock.sendall(known)
            assert sock.recv(1 << 16).endswith(b"here")
        go_on.set()
        assert posted.result(PATIENCE_S) == (200, b"taken")


def test_a_new_connection_is_closed_if_all_are_busy():
    begun, go_on = threading.Semaphore(0), threading.Event()

    def take(body: bytes) -> HttpResponse:
        begun.release()
        assert go_on.wait(PATIENCE_S)
        return HttpResponse(b"taken", "text/plain")

    with (
        serve({}, HERE, 0, BearerToken(b"right"), forms={"/form": take}) as port,
        ThreadPoolExecutor(MOST_OPEN) as pool,
    ):
        posted = [pool.submit(post, port) for _ in range(MOST_OPEN)]
        for _ in posted:
            assert begun.acquire(timeout=PATIENCE_S)
        with socket.create_connection((HERE, port), PATIENCE_S) as sock:
            assert sock.recv(1) == b""
        go_on.set()
        assert [p.result(PATIENCE_S) for p in posted] == [(200, b"taken")] * MOST_OPEN


@pytest.mark.parametrize(
    "nonsense", [b"\x00\xff\r\n\r\n", b"GET\r\n\r\n", b"A" * 70000 + b"\r\n\r\n"]
)
def test_nonsense_is_refused(nonsense):
    with serve({"/": lambda: HttpResponse(b"here", "text/plain")}, HERE, 0) as port:
        with socket.create_connection((HERE, port), PATIENCE_S) as sock:
            sock.sendall(nonsense)
            with suppress(ConnectionResetError):  # the server does not wait for unread bytes
                assert b"here" not in sock.recv(1 << 16)
        assert ask(port, "/") == (200, b"here")


@pytest.mark.parametrize("host", ["no.such.host.invalid", "x" * 64])
def test_an_unknown_host_is_an_error_of_one_line(host):
    with (
        pytest.raises(UnavailableError, match=rf"^http.port: cannot listen on {host} port "),
        serve({}, host, 0),
    ):
        pass


def test_a_port_in_use_is_reported_with_the_remedy():
    with (
        serve({}, HERE, 0) as port,
        pytest.raises(UnavailableError, match=rf"^http.port: .*{port}.*in use; set http.port"),
        serve({}, HERE, port),
    ):
        pass


def say(port: int, request: bytes) -> bytes:
    """Return the answer to these bytes, up to the end of the connection."""
    with socket.create_connection((HERE, port), PATIENCE_S) as sock:
        sock.sendall(request)
        answer = b""
        with suppress(ConnectionResetError):
            while part := sock.recv(1 << 16):
                answer += part
        return answer


def post(port: int, body: bytes = b"{}", path: str = "/form", **headers: str) -> tuple[int, bytes]:
    given = {"Authorization": "Bearer right", "Content-Type": "application/json", **headers}
    connection = HTTPConnection(HERE, port, timeout=PATIENCE_S)
    connection.request("POST", path, body, {k.replace("_", "-"): v for k, v in given.items()})
    answer = connection.getresponse()
    said = answer.status, answer.read()
    connection.close()
    return said


@pytest.fixture
def taken() -> Iterator[tuple[int, list[bytes]]]:
    """Serve a port that accepts bodies from clients with the token; record them."""
    bodies: list[bytes] = []

    def take(body: bytes) -> HttpResponse:
        bodies.append(body)
        return HttpResponse(b"taken", "text/plain")

    pages = {"/": lambda: HttpResponse(b"here", "text/plain"), "/data": lambda: json_response(1)}
    token = BearerToken(b"right")
    with serve(pages, HERE, 0, token, forms={"/form": take}, public=("/",)) as port:
        yield port, bodies


def test_the_page_is_public_but_its_data_need_the_token(taken):
    port, _ = taken
    assert ask(port, "/") == (200, b"here")
    assert ask(port, "/data")[0] == 401


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b"", {}, 200),
        (b"{}", {"Content_Type": "Application/JSON; charset=utf-8"}, 200),
        (b"x" * MOST_BYTES, {}, 200),
        (b"x" * (MOST_BYTES + 1), {}, 413),
        (b"{}", {"Content_Length": "9" * 30}, 413),
        (b"{}", {"Content_Length": "-1"}, 411),
        (b"{}", {"Content_Length": "2_"}, 411),
        (b"{}", {"Transfer_Encoding": "chunked"}, 411),
        (b"{}", {"Content_Type": "text/plain"}, 415),
        (b"{}", {"Authorization": "Bearer wrong"}, 401),
        (b"{}", {"Authorization": ""}, 401),
        (b"{}", {"Origin": "http://evil.example"}, 403),
        (b"{}", {"Origin": "null"}, 403),
        (b"{}", {"Origin": "http://[evil"}, 403),
    ],
)
def test_a_post_is_accepted_whole_or_refused(taken, body, headers, status):
    port, bodies = taken
    assert post(port, body, **headers)[0] == status
    assert bodies == ([body] if status == 200 else [])


def test_a_page_of_ours_may_post(taken):
    port, bodies = taken
    assert post(port, Origin=f"http://{HERE}:{port}") == (200, b"taken")
    assert post(port, path="/data")[0] == 405
    assert bodies == [b"{}"]


def test_an_incomplete_body_times_out(taken, monkeypatch):
    monkeypatch.setattr("edge.host.web_server._PATIENCE_S", 0.2)
    port, bodies = taken
    head = b"POST /form HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer right\r\n"
    head += b"Content-Type: application/json\r\nContent-Length: 9\r\n\r\n"
    assert say(port, head + b"12345").startswith(b"HTTP/1.1 408 ")
    assert bodies == []


def test_a_refused_body_is_not_read_as_a_request(taken):
    """This holds for the body of a GET, and of a request without the token."""
    port, bodies = taken
    inner = b"POST /form HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer right\r\n"
    inner += b"Content-Type: application/json\r\nContent-Length: 0\r\n\r\n"
    for method in (b"GET /", b"POST /form"):
        length = b"Content-Length: %d\r\n\r\n" % len(inner)
        answer = say(port, method + b" HTTP/1.1\r\nHost: x\r\n" + length + inner)
        assert answer.count(b"HTTP/1.1") == 1
    assert bodies == []


def test_without_a_token_nothing_can_be_posted():
    with serve({}, HERE, 0, forms={"/form": lambda body: 1 // 0}) as port:
        assert post(port) == (403, b"read-only: set http.token_file to allow changes\n")


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:{port}", 200),
        ("localhost", 200),
        ("LOCALHOST:1234", 200),
        ("[::1]:{port}", 200),
        ("evil.example:{port}", 421),
        ("127.0.0.1.evil.example", 421),
        ("192.168.0.7", 421),
        ("[::1", 421),
        ("", 421),
    ],
)
def test_without_a_token_the_request_must_name_this_machine(host, status):
    """A page of another site may have its name lead here (DNS rebinding)."""
    with serve({"/": lambda: HttpResponse(b"here", "text/plain")}, HERE, 0, public=("/",)) as port:
        assert ask(port, "/", Host=host.format(port=port))[0] == status


def test_an_unchanged_page_returns_304():
    page = HttpResponse(b"here", "text/plain", etag="7")
    with serve({"/": lambda: page}, HERE, 0) as port:
        assert ask(port, "/", **{"If-None-Match": '"6"'}) == (200, b"here")
        assert ask(port, "/", **{"If-None-Match": '"7"'}) == (304, b"")


@pytest.mark.parametrize(
    ("request_head", "status"),
    [
        (b"GET /else HTTP/1.0", 404),
        (b"GET /else HTTP/1.1\r\nContent-Length: 1", 413),
        (b"POST /else HTTP/1.1", 405),
        (b"<b> /else HTTP/1.1", 501),
        (b"GET /else HTTP/1.1" + b"\r\nX: y" * 101, 431),
        (b"GET /else HTTP/1.1\r\n" + b"X: y".ljust(LONGEST_LINE + 1, b"y"), 431),
        (b"GET /".ljust(LONGEST_LINE + 1, b"y"), 414),
        (b"GET /else HTTP/2.0", 505),
        (b"GET /else HTTP/x", 400),
        (b"a b c d", 400),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_error_responses_have_the_security_headers(request_head, status):
    with serve({}, HERE, 0) as port:
        # A line that is too long is cut there: unread bytes would lose the answer.
        end = b"" if len(request_head) > LONGEST_LINE else b"\r\n\r\n"
        answer = say(port, request_head + end)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 %d " % status)
    for name, value in web_server._HEADERS.items():
        assert f"\r\n{name}: {value}".encode() in head
    assert b"\r\nContent-Type: text/plain; charset=utf-8" in head
    assert b"\r\nContent-Length: %d" % len(body) in head
    assert (body.count(b"\n"), body[-1:]) == (1, b"\n")

"""The chat client against servers that are down, slow, broken, talkative or of another kind."""

from __future__ import annotations

import logging
import socket
import threading
import tracemalloc

import pytest
from chat_server import completion, likeliest, saying, send, serving
from patience import PATIENCE_S, eventually

from edge import chat
from edge.chat import ChatClient, ChatError, make_chat_client
from edge.config import TranslatorLlm

HELLO = [{"role": "user", "content": "hello"}]
KEY = "sk-very-secret-0123456789"


def drip_body_and_keep_alive(handler):
    """One byte every 50 ms: no single read is slow, the entire answer never ends."""
    handler.protocol_version = "HTTP/1.1"
    handler.send_response(200)
    handler.send_header("Content-Length", "10000")
    handler.end_headers()
    while not handler.stopping.wait(0.05):
        handler.wfile.write(b" ")


def silent(handler):
    handler.stopping.wait()


def talkative(handler):
    """100 MB of JSON."""
    handler.send_response(200)
    handler.end_headers()
    for _ in range(100):
        handler.wfile.write(b" " * 1_000_000)


def closes_midway(handler):
    handler.send_response(200)
    handler.send_header("Content-Length", "1000")
    handler.end_headers()
    handler.wfile.write(completion("F chair"))


def closes_midway_in_a_chunk(handler):
    handler.protocol_version = "HTTP/1.1"
    handler.send_response(200)
    handler.send_header("Transfer-Encoding", "chunked")
    handler.end_headers()
    handler.wfile.write(b'40\r\n{"choices"')


def no_http(handler):
    handler.wfile.write(b"\x16\x03\x01 ssh-2.0 hello\r\n\r\n")


def body(data: bytes, status: int = 200, **headers: str):
    return lambda handler: send(handler, data, status, **headers)


def redirect(handler):
    send(handler, b"", 307, Location=f"http://{handler.headers['Host']}{handler.path}")


@pytest.mark.parametrize(
    ("behave", "expected"),
    [
        (talkative, "more than 16 KB"),
        (closes_midway, "before its answer was complete"),
        (closes_midway_in_a_chunk, "before its answer was complete"),
        (no_http, "does not speak HTTP"),
        (redirect, "(HTTP 307); configure the right URL"),
        (body(b"<html>hi</html>", Content_Type="text/html"), "not JSON (text/html): '<html>hi"),
        (body(b"\xff\xfe\x00"), "not JSON"),
        (body(b"[" * 10_000), "not JSON"),
        (body(b"null"), "no choices[0].message.content"),
        (body(b'{"choices": [{"text": "F chair"}]}'), "no choices[0].message.content"),
        (body(b'{"choices": {"0": 1}}'), "no choices[0].message.content"),
        (body(completion(None)), "the answer is empty"),
        (body(completion("")), "the answer is empty"),
        (body(completion(7)), "no choices[0].message.content"),
        (body(b'{"error": {"message": "no\\nmodel\\u001b[2J"}}', 500), "HTTP 500: no model [2J"),
        (body(b'{"detail": "no such model"}', 404), "HTTP 404: no such model"),
        (body(b"", 401), "HTTP 401; see the server's log"),
        (body(completion("F chair & F be", "length")), "cut off at the token limit"),
    ],
)
def test_an_unusable_answer_is_an_error_of_one_line(behave, expected):
    with serving(behave) as server:
        client = ChatClient(server.url, "m", KEY, PATIENCE_S, max_answer_bytes=16 * 1024)
        with pytest.raises(ChatError) as raised:
            client.ask(HELLO)
    message = str(raised.value)
    assert message.startswith(f"{server.url}: ")
    assert expected in message
    assert message.isprintable()
    assert len(message) < 500


def request_threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name == "chat"}


def assert_ended(threads: set[threading.Thread]) -> None:
    for thread in threads:
        thread.join(PATIENCE_S)
        assert not thread.is_alive(), "the request's thread goes on"


@pytest.mark.parametrize("behave", [silent, drip_body_and_keep_alive])
def test_the_limit_is_for_the_whole_answer(behave):
    """tests/attacks has more servers that never end."""
    before = request_threads()
    with serving(behave) as server:
        with pytest.raises(ChatError) as raised:
            ChatClient(server.url, "m", time_limit_s=0.5).ask(HELLO)
        assert_ended(request_threads() - before)
    wanted = f"{server.url}: no complete answer within 0.5 s; raise time_limit_s"
    assert str(raised.value).startswith(wanted)


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_a_server_that_accepts_no_connection_is_given_up(scheme):
    before = request_threads()
    with socket.create_server(("127.0.0.1", 0)) as listening:  # as far as the kernel goes
        url = f"{scheme}://127.0.0.1:{listening.getsockname()[1]}"
        with pytest.raises(ChatError, match=r"no complete answer within 0\.5 s"):
            ChatClient(url, "m", time_limit_s=0.5).ask(HELLO)
        assert_ended(request_threads() - before)


@pytest.mark.parametrize("left_s", [0.0, -1.0])
def test_no_time_left_asks_nothing_and_names_the_limit(left_s):
    with serving(saying("F chair")) as server:
        with pytest.raises(ChatError, match="no complete answer within 30 s"):
            ChatClient(server.url, "m", time_limit_s=30.0).ask(HELLO, left_s=left_s)
        assert server.requests == []


def test_a_long_answer_is_not_kept():
    with serving(talkative) as server:
        tracemalloc.start()
        try:
            with pytest.raises(ChatError, match="more than 256 KB"):
                ChatClient(server.url, "m").ask(HELLO)
            assert tracemalloc.get_traced_memory()[1] < 8_000_000
        finally:
            tracemalloc.stop()


def test_plain_http_instead_of_tls_is_an_error():
    with (
        serving(saying("F chair")) as server,
        pytest.raises(ChatError, match=r"does not speak TLS|closed the connection"),
    ):
        ChatClient(server.url.replace("http:", "https:"), "m", time_limit_s=5.0).ask(HELLO)


@pytest.mark.parametrize(
    "url",
    [
        "", "localhost:8080/v1", "ftp://host/v1", "file:///etc/passwd", "http://", "http:///v1",
        "http://host:port/v1", "http://host:99999/v1", "http://host/a b", "http://host/\n",
        "http://[::1/v1", "http://user:secret@host/v1", "http://höst/v1",
    ],
)  # fmt: skip
def test_unusable_urls_are_refused_at_once(url):
    with pytest.raises(ChatError, match="chat server") as raised:
        ChatClient(url, "m")
    assert "secret" not in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_good_answer():
    with serving(saying("F chair")) as server:
        client = ChatClient(server.url + "/?version=1", "tiny", KEY)
        assert client.ask(HELLO, temperature=0) == "F chair"
    ((path, headers, request),) = server.requests
    assert path == "/v1/chat/completions?version=1"
    assert headers["Authorization"] == f"Bearer {KEY}"
    expected = {"model": "tiny", "messages": HELLO, "stream": False, "temperature": 0}
    assert request == expected


def test_the_key_is_taken_from_the_environment_and_never_shown(monkeypatch, caplog):
    monkeypatch.setenv("MY_KEY", f"{KEY}\n")
    echo = f'{{"error": {{"message": "wrong key {KEY}"}}}}'.encode()
    with caplog.at_level(logging.DEBUG), serving(body(echo, 401)) as server:
        client = make_chat_client(TranslatorLlm(url=server.url, api_key_env="MY_KEY"))
        with pytest.raises(ChatError, match=r"HTTP 401: wrong key \*\*\*") as raised:
            client.ask(HELLO)
    assert server.requests[0][1]["Authorization"] == f"Bearer {KEY}"
    for shown in (str(raised.value), repr(client), caplog.text):
        assert KEY not in shown


@pytest.mark.parametrize("key", ["secret\nkey: value", "sëcret", "sec ret"])
def test_a_key_that_no_header_can_carry(key):
    with pytest.raises(ChatError, match="no HTTP header can have") as raised:
        ChatClient("http://host/v1", "m", key)
    assert key not in str(raised.value)


def test_the_next_tokens_are_asked_for_and_read():
    image = [{"type": "image_url", "image_url": {"url": "data:image/jpeg;base64,AAAA"}}]
    with serving(body(likeliest({"A": -0.5, " B": -1, "no": 0, "C": -1e300}))) as server:
        tokens = ChatClient(server.url, "m").next_tokens([{"role": "user", "content": image}])
    assert tokens == [("A", -0.5), (" B", -1.0), ("no", 0.0), ("C", -1e4)]
    assert server.requests[0][2] == {
        "model": "m", "messages": [{"role": "user", "content": image}], "stream": False,
        "max_tokens": 1, "temperature": 1, "logprobs": True, "top_logprobs": 20,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (b"", "not JSON"),
        (b"{}", "no logprobs"),
        (completion("A"), "no logprobs"),
        (likeliest(None), "no logprobs"),
        (likeliest({"A": -1.0})[:-5], "not JSON"),
        (likeliest([{"token": 1, "logprob": -1.0}]), "an invalid logprob, 1: -1.0"),
        (likeliest({"A": float("nan")}), "an invalid logprob, 'A': nan"),
        (likeliest({"A": -1.0, "B": "-2"}), "an invalid logprob, 'B': '-2'"),
        (likeliest({"A": None}), "an invalid logprob"),
        (likeliest({"A": 10**400}), "an invalid logprob"),
    ],
)
def test_an_answer_without_log_probabilities_is_an_error(answer, expected):
    with serving(body(answer)) as server, pytest.raises(ChatError) as raised:
        ChatClient(server.url, "m").next_tokens(HELLO)
    assert expected in str(raised.value)
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 400


@pytest.mark.parametrize("connects", [True, False])
def test_closing_the_client_cancels_its_requests(connects):
    """`close` waits neither for an answer nor for a connection."""
    said: list[Exception] = []

    def ask(client: ChatClient) -> None:
        try:
            client.ask(HELLO)
        except ChatError as error:
            said.append(error)

    with serving(silent) as server, socket.create_server(("127.0.0.1", 0), backlog=1) as deaf:
        url = server.url if connects else f"https://127.0.0.1:{deaf.getsockname()[1]}"
        client = ChatClient(url, "m", time_limit_s=PATIENCE_S)
        asking = threading.Thread(target=ask, args=(client,), daemon=True)
        asking.start()
        eventually(lambda: client._under_way)
        client.close()
        eventually(lambda: said)
        with pytest.raises(ChatError, match="cancelled: the client is closed"):
            client.ask(HELLO)
    asking.join(PATIENCE_S)
    assert "cancelled: the client is closed" in str(said[0])


@pytest.mark.parametrize("status", [200, 404])
def test_a_busy_server_is_waited_for(status, monkeypatch):
    monkeypatch.setattr(chat, "LIFE_PERIOD_S", 0.01)
    lives = []

    def behave(handler):
        eventually(lambda: len(lives) > 3)
        send(handler, completion("at last"))

    with serving(
        behave, lambda handler: lives.append(handler.path) or send(handler, b"", status)
    ) as server:
        client = ChatClient(server.url, "m", KEY, PATIENCE_S, must_live=True)
        assert client.ask(HELLO) == "at last"
    assert set(lives) == {"/v1/models"}


def test_a_hanging_server_is_given_up_early(monkeypatch):
    monkeypatch.setattr(chat, "LIFE_PERIOD_S", 0.01)
    monkeypatch.setattr(chat, "LIFE_S", 0.2)
    with serving(silent, silent) as server:
        client = ChatClient(server.url, "m", time_limit_s=10 * PATIENCE_S, must_live=True)
        with pytest.raises(ChatError, match=r"^[^ ]*: the server hangs: it does not answer even"):
            client.ask(HELLO)

"""Servers that drip, give false answers and never end: the client ends with one line that says so.

The servers are real ones on this machine that speak bytes, so that they can do what no HTTP
library would. Only the limit that a server runs into is short, as machines may be busy.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import socket
import threading
from collections.abc import Callable, Iterator

import pytest
import yaml

from edge.chat import ChatClient, ChatError
from edge.host import resources
from edge.models.download import DownloadLimits, download, read_small
from edge.models.partial_file import FetchError, PartialFile
from edge.models.pull import PullOptions, pull
from edge.perception.runtime.cards import load_card

pytestmark = pytest.mark.timeout(60)

CONTENT = b"weights" * 1000
SHA256 = hashlib.sha256(CONTENT).hexdigest()
OK = b"HTTP/1.1 200 OK\r\n"
CHUNKED = OK + b"Transfer-Encoding: chunked\r\n\r\n"
_DRIP_S = 0.005
_SHORT_S = 0.15
_TOO_MUCH = "Receive buffer too long"  # of trailers without end

Talk = Callable[["Line"], None]


class Line:
    """The server's end of one connection.

    Attributes:
        address: of the server.
        path: what is asked for.
    """

    def __init__(self, sock: socket.socket, over: threading.Event, address: str) -> None:
        self._sock, self._over, self.address, self.path = sock, over, address, ""

    def hear(self) -> None:
        """Wait for an entire request."""
        heard = b""
        while b"\r\n\r\n" not in heard:
            if not (more := self._sock.recv(4096)):
                raise ConnectionError
            heard += more
        self.path = heard.split()[1].decode()

    def say(self, data: bytes) -> None:
        self._sock.sendall(data)

    def drip(self, data: bytes) -> None:
        """Send the bytes one at a time; repeat the last one for ever."""
        for k in itertools.count():
            if self._over.wait(_DRIP_S):
                return
            self.say(data[k : k + 1] or data[-1:])

    def repeat(self, data: bytes) -> None:
        while not self._over.is_set():
            self.say(data)


@contextlib.contextmanager
def serving(talk: Talk) -> Iterator[str]:
    """HOST:PORT of a server that treats every connection so."""
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"127.0.0.1:{listener.getsockname()[1]}"

        def answer(sock: socket.socket) -> None:
            with sock, contextlib.suppress(OSError):
                talk(Line(sock, over, address))

        def accept() -> None:
            with contextlib.suppress(OSError):
                while True:
                    threading.Thread(target=answer, args=listener.accept()[:1], daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        try:
            yield address
        finally:
            over.set()
            listener.shutdown(socket.SHUT_RDWR)


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch):
    monkeypatch.setenv("no_proxy", "127.0.0.1")


def after_hearing(say: Talk) -> Talk:
    def talk(line: Line) -> None:
        line.hear()
        say(line)

    return talk


def redirects_to(path: str, content: Talk) -> Talk:
    def talk(line: Line) -> None:
        line.hear()
        if line.path == path:
            line.drip(OK + b"X-Padding: a")
        line.say(f"HTTP/1.1 302 Found\r\nLocation: http://{line.address}{path}\r\n\r\n".encode())
        content(line)

    return talk


def redirects_for_ever(line: Line) -> None:
    line.hear()
    there = f"http://{line.address}{line.path}x"
    line.say(f"HTTP/1.1 302 Found\r\nContent-Length: 0\r\nLocation: {there}\r\n\r\n".encode())


HEADS = {
    "drips the status": lambda line: line.drip(b"HTTP/1.1 200 OK"),
    "drips a header": lambda line: line.drip(OK + b"X-Padding: a"),
    "drips headers without end": lambda line: line.drip(OK + b"A: b\r\n" * 10_000),
    "says nothing": lambda line: line.drip(b""),
    "asks for patience without end": lambda line: line.repeat(b"HTTP/1.1 100 Continue\r\n\r\n"),
}
BODIES = {
    "drips content": lambda line: (line.say(OK + b"\r\n"), line.drip(CONTENT)),
    "stalls in the content": lambda line: (line.say(OK + b"\r\n" + CONTENT[:9]), line.drip(b"")),
    "drips the length of a chunk": lambda line: (line.say(CHUNKED), line.drip(b"0")),
    "trailers without end": lambda line: (
        line.say(CHUNKED + b"7\r\nweights\r\n0\r\n"), line.repeat(b"A: b\r\n" * 1000),
    ),
    "drips trailers": lambda line: (line.say(CHUNKED + b"0\r\n"), line.drip(b"A: b\r\n" * 10_000)),
}  # fmt: skip
HASTY_HEAD = DownloadLimits(answer_s=_SHORT_S, tries=2)
HASTY_BODY = DownloadLimits(slow_s=_SHORT_S, slow_bytes=1 << 20, tries=2)


def fetch(address: str, folder, limits: DownloadLimits, scheme: str = "http") -> None:
    with PartialFile(folder / "w.pt", SHA256) as part:
        download(f"{scheme}://{address}/w.pt", part, limits)


@pytest.mark.parametrize("how", HEADS)
def test_a_download_without_a_complete_head_times_out(tmp_path, how):
    with serving(after_hearing(HEADS[how])) as address:
        with pytest.raises(FetchError, match=rf"/w\.pt: no answer within {_SHORT_S} s$"):
            fetch(address, tmp_path, HASTY_HEAD)
        with pytest.raises(FetchError, match="no answer within"):
            read_small(f"http://{address}/said", HASTY_HEAD)
    assert not (tmp_path / "w.pt").exists()


@pytest.mark.parametrize("how", BODIES)
def test_a_download_with_an_endless_body_is_ended(tmp_path, how):
    with serving(after_hearing(BODIES[how])) as address:
        with pytest.raises(FetchError, match=rf"{_TOO_MUCH}|only \d+ bytes came in {_SHORT_S} s$"):
            fetch(address, tmp_path, HASTY_BODY)
        with pytest.raises(FetchError, match=f"{_TOO_MUCH}|not complete after"):
            read_small(f"http://{address}/said", DownloadLimits(small_s=_SHORT_S))
    assert not (tmp_path / "w.pt").exists()


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_a_slow_proxy_or_handshake_times_out(tmp_path, monkeypatch, scheme):
    """Over https a dripping proxy is asked to connect; without one, TLS drips."""
    with serving(lambda line: line.drip(OK + b"A: b\r\n" * 10_000)) as proxy:
        monkeypatch.delenv("no_proxy")
        monkeypatch.setenv(f"{scheme}_proxy", f"http://{proxy}")
        with pytest.raises(FetchError, match="no answer within"):
            fetch("example.invalid", tmp_path, HASTY_HEAD, scheme)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    hello = b"\x16\x03\x03\x40\x00" + bytes(1 << 14)
    with (
        serving(lambda line: line.drip(hello)) as address,
        pytest.raises(FetchError, match=r"no answer within|closed the connection"),
    ):
        fetch(address, tmp_path, HASTY_HEAD, "https")


@pytest.mark.parametrize(
    "content",
    [lambda line: None, lambda line: line.repeat(bytes(1 << 16)), lambda line: line.drip(b"x")],
    ids=["to a drip", "with endless content", "with dripping content"],
)
def test_redirects_end(tmp_path, content):
    talk = redirects_to("/drips", content)
    with serving(talk) as address, pytest.raises(FetchError, match="no answer within"):
        fetch(address, tmp_path, HASTY_HEAD)


def test_a_negative_length_is_no_http(tmp_path):
    sent = OK + b"Content-Length: -1\r\n\r\n" + CONTENT[:6000]
    with (
        serving(after_hearing(lambda line: line.say(sent))) as address,
        pytest.raises(FetchError, match=r"does not speak HTTP \(bad Content-Length\)"),
    ):
        fetch(address, tmp_path, DownloadLimits(tries=1))
    assert not (tmp_path / "w.pt").exists()


def test_a_pull_continues_with_the_next_source(tmp_path, monkeypatch, capsys):
    def honest(line: Line) -> None:
        line.hear()
        line.say(OK + f"Content-Length: {len(CONTENT)}\r\n\r\n".encode() + CONTENT)

    monkeypatch.setattr(resources, "data_dir", lambda kind: tmp_path)
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    with serving(redirects_for_ever) as lying, serving(honest) as sound:
        sources = [
            {"kind": "url", "url": f"http://{address}/w.pt", "sha256": SHA256}
            for address in (lying, sound)
        ]
        card = {
            "name": "tiny", "family": "f", "task": "image", "file": "tiny.onnx", "sha256": None,
            "sources": sources, "license": "MIT", "input": {"height": 64, "width": 64},
            "precision": "fp32", "derived_from": None, "dim": 8, "parity": None,
            "preprocess": {"color": "rgb", "scale": 1.0, "mean": [0, 0, 0], "std": [1, 1, 1]},
        }  # fmt: skip
        (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(card))
        pull(load_card("tiny"), PullOptions(limits=DownloadLimits(tries=1)))
    (note,) = capsys.readouterr().err.splitlines()
    assert note.startswith(f"tiny: note: http://{lying}/w.pt: ")
    assert "HTTP 302" in note
    assert [p.read_bytes() for p in (tmp_path / "cache" / "weights").iterdir()] == [CONTENT]


@pytest.mark.parametrize("how", [*HEADS, *BODIES])
def test_a_chat_with_such_a_server_ends(how):
    with serving(after_hearing({**HEADS, **BODIES}[how])) as address:
        client = ChatClient(f"http://{address}/v1", "m", time_limit_s=_SHORT_S)
        with pytest.raises(ChatError, match=rf"{_TOO_MUCH}|no complete answer within {_SHORT_S} s"):
            client.ask([{"role": "user", "content": "hello"}])

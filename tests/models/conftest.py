"""A server that sends files, also badly; a card and an empty cache."""

from __future__ import annotations

import http.server
import threading
from dataclasses import dataclass, field

import pytest
import yaml

from edge.host import resources


@dataclass
class Behaviour:
    """Server behaviour for one path.

    Attributes:
        ranges: whether parts can be asked for.
        cut: bytes after which each connection breaks; None for never.
        stall: whether it then says nothing more, in place of breaking off.
        told: the length that it claims, in place of the true one.
        status: of the answer; with `location`, where else to look.
    """

    content: bytes = b""
    ranges: bool = True
    cut: int | None = None
    stall: bool = False
    told: int | None = None
    status: int = 200
    location: str | None = None
    kind: str = "application/octet-stream"
    asked: list[dict[str, str]] = field(default_factory=list)


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        how = self.server.paths.get(self.path)
        if how is None:
            self.send_error(404)
            return
        how.asked.append({key.lower(): value for key, value in self.headers.items()})
        begin = 0
        if how.ranges and (wanted := self.headers.get("Range")):
            begin = int(wanted.removeprefix("bytes=").partition("-")[0])
        if begin and begin >= len(how.content):
            self.send_error(416)
            return
        self.send_response(206 if begin else how.status)
        if how.location:
            self.send_header("Location", how.location)
        body, size = how.content[begin:], len(how.content)
        if begin:
            self.send_header("Content-Range", f"bytes {begin}-{size - 1}/{size}")
        self.send_header("Content-Length", str(len(body) if how.told is None else how.told))
        self.send_header("Content-Type", how.kind)
        self.end_headers()
        self.wfile.write(body if how.cut is None else body[: how.cut])
        self.wfile.flush()
        if how.stall:
            self.server.over.wait()
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        pass


class Server(http.server.ThreadingHTTPServer):
    """Files by path; `url(path)` is their address."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.paths: dict[str, Behaviour] = {}
        self.over = threading.Event()

    def handle_error(self, *_: object) -> None:
        """Ignore clients that hang up, which many tests are about."""

    def put(self, path: str, content: bytes = b"", **how: object) -> Behaviour:
        self.paths[path] = Behaviour(content, **how)
        return self.paths[path]

    def url(self, path: str, user: str = "") -> str:
        return f"http://{user}127.0.0.1:{self.server_port}{path}"


@pytest.fixture
def server(monkeypatch):
    """Run a `Server`, called directly without the environment's proxy."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    made = Server()
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield made
    made.over.set()
    made.shutdown()
    thread.join()
    made.server_close()


@pytest.fixture
def put_card(tmp_path, monkeypatch):
    """Return `put_card(card)`, with an empty folder of cards and an empty cache."""
    folder = tmp_path / "cards"
    folder.mkdir()
    monkeypatch.setattr(resources, "data_dir", lambda kind: folder)
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))

    def put(card):
        (folder / f"{card['name']}.yaml").write_text(yaml.safe_dump(card))
        return card["name"]

    return put

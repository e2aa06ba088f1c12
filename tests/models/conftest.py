"""A server that sends files, also badly; a card and an empty cache."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import pytest
import yaml
from http_server import Quiet, running


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


class _Handler(Quiet):
    protocol_version = "HTTP/1.1"
    files: Files

    def do_GET(self) -> None:
        how = self.files.paths.get(self.path)
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
            self.files.over.wait()
        self.close_connection = True


class Files:
    """Files by path; `url(path)` is their address."""

    def __init__(self) -> None:
        self.paths: dict[str, Behaviour] = {}
        self.over, self.port = threading.Event(), 0

    def put(self, path: str, content: bytes = b"", **how: object) -> Behaviour:
        self.paths[path] = Behaviour(content, **how)
        return self.paths[path]

    def url(self, path: str, user: str = "") -> str:
        return f"http://{user}127.0.0.1:{self.port}{path}"


@pytest.fixture
def server(monkeypatch):
    """Serve `Files`, called directly without the environment's proxy."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    files = Files()
    with running(type("Handler", (_Handler,), {"files": files}), files.over) as url:
        files.port = int(url.rpartition(":")[2])
        yield files


@pytest.fixture
def put_card(cards):
    """Return `put_card(card)`, with an empty folder of cards and an empty cache."""

    def put(card):
        (cards / f"{card['name']}.yaml").write_text(yaml.safe_dump(card))
        return card["name"]

    return put

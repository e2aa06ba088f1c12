"""A small HTTP server: pages that are made when they are asked for, for few who ask seldom."""

from __future__ import annotations

import json
import logging
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from socketserver import ThreadingMixIn
from typing import Any

from edge.errors import UnavailableError
from edge.text import one_line

log = logging.getLogger("edge.host.pages")

MOST_OPEN = 16
_PATIENCE_S = 5.0
_LOOK_S = 0.1  # for the end of the block


@dataclass(frozen=True)
class Page:
    """What is answered; `kind` is its media type."""

    body: bytes
    kind: str
    status: HTTPStatus = HTTPStatus.OK


Pages = Mapping[str, Callable[[], Page]]
"""By path. What makes one is called on a thread of its own, and waits for nothing."""


def json_page(said: object, status: HTTPStatus = HTTPStatus.OK) -> Page:
    return Page(json.dumps(said, ensure_ascii=False).encode() + b"\n", "application/json", status)


@contextmanager
def serve(pages: Pages, host: str, port: int | None) -> Iterator[int | None]:
    """Answer GET and HEAD while the block runs; with no port, nothing is done.

    Args:
        port: 0 takes a free one.

    Yields:
        The port.

    Raises:
        UnavailableError: it cannot be listened on.
    """
    if port is None:
        yield None
        return
    try:
        server = _Server(host, port, pages)
    except OSError as error:
        raise UnavailableError(
            f"http.port: cannot listen on {one_line(host)} port {port}: "
            f"{error.strerror or one_line(error)}; set http.port to a free one, or to null"
        ) from None
    thread = threading.Thread(
        target=server.serve_forever, args=(_LOOK_S,), name="pages", daemon=True
    )
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(ThreadingMixIn, HTTPServer):
    """A thread for each connection, of which there are few: the oldest makes room for a new one,
    so that whoever keeps connections open, or sends a byte now and then, locks nobody out."""

    daemon_threads, block_on_close = True, False
    request_queue_size = 4 * MOST_OPEN

    def __init__(self, host: str, port: int, pages: Pages) -> None:
        self.pages = pages
        self._open: dict[socket.socket, None] = {}
        self._hand = threading.Lock()
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        super().__init__(address[:2], _Handler)

    def server_bind(self) -> None:
        """HTTPServer's own asks the name service who we are, which can take long."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = self.server_address[:2]

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._hand:
            self._open[request] = None
            if len(self._open) > MOST_OPEN:
                with suppress(OSError):  # it may have been closed by now
                    next(iter(self._open)).shutdown(socket.SHUT_RDWR)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._hand:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Whoever goes away in the middle of an answer is no fault of ours."""
        log.debug("a request failed", exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    timeout = _PATIENCE_S
    server: _Server
    server_version, sys_version = "edge", ""

    def do_GET(self) -> None:
        make = self.server.pages.get(self.path.partition("?")[0])
        self._answer(self._nothing() if make is None else make())

    do_HEAD = do_GET

    def _nothing(self) -> Page:
        there = ", ".join(sorted(self.server.pages))
        return Page(f"no such page (there are: {there})\n".encode(), "text/plain; charset=utf-8",
                    HTTPStatus.NOT_FOUND)  # fmt: skip

    def _answer(self, page: Page) -> None:
        self.send_response(page.status)
        self.send_header("Content-Type", page.kind)
        self.send_header("Content-Length", str(len(page.body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(page.body)

    def log_message(self, format: str, *args: Any) -> None:
        log.debug("%s", one_line(format % args))

"""A small HTTP server: pages that are made when they are asked for, for few who ask seldom.

Where there is a token, it is asked for. Only of the pages that are probes everybody is told the
status, without a word: an orchestrator's probe has no token (nor asks Kubernetes' own API server
for one at its `/readyz`), and would end what is well if it were refused.
"""

from __future__ import annotations

import json
import logging
import socket
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from socketserver import ThreadingMixIn
from typing import Any

from edge.errors import UnavailableError
from edge.host.credentials import Token
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


def _page(said: str, status: HTTPStatus) -> Page:
    return Page(f"{said}\n".encode(), "text/plain; charset=utf-8", status)


@contextmanager
def serve(
    pages: Pages,
    host: str,
    port: int | None,
    token: Token | None = None,
    probes: Collection[str] = (),
) -> Iterator[int | None]:
    """Answer GET and HEAD while the block runs; with no port, nothing is done.

    Args:
        port: 0 takes a free one.
        token: must be known to whoever asks; None: nothing need be.
        probes: pages of which others are told the status.

    Yields:
        The port.

    Raises:
        UnavailableError: it cannot be listened on.
    """
    if port is None:
        yield None
        return
    try:
        server = _Server(host, port, pages, token, probes)
    except (OSError, UnicodeError) as error:  # UnicodeError: a label that no host name may have
        reason = getattr(error, "strerror", None) or one_line(error)
        raise UnavailableError(
            f"http.port: cannot listen on {one_line(host)} port {port}: {reason}; "
            "set http.port to a free one, or to null"
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

    def __init__(
        self, host: str, port: int, pages: Pages, token: Token | None, probes: Collection[str]
    ) -> None:
        self.pages, self.token, self.probes = pages, token, probes
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
        path, token = self.path.partition("?")[0], self.server.token
        if token is None or token.is_borne_by(self.headers.get("Authorization", "")):
            make = self.server.pages.get(path)
            self._answer(self._nothing() if make is None else make())
        elif path in self.server.probes:
            self._answer(replace(self.server.pages[path](), body=b""))
        else:
            self._answer(_page("who asks must know the token", HTTPStatus.UNAUTHORIZED))

    do_HEAD = do_GET

    def _nothing(self) -> Page:
        there = ", ".join(sorted(self.server.pages))
        return _page(f"no such page (there are: {there})", HTTPStatus.NOT_FOUND)

    def _answer(self, page: Page) -> None:
        self.send_response(page.status)
        self.send_header("Content-Type", page.kind)
        self.send_header("Content-Length", str(len(page.body)))
        self.send_header("Cache-Control", "no-store")
        if page.status == HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", 'Bearer realm="edge"')
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(page.body)

    def log_message(self, format: str, *args: Any) -> None:
        log.debug("%s", one_line(format % args))

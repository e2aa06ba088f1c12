"""A small HTTP server: pages that are made when they are asked for, for few who ask seldom.

Where there is a token, it is asked for, but for public pages: what a browser shows before its user
can say the token. Of the pages that are probes everybody is told the status, without a word: an
orchestrator's probe has no token (nor asks Kubernetes' own API server for one at its `/readyz`),
and would end what is well if it were refused.

Without a token, whoever can reach the port may read, which is this machine; a page of another site
in a browser here may not (DNS rebinding), so a request has to name this machine. Nothing can be
changed without a token.
"""

from __future__ import annotations

import json
import logging
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from socketserver import ThreadingMixIn
from typing import Any
from urllib.parse import urlsplit

from edge.errors import UnavailableError
from edge.host.credentials import Token
from edge.host.ports import is_loopback
from edge.text import one_line

log = logging.getLogger("edge.host.pages")

MOST_OPEN = 16
MOST_BYTES = 65536
"""Of what is posted."""
_PATIENCE_S = 5.0
_LOOK_S = 0.1  # for the end of the block
_STRANGER, _KNOWN, _BUSY = range(3)
"""States of a connection: no request on it bore the token; one did; one that did is under way."""
_ELSEWHERE = HTTPStatus.MISDIRECTED_REQUEST
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Of every answer: a page runs what came with it, asks nobody else, and lies in no other page."""


@dataclass(frozen=True)
class Page:
    """What is answered.

    Attributes:
        kind: its media type.
        etag: names what it says; whoever has that already is told so, with 304 and no body.
    """

    body: bytes
    kind: str
    status: HTTPStatus = HTTPStatus.OK
    etag: str = ""


Pages = Mapping[str, Callable[[], Page]]
"""By path. What makes one is called on a thread of its own, and waits for nothing."""

Forms = Mapping[str, Callable[[bytes], Page]]
"""By path, what takes a JSON text that is posted there; called on a thread of its own."""


@dataclass(frozen=True)
class Site:
    """All that is served, and to whom.

    Attributes:
        host: as configured.
        token: must be known to whoever asks; None: nothing need be, and nothing can be posted.
        probes: pages of which others are told the status.
        public: pages that others are shown.
    """

    pages: Pages
    host: str
    token: Token | None = None
    probes: Collection[str] = ()
    forms: Forms = field(default_factory=dict)
    public: Collection[str] = ()


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
    forms: Forms | None = None,
    public: Collection[str] = (),
) -> Iterator[int | None]:
    """Answer GET and HEAD, and POST where there are forms, while the block runs; with no port,
    nothing is done.

    Args:
        port: 0 takes a free one.
        pages, host, token, probes, forms, public: see `Site`.

    Yields:
        The port.

    Raises:
        UnavailableError: it cannot be listened on.
    """
    if port is None:
        yield None
        return
    try:
        server = _Server(Site(pages, host, token, probes, forms or {}, public), port)
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
        server.hang_up()


class _Server(ThreadingMixIn, HTTPServer):
    """A thread for each connection, of which there are few: one makes room for a new one, so that
    whoever keeps connections open, or sends a byte now and then, locks nobody out.

    The oldest stranger goes first, then the oldest that bore the token and asks for nothing now.
    """

    daemon_threads, block_on_close = True, False
    request_queue_size = 4 * MOST_OPEN

    def __init__(self, site: Site, port: int) -> None:
        self.site = site
        self._open: dict[socket.socket, int] = {}
        self._hand = threading.Lock()
        self._faulty: set[str] = set()
        family, *_, address = socket.getaddrinfo(site.host, port, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        super().__init__(address[:2], _Handler)

    def server_bind(self) -> None:
        """HTTPServer's own asks the name service who we are, which can take long."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = self.server_address[:2]

    def get_request(self) -> tuple[Any, Any]:
        try:
            return super().get_request()
        except OSError:
            time.sleep(_LOOK_S)  # with no descriptor left, it would be asked for again at once
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._hand:
            if len(self._open) >= MOST_OPEN:
                first = min(self._open, key=self._open.__getitem__)  # of those alike, the oldest
                if self._open[first] == _BUSY:
                    first = request
                self._open.pop(first, None)  # the next of a burst makes room of another
                with suppress(OSError):  # it may have been closed by now
                    first.shutdown(socket.SHUT_RDWR)
            if len(self._open) < MOST_OPEN:
                self._open[request] = _STRANGER
        super().process_request(request, client_address)

    def mark(self, request: Any, state: int) -> bool:
        """Set the state of a connection. Return False if it has made room for another."""
        with self._hand:
            if request in self._open:
                self._open[request] = state
            return request in self._open

    def hang_up(self) -> None:
        """Whoever keeps a connection open is answered nothing more."""
        with self._hand:
            for connection in self._open:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        with self._hand:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Whoever goes away in the middle of an answer is no fault of ours."""
        log.debug("a request failed", exc_info=True)

    def tell_once(self, path: str, fault: str) -> None:
        """Log why a page cannot be made: the first time, since many ask again and again."""
        with self._hand:
            told = path in self._faulty
            self._faulty.add(path)
        if not told:
            log.warning("%s", fault)
        log.debug("%s", fault, exc_info=True)


class _RefusedError(Exception):
    """Why a request is not answered as it was meant."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    timeout = _PATIENCE_S
    server: _Server
    server_version, sys_version = "edge", ""
    protocol_version = "HTTP/1.1"  # a page that asks five times a second keeps its connection
    # An answer is one packet, and goes out at once: else its second part waits for the reader to
    # confirm the first, 40 ms.
    wbufsize, disable_nagle_algorithm = -1, True

    def handle_one_request(self) -> None:
        self._bore_token = False
        super().handle_one_request()
        if self._bore_token:
            self.server.mark(self.connection, _KNOWN)

    def do_GET(self) -> None:
        site, path = self.server.site, self.path.partition("?")[0]
        try:
            self._body_length(most=0)
        except _RefusedError as refused:
            self._refuse(refused, close=True)
            return
        stranger = self._stranger()
        if stranger is None or (path in site.public and stranger.status != _ELSEWHERE):
            make = site.pages.get(path)
            self._answer(self._nothing() if make is None else self._made(path, make))
        elif path in site.probes:
            self._answer(replace(self._made(path, site.pages[path]), body=b""))
        else:
            self._refuse(stranger)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        path = self.path.partition("?")[0]
        try:
            take = self._form(path)
            body = self._body()
        except _RefusedError as refused:
            self._refuse(refused, close=True)
        else:
            self._answer(self._made(path, partial(take, body)))

    def _made(self, path: str, make: Callable[[], Page]) -> Page:
        """What is to be answered; a fault of whoever makes it is told to who asks."""
        try:
            return make()
        except Exception as error:
            said = f"{path} failed: {type(error).__name__}: {one_line(error)}"
            self.server.tell_once(path, said)
            return _page(f"{said}; see the service's log", HTTPStatus.INTERNAL_SERVER_ERROR)

    def _form(self, path: str) -> Callable[[bytes], Page]:
        """What takes a post there, from whoever may."""
        site = self.server.site
        if path not in site.forms:
            raise _RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, "nothing can be posted here")
        if (stranger := self._stranger()) is not None:
            raise stranger
        if site.token is None:
            raise _RefusedError(HTTPStatus.FORBIDDEN, "read-only: set http.token_file")
        origin = self.headers.get("Origin")
        if origin is not None and _authority(origin) != self.headers.get("Host"):
            raise _RefusedError(HTTPStatus.FORBIDDEN, "posted by a page of another site")
        return site.forms[path]

    def _stranger(self) -> _RefusedError | None:
        """Why who asks may not know everything."""
        site = self.server.site
        if site.token is None:
            if not _names_this_machine(self.headers.get("Host"), site.host):
                return _RefusedError(_ELSEWHERE, "asked for another host than this one")
        elif not site.token.is_borne_by(self.headers.get("Authorization", "")):
            return _RefusedError(HTTPStatus.UNAUTHORIZED, "who asks must know the token")
        else:
            self._bore_token = True
            if not self.server.mark(self.connection, _BUSY):  # no answer would arrive
                return _RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections")
        return None

    def _body_length(self, most: int) -> int:
        """How many bytes the body has, as the request says."""
        said = self.headers.get("Content-Length", "0")
        if "Transfer-Encoding" in self.headers or not (said.isascii() and said.isdecimal()):
            raise _RefusedError(HTTPStatus.LENGTH_REQUIRED, "expected a Content-Length")
        if len(said) > 18 or int(said) > most:
            raise _RefusedError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {most} bytes are taken"
            )
        return int(said)

    def _body(self) -> bytes:
        """What is posted, which has to come within `_PATIENCE_S`."""
        length = self._body_length(MOST_BYTES)
        kind = self.headers.get("Content-Type", "").partition(";")[0].strip().lower()
        if kind != "application/json":
            raise _RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")
        body, until_s = bytearray(), time.monotonic() + _PATIENCE_S
        while len(body) < length:
            self.connection.settimeout(max(until_s - time.monotonic(), 1e-3))
            try:
                part = self.rfile.read1(length - len(body))
            except TimeoutError:
                raise _RefusedError(HTTPStatus.REQUEST_TIMEOUT, "the rest did not come") from None
            if not part:
                raise _RefusedError(HTTPStatus.BAD_REQUEST, "the rest did not come")
            body += part
        self.connection.settimeout(_PATIENCE_S)
        return bytes(body)

    def _nothing(self) -> Page:
        there = ", ".join(sorted(self.server.site.pages))
        return _page(f"no such page (there are: {there})", HTTPStatus.NOT_FOUND)

    def _refuse(self, refused: _RefusedError, close: bool = False) -> None:
        """Say why; with `close`, what else the request says is not read."""
        self.close_connection |= close
        self._answer(_page(str(refused), refused.status))

    def _answer(self, page: Page) -> None:
        if page.etag and self.headers.get("If-None-Match") == f'"{page.etag}"':
            page = replace(page, body=b"", status=HTTPStatus.NOT_MODIFIED)
        self.send_response(page.status)
        self.send_header("Content-Type", page.kind)
        self.send_header("Content-Length", str(len(page.body)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        if page.etag:
            self.send_header("ETag", f'"{page.etag}"')
        if page.status == HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", 'Bearer realm="edge"')
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(page.body)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer what the base class refuses with a page like any other."""
        status = HTTPStatus(code)
        self.close_connection, self.request_version = True, self.protocol_version
        self._answer(_page(one_line(message or status.phrase), status))

    def log_message(self, format: str, *args: Any) -> None:
        log.debug("%s", one_line(format % args))


def _authority(origin: str) -> str:
    """Host and port of a header `Origin`, as a header `Host` has them."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _names_this_machine(asked: str | None, host: str) -> bool:
    """Whether a request's header `Host` is one that only this machine answers to.

    What is no browser may leave it out (HTTP/1.0).
    """
    if asked is None:
        return True
    try:
        name = urlsplit(f"//{asked}").hostname or ""
    except ValueError:
        return False
    return is_loopback(name) or name == host.lower()

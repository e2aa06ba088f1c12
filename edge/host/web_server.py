"""A small HTTP server for few readers; pages are made when they are requested.

If a token is set, every request must send it, with two exceptions. Public pages are what a browser
shows before its user can enter the token. Probes return their status without a body to everybody,
since an orchestrator has no token and would restart a healthy service if it were refused.

Without a token, all processes of this machine can read the pages, but nothing can be changed. The
header `Host` must name this machine, which stops pages of other sites in a local browser (DNS
rebinding).
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
from edge.host.credentials import BearerToken
from edge.host.ports import is_loopback
from edge.text import one_line

log = logging.getLogger("edge.host.web_server")

MOST_OPEN = 16
"""Largest number of connections."""
MOST_BYTES = 65536
"""Largest body of a POST."""
_PATIENCE_S = 5.0  # time in which a client must send its request
_POLL_S = 0.1  # period of the check for the end of the block of `serve`
# States of a connection; the lowest is closed first to make room.
_STRANGER = 0  # no request had the token
_KNOWN = 1  # a request had the token
_BUSY = 2  # a request with the token is in progress

# Status for a request whose header `Host` names another machine.
_OTHER_HOST = HTTPStatus.MISDIRECTED_REQUEST
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
"""Headers of every response: only our own scripts, no requests to other sites, no framing."""


@dataclass(frozen=True)
class HttpResponse:
    """A response.

    Attributes:
        etag: version of the content. A client that has this version gets 304 without a body; "":
            no version.
    """

    body: bytes
    media_type: str
    status: HTTPStatus = HTTPStatus.OK
    etag: str = ""


GetRoutes = Mapping[str, Callable[[], HttpResponse]]
"""Path → function that makes the page. It is called on a thread of its own and must not block."""

PostRoutes = Mapping[str, Callable[[bytes], HttpResponse]]
"""Path → function that handles a posted JSON text; called on a thread of its own."""


@dataclass(frozen=True)
class ServedPages:
    """All pages of a server, and the clients that may read them.

    Attributes:
        token: token that a request must have; None: no token is needed, and POST is refused.
        probes: pages whose status is returned without the token.
        public: pages that are returned without the token.
    """

    pages: GetRoutes
    host: str
    token: BearerToken | None = None
    probes: Collection[str] = ()
    forms: PostRoutes = field(default_factory=dict)
    public: Collection[str] = ()


def json_response(data: object, status: HTTPStatus = HTTPStatus.OK) -> HttpResponse:
    """Return a page of JSON data."""
    return HttpResponse(
        json.dumps(data, ensure_ascii=False).encode() + b"\n", "application/json", status
    )


def _text_page(text: str, status: HTTPStatus) -> HttpResponse:
    return HttpResponse(f"{text}\n".encode(), "text/plain; charset=utf-8", status)


@contextmanager
def serve(
    pages: GetRoutes,
    host: str,
    port: int | None,
    token: BearerToken | None = None,
    probes: Collection[str] = (),
    forms: PostRoutes | None = None,
    public: Collection[str] = (),
) -> Iterator[int | None]:
    """Serve pages and forms while the block runs; `ServedPages` describes the arguments.

    Args:
        pages: pages for GET and HEAD.
        host: address to listen on.
        port: TCP port; 0: a free one; None: serve nothing.
        token: token that a request must have.
        probes: pages whose status is public.
        forms: handlers for POST.
        public: pages that are public.

    Yields:
        The port, or None.

    Raises:
        UnavailableError: the port cannot be listened on.
    """
    if port is None:
        yield None
        return
    try:
        server = _Server(ServedPages(pages, host, token, probes, forms or {}, public), port)
    except (OSError, UnicodeError) as error:  # UnicodeError: an invalid label in the host name
        reason = getattr(error, "strerror", None) or one_line(error)
        raise UnavailableError(
            f"http.port: cannot listen on {one_line(host)} port {port}: {reason}; "
            "set http.port to a free port, or to null"
        ) from None
    thread = threading.Thread(
        target=server.serve_forever, args=(_POLL_S,), name="pages", daemon=True
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
    """A server with a thread for each connection, and at most `MOST_OPEN` connections.

    A new connection closes an old one, so that idle or slow clients do not lock others out. The
    oldest connection without the token is closed first, then the oldest idle one with the token.
    """

    daemon_threads, block_on_close = True, False
    request_queue_size = 4 * MOST_OPEN

    def __init__(self, served: ServedPages, port: int) -> None:
        self.served = served
        self._open: dict[socket.socket, int] = {}  # connection → state
        self._lock = threading.Lock()
        self._logged_paths: set[str] = set()
        family, *_, address = socket.getaddrinfo(served.host, port, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        super().__init__(address[:2], _Handler)

    def server_bind(self) -> None:
        """Bind without HTTPServer's lookup of our host name, which can take long."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = self.server_address[:2]

    def get_request(self) -> tuple[Any, Any]:
        try:
            return super().get_request()
        except OSError:
            time.sleep(_POLL_S)  # without a free descriptor, the loop would spin
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        """Make room for a connection if needed, then handle it on a thread."""
        with self._lock:
            if len(self._open) >= MOST_OPEN:
                # The first of equal connections is the oldest.
                victim = min(self._open, key=self._open.__getitem__)
                if self._open[victim] == _BUSY:
                    victim = request  # all are busy: close the new one
                self._open.pop(victim, None)  # so that the next connection closes another one
                with suppress(OSError):  # it may be closed already
                    victim.shutdown(socket.SHUT_RDWR)
            if len(self._open) < MOST_OPEN:
                self._open[request] = _STRANGER
        super().process_request(request, client_address)

    def mark(self, request: Any, state: int) -> bool:
        """Set the state of a connection; return False if it was closed for a new one."""
        with self._lock:
            if request in self._open:
                self._open[request] = state
            return request in self._open

    def hang_up(self) -> None:
        """Close all open connections."""
        with self._lock:
            for connection in self._open:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error of a connection at debug level: the client has usually gone away."""
        log.debug("http: a connection failed", exc_info=True)

    def log_once(self, path: str, fault: str) -> None:
        """Log why a page cannot be made; a warning the first time, then at debug level."""
        with self._lock:
            logged = path in self._logged_paths
            self._logged_paths.add(path)
        if not logged:
            log.warning("%s", fault)
        log.debug("%s", fault, exc_info=True)


class _RefusedError(Exception):
    """A refused request, with its status and reason; raised, or returned as a value."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection, on its thread."""

    timeout = _PATIENCE_S
    server: _Server
    server_version, sys_version = "edge", ""
    protocol_version = "HTTP/1.1"  # keep-alive, for pages that poll five times a second
    # Send a response at once and in one packet. Else its second part waits 40 ms for the reader's
    # acknowledgement of the first.
    wbufsize, disable_nagle_algorithm = -1, True

    def handle_one_request(self) -> None:
        self._has_token = False
        super().handle_one_request()
        if self._has_token:
            self.server.mark(self.connection, _KNOWN)

    def do_GET(self) -> None:
        """Send a page if the client may read it, else its bare status or a refusal."""
        served, path = self.server.served, self.path.partition("?")[0]
        try:
            self._body_length(most=0)
        except _RefusedError as refused:
            self._refuse(refused, close=True)
            return
        denied = self._unauthorized_reason()
        if denied is None or (path in served.public and denied.status != _OTHER_HOST):
            make = served.pages.get(path)
            self._send_response(
                self._not_found_page() if make is None else self._build_response(path, make)
            )
        elif path in served.probes:
            self._send_response(replace(self._build_response(path, served.pages[path]), body=b""))
        else:
            self._refuse(denied)

    do_HEAD = do_GET  # noqa: N815 - the name that http.server calls

    def do_POST(self) -> None:
        """Pass the body to the handler of the path, if the client may make changes."""
        path = self.path.partition("?")[0]
        try:
            handle = self._find_form(path)
            body = self._read_body()
        except _RefusedError as refused:
            self._refuse(refused, close=True)
        else:
            self._send_response(self._build_response(path, partial(handle, body)))

    def _build_response(self, path: str, make: Callable[[], HttpResponse]) -> HttpResponse:
        """Build the response. If the handler raises, return status 500 with the reason."""
        try:
            return make()
        except Exception as error:
            fault = f"{path} failed: {type(error).__name__}: {one_line(error)}"
            self.server.log_once(path, fault)
            return _text_page(f"{fault}; see the service's log", HTTPStatus.INTERNAL_SERVER_ERROR)

    def _find_form(self, path: str) -> Callable[[bytes], HttpResponse]:
        """Return the handler of a POST, or raise _RefusedError."""
        served = self.server.served
        if path not in served.forms:
            raise _RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, "POST is not supported here")
        if (denied := self._unauthorized_reason()) is not None:
            raise denied
        if served.token is None:
            raise _RefusedError(
                HTTPStatus.FORBIDDEN, "read-only: set http.token_file to allow changes"
            )
        origin = self.headers.get("Origin")
        if origin is not None and _authority(origin) != self.headers.get("Host"):
            raise _RefusedError(HTTPStatus.FORBIDDEN, "refused: sent by a page of another site")
        return served.forms[path]

    def _unauthorized_reason(self) -> _RefusedError | None:
        """Return why the client is not authorized; None if it is authorized."""
        served = self.server.served
        if served.token is None:
            if not _names_this_machine(self.headers.get("Host"), served.host):
                return _RefusedError(_OTHER_HOST, "the request names another host than this one")
        elif not served.token.matches(self.headers.get("Authorization", "")):
            return _RefusedError(
                HTTPStatus.UNAUTHORIZED, "a token is required: Authorization: Bearer TOKEN"
            )
        else:
            self._has_token = True
            if not self.server.mark(self.connection, _BUSY):  # it was closed for another connection
                return _RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections")
        return None

    def _body_length(self, most: int) -> int:
        """Return the body's length from the headers; raise _RefusedError above `most` bytes."""
        length = self.headers.get("Content-Length", "0")
        if "Transfer-Encoding" in self.headers or not (length.isascii() and length.isdecimal()):
            raise _RefusedError(HTTPStatus.LENGTH_REQUIRED, "expected a Content-Length")
        if len(length) > 18 or int(length) > most:
            raise _RefusedError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {most} bytes are accepted"
            )
        return int(length)

    def _read_body(self) -> bytes:
        """Read the body of a POST, within `_PATIENCE_S`."""
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
                raise _RefusedError(HTTPStatus.REQUEST_TIMEOUT, "the body is incomplete") from None
            if not part:
                raise _RefusedError(HTTPStatus.BAD_REQUEST, "the body is incomplete")
            body += part
        self.connection.settimeout(_PATIENCE_S)
        return bytes(body)

    def _not_found_page(self) -> HttpResponse:
        paths = ", ".join(sorted(self.server.served.pages))
        return _text_page(f"no such page (pages: {paths})", HTTPStatus.NOT_FOUND)

    def _refuse(self, refused: _RefusedError, close: bool = False) -> None:
        """Send the reason; with `close`, ignore the rest and close the connection."""
        self.close_connection |= close
        self._send_response(_text_page(str(refused), refused.status))

    def _send_response(self, page: HttpResponse) -> None:
        """Send a page, or 304 if the client has this version of it."""
        if page.etag and self.headers.get("If-None-Match") == f'"{page.etag}"':
            page = replace(page, body=b"", status=HTTPStatus.NOT_MODIFIED)
        self.send_response(page.status)
        self.send_header("Content-Type", page.media_type)
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
        """Send an error of the base class in the format of our pages."""
        status = HTTPStatus(code)
        self.close_connection, self.request_version = True, self.protocol_version
        self._send_response(_text_page(one_line(message or status.phrase), status))

    def log_message(self, format: str, *args: Any) -> None:
        log.debug("%s", one_line(format % args))


def _authority(origin: str) -> str:
    """Return host and port of a header `Origin`, in the format of a header `Host`."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _names_this_machine(asked: str | None, host: str) -> bool:
    """Return True if a header `Host` names this machine, or is missing.

    Clients that are no browsers may leave it out (HTTP/1.0).
    """
    if asked is None:
        return True
    try:
        name = urlsplit(f"//{asked}").hostname or ""
    except ValueError:
        return False
    return is_loopback(name) or name == host.lower()

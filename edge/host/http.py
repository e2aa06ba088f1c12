"""HTTP requests with a time limit that holds for any server.

httpx limits only each read of a socket. A server that sends one byte now and then never exceeds
that limit. So another thread watches the clock and can cut the connection of a request.
"""

from __future__ import annotations

import json
import queue
import socket
import ssl
import threading
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Any

import httpx

from edge.text import one_line


class RequestCancelledError(Exception):
    """The request was cancelled by the caller."""


@dataclass(frozen=True, slots=True)
class HttpReply:
    """Answer of a server.

    Attributes:
        body: content, as it was sent. If it is longer than `max_bytes` of
            `CancellableRequest.send`, the rest was not read.
    """

    status: int
    headers: httpx.Headers
    body: bytes


class CancellableRequest:
    """One request, on a thread of its own, since the lookup of a host name may take long.

    Args:
        connection: connection of the client, shared with earlier requests; None: a new one. It
            cannot be used again after a request was cancelled.
    """

    def __init__(self, connection: CuttableConnection | None = None) -> None:
        self.connection = CuttableConnection() if connection is None else connection
        self._outcome: queue.SimpleQueue[HttpReply | Exception] = queue.SimpleQueue()

    def send(
        self, client: httpx.Client, request: httpx.Request, max_bytes: int, limit_s: float
    ) -> HttpReply:
        """Send the request, and return the entire answer.

        Raises:
            TimeoutError: the answer was not complete in time; the connection is cut.
            Exception: another thread cancelled the request, with this exception.
            httpx.HTTPError, UnicodeError: see `failure_reason`.
        """
        arguments = (client, request, max_bytes)
        threading.Thread(target=self._run, args=arguments, name="http", daemon=True).start()
        try:
            outcome = self._outcome.get(timeout=limit_s)
        except queue.Empty:
            outcome = TimeoutError()
            self.cancel(outcome)
        if isinstance(outcome, HttpReply):
            return outcome
        raise outcome

    def cancel(self, why: Exception) -> None:
        """Cancel the request: the waiting caller gets this exception. Callable from any thread."""
        self._outcome.put(why)
        self.connection.cut()

    def _run(self, client: httpx.Client, request: httpx.Request, max_bytes: int) -> None:
        try:
            request.extensions["trace"] = self.connection.trace
            self._outcome.put(_receive(client.send(request, stream=True), max_bytes))
        except Exception as error:  # raised again in the thread that waits
            self._outcome.put(error)


def _receive(response: httpx.Response, max_bytes: int) -> HttpReply:
    """Read the body to its end, or until it is longer than `max_bytes`."""
    body = bytearray()
    with closing(response):
        for chunk in response.iter_raw():
            body += chunk
            if len(body) > max_bytes:
                break
    return HttpReply(response.status_code, response.headers, bytes(body))


class CuttableConnection:
    """Connection of one request, or of several in sequence, that any thread can cut.

    Pass `trace` to httpx as the request's extension `trace`.
    """

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._is_cut = False

    def trace(self, event: str, info: dict[str, Any]) -> None:
        """Store the socket when httpx reports that it is connected."""
        if event.endswith((".connect_tcp.complete", ".start_tls.complete")):
            self._socket = info["return_value"].get_extra_info("socket")
            # `cut` may run now, on another thread. It sets `_is_cut` and then reads the socket.
            # Here the order is reversed, so one of the two sees what the other has set.
            if self._is_cut:
                self.cut()

    def cut(self) -> None:
        """Shut the socket down, so that a waiting read ends at once."""
        self._is_cut = True
        if self._socket is not None:
            with suppress(OSError):  # it may have been closed by now
                # Not SSLSocket.shutdown, after which further reads are not decrypted.
                socket.socket.shutdown(self._socket, socket.SHUT_RDWR)


def explanation(body: bytes) -> str | bytes:
    """Return a server's explanation of an HTTP error, if it sent one; not sanitized."""
    text: Any = body
    with suppress(ValueError, RecursionError):
        text = json.loads(body)
    for key in ("error", "message", "detail"):
        if isinstance(text, dict) and key in text:
            text = text[key]
    return text if isinstance(text, (str, bytes)) else json.dumps(text)


def failure_reason(error: Exception) -> str:
    """Return why a request failed, and what to do, as the end of a message."""
    cause: BaseException = error
    # Find the innermost error: httpx wraps that of httpcore, which wraps that of the socket.
    while inner := cause.__cause__ or cause.__context__:
        cause = inner
    match cause:
        case socket.gaierror() | UnicodeError():  # UnicodeError: an invalid label in the name
            return "the host is not known; check the URL"
        case ssl.SSLCertVerificationError():
            return f"its certificate is not trusted ({one_line(cause.verify_message)})"
        case ConnectionRefusedError():
            return "nothing listens there; start the server or correct the URL"
        case ssl.SSLError():
            return f"does not speak TLS ({type(cause).__name__}); check the URL"
        case ConnectionError():
            return _BROKEN_OFF
        case OSError():
            return f"cannot be reached ({cause.strerror or type(cause).__name__}); check the URL"
    if not isinstance(error, httpx.RemoteProtocolError):
        return one_line(error) or type(error).__name__
    # The same exception stands for a connection that ends early, and for no HTTP.
    ended = any(words in str(error) for words in ("disconnected", "peer closed"))
    return _BROKEN_OFF if ended else f"does not speak HTTP ({one_line(error)}); check the URL"


_BROKEN_OFF = "closed the connection before its answer was complete; see the server's log"

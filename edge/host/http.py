"""HTTP requests that end in time, whatever the server sends.

httpx limits each read of a socket: a server that sends a byte now and then outlasts that, in a
header, in the length of a chunk or in what follows the last one. So the connection of a request can
be cut from another thread, which looks at the clock.
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


class GivenUpError(Exception):
    """The request was given up by whoever made it."""


@dataclass(frozen=True, slots=True)
class Reply:
    """A server's answer; the body is longer than allowed where it would have sent more."""

    status: int
    headers: httpx.Headers
    body: bytes


class Exchange:
    """One request, which a thread of its own carries out, as looking up a host name may take long.

    Args:
        connection: where the client keeps its connection, the one of the requests before; it is
            of no use any more once a request was given up.
    """

    def __init__(self, connection: Connection | None = None) -> None:
        self.connection = Connection() if connection is None else connection
        self._outcome: queue.SimpleQueue[Reply | Exception] = queue.SimpleQueue()

    def carry_out(
        self, client: httpx.Client, request: httpx.Request, max_bytes: int, limit_s: float
    ) -> Reply:
        """Send the request, and wait for the whole answer.

        Raises:
            TimeoutError: it was not there in time; the connection is cut.
            GivenUpError: another thread gave the request up.
            httpx.HTTPError, UnicodeError: see `failure`.
        """
        arguments = (client, request, max_bytes)
        threading.Thread(target=self._run, args=arguments, name="http", daemon=True).start()
        try:
            outcome = self._outcome.get(timeout=limit_s)
        except queue.Empty:
            outcome = TimeoutError()
            self.give_up(outcome)
        if isinstance(outcome, Reply):
            return outcome
        raise outcome

    def give_up(self, why: Exception) -> None:
        """Have whoever waits for the answer get this in its place; from any thread."""
        self._outcome.put(why)
        self.connection.cut()

    def _run(self, client: httpx.Client, request: httpx.Request, max_bytes: int) -> None:
        try:
            request.extensions["trace"] = self.connection.trace
            self._outcome.put(_receive(client.send(request, stream=True), max_bytes))
        except Exception as error:  # whatever it is, it is told where the answer is awaited
            self._outcome.put(error)


def _receive(response: httpx.Response, max_bytes: int) -> Reply:
    """Reads until more than `max_bytes` are there, or to the end."""
    body = bytearray()
    with closing(response):
        for chunk in response.iter_raw():
            body += chunk
            if len(body) > max_bytes:
                break
    return Reply(response.status_code, response.headers, bytes(body))


class Connection:
    """The connection of one request, or of several after each other, which any thread may cut.

    httpx takes `trace` as the request's extension of that name.
    """

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._is_cut = False

    def trace(self, event: str, info: dict[str, Any]) -> None:
        """Take note of the socket when httpx tells that it is connected."""
        if event.endswith((".connect_tcp.complete", ".start_tls.complete")):
            self._socket = info["return_value"].get_extra_info("socket")
            if self._is_cut:  # looked at after the socket is set: `cut` does the reverse
                self.cut()

    def cut(self) -> None:
        """Whoever waits for the server finds the connection ended, at once."""
        self._is_cut = True
        if self._socket is not None:
            with suppress(OSError):  # it may have been closed by now
                # Not SSLSocket's own: after that one, what is still read is not decrypted.
                socket.socket.shutdown(self._socket, socket.SHUT_RDWR)


def explanation(body: bytes) -> str | bytes:
    """What a server says about an HTTP error, where it says something; not made safe to show."""
    text: Any = body
    with suppress(ValueError, RecursionError):
        text = json.loads(body)
    for key in ("error", "message", "detail"):
        if isinstance(text, dict) and key in text:
            text = text[key]
    return text if isinstance(text, (str, bytes)) else json.dumps(text)


def failure(error: Exception) -> str:
    """Why a request brought no answer, and what to do, in the words of who asked."""
    cause: BaseException = error
    while inner := cause.__cause__ or cause.__context__:  # httpx wraps what httpcore wraps
        cause = inner
    match cause:
        case socket.gaierror() | UnicodeError():  # UnicodeError: a label no host name may have
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
    # Of its kind are both a connection that ends early and an answer that is no HTTP.
    ended = any(words in str(error) for words in ("disconnected", "peer closed"))
    return _BROKEN_OFF if ended else f"does not speak HTTP ({one_line(error)}); check the URL"


_BROKEN_OFF = "closed the connection before its answer was whole; see the server's log"

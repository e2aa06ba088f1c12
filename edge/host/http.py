"""HTTP requests that end in time, whatever the server sends.

httpx limits each read of a socket: a server that sends a byte now and then outlasts that, in a
header, in the length of a chunk or in what follows the last one. So the connection of a request can
be cut from another thread, which looks at the clock.
"""

from __future__ import annotations

import socket
import ssl
from contextlib import suppress
from typing import Any

import httpx

from edge.text import one_line


class Connection:
    """The connection of one request, which any thread may cut.

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

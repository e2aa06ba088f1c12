"""How long a server is waited for, whatever it sends meanwhile.

A socket's own time limit is for each read: a server that sends a byte now and then outlasts it,
in a header, in the length of a chunk or in what follows the last one. So the clock is looked at
with every read of the socket itself.
"""

from __future__ import annotations

import http.client
import io
import math
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from edge.models.part import Interrupted

_LEAST_S = 1e-3  # a socket's limit of 0 would mean not to wait at all


@dataclass(frozen=True)
class Limits:
    """How long a server is waited for.

    Attributes:
        answer_s: the head of an answer must be there after so long, with all that comes before
            it: connecting, TLS, a proxy, redirects.
        read_s: a connection that then brings nothing for so long is given up.
        slow_s, slow_bytes: so is one that brings less than so many bytes of content in so long.
        tries: connections to one address; each goes on where the last ended.
        page_s, page_bytes: of a page of an index, which must be there whole after so long.
    """

    answer_s: float = 30.0
    read_s: float = 30.0
    slow_s: float = 60.0
    slow_bytes: int = 1 << 16
    tries: int = 3
    page_s: float = 120.0
    page_bytes: int = 64 << 20


LIMITS = Limits()


class Pace:
    """How one request goes: begins with it, and is told when its answer is there.

    Args:
        whole_s: the content must be there after so long.
    """

    def __init__(self, limits: Limits, whole_s: float = math.inf) -> None:
        self._limits, self._whole_s = limits, whole_s
        self._began_s = self._since_s = time.monotonic()
        self._answered, self._came = False, 0

    @property
    def left_s(self) -> float:
        """How long the next read may take."""
        if self._answered:
            return self._limits.read_s
        return max(self._began_s + self._limits.answer_s - time.monotonic(), _LEAST_S)

    def answered(self) -> None:
        """The head of the answer is there: what comes now is content."""
        self._answered, self._since_s = True, time.monotonic()

    def took(self, n: int) -> None:
        """`n` bytes of content have come; see `check`."""
        self._came += n
        self.check()

    def check(self) -> None:
        """
        Raises:
            Interrupted: it takes too long.
        """
        now_s, limits = time.monotonic(), self._limits
        if not self._answered:
            if now_s - self._began_s > limits.answer_s:
                raise self.no_answer()
            return
        if now_s - self._began_s > self._whole_s:
            raise Interrupted(f"not whole after {self._whole_s:g} s")
        if now_s - self._since_s > limits.slow_s:
            if self._came < limits.slow_bytes:
                raise Interrupted(f"only {self._came} bytes came in {limits.slow_s:g} s")
            self._since_s, self._came = now_s, 0

    def no_answer(self) -> Interrupted:
        return Interrupted(f"no answer within {self._limits.answer_s:g} s")

    def nothing_came(self) -> Interrupted:
        return Interrupted(f"nothing came for {self._limits.read_s:g} s")


def connecting(
    kind: type[http.client.HTTPConnection], pace: Pace
) -> Callable[..., http.client.HTTPConnection]:
    """Makes connections of a kind whose answers keep the pace, as `urllib` makes them."""

    class Response(http.client.HTTPResponse):
        def __init__(self, sock: socket.socket, *args: Any, **options: Any) -> None:
            super().__init__(sock, *args, **options)
            self.fp = io.BufferedReader(_Paced(sock, self.fp.detach(), pace))

    def connect(host: str, **options: Any) -> http.client.HTTPConnection:
        connection = kind(host, **{**options, "timeout": pace.left_s})
        connection.response_class = Response
        return connection

    return connect


class _Paced(io.RawIOBase):
    """What comes in by a socket."""

    def __init__(self, sock: socket.socket, file: io.RawIOBase, pace: Pace) -> None:
        self._sock, self._file, self._pace = sock, file, pace

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        self._sock.settimeout(self._pace.left_s)
        n = self._file.readinto(buffer)
        if n:
            self._pace.check()
        return n

    def close(self) -> None:
        self._file.close()
        super().close()

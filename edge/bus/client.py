"""Client of `edge.bus.requests`: connect to the running service and send it a request.

Cheap to import, because the command line imports its errors from here.
"""

from __future__ import annotations

import json
import os
import threading
import time
from typing import TYPE_CHECKING

from edge.errors import UnavailableError
from edge.text import one_line, read_json_object

if TYPE_CHECKING:
    import zenoh

    from edge.config import ZenohConfig

CONNECT_S = 5.0
"""Longest time in seconds to connect."""
_TRIES, _AGAIN_S = 3, 0.3
"""Number of times to send a request that gets no reply, and the pause between them: a service
that gets too many requests at once drops some unread."""
_REASON_CHARS = 1000  # the longest error of a server, see `edge.bus.requests`
_ZENOH_TIMEOUT = b"Timeout"  # Zenoh's own payload if no answer came in time


class RequestError(UnavailableError):
    """The service cannot be reached or does not answer; the message is one line."""


class RefusedError(RequestError):
    """The service refused the request; the message quotes its reason."""

    exit_code = os.EX_DATAERR


def connect(
    settings: ZenohConfig,
    patience_s: float,
    what: str,
    whom: str = "service",
    start: str = "edge run",
) -> zenoh.Session:
    """Open a session with the service. The caller closes it.

    Args:
        settings: `zenoh` of the configuration.
        patience_s: how long to try, in seconds, at most `CONNECT_S`.
        what: the command's name, for the error message.
        whom: the process that should answer, for the error message.
        start: the command that starts this process, for the error message.

    Raises:
        RequestError: nothing listens there, or the session is refused.
    """
    from edge.bus.session import ConnectInterrupted, open_session

    timeout = threading.Event()
    timer = threading.Timer(min(CONNECT_S, patience_s), timeout.set)
    timer.daemon = True
    timer.start()
    try:
        return open_session(settings, "connect", timeout)
    except ConnectInterrupted as error:
        where = settings.address
        if error.unknown is not None:
            raise RequestError(f"{what}: {where}: {error.unknown}") from None
        if error.refused is not None:
            raise RequestError(f"{what}: refused at {where}: {error.refused}") from None
        raise RequestError(f"{what}: no {whom} at {where}; start one with `{start}`") from None
    finally:
        timer.cancel()


def send_request(
    session: zenoh.Session, key: str, request: dict, timeout_s: float, what: str
) -> dict:
    """Send a request to the service and return its answer.

    Args:
        session: an open session.
        key: Zenoh key of the server, such as `edge/mission/request`.
        request: the request, such as `{"do": "status"}`.
        timeout_s: how long to wait for the answer.
        what: the command's name, for the error message.

    Raises:
        RefusedError: the service refused the request.
        RequestError: no answer within `timeout_s`.
    """
    import zenoh

    for attempt in range(_TRIES):
        if attempt > 0:
            time.sleep(_AGAIN_S)
        replies = session.get(
            key, payload=json.dumps(request), encoding=zenoh.Encoding.APPLICATION_JSON,
            timeout=timeout_s, priority=zenoh.Priority.INTERACTIVE_HIGH, express=True,
        )  # fmt: skip
        for reply in replies:
            if reply.ok is not None:
                return _read_answer(key, reply.ok.payload.to_bytes(), what)
            content = reply.err.payload.to_bytes()
            if content == _ZENOH_TIMEOUT:
                raise RequestError(f"{what}: {key}: no answer within {timeout_s:g} s")
            reason = one_line(_read_answer(key, content, what).get("error"), _REASON_CHARS)
            raise RefusedError(f"{what}: refused: {reason}")
    raise RequestError(
        f"{what}: no service answers at {key}; start one with `edge run`. If one runs, its access "
        "rules must allow this client to send requests"
    )


def _read_answer(key: str, content: bytes, what: str) -> dict:
    """Parse an answer; raise RequestError if it is not a JSON object."""
    try:
        return read_json_object(content)
    except ValueError:
        shown = f"{content[:60]!r}"
        raise RequestError(f"{what}: {key}: the answer is not a JSON object: {shown}") from None

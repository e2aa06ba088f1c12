"""The client of `edge.bus.requests`: reach the running service, ask it for something.

Light to import, so that the command line can take its error from here.
"""

from __future__ import annotations

import json
import os
import threading
from typing import TYPE_CHECKING

from edge.errors import UnavailableError
from edge.text import one_line, read_json_object

if TYPE_CHECKING:
    import zenoh

    from edge.config import Zenoh

CONNECT_S = 5.0
_REASON_CHARS = 1000  # what a server sends at most, see `edge.bus.requests`
_ZENOH_TIMEOUT = b"Timeout"  # what Zenoh itself puts in the place of an answer


class RequestError(UnavailableError):
    """Nobody took the request; one line."""


class RefusedError(RequestError):
    """The service refused it, in its own words."""

    exit_code = os.EX_DATAERR


def connect(
    settings: Zenoh, patience_s: float, what: str, whom: str = "service", start: str = "edge run"
) -> zenoh.Session:
    """A session with the service; the caller closes it.

    Args:
        patience_s: how long to look for it, `CONNECT_S` at most.
        what: the command, for the error's line.
        whom: who should be there, for the message.
        start: the command that starts it, for the message.

    Raises:
        RequestError: nobody is there, or it does not take us in.
    """
    from edge.bus.session import NotTakenIn, open_session

    enough = threading.Event()
    timer = threading.Timer(min(CONNECT_S, patience_s), enough.set)
    timer.daemon = True
    timer.start()
    try:
        return open_session(settings, "connect", enough)
    except NotTakenIn as error:
        where = settings.address
        if error.unknown is not None:
            raise RequestError(f"{what}: {where}: {error.unknown}") from None
        if error.refused is not None:
            raise RequestError(f"{what}: refused at {where}: {error.refused}") from None
        raise RequestError(f"{what}: no {whom} at {where}; start one with `{start}`") from None
    finally:
        timer.cancel()


def ask(session: zenoh.Session, key: str, request: dict, timeout_s: float, what: str) -> dict:
    """The answer of the service whose requests go to `key`, such as `edge/mission/request`.

    Args:
        what: the command, for the error's line.

    Raises:
        RefusedError: it refused (its own words).
        RequestError: none answered within `timeout_s`.
    """
    import zenoh

    replies = session.get(
        key, payload=json.dumps(request), encoding=zenoh.Encoding.APPLICATION_JSON,
        timeout=timeout_s, priority=zenoh.Priority.INTERACTIVE_HIGH, express=True,
    )  # fmt: skip
    for reply in replies:
        if reply.ok is not None:
            return _object(key, reply.ok.payload.to_bytes(), what)
        content = reply.err.payload.to_bytes()
        if content == _ZENOH_TIMEOUT:
            raise RequestError(f"{what}: {key}: no answer within {timeout_s:g} s")
        reason = one_line(_object(key, content, what).get("error"), _REASON_CHARS)
        raise RefusedError(f"{what}: refused: {reason}")
    raise RequestError(
        f"{what}: no service answers at {key}; start one with `edge run`, or, where one runs, let "
        "its access rules permit us to ask"
    )


def _object(key: str, content: bytes, what: str) -> dict:
    try:
        return read_json_object(content)
    except ValueError:
        shown = f"{content[:60]!r}"
        raise RequestError(f"{what}: {key}: not the answer of a service: {shown}") from None

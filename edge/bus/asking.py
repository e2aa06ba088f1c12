"""The other side of a desk: reach the running service, give it an order, read its answer.

Light to import, so that the command line can take its error from here.
"""

from __future__ import annotations

import json
import os
import threading
from typing import TYPE_CHECKING

from edge.errors import Stopped, UnavailableError
from edge.text import one_line

if TYPE_CHECKING:
    import zenoh

    from edge.config import Zenoh

CONNECT_S = 5.0
_REASON_CHARS = 1000  # what a desk sends at most, see `edge.bus.desk`
_ZENOH_TIMEOUT = b"Timeout"  # what Zenoh itself puts in the place of an answer


class OrderError(UnavailableError):
    """Nobody took the order; one line."""


class RefusedError(OrderError):
    """The service refused it, in its own words."""

    exit_code = os.EX_DATAERR


def connect(settings: Zenoh, patience_s: float, what: str) -> zenoh.Session:
    """A session with the service; the caller closes it.

    Args:
        patience_s: how long to look for it, `CONNECT_S` at most.
        what: the command, for the error's line.

    Raises:
        OrderError: no service is there.
    """
    from edge.bus.session import open_session

    enough = threading.Event()
    timer = threading.Timer(min(CONNECT_S, patience_s), enough.set)
    timer.daemon = True
    timer.start()
    try:
        return open_session(settings, "connect", enough)
    except Stopped:
        where = settings.endpoint
        raise OrderError(f"{what}: no service at {where}; start one with `edge run`") from None
    finally:
        timer.cancel()


def ask(session: zenoh.Session, key: str, request: dict, timeout_s: float, what: str) -> dict:
    """Give an order to the desk at `key`; its answer.

    Raises:
        RefusedError: it refused (its own words).
        OrderError: none answered within `timeout_s`.
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
            raise OrderError(f"{what}: {key}: no answer within {timeout_s:g} s")
        reason = one_line(_object(key, content, what).get("error"), _REASON_CHARS)
        raise RefusedError(f"{what}: refused: {reason}")
    raise OrderError(f"{what}: no service answers at {key}; start one with `edge run`")


def _object(key: str, content: bytes, what: str) -> dict:
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise OrderError(f"{what}: {key}: not the answer of a service: {content[:60]!r}")
    return data

"""Requests to stop the robot and to release it, which pass all queues.

They have keys, Zenoh queryables and threads of their own. So they wait for no other request,
whatever its number. Any request to stop stops, also one without a payload or with a malformed one.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from functools import partial

import zenoh

from edge.bus import topics
from edge.bus.verbs import error_payload
from edge.config import ZenohConfig
from edge.errors import UserError
from edge.host.stop_latch import StopLatch
from edge.text import one_line, read_json_object

log = logging.getLogger("edge.bus.stop")

_RING_QUERIES = 16  # a full ring drops the oldest query; the others stop the robot as well

_CLOSE_S = 5.0  # longest wait for a thread that is replying

Reply = Callable[[bytes, bool], None]
"""Sends an answer; True: it is an error."""


class StopRequests:
    """The requests of one key, from any transport; `accept` is as that of `RequestQueue`.

    Args:
        act: takes the reason and returns the answer; raises UserError to refuse.
    """

    def __init__(self, act: Callable[[str], dict[str, object]]) -> None:
        self._act = act

    def accept(self, payload: bytes, reply: Reply) -> None:
        """Carry out a request at once, and reply."""
        try:
            why = read_json_object(payload).get("why")
        except ValueError:
            why = None
        try:
            answer = self._act(why if isinstance(why, str) else "")
        except UserError as error:
            reply(error_payload(str(error)), True)
        else:
            reply(json.dumps(answer).encode(), False)


def stop_requests(latch: StopLatch) -> dict[str, StopRequests]:
    """Return the requests to stop and to release, by key."""
    return {
        topics.STOP_REQUEST: StopRequests(latch.stop),
        topics.RELEASE_REQUEST: StopRequests(lambda why: latch.release()),
    }


class StopServer:
    """Answers requests to stop and to release over Zenoh, with a thread for each."""

    def __init__(
        self, session: zenoh.Session, settings: ZenohConfig, requests: dict[str, StopRequests]
    ) -> None:
        self._queryables, self._threads = [], []
        for name, accepted in requests.items():
            key = settings.key(name)  # type: ignore[arg-type]
            queryable = session.declare_queryable(key, zenoh.handlers.RingChannel(_RING_QUERIES))
            self._queryables.append(queryable)
            thread = threading.Thread(
                target=_serve, args=(queryable, key, accepted), name=key, daemon=True
            )
            self._threads.append(thread)
            thread.start()

    def close(self) -> None:
        """Accept no more requests, and wait for the threads.

        Python aborts at its end if it finds a thread in Zenoh's code.
        """
        for queryable in self._queryables:
            queryable.undeclare()
        for thread in self._threads:
            thread.join(_CLOSE_S)


def _serve(queryable: zenoh.Queryable, key: str, requests: StopRequests) -> None:
    """Answer queries until the queryable is undeclared, or its session is closed."""
    while True:
        try:
            query = queryable.handler.recv()
        except zenoh.ZError:
            return
        payload = b"" if query.payload is None else query.payload.to_bytes()
        try:
            requests.accept(payload, partial(_reply, query, key))
        except Exception as error:  # nothing may end this thread
            log.warning("the answer to %s could not be sent: %s", key, one_line(error))


def _reply(query: zenoh.Query, key: str, content: bytes, is_error: bool) -> None:
    with query:
        if is_error:
            query.reply_err(content, encoding=zenoh.Encoding.APPLICATION_JSON)
        else:
            query.reply(key, content, encoding=zenoh.Encoding.APPLICATION_JSON)

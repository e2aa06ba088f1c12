"""Server of requests to the running service over Zenoh: JSON in, one JSON answer out.

The server is a queryable. A query is `{"do": VERB, …}`; the answer is a JSON object, or the error
`{"error": <one line>}`. One thread receives queries and checks timeouts, a few threads send the
answers. Between them is a `RequestQueue`, which also accepts queries from other transports.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial

import zenoh

from edge.bus.request_queue import MAX_BYTES, PATIENCE_S, RequestQueue
from edge.bus.session import QueryRing
from edge.bus.verbs import Request, Verb, error_payload
from edge.text import one_line

log = logging.getLogger("edge.bus.requests")

_RING_QUERIES = 1024  # queries that Zenoh buffers: enough for 6,400 a second
_MOST_PER_POLL = 128  # queries
_RECEIVE_S = 0.02  # period of polls
_SENDERS = 4  # threads


class RequestServer:
    """Accepts requests over Zenoh until it is closed.

    Attributes:
        queue: the queue of requests; other transports may add queries to it.
        serve: see `RequestQueue.serve`.
        poll: see `RequestQueue.poll`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        verbs: Mapping[str, Verb],
        handle: Callable[[Request, int], dict],
        patience_s: float = PATIENCE_S,
    ) -> None:
        self.key = key
        self.queue = RequestQueue(key, verbs, handle, patience_s)
        self.serve, self.poll = self.queue.serve, self.queue.poll
        self._replies: queue.SimpleQueue[tuple[zenoh.Query, bytes, bool] | None]
        self._replies = queue.SimpleQueue()
        self._closing = threading.Event()
        # A full ring drops the oldest query; a full FIFO would block the session.
        self._ring = QueryRing(session, key, _RING_QUERIES)
        self._polled: deque[zenoh.Query] = deque()  # taken from the ring, not handled yet
        loops = [self._receive_all, *[self._send_all] * _SENDERS]
        self._threads = [
            threading.Thread(target=loop, name=f"{key}{loop.__name__}", daemon=True)
            for loop in loops
        ]
        for thread in self._threads:
            thread.start()

    @property
    def overruns(self) -> int:
        """Number of polls at which the ring was full, so queries may be lost (`Ring.overruns`)."""
        return self._ring.overruns

    def close(self, timeout_s: float = 1.0) -> None:
        """Refuse open queries and accept no more; a running preparation is abandoned."""
        self._closing.set()
        until_s = time.monotonic() + timeout_s
        for thread in (*self._threads, self.queue):
            thread.join(max(until_s - time.monotonic(), 0.0))

    # -- the receiving thread

    def _receive_all(self) -> None:
        """Receive queries until the server is closed; then refuse those that are left."""
        try:
            while not self._closing.wait(_RECEIVE_S):
                for query in self._take_queries(_MOST_PER_POLL):
                    self._receive(query)
                self.queue.expire()
            self.queue.close()
            for query in self._take_queries(2 * _RING_QUERIES):
                self._receive(query)
            self._ring.close()
        except zenoh.ZError as error:
            log.warning(
                "requests are no longer accepted, the Zenoh session is closed: %s", _reason(error)
            )
        finally:
            self._closing.set()
            self.queue.close()
            for _ in range(_SENDERS):
                self._replies.put(None)

    def _take_queries(self, most: int) -> Iterator[zenoh.Query]:
        """Yield at most `most` queries that have arrived."""
        for _ in range(most):
            if not self._polled:
                self._polled.extend(self._ring.take())
            if not self._polled:
                return
            yield self._polled.popleft()

    def _receive(self, query: zenoh.Query) -> None:
        """Pass a query to the queue, or refuse it."""
        reply = partial(self._reply, query)
        try:
            self.queue.accept(_payload(query), reply)
        except ValueError as error:
            reply(error_payload(str(error)), True)
        except Exception as error:  # nothing may end this thread
            log.exception("a request was refused because of an internal error")
            reply(error_payload(f"internal error: {type(error).__name__}"), True)

    def _reply(self, query: zenoh.Query, reply: bytes, is_error: bool) -> None:
        self._replies.put((query, reply, is_error))

    # -- the sending threads. Several, because a reply to a stopped client blocks its thread.

    def _send_all(self) -> None:
        while (entry := self._replies.get()) is not None:
            self._send(*entry)

    def _send(self, query: zenoh.Query, reply: bytes, is_error: bool) -> None:
        """Send a reply and release the query; until then its client waits."""
        try:
            with query as asked:
                if is_error:
                    asked.reply_err(reply, encoding=zenoh.Encoding.APPLICATION_JSON)
                else:
                    asked.reply(self.key, reply, encoding=zenoh.Encoding.APPLICATION_JSON)
        except Exception as error:  # nothing may end this thread
            log.warning("the answer to a request could not be sent: %s", _reason(error))


def _payload(query: zenoh.Query) -> bytes:
    """Return a query's payload; raise ValueError if it is empty or too long."""
    payload = query.payload
    if payload is None or not len(payload):
        raise ValueError("the request has no payload: expected a JSON object")
    if len(payload) > MAX_BYTES:
        raise ValueError(f"the request has {len(payload)} bytes, at most {MAX_BYTES} are allowed")
    return payload.to_bytes()


def _reason(error: Exception) -> str:
    """Return an error's text, without the location in Zenoh's source."""
    return one_line(str(error).split(" at /")[0])

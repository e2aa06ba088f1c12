"""Queue of requests to the loop, independent of the transport; JSON in, JSON out.

A query is one message of a client. A request is what the loop handles: several equal queries become
one request, and each of them gets its answer.

There are two lanes. Requests in the first need no preparation. Requests in the second are prepared
by a thread first, for example translated. The loop only polls the lanes, so neither a slow
preparation nor a slow client blocks the robot.

The sender of a query is unknown, so a flood is limited by content, not by sender:

- Requests of the first lane are served before those of the second.
- Equal queries are merged: the loop handles them once.
- A request that stops the robot always finds a place, at the end of the first lane. It also cancels
  all requests in the second lane: they are refused, so that after the answer to a stop only a later
  request moves the robot.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from edge.bus.verbs import Request, Verb, error_payload, read_request
from edge.errors import UserError

log = logging.getLogger("edge.bus.request_queue")

MAX_BYTES = 65536
"""Longest request in bytes."""
PATIENCE_S = 2.0
"""Time in seconds in which the loop must answer a request."""

_MAX_SERVED = 12  # requests in one call of `serve`: more than `_MAX_WAITING`
_MAX_UNPREPARED = 2  # requests that wait for preparation, in addition to the one in preparation
_MAX_WAITING = 8  # requests in each lane; stops may exceed it
_MAX_MERGED = 256  # queries merged into one request, whose preparation may take minutes
_BUSY = "busy with other requests; try again later"
_STOPPED = "cancelled by a stop request that came later: send it again"
_STOPPING = "the service is stopping"


@dataclass(eq=False)
class Query:
    """One query of a client.

    Attributes:
        reply: called once with (payload, is_error), from any thread. Must not block.
        until_s: monotonic time at which the client has waited long enough; infinite while the
            request waits for preparation.
    """

    reply: Callable[[bytes, bool], None]
    until_s: float = math.inf


class RequestQueue:
    """Accepts requests until it is closed.

    Args:
        name: prefix of the name of the preparation thread.
        verbs: the known requests, by name.
        handle: carries out a request at the loop's time in nanoseconds; called by `serve`. Returns
            the answer. Raises UserError to refuse the request and change nothing.
        patience_s: how long the loop may take to answer.
    """

    def __init__(
        self,
        name: str,
        verbs: Mapping[str, Verb],
        handle: Callable[[Request, int], dict],
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._verbs, self._handle = verbs, handle
        self._patience_s = patience_s
        self._lock = threading.Lock()  # for both lanes and the open queries
        self._to_prepare = threading.Condition(self._lock)
        # The two lanes.
        self._first: list[Request] = []
        self._second: list[Request] = []  # prepared, or waiting for preparation
        self._open: set[Query] = set()
        self._polled_s = -math.inf
        self._closed = False
        self._thread = threading.Thread(
            target=self._prepare_all, name=f"{name}_prepare_all", daemon=True
        )
        self._thread.start()

    # -- called by the loop --------------------------------------------------------------------

    def serve(self, now_ns: int) -> int:
        """Handle waiting requests; called by the loop, never blocks.

        At most one prepared request is handled per call, since a new mission takes a while to
        start.

        Returns:
            The number of requests that were handled.

        Raises:
            Exception: a handler failed; its clients got an error.
        """
        for served in range(_MAX_SERVED):
            if (request := self.poll()) is None:
                return served
            try:
                request.answer(self._handle(request, now_ns))
            except UserError as error:
                request.refuse(str(error))
            except Exception as error:
                request.refuse(f"internal error: {type(error).__name__}: {error}")
                raise
            if self._verbs[request.do].prepare is not None:
                return served + 1
        return _MAX_SERVED

    def poll(self) -> Request | None:
        """Return the next ready request, or None. The first lane comes before the second."""
        self._polled_s = time.monotonic()
        if not self._first and not self._second:
            return None
        with self._lock:
            for lane in (self._first, self._second):
                if lane and lane[0].ready:
                    return lane.pop(0)
        return None

    # -- called by transports ------------------------------------------------------------------

    def accept(self, payload: bytes, reply: Callable[[bytes, bool], None]) -> None:
        """Accept one query. It is answered exactly once in every case.

        Args:
            payload: JSON, at most `MAX_BYTES`.
            reply: see `Query`.
        """
        query = Query(reply)
        with self._lock:
            self._open.add(query)
            closed = self._closed
        if closed:
            self._finish((query,), error_payload(_STOPPING), True)
            return
        try:
            do, fields = read_request(payload, self._verbs)
        except ValueError as error:
            self._finish((query,), error_payload(str(error)), True)
            return
        except Exception as error:  # else it would end the transport's thread
            log.exception(
                "a request could not be read: a bug in edge; please report this traceback"
            )
            self._finish((query,), error_payload(_internal(error)), True)
            return
        cancelled: list[Request] = []
        with self._lock:
            if self._verbs[do].stops_robot:
                cancelled, self._second = self._second, []
            if (request := self._find_place(do, fields)) is not None:
                request.queries.append(query)
                request.cancelled += len(cancelled)
                if request.ready:
                    query.until_s = time.monotonic() + self._patience_s
                self._to_prepare.notify()
        for other in cancelled:
            other.refuse(_STOPPED)
        if request is None:
            self._finish((query,), error_payload(_BUSY), True)

    def expire(self) -> None:
        """Answer queries that have waited too long with an error; call this periodically."""
        now_s, waiting = time.monotonic(), set[Query]()
        with self._lock:
            late = {query for query in self._open if now_s >= query.until_s}
            for lane in (self._first, self._second) if late else ():
                for request in lane:
                    waiting.update(late.intersection(request.queries))
                    request.queries = [query for query in request.queries if query not in late]
                lane[:] = [request for request in lane if request.queries]
            polled_s = self._polled_s
        limit = f"within {self._patience_s:g} s"
        # Late queries in a lane were not handled; the loop has taken the others.
        why = f"the loop is not running: request not handled {limit}"
        if now_s - polled_s < self._patience_s:
            why = f"busy with other requests: not handled {limit}; try again later"
        self._finish(waiting, error_payload(why), True)
        accepted = f"request accepted, but not answered {limit}; ask for the status"
        self._finish(late - waiting, error_payload(accepted), True)

    def close(self) -> None:
        """Refuse all open and future queries; does not wait."""
        with self._lock:
            self._closed = True
            left = tuple(self._open)
            self._to_prepare.notify()
        self._finish(left, error_payload(_STOPPING), True)

    def join(self, timeout_s: float) -> None:
        """Wait for the preparation thread after `close`; after the timeout it is abandoned."""
        self._thread.join(timeout_s)

    def _find_place(self, do: str, fields: dict) -> Request | None:
        """Return the request that a query joins, or a new one in its lane.

        A query joins an equal request only if that request is the last of its lane. Otherwise the
        query would be handled before a different request that came earlier. Exception: a stop joins
        an equal stop if only stops and requests that only read are behind it. So few stops wait,
        however many arrive, and a stop is never refused.

        Returns:
            The request; None if the lane, or the equal request, is full.
        """
        verb = self._verbs[do]
        lane = self._first if verb.prepare is None else self._second
        for request in reversed(lane):  # from the last one
            if (request.do, request.fields) == (do, fields):
                return request if verb.stops_robot or len(request.queries) < _MAX_MERGED else None
            other = self._verbs[request.do]
            if not verb.stops_robot or not (other.stops_robot or other.read_only):
                break
        full = len(lane) >= _MAX_WAITING
        if not verb.stops_robot and (
            full or (verb.prepare and len(self._unprepared()) > _MAX_UNPREPARED)
        ):
            return None
        lane.append(Request(do, fields, self._finish, ready=verb.prepare is None))
        return lane[-1]

    def _finish(self, queries: Iterable[Query], reply: bytes, is_error: bool) -> None:
        """Send a reply to each query that has none yet; see `edge.bus.verbs.Finish`."""
        with self._lock:
            finished = self._open.intersection(queries)
            self._open -= finished
        for query in finished:
            query.reply(reply, is_error)

    # -- preparation thread. A stop may refuse the request in preparation. Its result then has no
    # effect: the request is in no lane, and only a query's first answer counts.

    def _prepare_all(self) -> None:
        while (request := self._wait_for_work()) is not None:
            self._prepare(request)

    def _wait_for_work(self) -> Request | None:
        """Wait for the next request to prepare; None if the queue is closed."""
        with self._to_prepare:
            self._to_prepare.wait_for(lambda: self._closed or self._unprepared())
            return None if self._closed else self._unprepared()[0]

    def _unprepared(self) -> list[Request]:
        """Return the requests that need preparation; the first is in preparation."""
        return [request for request in self._second if not request.ready]

    def _prepare(self, request: Request) -> None:
        """Prepare a request and mark it as ready, or refuse it."""
        try:
            prepared = self._verbs[request.do].prepare(request.fields)
        except UserError as error:
            self._drop_failed(request, error)
        except Exception as error:
            log.exception(
                "request %s failed: a bug in edge; please report this traceback", request.do
            )
            self._drop_failed(request, UserError(_internal(error)))
        else:
            with self._lock:
                request.prepared, request.ready = prepared, True
                until_s = time.monotonic() + self._patience_s
                for query in request.queries:
                    query.until_s = until_s

    def _drop_failed(self, request: Request, error: UserError) -> None:
        """Refuse a request whose preparation failed, and remove it from its lane."""
        with self._lock:
            if request in self._second:
                self._second.remove(request)
        request.refuse(str(error), error.details)


def _internal(error: Exception) -> str:
    """Return the refusal for an error that is a bug."""
    return f"internal error: {type(error).__name__}: {error}"

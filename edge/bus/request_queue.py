"""Requests on their way to the loop, whichever transport brought them; JSON in, JSON out.

One thread prepares requests that take a while to understand. The loop only looks into two lanes,
so neither a slow preparation nor a slow client holds up the robot.

Nobody tells whose a query is, so a flood is limited by what it asks for, not by who asks:
requests that need no preparation pass all others, equal ones are one for the loop, and those that
stop the robot always find a place. These also end whatever was asked for before and is still to be
prepared or begun: once a stop was answered, only a later request sets the robot going.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from edge.bus.verbs import Request, Verb, error_of, read_request
from edge.errors import UserError

log = logging.getLogger("edge.bus.request_queue")

MAX_BYTES = 65536
PATIENCE_S = 2.0

_SERVED = 12  # a look of the loop: more than wait in the first lane
_WAITING_NEW = 2  # to be prepared, besides the one that is being worked on
_WAITING = 8  # requests in each lane
_SAME = 256  # queries of one request, which may take minutes to prepare
_BUSY = "busy with other requests; try again later"
_STOPPED = "stopped meanwhile: give it again"
_STOPPING = "the service is stopping"


@dataclass(eq=False)
class Query:
    """One query of a client.

    Attributes:
        reply: sends the answer, or with True an error; called once, by any thread. Never blocks.
        until_s: when the client has waited long enough.
    """

    reply: Callable[[bytes, bool], None]
    until_s: float = math.inf


class RequestQueue:
    """Takes requests until it is closed.

    Args:
        name: of the thread that prepares.
        verbs: what can be asked for.
        handle: does what a request asks for, at the loop's time; called by `serve`. Returns the
            answer; raises UserError to refuse and change nothing.
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
        self._lock = threading.Lock()  # for the two lanes and what is open
        self._to_prepare = threading.Condition(self._lock)
        self._first: list[Request] = []
        self._second: list[Request] = []  # prepared, or to be prepared
        self._open: set[Query] = set()
        self._polled_s = -math.inf
        self._closed = False
        self._thread = threading.Thread(
            target=self._prepare_all, name=f"{name}_prepare_all", daemon=True
        )
        self._thread.start()

    # -- for the loop --------------------------------------------------------------------------

    def serve(self, now_ns: int) -> int:
        """Do what waits, for one look: a few, of which one was prepared, since a new mission takes
        a while to begin. For the loop: never blocks.

        Returns:
            How many there were.

        Raises:
            Exception: a handler failed; who asked was told.
        """
        for served in range(_SERVED):
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
        return _SERVED

    def poll(self) -> Request | None:
        """The next request, if there is one; a prepared one when no other waits."""
        self._polled_s = time.monotonic()
        if not self._first and not self._second:
            return None
        with self._lock:
            for lane in (self._first, self._second):
                if lane and lane[0].ready:
                    return lane.pop(0)
        return None

    # -- for those who bring queries -----------------------------------------------------------

    def take(self, payload: bytes, reply: Callable[[bytes, bool], None]) -> None:
        """One query; it is answered once, whatever becomes of it.

        Args:
            payload: JSON, of at most `MAX_BYTES`.
            reply: see `Query`.
        """
        query = Query(reply)
        with self._lock:
            self._open.add(query)
            closed = self._closed
        if closed:
            self._finish((query,), error_of(_STOPPING), True)
            return
        try:
            do, fields = read_request(payload, self._verbs)
        except ValueError as error:
            self._finish((query,), error_of(str(error)), True)
            return
        overtaken: list[Request] = []
        with self._lock:
            if self._verbs[do].stops:
                overtaken, self._second = self._second, []
            if (request := self._place(do, fields)) is not None:
                request.queries.append(query)
                request.overtaken += len(overtaken)
                if request.ready:
                    query.until_s = time.monotonic() + self._patience_s
                self._to_prepare.notify()
        for stopped in overtaken:
            stopped.refuse(_STOPPED)
        if request is None:
            self._finish((query,), error_of(_BUSY), True)

    def give_up(self) -> None:
        """Tell those who have waited long enough; for a thread that comes by now and then."""
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
        why = f"the loop is not running: not taken {limit}"
        if now_s - polled_s < self._patience_s:
            why = f"busy with other requests: not taken {limit}; try again later"
        self._finish(waiting, error_of(why), True)
        taken = f"taken, but not answered {limit}; ask for the status"
        self._finish(late - waiting, error_of(taken), True)

    def close(self) -> None:
        """Refuse what is open, and whatever still comes; waits for nothing."""
        with self._lock:
            self._closed = True
            left = tuple(self._open)
            self._to_prepare.notify()
        self._finish(left, error_of(_STOPPING), True)

    def join(self, timeout_s: float) -> None:
        """Wait for the thread that prepares, once closed; one that goes on is abandoned."""
        self._thread.join(timeout_s)

    def _place(self, do: str, fields: dict) -> Request | None:
        """The request that a query joins, or a new one in its lane; None: too many wait.

        A query joins the last request, if that asks for the same, however far it is. It passes no
        other, or the other would have the last word. Only what stops the robot joins an equal one
        even past other stops, so however many come, only few of them wait, and none is ever turned
        away.
        """
        verb = self._verbs[do]
        lane = self._first if verb.prepare is None else self._second
        for request in reversed(lane):
            if (request.do, request.fields) == (do, fields):
                return request if verb.stops or len(request.queries) < _SAME else None
            other = self._verbs[request.do]
            if not verb.stops or not (other.stops or other.reads):
                break
        full = len(lane) >= _WAITING
        if not verb.stops and (full or (verb.prepare and len(self._unready()) > _WAITING_NEW)):
            return None
        lane.append(Request(do, fields, self._finish, ready=verb.prepare is None))
        return lane[-1]

    def _finish(self, queries: Iterable[Query], reply: bytes, is_error: bool) -> None:
        """See `edge.bus.verbs.Finish`."""
        with self._lock:
            finished = self._open.intersection(queries)
            self._open -= finished
        for query in finished:
            query.reply(reply, is_error)

    # -- the thread that prepares. What it works on may be overtaken, and its queries refused. Then
    # what follows changes nothing: it is in no lane, and a query's first answer counts.

    def _prepare_all(self) -> None:
        while (request := self._wait_for_work()) is not None:
            self._prepare(request)

    def _wait_for_work(self) -> Request | None:
        """The next request to prepare; None when the queue is closed."""
        with self._to_prepare:
            self._to_prepare.wait_for(lambda: self._closed or self._unready())
            return None if self._closed else self._unready()[0]

    def _unready(self) -> list[Request]:
        """Requests to prepare: the first is worked on, others wait for that."""
        return [request for request in self._second if not request.ready]

    def _prepare(self, request: Request) -> None:
        try:
            prepared = self._verbs[request.do].prepare(request.fields)
        except UserError as error:
            self._drop(request, error)
        except Exception as error:
            log.exception("a request could not be prepared")
            self._drop(request, UserError(f"internal error: {type(error).__name__}: {error}"))
        else:
            with self._lock:
                request.prepared, request.ready = prepared, True
                until_s = time.monotonic() + self._patience_s
                for query in request.queries:
                    query.until_s = until_s

    def _drop(self, request: Request, error: UserError) -> None:
        with self._lock:
            if request in self._second:
                self._second.remove(request)
        request.refuse(str(error), error.details)

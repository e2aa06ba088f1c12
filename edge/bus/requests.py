"""Requests to the running service over Zenoh: JSON in, one answer out, nobody waits.

A server is a queryable: `{"do": VERB, …}` comes in, a JSON object or an error
`{"error": <one line>}` goes out, for every query. One thread receives and keeps time, one prepares
requests that take a while to understand, a few send the answers. The loop only looks into two
lanes, so neither a slow preparation nor a slow client holds up the robot.

Zenoh does not tell whose a query is, so a flood is limited by what it asks for, not by who asks:
requests that need no preparation pass all others, equal ones are one for the loop, and those that
stop the robot always find a place. These also end whatever was asked for before and is still to be
prepared or begun: once a stop was answered, only a later request sets the robot going.
"""

from __future__ import annotations

import json
import logging
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import zenoh

from edge.bus.session import QueryRing
from edge.errors import UserError
from edge.text import one_line, read_json_object

log = logging.getLogger("edge.bus.requests")

MAX_BYTES = 65536
MAX_CHARS = 10_000
MAX_ERROR_CHARS = 1000
PATIENCE_S = 2.0

_ARRIVED = 1024  # kept by Zenoh until as many before them are received: 6,400 a second
_A_LOOK = 128
_RECEIVE_S = 0.02
_SERVED = 12  # a look of the loop: more than wait in the first lane
_WAITING_NEW = 2  # to be prepared, besides the one that is being worked on
_WAITING = 8  # requests in each lane
_SAME = 256  # queries of one request, which may take minutes to prepare
_SENDERS = 4
_BUSY = "busy with other requests; try again later"
_STOPPED = "stopped meanwhile: give it again"


@dataclass(frozen=True)
class Verb:
    """One thing that can be asked for.

    Attributes:
        fields: the names of what a request may have besides `do`.
        read: makes the request's fields of those that came; raises ValueError, with one line.
        prepare: for what takes a while: called with the fields on a thread of the server, one
            request at a time; raises UserError for what cannot be done.
        stops: it stops the robot: never refused as one too many, and whatever was to be prepared
            before it is refused.
        reads: it changes nothing.
    """

    fields: tuple[str, ...] = ()
    read: Callable[[dict], dict] = dict
    prepare: Callable[[dict], object] | None = None
    stops: bool = False
    reads: bool = False


def read_request(payload: bytes, verbs: Mapping[str, Verb]) -> tuple[str, dict]:
    """A request's verb and its fields.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    data = read_json_object(payload)
    do = data.pop("do", None)
    if not isinstance(do, str) or do not in verbs:
        raise ValueError(f"do: unknown {shown(do)} (choices: {', '.join(verbs)})")
    if unknown := sorted(data.keys() - set(verbs[do].fields)):
        raise ValueError(f"{unknown[0]!r:.40}: not taken with do: {do}")
    return do, verbs[do].read(data)


def check_text(name: str, text: object, limit: int = MAX_CHARS) -> str:
    """A request's text as it came.

    Raises:
        ValueError: it is not text, says nothing, or is longer than `limit` characters.
    """
    if not isinstance(text, str) or not text.strip():
        raise ValueError(f"{name}: expected text, got {shown(text)}")
    if len(text) > limit:
        raise ValueError(f"{name}: {len(text)} characters, at most {limit} are taken")
    if any("\ud800" <= c <= "\udfff" for c in text):
        raise ValueError(f"{name}: not Unicode text")
    return text


def shown(value: object) -> str:
    """For a message; what is nested is not shown, since it may be nested very deep."""
    plain = value is None or isinstance(value, (str, int, float))
    return f"{value!r:.40}" if plain else f"a {type(value).__name__}"


@dataclass(eq=False)
class Query:
    """One query of a client; `until_s` is when it has waited long enough for its answer."""

    asked: zenoh.Query
    until_s: float = math.inf

    def payload(self) -> bytes:
        """ValueError when there is none, or too much of it."""
        payload = self.asked.payload
        if payload is None or not len(payload):
            raise ValueError("no payload: expected a JSON object")
        if len(payload) > MAX_BYTES:
            raise ValueError(f"{len(payload)} bytes, at most {MAX_BYTES} are taken")
        return payload.to_bytes()


Finish = Callable[[Iterable[Query], bytes, bool], None]
"""Sends a reply, or an error, to each of these queries that has none yet. Never blocks."""


@dataclass(eq=False)
class Request:
    """What the loop does once, for all who asked for it one after the other.

    Attributes:
        queries: of those.
        prepared: what `Verb.prepare` made of it.
        ready: for the loop.
        overtaken: how many different requests, made before and not begun, this one stopped.
    """

    do: str
    fields: dict = field(default_factory=dict)
    finish: Finish = lambda queries, reply, is_error: None
    queries: list[Query] = field(default_factory=list)
    prepared: object | None = None
    ready: bool = True
    overtaken: int = 0

    def answer(self, data: dict) -> None:
        """Send what JSON can carry (finite numbers only). Only the first call of `answer` or
        `refuse` counts, and only within the server's patience."""
        # Encoded here: the dict is the caller's, who may go on to change it.
        try:
            reply = json.dumps(data, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            log.error("an answer to a request is not JSON: %s", error)
            self.refuse("internal error: the answer is not JSON")
        else:
            self.finish(self.queries, reply, False)

    def refuse(self, reason: str) -> None:
        """Send an error instead."""
        self.finish(self.queries, _error(reason), True)


def _error(reason: str) -> bytes:
    return json.dumps({"error": one_line(reason, MAX_ERROR_CHARS)}).encode()


class RequestServer:
    """Takes requests until it is closed.

    Args:
        key: of the queryable.
        verbs: what can be asked for.
        handle: does what a request asks for, at the loop's time; called by `serve`. Returns the
            answer; raises UserError to refuse and change nothing.
        patience_s: how long the loop may take to answer.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        verbs: Mapping[str, Verb],
        handle: Callable[[Request, int], dict],
        patience_s: float = PATIENCE_S,
    ) -> None:
        self.key, self._verbs, self._handle = key, verbs, handle
        self._patience_s = patience_s
        self._lock = threading.Lock()  # for the two lanes and what is open
        self._to_prepare = threading.Condition(self._lock)
        self._first: list[Request] = []
        self._second: list[Request] = []  # prepared, or to be prepared
        self._open: set[Query] = set()
        self._polled_s = -math.inf
        self._replies: queue.SimpleQueue[tuple[Query, bytes, bool] | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        # A ring lets the oldest go when it is full; a FIFO would block the session.
        self._ring = QueryRing(session, key, _ARRIVED)
        self._looked: deque[zenoh.Query] = deque()  # taken from the ring, and yet to be received
        tasks = [self._receive_all, self._prepare_all, *[self._send_all] * _SENDERS]
        self._threads = [
            threading.Thread(target=task, name=f"{key}{task.__name__}", daemon=True)
            for task in tasks
        ]
        for thread in self._threads:
            thread.start()

    @property
    def overruns(self) -> int:
        """Looks that found more queries come than are received, so that some may have been let go
        unanswered (see `Ring.overruns`)."""
        return self._ring.overruns

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

    def close(self, timeout_s: float = 1.0) -> None:
        """Refuse what is open and take nothing more; a preparation that goes on is abandoned."""
        self._closing.set()
        until_s = time.monotonic() + timeout_s
        for thread in self._threads:
            thread.join(max(until_s - time.monotonic(), 0.0))

    # The thread that receives.

    def _receive_all(self) -> None:
        try:
            while not self._closing.wait(_RECEIVE_S):
                for query in self._arrived(_A_LOOK):
                    self._receive(query)
                self._give_up(time.monotonic())
            self._note(self._arrived(2 * _ARRIVED))
            self._ring.close()
        except zenoh.ZError as error:
            log.warning("no more requests are taken, the session is closed: %s", _reason(error))
        finally:
            self._closing.set()
            with self._lock:
                left = tuple(self._open)
                self._to_prepare.notify()
            self._finish(left, _error("the service is stopping"), True)
            for _ in range(_SENDERS):
                self._replies.put(None)

    def _arrived(self, most: int) -> Iterator[Query]:
        for _ in range(most):
            if not self._looked:
                self._looked.extend(self._ring.take())
            if not self._looked:
                return
            yield Query(self._looked.popleft())

    def _note(self, queries: Iterable[Query]) -> None:
        with self._lock:
            self._open.update(queries)

    def _receive(self, query: Query) -> None:
        self._note((query,))
        try:
            do, fields = read_request(query.payload(), self._verbs)
        except ValueError as error:
            self._finish((query,), _error(str(error)), True)
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
            self._finish((query,), _error(_BUSY), True)

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

    def _give_up(self, now_s: float) -> None:
        waiting: set[Query] = set()
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
        self._finish(waiting, _error(why), True)
        taken = f"taken, but not answered {limit}; ask for the status"
        self._finish(late - waiting, _error(taken), True)

    def _finish(self, queries: Iterable[Query], reply: bytes, is_error: bool) -> None:
        """See `Finish`."""
        with self._lock:
            finished = self._open.intersection(queries)
            self._open -= finished
        for query in finished:
            self._replies.put((query, reply, is_error))

    # The thread that prepares. What it works on may be overtaken, and its queries refused. Then
    # what follows changes nothing: it is in no lane, and a query's first answer counts.

    def _prepare_all(self) -> None:
        while (request := self._wait_for_work()) is not None:
            self._prepare(request)

    def _wait_for_work(self) -> Request | None:
        """The next request to prepare; None when the server closes."""
        with self._to_prepare:
            self._to_prepare.wait_for(lambda: self._closing.is_set() or self._unready())
            return None if self._closing.is_set() else self._unready()[0]

    def _unready(self) -> list[Request]:
        """Requests to prepare: the first is worked on, others wait for that."""
        return [request for request in self._second if not request.ready]

    def _prepare(self, request: Request) -> None:
        try:
            prepared = self._verbs[request.do].prepare(request.fields)
        except UserError as error:
            self._drop(request, str(error))
        except Exception as error:
            log.exception("a request could not be prepared")
            self._drop(request, f"internal error: {type(error).__name__}: {error}")
        else:
            with self._lock:
                request.prepared, request.ready = prepared, True
                until_s = time.monotonic() + self._patience_s
                for query in request.queries:
                    query.until_s = until_s

    def _drop(self, request: Request, reason: str) -> None:
        with self._lock:
            if request in self._second:
                self._second.remove(request)
        request.refuse(reason)

    # The others: one that answers a stopped client waits until Zenoh lets that one go.

    def _send_all(self) -> None:
        while (entry := self._replies.get()) is not None:
            self._send(*entry)

    def _send(self, query: Query, reply: bytes, is_error: bool) -> None:
        """Reply and let the query go, or its client would wait on."""
        try:
            with query.asked as asked:
                if is_error:
                    asked.reply_err(reply, encoding=zenoh.Encoding.APPLICATION_JSON)
                else:
                    asked.reply(self.key, reply, encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            log.warning("an answer to a request was lost: %s", _reason(error))


def _reason(error: zenoh.ZError) -> str:
    """Without the place in Zenoh's source."""
    return str(error).split(" at /")[0]

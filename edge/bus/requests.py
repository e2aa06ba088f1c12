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
from edge.text import one_line

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
    try:
        data = json.loads(payload)
    except (ValueError, RecursionError):
        raise ValueError("not JSON") from None
    if not isinstance(data, dict):
        raise ValueError("not a JSON object")
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


class Query:
    """One query, from its arrival to its one answer."""

    def __init__(self, query: zenoh.Query, answered: Callable[[Query], None]) -> None:
        self.until_s = math.inf
        self._query, self._answered = query, answered
        self._first = threading.Lock()
        self._reply: bytes = b""
        self._is_error = False

    def payload(self) -> bytes:
        """ValueError when there is none, or too much of it."""
        payload = self._query.payload
        if payload is None or not len(payload):
            raise ValueError("no payload: expected a JSON object")
        if len(payload) > MAX_BYTES:
            raise ValueError(f"{len(payload)} bytes, at most {MAX_BYTES} are taken")
        return payload.to_bytes()

    def refuse(self, reason: str) -> None:
        line = one_line(reason, MAX_ERROR_CHARS)
        self.finish(json.dumps({"error": line}).encode(), is_error=True)

    def finish(self, reply: bytes, is_error: bool) -> None:
        """Only the first counts."""
        if self._first.acquire(blocking=False):
            self._reply, self._is_error = reply, is_error
            self._answered(self)

    def send(self, key: str) -> None:
        """Reply and let the query go, or its client would wait on."""
        try:
            with self._query as query:
                if self._is_error:
                    query.reply_err(self._reply, encoding=zenoh.Encoding.APPLICATION_JSON)
                else:
                    query.reply(key, self._reply, encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            log.warning("an answer to a request was lost: %s", _reason(error))


@dataclass(eq=False)
class Request:
    """What the loop does once, for all who asked for it one after the other.

    Attributes:
        prepared: what `Verb.prepare` made of it.
        ready: for the loop.
        overtaken: how many different requests, made before and not begun, this one stopped.
    """

    do: str
    fields: dict = field(default_factory=dict)
    queries: list[Query] = field(default_factory=list)
    prepared: object | None = None
    ready: bool = True
    overtaken: int = 0

    def answer(self, data: dict) -> None:
        """Send what JSON can carry (finite numbers only). Never blocks; only the first call of
        `answer` or `refuse` counts, and only within `PATIENCE_S`."""
        # Encoded here: the dict is the caller's, who may go on to change it.
        try:
            encoded, is_error = json.dumps(data, allow_nan=False).encode(), False
        except (TypeError, ValueError) as error:
            log.error("an answer to a request is not JSON: %s", error)
            encoded, is_error = b'{"error": "internal error: the answer is not JSON"}', True
        for query in self.queries:
            query.finish(encoded, is_error)

    def refuse(self, reason: str) -> None:
        """Send an error instead."""
        for query in self.queries:
            query.refuse(reason)


class _Lane:
    """Requests that wait for the loop, in the order in which they came; equal ones are one.

    One joins the last of them, if that asks for the same, however far it is. It passes no other,
    nor does any pass it, or the other would have the last word. Only what stops the robot joins
    an equal one even past other stops, so however many come, only few of them wait, and none is
    ever turned away.
    """

    def __init__(self, verbs: Mapping[str, Verb]) -> None:
        self._verbs = verbs
        self._requests: deque[Request] = deque()

    def __len__(self) -> int:
        return len(self._requests)

    def add(self, do: str, fields: dict, query: Query) -> Request | None:
        """The request that the query is of; None: too many wait."""
        verb = self._verbs[do]
        for request in reversed(self._requests):
            if (request.do, request.fields) == (do, fields):
                if len(request.queries) >= _SAME and not verb.stops:
                    return None
                request.queries.append(query)
                return request
            other = self._verbs[request.do]
            if not verb.stops or not (other.stops or other.reads):
                break
        full = len(self._requests) >= _WAITING or len(self.unready()) > _WAITING_NEW
        if full and not verb.stops:
            return None
        self._requests.append(Request(do, fields, [query], ready=verb.prepare is None))
        return self._requests[-1]

    def pop(self) -> Request | None:
        """The oldest, if it is ready."""
        return self._requests.popleft() if self._requests and self._requests[0].ready else None

    def unready(self) -> list[Request]:
        """Those that are to be prepared: the first is worked on, others wait for that."""
        return [request for request in self._requests if not request.ready]

    def remove(self, query: Query) -> bool:
        """Take a query back whose request the loop has not taken; False where it has."""
        for request in self._requests:
            if query in request.queries:
                request.queries.remove(query)
                if not request.queries:
                    self._requests.remove(request)
                return True
        return False

    def discard(self, request: Request) -> None:
        if request in self._requests:
            self._requests.remove(request)

    def clear(self) -> list[Request]:
        """All of them, which are in the lane no more."""
        requests = list(self._requests)
        self._requests.clear()
        return requests


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
        self._first, self._second = _Lane(verbs), _Lane(verbs)
        self._open: set[Query] = set()
        self._polled_s = -math.inf
        self._answered: queue.SimpleQueue[Query | None] = queue.SimpleQueue()
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
            return self._first.pop() or self._second.pop()

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
            for query in left:
                query.refuse("the service is stopping")
            for _ in range(_SENDERS):
                self._answered.put(None)

    def _arrived(self, most: int) -> Iterator[Query]:
        for _ in range(most):
            if not self._looked:
                self._looked.extend(self._ring.take())
            if not self._looked:
                return
            yield Query(self._looked.popleft(), self._finished)

    def _note(self, queries: Iterable[Query]) -> None:
        with self._lock:
            self._open.update(queries)

    def _receive(self, query: Query) -> None:
        self._note((query,))
        try:
            do, fields = read_request(query.payload(), self._verbs)
        except ValueError as error:
            query.refuse(str(error))
            return
        with self._lock:
            overtaken = self._second.clear() if self._verbs[do].stops else []
            taken = self._take_in(do, fields, query, len(overtaken))
        for request in overtaken:
            request.refuse(_STOPPED)
        if not taken:
            query.refuse(_BUSY)

    def _take_in(self, do: str, fields: dict, query: Query, overtaken: int) -> bool:
        """False: too many wait."""
        lane = self._first if self._verbs[do].prepare is None else self._second
        if (request := lane.add(do, fields, query)) is None:
            return False
        request.overtaken += overtaken
        if request.ready:
            query.until_s = time.monotonic() + self._patience_s
        else:
            self._to_prepare.notify()
        return True

    def _give_up(self, now_s: float) -> None:
        with self._lock:
            late = [query for query in self._open if now_s >= query.until_s]
            lanes = (self._first, self._second)
            waited = {query for query in late if any(lane.remove(query) for lane in lanes)}
            polled_s = self._polled_s
        for query in late:
            limit = f"within {self._patience_s:g} s"
            if query not in waited:
                query.refuse(f"taken, but not answered {limit}; ask for the status")
            elif now_s - polled_s < self._patience_s:
                query.refuse(f"busy with other requests: not taken {limit}; try again later")
            else:
                query.refuse(f"the loop is not running: not taken {limit}")

    def _finished(self, query: Query) -> None:
        with self._lock:
            self._open.discard(query)
        self._answered.put(query)

    # The thread that prepares. What it works on may be overtaken, and its queries refused. Then
    # what follows changes nothing: it is in no lane, and a query's first answer counts.

    def _prepare_all(self) -> None:
        while (request := self._wait_for_work()) is not None:
            self._prepare(request)

    def _wait_for_work(self) -> Request | None:
        """The next request to prepare; None when the server closes."""
        with self._to_prepare:
            self._to_prepare.wait_for(lambda: self._closing.is_set() or self._second.unready())
            return None if self._closing.is_set() else self._second.unready()[0]

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
            self._second.discard(request)
        request.refuse(reason)

    # The others: one that answers a stopped client waits until Zenoh lets that one go.

    def _send_all(self) -> None:
        while (query := self._answered.get()) is not None:
            query.send(self.key)


def _reason(error: zenoh.ZError) -> str:
    """Without the place in Zenoh's source."""
    return str(error).split(" at /")[0]

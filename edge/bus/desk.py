"""Where the running service takes orders over Zenoh: one line in, one answer out, nobody waits.

A desk is a queryable: a JSON object comes in, a JSON object or an error `{"error": <one line>}`
goes out, to every order. One thread receives and keeps time, one prepares orders that take a while
to understand, a few send the answers. The loop only looks into two lanes, so neither a slow
preparation nor a slow asker holds up the robot.

Zenoh does not tell whose an order is, so a flood is limited by what it asks for, not by who asks:
orders that need no preparation pass all others, equal ones are one for the loop, and those that
stop the robot always find a place. These also end whatever was given before and is still to be
prepared or begun: once a stop was answered, only a later order sets the robot going.
"""

from __future__ import annotations

import json
import logging
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import zenoh

from edge.bus.session import QueryRing
from edge.errors import UserError
from edge.text import one_line

log = logging.getLogger("edge.bus.desk")

MAX_BYTES = 65536
MAX_CHARS = 10_000
MAX_ERROR_CHARS = 1000
PATIENCE_S = 2.0

_ARRIVED = 1024  # kept by Zenoh until as many before them are received: 6,400 a second
_A_LOOK = 128
_RECEIVE_S = 0.02
_WAITING_NEW = 2  # to be prepared, besides the one that is being worked on
_WAITING = 8  # groups in each lane
_SAME = 256  # askers of one order that is to be prepared, which can take minutes
_SENDERS = 4
_READS = "status"  # changes nothing
_BUSY = "busy with other orders; try again later"
_STOPPED = "stopped meanwhile: give it again"


class Order(Protocol):
    """What was asked for; `do` says what kind of thing it is. Equal ones ask for the same."""

    @property
    def do(self) -> str: ...


@dataclass(frozen=True)
class Request:
    """An order for the loop, of one asker or of several who want the same.

    Attributes:
        do: the order's.
        prepared: what `prepare` made of it; None for orders that need no preparation.
        answer: sends the answer, a dict that JSON can carry (finite numbers only). Never blocks;
            only the first call of `answer` or `refuse` counts, and only within `PATIENCE_S`.
        refuse: sends an error instead.
        overtaken: how many different orders, given before and not begun, this one stopped.
    """

    do: str
    prepared: object | None
    answer: Callable[[dict], None]
    refuse: Callable[[str], None]
    overtaken: int = 0


def read_order(payload: bytes, taken: Mapping[str, tuple[str, ...]]) -> tuple[str, dict]:
    """An order's `do`, and its other entries as they came.

    Args:
        taken: the orders there are, and the names of the entries that each may have.

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
    if not isinstance(do, str) or do not in taken:
        raise ValueError(f"do: unknown {shown(do)} (choices: {', '.join(taken)})")
    if unknown := sorted(data.keys() - set(taken[do])):
        raise ValueError(f"{unknown[0]!r:.40}: not taken with do: {do}")
    return do, data


def check_text(name: str, text: object, limit: int = MAX_CHARS) -> str:
    """An order's text as it came.

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


class Desk:
    """Takes orders until it is closed.

    Args:
        key: of the queryable.
        read: makes an order of a payload; raises ValueError, with one line, for what is none.
        prepare: by `do`, for orders that take a while: called on a thread of the desk, one at a
            time; raises UserError for what cannot be done.
        stops: orders, by `do`, that stop the robot; never refused as one too many. One that comes
            has those refused that came before it and were to be prepared.
        patience_s: how long the loop may take to answer.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        read: Callable[[bytes], Order],
        prepare: Mapping[str, Callable[..., object]],
        stops: Collection[str] = (),
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._key, self._read, self._prepare = key, read, prepare
        self._stops, self._patience_s = frozenset(stops), patience_s
        self._lock = threading.Lock()  # for the two lanes and what is open
        self._to_prepare = threading.Condition(self._lock)
        self._first, self._second = _FirstLane(self._stops), _SecondLane()
        self._open: set[_Asker] = set()
        self._polled_s = -math.inf
        self._answered: queue.SimpleQueue[_Asker | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        # A ring lets the oldest go when it is full; a FIFO would block the session.
        self._ring = QueryRing(session, key, _ARRIVED)
        self._looked: deque[zenoh.Query] = deque()  # taken from the ring, and yet to be received
        tasks = {"post": self._serve, "prepare": self._work}
        tasks |= {f"answer-{n}": self._send for n in range(_SENDERS)}
        self._threads = [
            threading.Thread(target=target, name=f"desk-{name}", daemon=True)
            for name, target in tasks.items()
        ]
        for thread in self._threads:
            thread.start()

    @property
    def overruns(self) -> int:
        """Looks that found more orders come than are received, so that some may have been let go
        unanswered (see `Ring.overruns`)."""
        return self._ring.overruns

    def poll(self) -> Request | None:
        """The next order, if there is one; a prepared one when no other waits. For the loop: never
        blocks."""
        self._polled_s = time.monotonic()
        if not self._first and not self._second:
            return None
        with self._lock:
            group = self._first.pop() or self._second.pop()
        return None if group is None else group.request()

    def close(self, timeout_s: float = 1.0) -> None:
        """Refuse what is open and take nothing more; a preparation that goes on is abandoned."""
        self._closing.set()
        until_s = time.monotonic() + timeout_s
        for thread in self._threads:
            thread.join(max(until_s - time.monotonic(), 0.0))

    # The first thread.

    def _serve(self) -> None:
        try:
            while not self._closing.wait(_RECEIVE_S):
                for asker in self._arrived(_A_LOOK):
                    self._receive(asker)
                self._give_up(time.monotonic())
            self._note(self._arrived(2 * _ARRIVED))
            self._ring.close()
        except zenoh.ZError as error:
            log.warning("no more orders are taken, the session is closed: %s", _reason(error))
        finally:
            self._closing.set()
            with self._lock:
                left = tuple(self._open)
                self._to_prepare.notify()
            for asker in left:
                asker.refuse("the service is stopping")
            for _ in range(_SENDERS):
                self._answered.put(None)

    def _arrived(self, most: int) -> Iterator[_Asker]:
        for _ in range(most):
            if not self._looked:
                self._looked.extend(self._ring.take())
            if not self._looked:
                return
            yield _Asker(self._looked.popleft(), self._finished)

    def _note(self, askers: Iterable[_Asker]) -> None:
        with self._lock:
            self._open.update(askers)

    def _receive(self, asker: _Asker) -> None:
        self._note((asker,))
        try:
            order = self._read(asker.payload())
        except ValueError as error:
            asker.refuse(str(error))
            return
        with self._lock:
            overtaken = self._second.clear() if order.do in self._stops else []
            taken = self._take_in(order, asker, len(overtaken))
        for group in overtaken:
            group.refuse(_STOPPED)
        if not taken:
            asker.refuse(_BUSY)

    def _take_in(self, order: Order, asker: _Asker, overtaken: int) -> bool:
        """False: too many wait."""
        lane = self._second if order.do in self._prepare else self._first
        if (group := lane.add(order, asker)) is None:
            return False
        group.overtaken += overtaken
        if lane is self._second:
            self._to_prepare.notify()
        if group.is_ready:
            asker.until_s = time.monotonic() + self._patience_s
        return True

    def _give_up(self, now_s: float) -> None:
        with self._lock:
            late = [asker for asker in self._open if now_s >= asker.until_s]
            lanes = (self._first, self._second)
            waited = {asker for asker in late if any(lane.remove(asker) for lane in lanes)}
            polled_s = self._polled_s
        for asker in late:
            limit = f"within {self._patience_s:g} s"
            if asker not in waited:
                asker.refuse(f"taken, but not answered {limit}; ask for the status")
            elif now_s - polled_s < self._patience_s:
                asker.refuse(f"busy with other orders: not taken {limit}; try again later")
            else:
                asker.refuse(f"the loop is not running: not taken {limit}")

    def _finished(self, asker: _Asker) -> None:
        with self._lock:
            self._open.discard(asker)
        self._answered.put(asker)

    # The second thread.

    def _work(self) -> None:
        while (group := self._wait_for_work()) is not None:
            try:
                prepared = self._prepare[group.do](group.order)
            except UserError as error:
                self._drop(group, str(error))
            except Exception as error:
                log.exception("an order could not be prepared")
                self._drop(group, f"internal error: {type(error).__name__}: {error}")
            else:
                self._hand_over(group, prepared)

    def _wait_for_work(self) -> _Group | None:
        """The next order to be prepared; None when the desk closes."""
        with self._to_prepare:
            while not self._closing.is_set():
                if (group := self._second.unprepared()) is not None:
                    return group
                self._to_prepare.wait()
        return None

    # The group that was worked on may have been overtaken, and its askers refused. Then what
    # follows changes nothing: it is in no lane, and an asker's first answer counts.

    def _drop(self, group: _Group, reason: str) -> None:
        with self._lock:
            self._second.discard(group)
        group.refuse(reason)

    def _hand_over(self, group: _Group, prepared: object) -> None:
        with self._lock:
            group.prepared, group.is_ready = prepared, True
            until_s = time.monotonic() + self._patience_s
            for asker in group.askers:
                asker.until_s = until_s

    # The others: one that answers a stopped asker waits until Zenoh lets that one go.

    def _send(self) -> None:
        while (asker := self._answered.get()) is not None:
            asker.send(self._key)


@dataclass(eq=False)
class _Group:
    """Those who gave the same order one after the other; the loop does it once, for all.

    Attributes:
        is_ready: for the loop.
        overtaken: see `Request`.
    """

    order: Order
    askers: list[_Asker]
    is_ready: bool
    prepared: object | None = None
    overtaken: int = 0

    @property
    def do(self) -> str:
        return self.order.do

    def request(self) -> Request:
        return Request(self.do, self.prepared, self.answer, self.refuse, self.overtaken)

    def answer(self, data: dict) -> None:
        # Encoded here: the dict is the caller's, who may go on to change it.
        try:
            encoded, is_error = json.dumps(data, allow_nan=False).encode(), False
        except (TypeError, ValueError) as error:
            log.error("an answer to an order is not JSON: %s", error)
            encoded, is_error = b'{"error": "internal error: the answer is not JSON"}', True
        for asker in self.askers:
            asker.finish(encoded, is_error)

    def refuse(self, reason: str) -> None:
        for asker in self.askers:
            asker.refuse(reason)


class _Lane:
    """Orders that wait for the loop, in the order in which they came; equal ones are one."""

    def __init__(self) -> None:
        self._groups: deque[_Group] = deque()

    def __len__(self) -> int:
        return len(self._groups)

    def pop(self) -> _Group | None:
        """The oldest, if it is ready."""
        return self._groups.popleft() if self._groups and self._groups[0].is_ready else None

    def remove(self, asker: _Asker) -> bool:
        """Take an order back that the loop has not taken; False where it has."""
        for group in self._groups:
            if asker in group.askers:
                group.askers.remove(asker)
                if not group.askers:
                    self._groups.remove(group)
                return True
        return False


class _FirstLane(_Lane):
    """Orders that need no preparation.

    One that stops the robot joins an equal one even past other stops, so however many come, only
    few groups wait, and none of them is ever turned away. It never passes an order that sets the
    robot going, nor does any of those pass it: the last word stands.

    Args:
        stops: which orders stop the robot.
    """

    def __init__(self, stops: frozenset[str]) -> None:
        super().__init__()
        self._stops = stops

    def add(self, order: Order, asker: _Asker) -> _Group | None:
        """The group it is in; None: too many wait."""
        for group in reversed(self._groups):
            if group.order == order:
                group.askers.append(asker)
                return group
            if order.do not in self._stops or group.do not in self._stops | {_READS}:
                break
        if order.do not in self._stops and len(self._groups) >= _WAITING:
            return None
        self._groups.append(_Group(order, [asker], is_ready=True))
        return self._groups[-1]


class _SecondLane(_Lane):
    """Orders that are to be prepared: some are ready, the next is worked on, others wait for that.

    One joins those that came right before it, if they are equal, however far they are. It joins
    none before another order, or that other one would have the last word.
    """

    def add(self, order: Order, asker: _Asker) -> _Group | None:
        """The group it is in; None: too many wait."""
        last = self._groups[-1] if self._groups else None
        if last is not None and last.order == order:
            if len(last.askers) >= _SAME:
                return None
            last.askers.append(asker)
            return last
        unprepared = sum(not group.is_ready for group in self._groups)
        if unprepared > _WAITING_NEW or len(self._groups) >= _WAITING:
            return None
        self._groups.append(_Group(order, [asker], is_ready=False))
        return self._groups[-1]

    def unprepared(self) -> _Group | None:
        """The oldest that is not ready."""
        return next((group for group in self._groups if not group.is_ready), None)

    def discard(self, group: _Group) -> None:
        with suppress(ValueError):
            self._groups.remove(group)

    def clear(self) -> list[_Group]:
        """All of them, which are in the lane no more."""
        groups = list(self._groups)
        self._groups.clear()
        return groups


class _Asker:
    """One query, from its arrival to its one answer."""

    def __init__(self, query: zenoh.Query, answered: Callable[[_Asker], None]) -> None:
        self.order: Order | None = None  # of one that is to be prepared
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
        """Reply and let the query go, or its asker would wait on."""
        try:
            with self._query as query:
                if self._is_error:
                    query.reply_err(self._reply, encoding=zenoh.Encoding.APPLICATION_JSON)
                else:
                    query.reply(key, self._reply, encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            log.warning("an answer to an order was lost: %s", _reason(error))


def _reason(error: zenoh.ZError) -> str:
    """Without the place in Zenoh's source."""
    return str(error).split(" at /")[0]

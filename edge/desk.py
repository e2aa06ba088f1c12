"""Where the running service takes orders over Zenoh: one line in, one answer out, nobody waits.

A desk is a queryable: a JSON object comes in, a JSON object or an error `{"error": <one line>}`
goes out. It has two threads. One receives, answers and keeps time; the other prepares orders that
take a while to understand. The loop only looks into an inbox, so neither a slow preparation nor a
slow asker holds up the robot.
"""

from __future__ import annotations

import json
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import zenoh

from edge.errors import UserError
from edge.text import one_line

log = logging.getLogger("edge.desk")

MAX_BYTES = 65536
MAX_CHARS = 10_000
MAX_ERROR_CHARS = 1000
PATIENCE_S = 2.0

_WAITING_NEW = 2  # besides the one that is being worked on
_WAITING = 32
_RECEIVE_S = 0.02


class Order(Protocol):
    """What was asked for; `do` says what kind of thing it is."""

    @property
    def do(self) -> str: ...


@dataclass(frozen=True)
class Request:
    """An order for the loop.

    Attributes:
        do: the order's.
        prepared: what `prepare` made of it; None for orders that need no preparation.
        answer: sends the answer, a dict that JSON can carry (finite numbers only). Never blocks;
            only the first call of `answer` or `refuse` counts, and only within `PATIENCE_S`.
        refuse: sends an error instead.
    """

    do: str
    prepared: object | None
    answer: Callable[[dict], None]
    refuse: Callable[[str], None]


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
        patience_s: how long the loop may take to answer.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        read: Callable[[bytes], Order],
        prepare: Mapping[str, Callable[..., object]],
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._key, self._read, self._prepare = key, read, prepare
        self._patience_s = patience_s
        self._lock = threading.Lock()
        self._inbox: deque[_Asker] = deque()
        self._open: set[_Asker] = set()
        self._answered: queue.SimpleQueue[_Asker] = queue.SimpleQueue()
        self._new: queue.Queue[_Asker | None] = queue.Queue(_WAITING_NEW)
        self._closing = threading.Event()
        # A ring lets the oldest go when it is full; a FIFO would block the session.
        self._queryable = session.declare_queryable(self._key, zenoh.handlers.RingChannel(_WAITING))
        self._threads = [
            threading.Thread(target=target, name=f"desk-{name}", daemon=True)
            for name, target in (("post", self._serve), ("prepare", self._work))
        ]
        for thread in self._threads:
            thread.start()

    def poll(self) -> Request | None:
        """The next order, if there is one. For the loop: never blocks."""
        if not self._inbox:
            return None
        with self._lock:
            return self._inbox.popleft().request() if self._inbox else None

    def close(self, timeout_s: float = 1.0) -> None:
        """Refuse what is open and take nothing more; a preparation that goes on is abandoned."""
        self._closing.set()
        for thread in self._threads:
            thread.join(timeout_s)

    # The first thread.

    def _serve(self) -> None:
        try:
            while not self._closing.wait(_RECEIVE_S):
                for asker in self._arrived():
                    self._receive(asker)
                self._give_up(time.monotonic())
                self._send()
            self._open.update(self._arrived())
            self._queryable.undeclare()
        except zenoh.ZError as error:
            log.warning("no more orders are taken, the session is closed: %s", _reason(error))
        finally:
            for asker in tuple(self._open):
                asker.refuse("the service is stopping")
            self._send()
            with suppress(queue.Empty):
                while True:
                    self._new.get_nowait()
            self._new.put(None)

    def _arrived(self) -> Iterator[_Asker]:
        while (query := self._queryable.try_recv()) is not None:
            yield _Asker(query, self._answered.put)

    def _receive(self, asker: _Asker) -> None:
        self._open.add(asker)
        try:
            asker.order = self._read(asker.payload())
        except ValueError as error:
            asker.refuse(str(error))
            return
        if asker.order.do not in self._prepare:
            self._hand_over(asker)
            return
        try:
            self._new.put_nowait(asker)
        except queue.Full:
            asker.refuse(f"busy with other orders to do: {asker.order.do}; try again later")

    def _give_up(self, now_s: float) -> None:
        for asker in tuple(self._open):
            if now_s < asker.until_s:
                continue
            with self._lock:
                taken = asker not in self._inbox
                if not taken:
                    self._inbox.remove(asker)
            asker.refuse(
                f"taken, but not answered within {self._patience_s:g} s; ask for the status"
                if taken
                else f"the loop is not running: not taken within {self._patience_s:g} s"
            )

    def _send(self) -> None:
        while not self._answered.empty():
            asker = self._answered.get()
            self._open.discard(asker)
            asker.send(self._key)

    # The second thread.

    def _work(self) -> None:
        while (asker := self._new.get()) is not None:
            try:
                asker.prepared = self._prepare[asker.order.do](asker.order)
            except UserError as error:
                asker.refuse(str(error))
            except Exception as error:
                log.exception("an order could not be prepared")
                asker.refuse(f"internal error: {type(error).__name__}: {error}")
            else:
                self._hand_over(asker)

    def _hand_over(self, asker: _Asker) -> None:
        asker.until_s = time.monotonic() + self._patience_s
        with self._lock:
            full = len(self._inbox) >= _WAITING
            if not full:
                self._inbox.append(asker)
        if full:
            asker.refuse("busy with other orders; try again later")


class _Asker:
    """One query, from its arrival to its one answer."""

    def __init__(self, query: zenoh.Query, answered: Callable[[_Asker], None]) -> None:
        self.order: Order | None = None
        self.prepared: object | None = None
        self.until_s = float("inf")
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

    def request(self) -> Request:
        return Request(self.order.do, self.prepared, self.answer, self.refuse)

    def answer(self, data: dict) -> None:
        self._finish(data, is_error=False)

    def refuse(self, reason: str) -> None:
        self._finish({"error": one_line(reason, MAX_ERROR_CHARS)}, is_error=True)

    def _finish(self, data: dict, is_error: bool) -> None:
        # Encoded here: the dict is the caller's, who may go on to change it.
        try:
            encoded = json.dumps(data, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            log.error("an answer to an order is not JSON: %s", error)
            encoded, is_error = b'{"error": "internal error: the answer is not JSON"}', True
        if self._first.acquire(blocking=False):
            self._reply, self._is_error = encoded, is_error
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

"""What can be asked for, and a request as whoever does it sees it; knows no transport."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from edge.text import bounded_repr, one_line, read_json_object

log = logging.getLogger(__name__)

MAX_CHARS = 10_000
MAX_ERROR_CHARS = 1000
CANCELLED = "cancelled"
"""Why a mission failed that somebody cancelled and said no more."""


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
        raise ValueError(f"{bounded_repr(unknown[0], 40)}: not taken with do: {do}")
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


def check_flag(name: str, fields: Mapping[str, object]) -> bool:
    """A request's flag; false where there is none.

    Raises:
        ValueError: it is neither true nor false.
    """
    flag = fields.get(name, False)
    if not isinstance(flag, bool):
        raise ValueError(f"{name}: expected true or false")
    return flag


def shown(value: object) -> str:
    """For a message; what is nested is not shown, since it may be nested very deep."""
    plain = value is None or isinstance(value, (str, int, float))
    return bounded_repr(value, 40) if plain else f"a {type(value).__name__}"


Finish = Callable[[Iterable[Any], bytes, bool], None]
"""Sends a reply, or an error, to each of these queries that has none yet. Never blocks."""


@dataclass(eq=False)
class Request:
    """What the loop does once, for all who asked for it one after the other.

    Attributes:
        queries: of those, as their server knows them.
        prepared: what `Verb.prepare` made of it.
        ready: for the loop.
        overtaken: how many different requests, made before and not begun, this one stopped.
    """

    do: str
    fields: dict = field(default_factory=dict)
    finish: Finish = lambda queries, reply, is_error: None
    queries: list[Any] = field(default_factory=list)
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

    def refuse(self, reason: str, details: Mapping[str, object] = MappingProxyType({})) -> None:
        """Send an error instead; see `error_of`."""
        self.finish(self.queries, error_of(reason, details), True)


def error_of(reason: str, details: Mapping[str, object] = MappingProxyType({})) -> bytes:
    """What a client is told in the place of an answer; for `details` see `UserError`."""
    return json.dumps({"error": one_line(reason, MAX_ERROR_CHARS), **details}).encode()

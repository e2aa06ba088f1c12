"""Verbs (kinds of requests) and requests as the loop sees them, independent of the transport."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from edge.errors import UserError
from edge.geometry import FARTHEST_M, SE2
from edge.text import bounded_repr, one_line, read_json_object

log = logging.getLogger(__name__)

MAX_CHARS = 10_000
"""Longest text field of a request, in characters."""
MAX_ERROR_CHARS = 1000
"""Longest error in an answer, in characters."""
CANCELLED = "cancelled"
"""Reason of a failed mission, if a user cancelled it without giving a reason."""


@dataclass(frozen=True)
class Verb:
    """One kind of request.

    Attributes:
        fields: names of the fields that a request may have, without `do`.
        read: checks and converts the fields; raises ValueError or UserError with one line.
        prepare: slow part of the work: called with the fields on a thread of the server, one
            request at a time; raises UserError to refuse the request.
        stops_robot: True if the request stops the robot. It is never refused for lack of room, and
            it cancels the requests that wait in the second lane of `RequestQueue`.
        read_only: True if the request changes nothing.
        instead: returns the verb and fields of another request that means the same, or None. So
            the instruction "stop" is as urgent as the verb that stops the robot.
    """

    fields: tuple[str, ...] = ()
    read: Callable[[dict], dict] = dict
    prepare: Callable[[dict], object] | None = None
    stops_robot: bool = False
    read_only: bool = False
    instead: Callable[[dict], tuple[str, dict] | None] = lambda fields: None


def read_request(payload: bytes, verbs: Mapping[str, Verb]) -> tuple[str, dict]:
    """Return the verb and the fields of a request.

    Raises:
        ValueError: with one line that names the fault.
    """
    data = read_json_object(payload)
    do = data.pop("do", None)
    if not isinstance(do, str) or do not in verbs:
        raise ValueError(f"do: unknown {show(do)} (choices: {', '.join(verbs)})")
    if unknown := sorted(data.keys() - set(verbs[do].fields)):
        fields = ", ".join(verbs[do].fields) or "none"
        raise ValueError(
            f"{bounded_repr(unknown[0], 40)}: not a field of do: {do} (its fields: {fields})"
        )
    try:
        fields = verbs[do].read(data)
    except UserError as error:
        raise ValueError(str(error)) from None
    return verbs[do].instead(fields) or (do, fields)


def check_text(name: str, text: object, limit: int = MAX_CHARS) -> str:
    """Return a text field unchanged.

    Raises:
        ValueError: it is not a string, blank, not Unicode, or longer than `limit` characters.
    """
    if not isinstance(text, str) or not text.strip():
        raise ValueError(f"{name}: expected text, got {show(text)}")
    if len(text) > limit:
        raise ValueError(f"{name}: {len(text)} characters, at most {limit} are allowed")
    if any("\ud800" <= c <= "\udfff" for c in text):
        raise ValueError(f"{name}: not Unicode text; send it as UTF-8")
    return text


def check_flag(name: str, fields: Mapping[str, object]) -> bool:
    """Return a boolean field; False if it is absent.

    Raises:
        ValueError: it is not a boolean.
    """
    flag = fields.get(name, False)
    if not isinstance(flag, bool):
        raise ValueError(f"{name}: expected true or false, got {show(flag)}")
    return flag


def check_pose(name: str, value: object) -> SE2:
    """Return a pose from a list of x and y in metres and the heading in radians.

    Raises:
        ValueError: it is not such a list, or too far away.
    """
    numbers = value if isinstance(value, list) else []
    valid = len(numbers) == 3 and all(type(n) in (int, float) for n in numbers)
    if not valid or not all(abs(n) <= FARTHEST_M for n in numbers):
        raise ValueError(
            f"{name}: expected [x_m, y_m, yaw_rad], each from {-FARTHEST_M:g} to {FARTHEST_M:g}, "
            f"got {show(value)}"
        )
    return SE2(*map(float, numbers))


def show(value: object) -> str:
    """Format a value for a message. Containers are not shown, as they may be nested deeply."""
    plain = value is None or isinstance(value, (str, int, float))
    return bounded_repr(value, 40) if plain else f"a {type(value).__name__}"


Finish = Callable[[Iterable[Any], bytes, bool], None]
"""Sends a reply (True: an error) to each query that has none yet. Must not block."""


@dataclass(eq=False)
class Request:
    """One request for the loop, merged from all equal queries.

    Attributes:
        do: name of the verb.
        fields: as `Verb.read` returned them.
        finish: sends the reply to the queries.
        queries: the merged queries, in the server's own type.
        prepared: result of `Verb.prepare`.
        ready: True if the loop may handle the request.
        cancelled: number of earlier requests, not yet started, that this request cancelled
            (see `edge.bus.request_queue`).
    """

    do: str
    fields: dict = field(default_factory=dict)
    finish: Finish = lambda queries, reply, is_error: None
    queries: list[Any] = field(default_factory=list)
    prepared: object | None = None
    ready: bool = True
    cancelled: int = 0

    def answer(self, data: dict) -> None:
        """Send an answer of JSON types (finite numbers only).

        Only the first call of `answer` or `refuse` counts, and only within the server's patience.
        """
        # Encode now: the caller owns the dict and may change it later.
        try:
            reply = json.dumps(data, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            log.error("a bug in edge: an answer cannot be written as JSON: %s; report it", error)
            self.refuse("internal error: the answer is not JSON")
        else:
            self.finish(self.queries, reply, False)

    def refuse(self, reason: str, details: Mapping[str, object] = MappingProxyType({})) -> None:
        """Send an error; see `error_payload`."""
        self.finish(self.queries, error_payload(reason, details), True)


def error_payload(reason: str, details: Mapping[str, object] = MappingProxyType({})) -> bytes:
    """Return the payload of an error; for `details` see `UserError`."""
    return json.dumps({"error": one_line(reason, MAX_ERROR_CHARS), **details}).encode()

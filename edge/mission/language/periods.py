"""Orders that are carried out again after a time: "check the stove every ten minutes"."""

from __future__ import annotations

import re
from typing import NamedTuple

from edge.mission.language.spans import DURATION, seconds_of
from edge.mission.language.tokens import unclear

_PERIOD = (
    rf"\b(?:(?:once |again )?every (?P<span>{DURATION}|(?:other )?(?:hour|minute)\b)|"
    r"(?:hourly|once an hour|each hour)\b)"
)
_ENDLESS = r"(?:forever|until (?:told|(?:i|we) (?:tell you|say)(?: to stop| so)?))"
_FIRST = re.compile(
    rf"^\s*{_PERIOD}(?: for (?P<limit>{DURATION}))?\s*,?\s*(?P<order>\S.*)$", re.I | re.S
)
_LAST = re.compile(
    rf"^(?P<order>.*\S)\s*,?\s+{_PERIOD}"
    rf"(?:,?\s+for (?P<limit>{DURATION})|,?\s+{_ENDLESS})?[\s.!?]*$",
    re.I | re.S,
)
_SEVERAL = re.compile(r"\b(?:then|after|before|first)\b", re.I)


class Period(NamedTuple):
    """An order without its period.

    Attributes:
        order: the order.
        wait_s: time from the end of one round to the begin of the next.
        limit_s: time after which all ends; None for no end.
    """

    order: str
    wait_s: float
    limit_s: float | None = None


def split_period(instruction: str) -> Period | None:
    """Return the parts of an order with a period; None if it has none.

    Raises:
        UnclearError: the period may belong to the last of several orders only.

    >>> split_period("patrol the house every half hour for 8 hours")
    Period(order='patrol the house', wait_s=1800.0, limit_s=28800.0)
    >>> split_period("Every other hour, check the stove"), split_period("visit every room")
    (Period(order='check the stove', wait_s=7200.0, limit_s=None), None)
    """
    found = _FIRST.match(instruction) or _LAST.match(instruction)
    if found is None:
        return None
    span = (found["span"] or "one hour").lower()
    if found.re is _LAST and _SEVERAL.search(found["order"]):
        said = f"every {span}"
        raise unclear(said, f"unclear which orders it repeats; begin with it: '{said}, go …'")
    if span in ("hour", "minute"):
        span = f"one {span}"
    limit_s = seconds_of(found["limit"]) if found["limit"] else None
    return Period(found["order"], seconds_of(span.replace("other", "two")), limit_s)

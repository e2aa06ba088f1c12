"""Orders that are carried out again after a time: "check the stove every ten minutes"."""

from __future__ import annotations

import re
from typing import NamedTuple

from edge.mission.language.words import nouns
from edge.mission.language.words.clock_times import CLOCK, time_of_day
from edge.mission.language.words.everyday_words import ARTICLE, MARK, is_room
from edge.mission.language.words.spans import DURATION, seconds_of
from edge.mission.language.words.tokens import unclear

_PERIOD = (
    rf"(?:(?:once |again )?every (?P<span>{DURATION}|(?:other )?(?:hour|minute)\b)(?: or so)?|"
    r"(?P<hourly>hourly|(?:once )?(?:each|per|every) hour|once an hour)\b|"
    rf"every day at (?P<clock>{CLOCK}))"
)
_LIMIT = rf",? for (?P<limit>{DURATION})"
_ENDLESS = r",? (?:forever|until (?:told|(?:i|we) (?:tell you|say))(?: to stop| stop| so)?)"
_BAN = (
    r"(?P<ban>,? (?:(?:but|and) )?(?:avoid|stay|keep|never|do not|don't|without|except|excluding|"
    r"apart from|but not)\b[^.;]*)"
)
_THANKS = r"(?:,? (?:please|thanks|thank you))?[\s.!?]*"
_FIRST = re.compile(rf"\s*{_PERIOD}(?:{_LIMIT})?,? (?P<order>\S.*)", re.I | re.S)
_LAST = re.compile(
    rf"(?P<order>\S.*?),?\s+{_PERIOD}(?:{_LIMIT}|{_ENDLESS})?{_BAN}?{_THANKS}", re.I | re.S
)
_ENDS = re.compile(rf" for (?P<span>{DURATION})(?={_THANKS}$)", re.I)
# An order that may last for some time.
_LASTS = re.compile(r"\b(?:wait|stay|remain|stand|stop|explore|look|search|patrol|guard)\b", re.I)
_DENIED = re.compile(r"(?:do not|don't|never|stop)\b", re.I)
# "go to the dock, then to the shelf, and do this [every hour]": all orders before it
_AGAIN = re.compile(
    r"(?<=\S)(?:[.;,]| and)+ (?:then )?(?:do|repeat)(?: (?:all (?:of )?)?(?:this|that|it|"
    r"the same))?(?: again)?$",
    re.I,
)
# The begin of a second order: "…, then go to the desk", "… and check the stove".
_JOINT = re.compile(r"[.;]\s*(?=\S)|\b(?:then|after|before)\b|(?:,|\band\b)\s+(?P<next>\S+)", re.I)


class Period(NamedTuple):
    """An order without its period."""

    order: str
    wait_s: float  # from the end of one round to the start of the next
    limit_s: float | None = None  # time after which all ends; None: no end
    until: str = ""  # time of day at which each round starts, as "09:00", in place of `wait_s`


def split_period(instruction: str) -> Period | None:
    """Return the parts of an order with a period; None if it has none.

    Args:
        instruction: an utterance that was tidied up; private characters stand for names.

    Raises:
        UnclearError: it is unclear which of several orders, or how often, the period repeats. A
            comma before it, or "do this", means all orders of the sentence.

    >>> split_period("patrol the house every half hour for 8 hours")
    Period(order='patrol the house', wait_s=1800.0, limit_s=28800.0, until='')
    >>> split_period("Every other hour, check the stove"), split_period("visit every room")
    (Period(order='check the stove', wait_s=7200.0, limit_s=None, until=''), None)
    """
    found = _FIRST.fullmatch(instruction) or _LAST.fullmatch(instruction)
    if found is None:
        return None
    span = "one hour" if found["hourly"] else (found["span"] or "24 hours").lower()
    said = "every hour" if found["hourly"] else f"every {span}"
    said = f"every day at {found['clock']}" if found["clock"] else said
    order, ban = found["order"], found.groupdict().get("ban") or ""
    if _DENIED.match(order):
        raise unclear(said, "only an order to drive can be repeated after a time")
    if found.re is _FIRST and re.search(r"[.;]\s*\w", order):
        raise unclear(said, "unclear which orders it repeats; say them in one sentence")
    is_set_off = instruction[found.end("order") :].startswith(",") or _AGAIN.search(order)
    order = _AGAIN.sub("", order)
    has_several = re.search(r"[.;]\s*\w", order) if is_set_off else has_several_orders(order)
    if found.re is _LAST and has_several:
        raise unclear(said, f"unclear which orders it repeats; begin with it: '{said}, go …'")
    if split_period(order) is not None:
        raise unclear(said, "unclear how often; say one time between two rounds")
    if span in ("hour", "minute"):
        span = f"one {span}"
    wait_s = seconds_of(span.replace("other", "two"))
    ends = _ENDS.search(order) if found.re is _FIRST else None
    if ends and not _LASTS.search(order) and seconds_of(ends["span"]) >= wait_s:
        raise unclear(ends[0].strip(), f"unclear if the rounds end then; say '{said}{ends[0]}, …'")
    limit_s = seconds_of(found["limit"]) if found["limit"] else None
    if found["clock"] and (limit_s is not None or re.match(r"(?:and|or)\b", order)):
        raise unclear(said, "a day has one round; give one time, and not for how long")
    if limit_s is not None and limit_s < wait_s:
        raise unclear(said, "unclear how often, since all ends before the second round")
    until = time_of_day(found["clock"]) if found["clock"] else ""
    return Period(order + ban, wait_s, limit_s, until)


def has_several_orders(order: str) -> bool:
    """Return True unless each part after the first is only the name of another object or place."""
    for joint in _JOINT.finditer(order):
        word = joint["next"]
        if word is None or not (
            re.fullmatch(ARTICLE, word, re.I)
            or re.match(MARK, word)
            or is_room(word.lower())
            or nouns.is_noun(word.lower())
        ):
            return True
    return False

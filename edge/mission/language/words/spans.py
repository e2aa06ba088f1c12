"""Lengths of time in words: "ten minutes", "half an hour", "a couple of minutes"."""

from __future__ import annotations

import re

from edge.number_words import SMALL_NUMBERS, TENS, number

# Unit, by its first letters → seconds; words before a unit → their value.
_UNITS_S = {"s": 1, "min": 60, "h": 3600}
_WORD_VALUES = {
    "a": 1.0, "an": 1.0, "one": 1.0, "half a": 0.5, "half an": 0.5, "half": 0.5,
    "a couple of": 2.0, "a couple": 2.0, "couple of": 2.0, "a quarter of an": 0.25,
    "quarter of an": 0.25, "quarter": 0.25, "a good": 1.0,
}  # fmt: skip
# Regular expressions; the longest words come first, so that "half a" comes before "half".
_TENS = rf"(?:{'|'.join(TENS)})(?:[ -](?:{'|'.join(SMALL_NUMBERS[1:10])}))?"
_NUMBER = rf"(?:\d+(?:\.\d+)?|{_TENS}|{'|'.join(sorted(SMALL_NUMBERS, key=len)[::-1])})"
COUNT = rf"(?:a couple of|a couple|{_NUMBER}|a)"
"""Regular expression for an integer."""
_SIZE = rf"(?:{'|'.join(sorted(_WORD_VALUES, key=len)[::-1])}|{_NUMBER})"
DURATION = (
    rf"(?:(?:about|around|like|exactly|roughly|maybe|another|the next|just|only|at least) )*{_SIZE}"
    r"[ -]?(?:seconds?|secs?|minutes?|mins?|hours?|s|min|h)\b(?: and a half)?"
)
"""Regular expression for a length of time."""
_DURATION_PARTS = re.compile(
    rf"(?P<size>{_SIZE})[ -]?(?P<unit>s|min|h)[a-z]*(?P<more> and a half)?$", re.I
)


def number_of(word: str) -> int | None:
    """Return the value of an integer in digits or words; None for other words.

    >>> number_of("twenty-one"), number_of("12"), number_of("twice"), number_of("some")
    (21, 12, 2, None)
    """
    if word.isdecimal():
        return int(word)
    often = {"once": 1, "twice": 2, "thrice": 3, "a": 1, "a couple of": 2, "a couple": 2}
    return often.get(word.lower(), number(re.split(r"[ -]", word.lower())))


def seconds_of(span: str) -> float:
    """Return the length [s] of a text that `DURATION` matches.

    Raises:
        ValueError: the text is no length of time.

    >>> seconds_of("half an hour"), seconds_of("about two minutes"), seconds_of("90 s")
    (1800.0, 120.0, 90.0)
    """
    found = _DURATION_PARTS.search(span.strip())
    if found is None:
        raise ValueError(f"not a length of time: {span!r}; expected one such as '90 s'")
    size = found["size"].lower()
    value = _WORD_VALUES.get(size)
    if value is None:
        value = float(size) if size[0].isdigit() else float(number_of(size) or 0)
    return (value + 0.5 * bool(found["more"])) * _UNITS_S[found["unit"].lower()]


def shown_s(seconds: float) -> str:
    """Return a duration for people.

    >>> shown_s(30.0), shown_s(600.0), shown_s(90.0), shown_s(2.5)
    ('30 s', '10 min', '90 s', '2.5 s')
    """
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min" if minutes and not rest else f"{seconds:g} s"

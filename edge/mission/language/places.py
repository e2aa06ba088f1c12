"""Names of places in an instruction, in quotes, so that every translator takes them as names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

START, HERE = "start", "here"
"""The first pose of the service, and the pose at which a mission begins."""

_WENT = r"(?:you|we)\s+(?:started|began|set\s+off|came)(?:\s+from)?"
_THEN = r"(?P<then>(?:\s*,)?\s+(?:and\s+)?(?:then\s+)?)?"
_END = r"(?=\s*(?:[.,;!?]|$|and\b|then\b|afterwards\b|again\b))"
_PHRASES = (
    (re.compile(rf"\b(?:the\s+(?:place|spot|point)\s+)?where\s+{_WENT}\b", re.I), f'"{START}"'),
    (
        re.compile(r"\b(?:the\s+|your\s+)?start(?:ing)?\s+(?:point|place|position|pose)\b", re.I),
        f'"{START}"',
    ),
    (re.compile(r"\bto\s+(?:the\s+)?start\b", re.I), f'to "{START}"'),
)
_BACK = re.compile(
    _THEN + r"\b(?:(?:come|go|get|drive|head|return|run)\s+back(?:\s+here)?|return(?:\s+here)?)"
    + _END,
    re.I,
)  # fmt: skip
_BACK_TO = re.compile(_THEN + r'\b(?:return|(?:come|head|get)\s+back)\s+to\s+(?=")', re.I)


def _then(place: str) -> Callable[[re.Match[str]], str]:
    """Return a replacement: to come back comes after all that is said before it."""
    return lambda found: f"{', then ' if found['then'] else ''}go to {place}"


def quote_places(instruction: str, names: Iterable[str]) -> str:
    """Put the names of places, and the words for where the robot was, into double quotes.

    Args:
        names: of places, in lower case.

    Example:
        >>> quote_places("Go to the charging dock, then come back.", ["charging dock"])
        'Go to "charging dock", then go to "here".'
    """
    pieces = re.split(r'("[^"]*")', instruction)
    known = sorted(names, key=len, reverse=True)
    if known:
        any_name = "|".join(r"\s+".join(map(re.escape, name.split())) for name in known)
        named = re.compile(rf"\b(?:(?:the|my|our|your)\s+)?({any_name})(?![\w'-])", re.I)
    for i in range(0, len(pieces), 2):
        text = pieces[i]
        for phrase, place in _PHRASES:
            text = phrase.sub(place, text)
        text = _BACK.sub(_then(f'"{HERE}"'), text)
        if known:
            outside = re.split(r'("[^"]*")', text)
            outside[::2] = [
                named.sub(lambda m: f'"{" ".join(m[1].lower().split())}"', part)
                for part in outside[::2]
            ]
            text = "".join(outside)
        pieces[i] = text
    return _BACK_TO.sub(_then(""), "".join(pieces))

"""Names of places and rooms in an instruction, in quotes, so that translators keep them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from edge import names as words

START, HERE, EXPLORED = "start", "here", "explored"
"""The first pose of the service; the pose at which a mission begins; wherever exploring ends."""
MAX_ROUNDS = 10

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
_EXPLORE = re.compile(
    r"\b(?:(?:explore|map|scan|survey)\s+(?:(?:the|this|your|my|our|whole|entire|all|of)\s+)*"
    r"(?:house|home|flat|apartment|building|floor|area|place|surroundings|environment|rooms|"
    r"everything|everywhere)|explore|look\s+around)" + _END,
    re.I,
)  # fmt: skip
_PATROL = re.compile(
    r"\bpatrol\s+(?:between\s+)?(?P<stops>[^.;!?]+?)[,\s]+(?P<rounds>\w+)\s+(?:times|rounds)\b",
    re.I,
)
_BACK = re.compile(
    _THEN + r"\b(?:(?:come|go|get|drive|head|return|run)\s+back(?:\s+here)?|return(?:\s+here)?)"
    + _END,
    re.I,
)  # fmt: skip
_ROOMS = (
    (re.compile(r"\b(?:the\s+)?(?:largest|biggest)\s+room\b", re.I), "largest room"),
    (re.compile(r"\b(?:the\s+)?next\s+room\b", re.I), "next room"),
    (
        re.compile(r"\b(?:the\s+)?room\s+with\s+(?:the|an?)\s+((?:\w+\s+){0,2}?\w+)" + _END, re.I),
        r"room with \1",
    ),
)
_BACK_TO = re.compile(_THEN + r'\b(?:return|(?:come|head|get)\s+back)\s+to\s+(?=")', re.I)


def _then(place: str) -> Callable[[re.Match[str]], str]:
    """Return a replacement: to come back comes after all that is said before it."""
    return lambda found: f"{', then ' if found['then'] else ''}go to {place}"


def _rounds(found: re.Match[str]) -> str:
    """Return a patrol as the stops of all its rounds; unchanged if their number is not clear."""
    rounds = words.number([found["rounds"].lower()])
    stops = re.split(r"\s*,\s*(?:and\s+)?|\s+and\s+", found["stops"].strip())
    if rounds is None or not 1 <= rounds <= MAX_ROUNDS or len(stops) < 2:
        return found[0]
    return ", then ".join(f"go to {stop}" for stop in stops * rounds)


def quote_places(instruction: str, names: Iterable[str]) -> str:
    """Put the names of places and rooms, and words for where the robot was, into double quotes.

    Args:
        names: of places and rooms, in lower case.

    Example:
        >>> quote_places("Go to the charging dock, then come back.", ["charging dock"])
        'Go to "charging dock", then go to "here".'
    """
    pieces = re.split(r'("[^"]*")', _PATROL.sub(_rounds, instruction))
    known = sorted(names, key=len, reverse=True)
    if known:
        any_name = "|".join(r"\s+".join(map(re.escape, name.split())) for name in known)
        named = re.compile(rf"\b(?:(?:the|my|our|your)\s+)?({any_name})(?![\w'-])", re.I)
    for i in range(0, len(pieces), 2):
        text = pieces[i]
        for phrase, place in _PHRASES:
            text = phrase.sub(place, text)
        for phrase, room in _ROOMS:
            text = phrase.sub(rf'"{room}"', text)
        text = _EXPLORE.sub(f'go to "{EXPLORED}"', text)
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

"""Names of places and rooms in an instruction, in quotes, so that translators keep them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from edge import names as words
from edge.mission.language.tokens import TranslationError

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
_STOPS = r"\bpatrol\s+(?:between\s+)?(?P<stops>[^.;!?]+?)[,\s]+"
_PATROL = re.compile(_STOPS + r"(?P<rounds>\w+)\s+(?:times|rounds)\b", re.I)
_LOOP = re.compile(
    _STOPS + r"(?P<end>\w+\s+(?:times|rounds)|for\s+(?!me\b|us\b)[\w.]+\s+\w+|"
    r"until\s+(?:I\s+(?:say|tell)\s[\w\s]+|told(?:\s[\w\s]+)?)|forever)\b(?P<rest>.*)$",
    re.I | re.S,
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


def _loop(instruction: str) -> str:
    """Return a patrol without a small number of rounds as stops with `repeat …` at the end.

    Raises:
        TranslationError: the patrol is not the whole instruction.
    """
    found = _LOOP.search(instruction)
    if found is None:
        return instruction
    end, stops = found["end"].lower().split(), _stops(found)
    counted = end[-1] in ("times", "rounds")
    rounds = words.number(end[:1]) if counted else None
    if len(stops) < 2 or (counted and (rounds is None or rounds <= MAX_ROUNDS)):
        return instruction
    before = instruction[: found.start()].strip(" ,").lower()
    if found["rest"].strip(" .!") or before not in ("", "please"):
        raise TranslationError(
            "instruction: a patrol for some time, or with more than "
            f"{MAX_ROUNDS} rounds, must be the whole instruction; send the rest afterwards"
        )
    timed = " ".join(end) if end[0] == "for" else "until told"
    phrase = f"{rounds} times" if counted else timed
    return f"{', then '.join(f'go to {stop}' for stop in stops)}; repeat {phrase}"


def _stops(found: re.Match[str]) -> list[str]:
    return re.split(r"\s*,\s*(?:and\s+)?|\s+and\s+", found["stops"].strip())


def _rounds(found: re.Match[str]) -> str:
    """Return a patrol as the stops of all its rounds; unchanged if their number is not clear."""
    rounds = words.number([found["rounds"].lower()])
    stops = _stops(found)
    if rounds is None or not 1 <= rounds <= MAX_ROUNDS or len(stops) < 2:
        return found[0]
    return ", then ".join(f"go to {stop}" for stop in stops * rounds)


def quote_places(instruction: str, names: Iterable[str]) -> str:
    """Put the names of places and rooms, and words for where the robot was, into double quotes.

    A patrol for some time becomes a list of stops with the phrase `repeat …` at the end, see
    `edge.mission.repetition`.

    Args:
        names: of places and rooms, in lower case.

    Raises:
        TranslationError: a patrol for some time is not the whole instruction.

    Example:
        >>> quote_places("Go to the charging dock, then come back.", ["charging dock"])
        'Go to "charging dock", then go to "here".'
    """
    pieces = re.split(r'("[^"]*")', _PATROL.sub(_rounds, _loop(instruction)))
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

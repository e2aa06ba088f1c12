"""Orders at a time of day: "at 9 am, go to the kitchen" becomes a wait, then the order."""

from __future__ import annotations

import re

from edge.mission.language.errands.periods import has_several_orders
from edge.mission.language.words.clock_times import CLOCK, refuse_unclear_times
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.tokens import unclear

_LASTS = re.compile(
    r"\b(?:wait|stay|remain|stand|stop|explore|look|search|find|patrol|guard|tour|map|scan)\b", re.I
)
"""Orders that may last for some time."""
_FIRST = re.compile(
    rf"(?P<joint>^|,? and(?: then)?|,? then|[.;]) at (?P<clock>{CLOCK}),?"
    r"(?= (?!(?:and|then|but|or)\b)[^\s.,;!?])",
    re.I,
)
"""The time before its order: "at 9:00 am, go …", "…, then at 9:00 am go …"."""
_LAST = re.compile(
    rf"(?P<lead>^|[.;!?])(?P<joint>(?: and| then)*)(?P<order> [^.;!?]*?),? at (?P<clock>{CLOCK})"
    r"(?=[.,;!?]|$| (?:and|then|but|without|to|into|back|home|if|whether|for|until)\b)",
    re.I,
)
"""The time after or in its order: "go to the dock at 9:00 am", "go at 9:00 am to the dock"."""
_BEGINS = ("verb", "endless", "stay", "must")  # kinds of words with which an order begins
_NOT_LATER = ("stop", "turn")  # "stop at 6:00 pm" is about what the robot does before
_LIMIT = re.compile(
    rf"\b(?P<verb>explor\w+|look|search|find|patrol\w*|guard\w*|tour|map|scan)\b"
    r"(?:(?! (?:wait|stay|remain|stand|go) )[^.;!?])*? "
    rf"(?P<until>until {CLOCK})",
    re.I,
)
_OTHER = re.compile(rf"(?:every day )?\b(?:at|by|before|after|from|around) {CLOCK}", re.I)


def lasts_before(found: re.Match[str]) -> bool:
    """Return True if the order before a match may last, so that a time may be its limit."""
    before = re.split(r"[.;!?,]| and | then ", found.string[: found.start()])[-1]
    return _LASTS.search(before) is not None


def put_times_first(text: str) -> str:
    """Return a text in which each time of day is a wait before its order.

    Args:
        text: an utterance that was tidied up, with a space before it.

    Raises:
        UnclearError: it is unclear which time is meant, or which orders it is for.

    >>> put_times_first(" go to the kitchen at 9:00 am, then come back")
    ' wait until 9:00 am, then go to the kitchen, then come back'
    """
    refuse_unclear_times(text)
    if limit := _LIMIT.search(text):
        hint = "only a wait ends at a time of day; say for how long, as in 'for two hours'"
        raise unclear(limit["until"], hint)
    text = _LAST.sub(_wait_before, _FIRST.sub(_wait_then, text))
    if other := _OTHER.search(text):
        hint = "say first when, then where to go, as in 'at 9 am, go to the dock'"
        raise unclear(other[0], hint)
    return text


def _wait_then(found: re.Match[str]) -> str:
    if not found["joint"]:
        return f" wait until {found['clock']}, then"
    if lasts_before(found):
        hint = "unclear if the order before it ends then; say for how long, as in 'for two hours'"
        raise unclear(found["clock"], hint)
    return f", then wait until {found['clock']}, then"


def _wait_before(found: re.Match[str]) -> str:
    order = found["order"].strip()
    first = order.split()[0].lower() if order else ""
    begins_order = TABLE.get((first,)) in _BEGINS or first == "guard"
    if not begins_order or first in _NOT_LATER:
        return found[0]
    if has_several_orders(order):
        hint = f"unclear which orders it is for; begin with it: 'at {found['clock']}, go …'"
        raise unclear(f"at {found['clock']}", hint)
    return f"{', then' * bool(found['lead'])} wait until {found['clock']}, then {order}"

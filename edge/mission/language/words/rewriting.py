"""Replacement in an instruction outside its quotes, and the text of plain orders."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Union

from edge.mission.language.words.places import is_marked
from edge.mission.language.words.templates import SentenceTemplate

Pattern = Union[re.Pattern[str], SentenceTemplate]
Change = Callable[[re.Match[str]], Union[str, None]]
"""Function that returns the replacement of a match; None keeps the match."""


def rewrite_outside_quotes(pattern: Pattern, change: Change, text: str) -> str:
    """Replace the matches of a pattern outside quotes."""

    def replace(found: re.Match[str]) -> str:
        # The match begins in quotes, or only one of its ends is in quotes.
        if text.count('"', 0, found.start()) % 2 or found[0].count('"') % 2:
            return found[0]
        new = change(found)
        return found[0] if new is None else new

    return pattern.sub(replace, text)


def go_to(proposition: str, found: re.Match[str] | None = None) -> str:
    """Return `go to "proposition"`; with "then" if the match is not at the start of the text."""
    later = found is not None and found.start() > 0
    return f'{", then" if later else ""} go to "{proposition}"'


def go_to_each(stops: Sequence[str]) -> str:
    """Return the order to go to each of the stops in sequence."""
    goals = (stop if is_marked(stop) or stop[0] == '"' else f"the {stop}" for stop in stops)
    return " " + ", then ".join(f"go to {goal}" for goal in goals)

"""Protection of place names in an instruction.

Each known name is put in quotes, so that translators do not read its words as orders.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from edge.mission.language.words import nouns

START = "start"
"""Name of the first pose of the service."""
HERE = "here"
"""Name of the pose at which a mission begins."""
EXPLORED = "explored"
"""Name of the end of an exploration, at any place."""
EVERY = "every"
"""First word of the proposition of a tour: "every room", "every bedroom"."""
NO = "no "
"""Beginning of the proposition that another target failed: "no mug" for "mug"."""
_FIRST_MARK = 0xF000  # placeholders are from Unicode's private-use area


def quote_places(instruction: str, names: Iterable[str]) -> str:
    """Put the names of places into double quotes, without their articles.

    Example:
        >>> quote_places("Go to the charging dock.", ["charging dock"])
        'Go to "charging dock".'
    """
    return restore_places(*mark_places(instruction, names))


def mark_places(instruction: str, names: Iterable[str]) -> tuple[str, list[str]]:
    """Replace each place name by one placeholder, so that it is one word.

    A placeholder is a character from Unicode's private-use area. Names in quotes stay.

    Returns:
        The text, and the names in the order of their placeholders; see `restore_places`.
    """
    known = sorted(names, key=len, reverse=True)
    if not known:
        return instruction, []
    # One group for each name: its number is that of the name.
    any_name = "|".join("(" + r"\s+".join(map(re.escape, name.split())) + ")" for name in known)
    named = re.compile(
        rf"\b(?:(?:the|my|our|your)\s+)?(?:{any_name})(?![\w'-])"
        r"(?=(?:\s+(?P<next>[\w'-]+))?)",
        re.I,
    )

    def mark(found: re.Match[str]) -> str:
        at = next(at for at, name in enumerate(found.groups()) if name)
        before = re.search(r"[\w'-]+ $", found.string[: found.start(at + 1)])
        longer = f"{before[0]}{known[at]}".lower() if before else ""
        if nouns.is_noun(f"{known[at]} {found['next']}".lower()) or longer in nouns.NOUNS:
            return found[0]  # "the reception desk" and "the loading dock" are one object
        return chr(_FIRST_MARK + at)

    pieces = re.split(r'("[^"]*")', instruction)
    pieces[::2] = [named.sub(mark, piece) for piece in pieces[::2]]
    return "".join(pieces), known


def restore_places(text: str, names: list[str]) -> str:
    """Replace the placeholders of `mark_places` by the names.

    A name that is not inside quotes already is put in quotes.
    """
    pieces = text.split('"')
    for i, piece in enumerate(pieces):
        quote = '"' if i % 2 == 0 else ""
        for at, name in enumerate(names):
            piece = piece.replace(chr(_FIRST_MARK + at), f"{quote}{name}{quote}")
        pieces[i] = piece
    return '"'.join(pieces)


def is_marked(name: str) -> bool:
    """Return True for the placeholder of a place."""
    return len(name) == 1 and ord(name) >= _FIRST_MARK

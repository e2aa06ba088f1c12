"""The words that the rules know, by kind; everything else can only name or describe a thing."""

from __future__ import annotations

import re

from edge.mission.language.words import Token

_SIDES = ("left", "right")

PHRASES: dict[str, str] = {
    # Who is spoken to, and words that carry nothing.
    "filler": "please|you|robot|the robot|can you|could you|now",
    "first": "first|first of all",
    # How steps hang together.
    "then": "then|and then|after that|and after that|afterwards|and afterwards|finally|and finally|"
    "next|and next",
    "and": "and",
    # What is done.
    "go": "go|drive|move|head|navigate|walk|travel|proceed|continue|come|roll|return|"
    "make your way|go on|drive on",
    "pass": "pass|pass by",
    "stop": "stop|halt|park|wait|end|come to a stop|come to a halt",
    # Where a thing is to the way.
    "to": "to|towards|toward|up to|over to|back to",
    "at": "at|near|next to|beside|close to|by",
    "past": "past",
    "around": "around|round",
    "between": "between|in between",
    "in front of": "in front of|to the front of",
    "behind": "behind",
    "straight": "straight|straight on|straight ahead|forward|forwards|ahead",
    "for": "for",
    "metres": "m|metre|metres|meter|meters",
    # Which thing is meant.
    "article": "the|a|an|this|that|your|my",
    "pronoun": "it",
    "id": "object|number|object number|thing number",
    "nearest": "|".join(
        f"{word}{to}"
        for word in ("nearest", "closest")
        for to in ("", " to you", " to me", " to the robot", " you")
    ),
    "farthest": "farthest|furthest|last|farthest away|furthest away|farthest from you|"
    "furthest from you|farthest away from you|furthest away from you",
    "from": "from",
    "here ahead": "in front of you|ahead of you|in front of the robot",
    "here behind": "behind you|behind the robot",
}
"""Kind → its phrases, separated by `|`."""

for _side in _SIDES:
    PHRASES[_side] = _side
    PHRASES[f"{_side}most"] = f"{_side}most|{_side} most|" + "|".join(
        (before + far + to + _side).strip()
        for far, to in (
            ("far", " "), ("farthest", " "), ("furthest", " "), ("farthest", " to the "),
            ("furthest", " to the "), ("farthest", " on the "), ("furthest", " on the "),
        )
        for before in (("", "on the ", "on your ", "to the ", "at the ") if to == " " else ("",))
    )  # fmt: skip
    PHRASES[f"from the {_side}"] = f"from the {_side}|from your {_side}|from {_side}"
    PHRASES[f"{_side} of"] = "|".join(
        f"{before}{_side}{after} of"
        for before in ("", "the ", "to the ", "on the ", "at the ")
        for after in ("", " side", " hand side")
    )
    PHRASES[f"its {_side}"] = "|".join(
        f"{before} its {_side}{after}" for before in ("on", "to", "by") for after in ("", " side")
    )
    PHRASES[f"on the {_side}"] = "|".join(
        f"{before} {_side}{after}"
        for before in ("on the", "on your", "to your", "on my", "on the robot's")
        for after in ("", " side", " hand side")
    ) + "".join(
        f"|on the {_side}{side} of the {way}"
        for side in ("", " side", " hand side") for way in ("road", "street", "robot")
    )  # fmt: skip

ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")
NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")

TABLE = {
    tuple(phrase.split()): kind for kind, listed in PHRASES.items() for phrase in listed.split("|")
}
LONGEST = max(map(len, TABLE))
MOST_DIGITS = 9

_TOKEN = re.compile(
    r"""(?P<ordinal>\d+(?:st|nd|rd|th)\b)|(?P<number>\d+(?:\.\d+)?)"""
    r"""|(?P<word>[^\W\d_]+(?:['’][^\W\d_]+)*)|(?P<mark>\S)"""
)
_PUNCTUATION = {",": "comma", ";": "stop mark", ".": "stop mark", "!": "stop mark"}


def tokenise(text: str) -> list[Token]:
    """An instruction's tokens, longest phrases first, with an "end" at the end.

    Kinds are those of `PHRASES`; "word" (of a name or a description), "number", "ordinal" (its text
    is the number), "comma", "stop mark" (a sentence's end), "mark" (nothing that is known), "end".
    """
    found = [
        (match.lastgroup or "mark", match[0].lower().replace("’", "'"), *match.span())
        for match in _TOKEN.finditer(text.replace("-", " "))
    ]
    tokens: list[Token] = []
    at = 0
    while at < len(found):
        length = _phrase_at(found, at)
        kind, word, start, end = found[at]
        if length:
            words, end = (
                tuple(item[1] for item in found[at : at + length]),
                found[at + length - 1][3],
            )
            tokens.append(Token(TABLE[words], " ".join(words), start, end))
        elif word in ORDINALS:
            tokens.append(Token("ordinal", str(ORDINALS.index(word) + 1), start, end))
        elif word in NUMBERS:
            tokens.append(Token("number", str(NUMBERS.index(word)), start, end))
        elif kind in ("ordinal", "number") and len(word) > MOST_DIGITS:
            tokens.append(Token("mark", word, start, end))
        elif kind == "ordinal":
            tokens.append(Token("ordinal", word[:-2], start, end))
        else:
            tokens.append(Token(_PUNCTUATION.get(word, kind), word, start, end))
        at += max(length, 1)
    return [*tokens, Token("end", "", len(text), len(text))]


def _phrase_at(found: list[tuple[str, str, int, int]], at: int) -> int:
    """How many words from there make the longest phrase; 0 when none does."""
    words = tuple(item[1] for item in found[at : at + LONGEST])
    return next((n for n in range(len(words), 0, -1) if words[:n] in TABLE), 0)

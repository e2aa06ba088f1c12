"""Words that the grammar of tasks knows, by kind, and the tokeniser that finds them.

Any other word can only name or describe an object.
"""

from __future__ import annotations

import re

from edge.mission.language.words.tokens import Token

_SIDES = ("left", "right")

PHRASES: dict[str, str] = {
    # Forms of address, and words without meaning for the task.
    "filler": "please|you|robot|the robot|can you|could you|would you|will you|now|just|kindly|"
    "i want you to|i need you to|i would like you to|i'd like you to|you should|you must|"
    "you have to|you need to|your task is to|let's|ok|okay",
    "for me": "for me",
    "first": "first|first of all",
    # Joints between steps.
    "then": "then|and then|after that|and after that|afterwards|and afterwards|finally|and finally|"
    "next|and next",
    "and": "and",
    "in order": "in that order|in this order",
    # Verbs.
    "go": "go|drive|move|head|navigate|walk|travel|proceed|continue|come|roll|return|steer|get|"
    "make your way|go on|drive on|keep going|keep driving|run|swing|squeeze|take me|bring me|"
    "lead me|guide me|advance",
    "pass": "pass|pass by|overtake|bypass",
    "stop": "stop|halt|park|wait|end|come to a stop|come to a halt|stand|pull up|pull over|meet me|"
    "wait for me|go and stand|go and stop|go and wait",
    "reach": "approach|reach|visit|head for|make for",
    "leave": "leave|keep",
    "follow": "follow",
    "circle": "circle|circle around|circle round|encircle|once around|once round|"
    "in a circle around|all the way around|a circle around|a full circle around|a lap around",
    "clockwise": "clockwise",
    "counterclockwise": "counterclockwise|anticlockwise|counter clockwise|anti clockwise",
    "across": "cross|across|cross over|over to the other side of|to the other side of|"
    "cross over to the other side of",
    "turn": "turn|rotate",
    "turn around": "turn around|turn round|turn back|make a u turn|do a u turn|take a u turn",
    "degrees": "degrees|degree",
    # Restrictions of the entire path, and of the distance from its end.
    "avoid": "avoid|avoiding|but avoid|while avoiding|keep away from|keep clear of|stay clear of|"
    "stay away from|steer clear of|keeping away from|staying away from|keep off|stay off|"
    "without going near|without coming near|without getting near|but keep clear of|"
    "but stay clear of|but keep away from|but stay away from|do not drive on|don't drive on|"
    "do not drive over|don't drive over|without driving on|without driving over|"
    "without crossing",
    "keep to": "keep to|keep on|stay on|remain on|keeping to|keeping on|staying on|but keep to|"
    "but stay on",
    "gap": "but stay|but keep|but stop|but not closer than|but no closer than|not closer than|"
    "no closer than|at a distance of|from a distance of",
    "short of": "short of",
    "away": "away|away from it|from it|short of it|before it",
    "from behind": "from behind|from the back|from the rear",
    "until": "until you reach|until you get to|until you come to|until you are at|until reaching",
    "until level": "until you are next to|until you are beside|until you are level with",
    # Verbs in a clause that depends on another: "after passing the van".
    "going": "going|by going|by driving|driving|moving|heading|steering|gone|driven",
    "passing": "via|by way of|passing|passing by|passed|passed by|overtaking|bypassing",
    "stopping": "stopping|halting|stopped|halted",
    "reaching": "approaching|reaching|visiting|reached|visited",
    "leaving": "leaving|keeping|with",
    "after": "after|once|as soon as|when",
    "before": "before",
    "while": "while|whilst",
    "having": "having|you have|you've|you are|you're",
    # Position of an object relative to the path.
    "to": "to|towards|toward|up to|over to|back to|on your way to|on the way to|"
    "as close as you can to|as near as you can to|as close as possible to",
    "at": "at|near|next to|beside|close to|by",
    "past": "past",
    "along": "along|alongside",
    "around": "around|round",
    "between": "between|in between|through between|halfway between|midway between|"
    + "|".join(
        f"{before} the {gap} between"
        for before in ("through", "in", "into")
        for gap in ("gap", "space", "middle")
    )
    + "".join(
        f"|to {place} {middle} between"
        for place in ("the spot", "the point", "the place", "a spot", "a point", "a place")
        for middle in ("midway", "halfway", "in the middle")
    ),
    "in front of": "in front of|to the front of|at the front of",
    "behind": "behind|to the back of|at the back of",
    "halfway": "halfway to|half way to|half the way to|half of the way to",
    "onto": "onto|on to|into|on|in|enter",
    "straight": "straight|straight on|straight ahead|forward|forwards|ahead",
    "for": "for",
    "metres": "m|metre|metres|meter|meters",
    "half": "half a",
    "and a half": "and a half",
    # Words that choose an object.
    "article": "the|a|an|this|that|your|my",
    "pronoun": "it",
    "there": "there",
    "which is": "that is|which is|that's|that are|which are|that stands|which stands",
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

GROUNDS: dict[str, str] = {
    "road": "road|street|roadway|asphalt",
    "sidewalk": "sidewalk|pavement|footpath|walkway",
    "parking": "parking lot|parking area|parking space|car park",
    "lawn": "lawn|grass|meadow|terrain",
    "path": "path|track|trail",
    "courtyard": "courtyard|yard",
    "square": "square|plaza",
}
"""Kind of ground → its names, separated by `|`. A region is of the kind that its label names."""
PHRASES["ground"] = "|".join(GROUNDS.values())

# Also with an adverb: "right behind", "directly in front of".
for _kind in ("at", "in front of", "behind", "here ahead", "here behind", "there"):
    PHRASES[_kind] += "".join(
        f"|{how} {phrase}"
        for how in ("right", "directly", "just", "immediately")
        for phrase in PHRASES[_kind].split("|")
    )

# For each side five more kinds: "leftmost" ("the far left"), "from the left" ("from your left"),
# "left of" ("to the left side of"), "its left" ("on its left side"), and "on the left" ("on your
# left", "on the left side of the road").
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
    PHRASES[f"turn {_side}"] = "|".join(
        f"{verb} {before}{_side}{after}"
        for verb, befores in (("turn", ("", "to the ", "to your ")), ("make", ("a ",)),
                              ("take", ("a ", "the ")))
        for before in befores for after in ("", " turn")
    )  # fmt: skip
    PHRASES[f"from the {_side}"] = f"from the {_side}|from your {_side}|from {_side}"
    PHRASES[f"{_side} of"] = "|".join(
        f"{before}{_side}{after} of"
        for before in ("", "the ", "to the ", "on the ", "at the ")
        for after in ("", " side", " hand side")
    )
    PHRASES[f"its {_side}"] = "|".join(
        f"{before}its {_side}{after}"
        for before in ("", "on ", "to ", "by ", "at ")
        for after in ("", " side", " hand side")
    )
    PHRASES[f"on the {_side}"] = "|".join(
        f"{before} {_side}{after}"
        for before in ("on the", "on your", "to your", "on my", "on the robot's")
        for after in ("", " side", " hand side")
    ) + "".join(
        f"|on the {_side}{side} of the {way}"
        for side in ("", " side", " hand side") for way in ("road", "street", "robot")
    )  # fmt: skip

_GROUND_OF = {name: kind for kind, listed in GROUNDS.items() for name in listed.split("|")}


def ground_kind(name: str) -> str:
    """Return the kind of ground that a word or a region's label names; an unknown one is its own.

    >>> ground_kind("street"), ground_kind("gravel")
    ('road', 'gravel')
    """
    return _GROUND_OF.get(name, name)


ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")
NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")

# Words of a phrase → its kind.
TABLE = {
    tuple(phrase.split()): kind for kind, listed in PHRASES.items() for phrase in listed.split("|")
}
LONGEST = max(map(len, TABLE))  # words of the longest phrase
MOST_DIGITS = 9  # a number with more digits becomes a "mark", which no rule accepts

# One token. Groups: `quoted` and `quote`: text in double or single quotation marks; `remark`:
# brackets in a name, as in "bow (weapon)"; `ordinal`:
# "2nd"; `number`: "3.5"; `word`: "van", "van's" or "&"; `dash`: that of "to the van - then stop";
# `mark`: any other character.
_TOKEN = re.compile(
    r"""["“](?P<quoted>[^"“”]*\w[^"“”]*)["”]|(?<!\w)['‘](?P<quote>[^'‘’]*\w[^'‘’]*)['’](?!\w)"""
    r"""|(?P<remark>\((?!the |an? )[^\W\d_]+(?: [^\W\d_]+){0,2}\))"""
    r"""|(?P<ordinal>\d+(?:st|nd|rd|th)\b)|(?P<number>\d+(?:\.\d+)?)"""
    r"""|(?P<word>[^\W\d_]+(?:['’][^\W\d_]+)*|&)"""
    r"""|(?P<dash>(?<=\s)[-–—](?=\s+[^\W\d_]))|(?P<mark>\S)"""
)
_HYPHEN = re.compile(r"(?<=[^\W_])-(?=[^\W\d_])")
"""Hyphen between the parts of a word, as in "left-hand". Any other may be a minus and is kept."""
_PUNCTUATION = {
    ",": "comma",
    ";": "stop mark",
    ".": "stop mark",
    "!": "stop mark",
    "?": "stop mark",
}


def tokenise(text: str) -> list[Token]:
    """Split an instruction into tokens, the longest phrases first, with an "end" at the end.

    Kinds are those of `PHRASES` and:

    - "word": part of a name or a description; each word in quotes or in brackets is one.
    - "number", "ordinal": the text of an ordinal is its number.
    - "comma", "stop mark" (end of a sentence), "mark" (any other character), "end".
    """
    found: list[tuple[str, str, int, int]] = []  # group of `_TOKEN`, text, start, end
    for match in _TOKEN.finditer(_HYPHEN.sub(" ", text)):
        kind = match.lastgroup or "mark"
        if kind in ("quoted", "quote", "remark"):
            found += [("quoted", word.lower(), *match.span()) for word in match[kind].split()]
        else:
            found.append((kind, match[0].lower().replace("’", "'"), *match.span()))
    tokens: list[Token] = []
    at = 0
    while at < len(found):
        length = _phrase_at(found, at)
        kind, word, start, end = found[at]
        if kind == "quoted":
            tokens.append(Token("word", word, start, end))
        elif length:
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
            kind = "comma" if kind == "dash" else _PUNCTUATION.get(word, kind)
            tokens.append(Token(kind, word, start, end))
        at += max(length, 1)
    return [*tokens, Token("end", "", len(text), len(text))]


def _phrase_at(found: list[tuple[str, str, int, int]], at: int) -> int:
    """Return the number of words that make the longest phrase at an index; 0 if there is none.

    Words in quotation marks belong to no phrase.
    """
    words = tuple("" if kind == "quoted" else word for kind, word, *_ in found[at : at + LONGEST])
    return next((n for n in range(len(words), 0, -1) if words[:n] in TABLE), 0)

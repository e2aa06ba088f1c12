"""Numbers in words: "twelve", "twenty one", "2nd".

>>> number(["twenty", "one"]), ordinal("third")
(21, 3)
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_SMALL_NUMBERS = """
    zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen
    sixteen seventeen eighteen nineteen
"""
_ORDINALS = "first second third fourth fifth sixth seventh eighth ninth tenth"
SMALL_NUMBERS = tuple(_SMALL_NUMBERS.split())
"""Words for 0 to 19."""
# Words for 20, 30, …
TENS = ("twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety")
ORDINALS = tuple(_ORDINALS.split())
"""Words for 1st to 10th."""


def number(words: Sequence[str]) -> int | None:
    """Return the number that one or two words spell; None if they spell none.

    >>> number(["12"]), number(["twelve"]), number(["twenty", "one"]), number(["chair"])
    (12, 12, 21, None)
    """
    first, last = words[0], words[-1]
    if len(words) == 2:
        units = SMALL_NUMBERS[1:10]
        if first in TENS and last in units:
            return 10 * (TENS.index(first) + 2) + units.index(last) + 1
        return None
    if last.isdecimal() and last.isascii() and len(last) < 10:
        return int(last)
    if last in SMALL_NUMBERS:
        return SMALL_NUMBERS.index(last)
    return 10 * (TENS.index(last) + 2) if last in TENS else None


_NTH = re.compile(r"(\d{1,9})(?:st|nd|rd|th)")
_TEENTHS = {"eleventh": 11, "twelfth": 12, "twentieth": 20}


def ordinal(word: str) -> int | None:
    """Return the number of an ordinal, such as 12 for "12th" or "twelfth"; None for other words.

    Known are all in digits, and those in words up to "twentieth".
    """
    if found := _NTH.fullmatch(word):
        return int(found[1])
    if word in ORDINALS:
        return ORDINALS.index(word) + 1
    if word in _TEENTHS:
        return _TEENTHS[word]
    return number([word.removesuffix("th")]) if word.endswith("teenth") else None

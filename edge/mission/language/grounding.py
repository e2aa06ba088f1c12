"""Which objects an instruction names, so that a formula cannot speak of any other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby

from edge import names
from edge.mission.language import lexicon

LONGEST_NAME = 5  # words in one name of the alias table
LONGEST_UNKNOWN = 3  # words in a name that the alias table does not have

ARTICLES = frozenset({"a", "an", "the", "some", "any", "my", "our"})
# Words that are no part of an object's name, but for those that the alias table has.
STOP_WORDS = frozenset(word for phrase in lexicon.TABLE for word in phrase) | ARTICLES
STOP_WORDS |= {"for", "from", "than", "how", "which", "who", "what", "s", "t", "doesn", "didn"}


def objects_in(instruction: str) -> tuple[str, ...]:
    """Phrases of an instruction that may name an object, in lower case, in order, each once.

    The longest names of the alias table come first; a name within a longer one ("table" in
    "coffee table") is not named. What is left between them and `STOP_WORDS` may be the words
    before such a name ("red chair"), or a name that the table does not have.

    >>> objects_in("Go to the coffee table, then decorate the red potted plant.")
    ('coffee table', 'decorate', 'potted plant', 'red potted plant')
    >>> objects_in("Do not do that!")
    ()
    """
    found: list[str] = []
    for part in re.split(r"[^\w\s'’&\-]+", instruction.lower()):
        for named, run in groupby(_names_and_words(part), key=_may_name):
            if named:
                found += _phrases(list(run))
    return tuple(dict.fromkeys(found))


def _names_and_words(part: str) -> Iterator[str]:
    """The known names in a part of an instruction, longest first, and the words between them."""
    words = re.findall(r"[^\W_]+|&", part)
    at = 0
    while at < len(words):
        length = 1
        if words[at] not in ARTICLES:  # `names` takes one before a name for a part of it
            lengths = range(min(LONGEST_NAME, len(words) - at), 1, -1)
            known = (n for n in lengths if names.is_known(" ".join(words[at : at + n])))
            length = next(known, 1)
        yield " ".join(words[at : at + length])
        at += length


def _may_name(item: str) -> bool:
    return item not in STOP_WORDS or names.is_known(item)


def _phrases(run: list[str]) -> Iterator[str]:
    """The names that a run of known names and unknown words may hold."""
    before: list[str] = []
    for item in run:
        if names.is_known(item):
            yield item
            if 0 < len(before) <= LONGEST_UNKNOWN:
                yield " ".join((*before, item))
            before = []
        else:
            before.append(item)
    for first in range(len(before)):
        for end in range(first + 1, min(first + LONGEST_UNKNOWN, len(before)) + 1):
            yield " ".join(before[first:end])

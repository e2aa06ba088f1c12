"""Words as people write them: contractions, informal spellings, and the words that they mean."""

from __future__ import annotations

import re

from edge.mission.language.words import nouns
from edge.number_words import SMALL_NUMBERS, TENS

WORD = re.compile(r"[^\W_]+(?:['\-_][^\W_]+)*")
"""A word: letters and digits, with single ' - _ between them, as in "don't" and "twenty-one"."""
# Contraction or informal spelling → its words.
_CONTRACTIONS = {
    "can't": "can not",
    "ur": "your", "pls": "please", "plz": "please", "gotta": "have to", "wanna": "want to",
    "gonna": "going to", "lemme": "let me", "untill": "until", "'til": "until",
    "anytime": "any time", "thru": "through", "isnt": "is not", "dont": "do not",
    "didnt": "did not", "cant": "can not", "wont": "will not", "cannot": "can not",
    "won't": "will not", "shan't": "shall not", "let's": "let us", "i'm": "i am", "im": "i am",
    "ive": "i have", "youre": "you are", "where'd": "where did",
    "everything's": "everything is",
    **{f"{word}{end}": f"{word} is" for word in ("where", "what", "there", "that")
       for end in ("s", "'s")},
    **{f"{word}'s": f"{word} is" for word in ("it", "he", "she", "here", "how", "who")},
}  # fmt: skip
# "2nd", "twenty-one"
_NUMERAL = re.compile(r"(\d{1,2})(?:st|nd|rd|th)")
_COMPOUND = re.compile(rf"({'|'.join(TENS)})-({'|'.join(SMALL_NUMBERS[1:10])})")
# End of a contraction → the words that replace it.
_ENDINGS = {"n't": " not", "'ve": " have", "'re": " are", "'ll": " will", "'d": " would"}


def expand_word(word: str) -> list[str]:
    """Return the words for which a word stands: `don't` is do, not; `2nd` is second."""
    if word in _CONTRACTIONS:
        return _CONTRACTIONS[word].split()
    if (numeral := _NUMERAL.fullmatch(word)) and 0 < int(numeral[1]) < len(nouns.NUMERALS):
        return [nouns.NUMERALS[int(numeral[1]) - 1]]
    if compound := _COMPOUND.fullmatch(word):
        return [compound[1], compound[2]]
    for ending, full in _ENDINGS.items():
        if word.endswith(ending) and len(word) > len(ending):
            return (word[: -len(ending)] + full).split()
    return [word]

"""Tokens of an English instruction (known phrases and possible names), and a reader for them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

from edge import number_words
from edge.errors import UserError
from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import LONGEST, TABLE
from edge.mission.language.words.spelling import WORD, expand_word
from edge.text import one_line

MAX_CHARS = 10_000
"""Largest number of characters of an instruction."""
MAX_WORDS = 1_000
"""Much more than an instruction needs; it limits the formula, and so the time to compile it."""

REASONS = {
    "endless": "a patrol needs two stops, or rooms: 'patrol the dock and the shelf', or 'patrol "
    "the house'",
    "forever": "a mission ends, so 'forever' is not possible",
    "going on": "say where to go, or 'until … is reached'",
    "stay": "the robot can only go to objects, not stay or leave",
    "stray": "leave it out",
    "origin": "a mission starts where the robot is; say 'first go to …'",
    "needless": "this is optional and asks for nothing; leave it out",
    "picture": "the robot can only go to objects; say 'photograph the …'",
    "mark": "this character is not allowed in an instruction",
}
"""Reasons to refuse tokens, by kind."""

ONE_ROBOT = "an instruction is for one robot only"
ONLY_REACHED = "the state of an object cannot be used, only that it is reached"
PAST_TENSE = "this describes the past; say what to do"
NONE_OR_NOT_ALL = "unclear: none of them, or not all? say for each if to avoid it"
"""Hints of refusals by several parsers."""

_DRIVEN = ("car", "vehicle")  # after "the", they may mean the robot or an object
_ARTICLES = ("a", "an", "any", "my", "our", "your", "some", "another")
_ACTS = ("must", "can", "verb", "not", "do", "always")  # kinds after "u" that means "you"
# Words that are skipped, unless they correct a name.
HESITATIONS = ("uh", "um", "er", "erm", "hmm")
# A name with an article, after a hesitation.
_NAMES = re.compile(r"[\s,]*(?:to )?(?:the|an?|my) ", re.IGNORECASE)
_MAY_SHUN = ("stay", "keep")  # "stay on the far side of": another translator may understand it
_SHOWN = 60  # most characters of a part in a message
_PUNCTUATION = {",": "comma", ";": "stop", ".": "stop", "!": "stop", "?": "stop", ":": "comma"}
_TOKEN = re.compile(rf"""(?P<quoted>"[^"]*")|(?P<word>{WORD.pattern})|(?P<mark>\S)""")
# Typographic quotes and dashes → plain ones.
STRAIGHT = str.maketrans({"’": "'", "‘": "'", "“": '"', "”": '"', "–": "-"})


class TranslationError(UserError):
    """An instruction that cannot be translated.

    Attributes:
        part: the part that was not understood, in the user's words; "" if there is no such part.
        position: position of its first character, counted from 1; 0 if there is no such part.
    """

    def __init__(self, message: str, part: str = "", position: int = 0) -> None:
        super().__init__(message)
        self.part = part
        self.position = position


class UnclearError(TranslationError):
    """An instruction that is no order, or is unclear; no other translator may guess its meaning."""


def not_understood(part: str, position: int, hint: str) -> TranslationError:
    """Return the error for a part of an instruction, with the part shortened and its position."""
    shown = one_line(part, _SHOWN) or " ".join(f"U+{ord(c):04X}" for c in part[:8])
    what = f"did not understand {shown!r}" if part.strip() else "it ends too early"
    return TranslationError(f"instruction, character {position}: {what}: {hint}", part, position)


def unclear(part: str, hint: str) -> UnclearError:
    """Return the error for a part of an instruction that is unclear."""
    return UnclearError(f"instruction: {one_line(part)!r}: {hint}", part.strip())


@dataclass(frozen=True, slots=True)
class Token:
    """A known phrase, a possible name, or a punctuation mark.

    Attributes:
        kind: a kind of the lexicon, "word" or "quoted" (a name), "comma", "stop" (end of a
            sentence), "end", or "mark" (a character that is not allowed).
        text: lower case; for a quotation, the text between the quotes.
        start: offset of the first character in the instruction.
        end: offset after the last character.
    """

    kind: str
    text: str
    start: int
    end: int


def tokenise(text: str) -> list[Token]:
    """Return the instruction's tokens, with an "end" token at the end; the longest phrases win.

    Raises:
        TranslationError: the instruction is too long.
    """
    if len(text) > MAX_CHARS:
        hint = f"an instruction has at most {MAX_CHARS} characters"
        raise not_understood(text[MAX_CHARS:], MAX_CHARS + 1, hint)
    words = _split_words(text)
    if len(words) > MAX_WORDS:
        late = words[MAX_WORDS].start
        raise not_understood(text[late:], late + 1, f"it has more than {MAX_WORDS} words")
    tokens: list[Token] = []
    i = 0
    while i < len(words):
        word = words[i]
        if word.text == "u" and i + 1 < len(words) and TABLE.get((words[i + 1].text,)) in _ACTS:
            words[i] = word = replace(word, text="you")
        if _is_car_robot(words, i):  # "the car must go to a": the car is the robot, no target
            tokens.append(Token("you", f"the {words[i + 1].text}", word.start, words[i + 1].end))
            i += 2
            continue
        length = _phrase_length(words, i) if word.kind == "word" else 0
        if length:
            phrase = tuple(w.text for w in words[i : i + length])
            end = words[i + length - 1].end
            kind = TABLE[phrase]
            if length == 1 and (_is_ordinal_of_name(words, i) or _is_object(words, i)):
                kind = "word"
            robot = tokens[-1] if tokens else None
            if phrase == ("visits",) and robot and (robot.kind == "you" or robot.text == "it"):
                kind = "verb"  # "the robot visits the bed": a verb, no count
            tokens.append(Token(kind, " ".join(phrase), word.start, end))
        elif word.text.isdecimal():
            tokens.append(Token("number", word.text, word.start, word.end))
        else:
            tokens.append(word)
        i += max(length, 1)
    return [*tokens, Token("end", "", len(text), len(text))]


def _split_words(text: str) -> list[Token]:
    words: list[Token] = []
    for match in _TOKEN.finditer(text.translate(STRAIGHT)):
        found, start, end = match.group(), match.start(), match.end()
        if match["quoted"] is not None:
            words.append(Token("quoted", found[1:-1].strip(), start, end))
        elif match["word"] is not None:
            if found.lower() in HESITATIONS and not _is_correction(words, text[end:]):
                continue
            for part in expand_word(found.lower()):
                words.append(Token("word", part, start, end))
        elif found == "&":
            words.append(Token("word", found, start, end))
        else:
            words.append(Token(_PUNCTUATION.get(found, "mark"), found, start, end))
    return words


def _is_correction(words: Sequence[Token], rest: str) -> bool:
    """Return True if a hesitation here corrects a name: "the bed, er, the sofa"."""
    named = len(words) > 1 and words[-1].kind == "comma" and nouns.is_noun(words[-2].text)
    return named and _NAMES.match(rest) is not None


def _is_car_robot(words: Sequence[Token], i: int) -> bool:
    """Return True if "the car" is the robot here: it goes, must go, never goes."""
    if words[i].text != "the" or len(words) < i + 4 or words[i + 1].text not in _DRIVEN:
        return False
    kind, verb = TABLE.get((words[i + 2].text,)), words[i + 2].text
    if kind in ("must", "can", "not"):
        return words[i + 3].text != "be"
    return kind == "verb" and verb.endswith("s") and not verb.endswith("ss")


def _is_ordinal_of_name(words: Sequence[Token], i: int) -> bool:
    """Return True if a word numbers the next word ("second floor"), not a step."""
    if words[i].text not in nouns.ORDINALS or len(words) < i + 2:
        return False
    numbered = words[i + 1].text in nouns.NUMBERED
    beyond = words[i + 2].text if len(words) > i + 2 else ""
    return numbered and number_words.number([beyond]) is None


def _is_object(words: Sequence[Token], i: int) -> bool:
    """Return True if a word of the lexicon is used as a noun here.

    The "robot" of "find a little robot" is no address; the "mop" of "the mop" and the "water" of
    "the water cooler" are no verbs.
    """
    kind = TABLE[(words[i].text,)]
    pair = " ".join(word.text for word in words[i : i + 2])
    named = nouns.is_noun(words[i].text) or (kind == "verb" and nouns.is_noun(pair))
    if kind not in ("filler", "addressed", "verb") or not named:
        return False
    first = i
    while first and words[first - 1].text in nouns.QUALITIES:
        first -= 1
    article = words[first - 1].text if first else ""
    return article in _ARTICLES or (article == "the" and (first < i or kind == "verb"))


def _phrase_length(words: Sequence[Token], i: int) -> int:
    """Return the number of words of the longest known phrase that begins here; 0 for none."""
    key: tuple[str, ...] = ()
    longest = 0
    for word in words[i : i + LONGEST]:
        if word.kind != "word":
            break
        key = (*key, word.text)
        if key in TABLE:
            longest = len(key)
    return longest


class TokenReader:
    """A cursor on the tokens of an instruction.

    Args:
        tokens: tokens of another lexicon; None uses the mission's lexicon.
        picks: the choice to take at ambiguous tokens, by offset of the token.

    Attributes:
        at: index of the next token.
        forks: number of choices at each ambiguous token, by offset of the token.
    """

    def __init__(
        self, text: str, tokens: list[Token] | None = None, picks: Mapping[int, int] | None = None
    ) -> None:
        self.text = text
        self.tokens = tokenise(text) if tokens is None else tokens
        self.at = 0
        self.forks: dict[int, int] = {}
        self._picks = picks or {}

    def pick(self, token: Token, ways: int) -> int:
        """Return the number of the choice to take at an ambiguous token in this pass."""
        self.forks[token.start] = ways
        return self._picks.get(token.start, 0)

    def peek(self, ahead: int = 0) -> Token:
        """Return the token `ahead` places after the next one; "end" beyond the last."""
        return self.tokens[min(self.at + ahead, len(self.tokens) - 1)]

    def is_at(self, *kinds: str, ahead: int = 0) -> bool:
        """Return True if the token `ahead` places after the next one has one of these kinds."""
        return self.peek(ahead).kind in kinds

    def take(self, *kinds: str) -> Token | None:
        """Take and return the next token if it has one of these kinds, else None."""
        token = self.peek()
        if token.kind not in kinds or token.kind == "end":
            return None
        self.at += 1
        return token

    def skip(self, *kinds: str) -> None:
        """Skip all tokens of these kinds."""
        while self.take(*kinds):
            pass

    def refuse_finally(self, hint: str, start: Token | None = None) -> NoReturn:
        """Raise an UnclearError that names the rest of this sentence, from `start` on."""
        part, position = self._rest_of_sentence(start or self.peek())
        error = not_understood(part, position, hint)
        raise UnclearError(str(error), part, position)

    def refuse(self, hint: str, start: Token | None = None) -> NoReturn:
        """Raise a TranslationError that names the rest of this sentence, from `start` on."""
        first = start or self.peek()
        if first.kind in REASONS and not first.text.startswith(_MAY_SHUN):
            self.refuse_finally(REASONS[first.kind], first)
        raise not_understood(*self._rest_of_sentence(first), REASONS.get(first.kind, hint))

    def _rest_of_sentence(self, first: Token) -> tuple[str, int]:
        """Return the text from a token to the end of its part of the sentence, and its position."""
        i = next((i for i, token in enumerate(self.tokens) if token is first), self.at)
        last = first
        for token in self.tokens[i:]:
            if token.kind in ("stop", "comma", "end") and token is not first:
                break
            if token.start < first.start:  # tokens of tasks may be in driving order
                break
            last = token
        return self.text[first.start : last.end], first.start + 1

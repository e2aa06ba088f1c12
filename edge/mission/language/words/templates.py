"""Sentence templates: patterns of everyday sentences, written as text.

The modules `intents`, `errands` and `remarks` compile them to regular expressions. An example:

    where (is|are) <object> [now|exactly]*

- `(a|b)` is a choice, `[a|b]` may be left out, and `*` after one of these repeats it any number of
  times.
- `<object>` is a slot: a name of up to five words, with or without an article. The match has its
  text as a named group. So is each slot that is not in the next list.
- `<stops>` is a list of names, `<each>` means several rooms, such as "all bedrooms", `<own>` is a
  name with "the" or "my", `<count>` a number, `<often>` once or twice, `<relation>` a word such as
  "behind", `<done>` a form such as "mopped", `<span>` a length of time, such as "ten minutes", and
  `<clock>` a time of day, as `clock_times.write_times` writes it.
- `{seen}` is another template, by its name in a table of parts.
- `,` is a comma that may be left out, and `...` is any rest that begins no new order.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache

from edge.mission.language.words.clock_times import CLOCK
from edge.mission.language.words.everyday_words import EACH_ROOM, MARK, NAME, PLAIN_NAME, phrase_of
from edge.mission.language.words.spans import COUNT, DURATION

_TOKEN = re.compile(r"<(?P<slot>\w+)>|\{(?P<part>\w+)\}|(?P<rest>\.\.\.)|(?P<mark>[()\[\]|*,])"
                    r"|(?P<word>[^\s()\[\]|*,<{]+)")  # fmt: skip
STOP = rf"(?:,? (?:and then|and|then|to|or) |, | (?={MARK}|the ))"
"""Regular expression for what separates the names of a list."""
_SLOTS = {
    "span": DURATION,
    "clock": CLOCK,
    "count": COUNT,
    "often": r"(?:once|twice|thrice)",
    "relation": phrase_of("relation"),
    "done": r"\w+(?:ed|ing)",
    "each": EACH_ROOM,
    "own": rf"(?:the|my|our|your|his|her|their) {PLAIN_NAME}",
    "stops": rf"{NAME}(?:{STOP}{NAME})+",
}
_MARKS = {"(": "(?:", ")": ")", "[": "(?:", "]": ")?", "|": "|", "*": "*", ",": ",?"}
_ORDER = (
    r"(?:(?:do )?not )?(?:go|come|drive|head|run|move|visit|explore|patrol|check|look|search|stay|"
    r"keep|enter|leave|return|wait|bring|fetch|take|get|not (?:the|an?|my|to))\b"
)
# Matches after " i ", " to " and the like. So `...` goes on at the "go" of "because I go out", but
# ends before the "go" of "because it rains go home".
_HAS_SUBJECT = "|".join(
    f"(?<= {word} )"
    for word in ("i", "we", "you", "he", "she", "they", "people", "to", "can", "will", "would")
)
_REST = (
    r"(?: (?!(?:then|and|or|but|find|instead|first|never|avoid|without|except|\.)(?: |$))"
    rf"(?:(?!{_ORDER})|{_HAS_SUBJECT})[^\s,;]+)*"
)
"""The words for `...`: any rest that begins no order, as in "because I go out"."""
END = r"(?=[ ,.;!?]|$)"
"""End of a word."""


def pattern(template: str, parts: Mapping[str, str]) -> str:
    """Return the regular expression of a template, in which each word follows a space.

    Args:
        template: see the module.
        parts: name -> template, for `{name}`.

    Example:
        >>> re.fullmatch(pattern("stop [now]*", {}), " stop now now") is not None
        True
    """
    pieces = []
    for token in _TOKEN.finditer(template):
        if slot := token["slot"]:
            pieces.append(f" (?P<{slot}>{_SLOTS.get(slot, NAME)})")
        elif token["part"]:
            pieces.append(f"(?:{pattern(parts[token['part']], parts)})")
        elif token["rest"]:
            pieces.append(_REST)
        elif token["mark"]:
            pieces.append(_MARKS[token["mark"]])
        else:
            pieces.append(f" {re.escape(token['word'])}")
    return re.sub(r"\)\?\*", ")*", "".join(pieces))  # "[a]*" gave "(?: a)?*"


class SentenceTemplate:
    """A sentence template that compiles its regular expression when it is needed.

    There are about 600, and most texts lack a word of nearly all of them. So the words are compared
    first; to compile all takes more than a second.
    """

    def __init__(self, template: str, parts: Mapping[str, str]) -> None:
        self._template, self._parts = template, parts
        self._needed = _needed_words(template, parts)

    @cached_property
    def _regex(self) -> re.Pattern[str]:
        return re.compile(pattern(self._template, self._parts) + END, re.I)

    def _may_fit(self, text: str) -> bool:
        return not any(words.isdisjoint(_words_of(text)) for words in self._needed)

    def match(self, text: str) -> re.Match[str] | None:
        """Match at the start of a text."""
        return self._regex.match(text) if self._may_fit(text) else None

    def fullmatch(self, text: str) -> re.Match[str] | None:
        """Match an entire text."""
        return self._regex.fullmatch(text) if self._may_fit(text) else None

    def sub(self, replace: Callable[[re.Match[str]], str], text: str) -> str:
        """Replace all matches in a text."""
        return self._regex.sub(replace, text) if self._may_fit(text) else text


@lru_cache(maxsize=16)
def _words_of(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"[^ ,.;!?]+", text.lower()))


def _needed_words(template: str, parts: Mapping[str, str]) -> list[frozenset[str]]:
    """Return sets of words, one for each word or choice of a template that no text may leave out.

    A text that fits has a word of each set.

    >>> [sorted(words) for words in _needed_words("where (is|are) <object> [now]", {})]
    [['where'], ['are', 'is']]
    """
    tokens = [*_TOKEN.finditer(template)]
    needed, at = _needed_in_group(tokens, 0, parts)
    assert at == len(tokens), template
    return needed


def _needed_in_group(
    tokens: Sequence[re.Match[str]], at: int, parts: Mapping[str, str]
) -> tuple[list[frozenset[str]], int]:
    """Return the needed words of a choice that begins at a token, and the index of its end."""
    choices: list[list[frozenset[str]]] = [[]]
    while at < len(tokens) and tokens[at]["mark"] not in (")", "]"):
        token = tokens[at]
        needed: list[frozenset[str]] = []
        if token["mark"] in ("(", "["):
            needed, at = _needed_in_group(tokens, at + 1, parts)
            repeated = at + 1 < len(tokens) and tokens[at + 1]["mark"] == "*"
            if token["mark"] == "[" or repeated:
                needed = []
        elif token["mark"] == "|":
            choices.append([])
        elif token["part"]:
            needed = _needed_words(parts[token["part"]], parts)
        elif token["word"]:
            words = _words_of(token["word"])
            needed = [words] if len(words) == 1 else []  # none for "."
        choices[-1] += needed
        at += 1
    if len(choices) > 1:
        shortest = [min(needed, key=len, default=None) for needed in choices]
        choices = [[] if None in shortest else [frozenset().union(*shortest)]]
    return choices[0], at


def compile_templates(templates: str, parts: Mapping[str, str]) -> list[SentenceTemplate]:
    """Return several templates, in their order.

    A template matches at a space before its first word, up to the end of a word.

    Args:
        templates: one template for each line; a line with 12 spaces or more before it continues the
            line before it.
        parts: see `pattern`.
    """
    lines: list[str] = []
    for line in filter(str.strip, templates.splitlines()):
        if line.startswith(" " * 12) and lines:
            lines[-1] += f" {line.strip()}"
        else:
            lines.append(line.strip())
    return [SentenceTemplate(line, parts) for line in lines]


def first_match(templates: list[SentenceTemplate], text: str) -> dict[str, str] | None:
    """Return the slots of the first template that fits the entire text; None if none does."""
    for template in templates:
        if found := template.fullmatch(f" {text}"):
            return {slot: name for slot, name in found.groupdict().items() if name is not None}
    return None

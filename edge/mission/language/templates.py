"""Sentence templates: patterns of everyday sentences, written as text.

    where (is|are) <thing> [now|exactly]*

- `(a|b)` is a choice, `[a|b]` may be left out, and `*` after either repeats it any number of times.
- `<thing>` is a name of up to five words, with or without an article.
- `<stops>` is a list of names, `<count>` a number, `<often>` once or twice, `<relation>` a word
  such as "behind", `<done>` a form such as "mopped", and `<span>` a length of time, such as "ten
  minutes".
- `{seen}` is another template, by its name in a table of parts.
- `,` is a comma that may be left out, and `...` is any rest that begins no new order.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from edge.mission.language.everyday_words import MARK, NAME, any_of
from edge.mission.language.spans import COUNT, SPAN

_TOKEN = re.compile(r"<(?P<slot>\w+)>|\{(?P<part>\w+)\}|(?P<rest>\.\.\.)|(?P<mark>[()\[\]|*,])"
                    r"|(?P<word>[^\s()\[\]|*,<{]+)")  # fmt: skip
STOP = rf"(?:,? (?:and then|and|then|to|or) |, | (?={MARK}|the ))"
"""Regular expression for what separates the names of a list."""
_SLOTS = {
    "span": SPAN,
    "count": COUNT,
    "often": r"(?:once|twice|thrice)",
    "relation": any_of("relation"),
    "done": r"\w+(?:ed|ing)",
    "stops": rf"{NAME}(?:{STOP}{NAME})+",
}
_MARKS = {"(": "(?:", ")": ")", "[": "(?:", "]": ")?", "|": "|", "*": "*", ",": ",?"}
_ORDER = (
    r"(?:(?:do )?not )?(?:go|come|drive|head|run|move|visit|explore|patrol|check|look|search|stay|"
    r"keep|enter|leave|return|wait|bring|fetch|take|get|not (?:the|an?|my|to))\b"
)
_HAS_SUBJECT = "|".join(
    f"(?<= {word} )"
    for word in ("i", "we", "you", "he", "she", "they", "people", "to", "can", "will", "would")
)
_REST = (
    r"(?: (?!(?:then|and|or|but|find|instead|first|never|avoid|without|except|\.)(?: |$))"
    rf"(?:(?!{_ORDER})|{_HAS_SUBJECT})[^\s,;]+)*"
)
"""Any rest that begins no order: "because I go out", not "until I call, go to the bed"."""
END = r"(?=[ ,.;!?]|$)"
"""End of a word."""


def pattern(template: str, parts: Mapping[str, str]) -> str:
    """Return the regular expression of a template, in which each word follows a space.

    Args:
        template: see the module.
        parts: templates that `{name}` stands for.

    Example:
        >>> re.fullmatch(pattern("stop [now]*", {}), " stop now now") is not None
        True
    """
    done = []
    for token in _TOKEN.finditer(template):
        if slot := token["slot"]:
            done.append(f" (?P<{slot}>{_SLOTS.get(slot, NAME)})")
        elif token["part"]:
            done.append(f"(?:{pattern(parts[token['part']], parts)})")
        elif token["rest"]:
            done.append(_REST)
        elif token["mark"]:
            done.append(_MARKS[token["mark"]])
        else:
            done.append(f" {re.escape(token['word'])}")
    return re.sub(r"\)\?\*", ")*", "".join(done))


def compiled(rows: str, parts: Mapping[str, str]) -> list[re.Pattern[str]]:
    """Return the patterns of several templates, one a line; a line that is indented more goes on.

    A pattern matches at a space before its first word, up to the end of a word.
    """
    lines: list[str] = []
    for line in filter(str.strip, rows.splitlines()):
        if line.startswith(" " * 12) and lines:
            lines[-1] += f" {line.strip()}"
        else:
            lines.append(line.strip())
    return [re.compile(pattern(line, parts) + END, re.I) for line in lines]


def first_match(patterns: list[re.Pattern[str]], text: str) -> dict[str, str] | None:
    """Return the slots of the first pattern that fits the whole text; None if none does."""
    for one in patterns:
        if found := one.fullmatch(f" {text}"):
            return {slot: name for slot, name in found.groupdict().items() if name is not None}
    return None

"""How often: "twice", "at least three times", "no more than once" as a range of visits."""

from __future__ import annotations

from dataclasses import dataclass

from edge.mission.language.lexicon import NUMBERS
from edge.mission.language.words import Reader

MAX_VISITS = 20
_MARKERS = (
    "at least", "at most", "exactly", "more than", "less than", "more or less", "or more",
    "or less", "only",
)  # fmt: skip
_NUMBERS = ("number", "times n", "once")


@dataclass(frozen=True, slots=True)
class Count:
    """A range of separate visits; `most` is None without an upper limit."""

    least: int
    most: int | None = None

    def negated(self) -> Count | None:
        """What "do not … so often" leaves; None where that is no range."""
        if self.most is None:
            return Count(0, self.least - 1) if self.least else None
        return Count(self.most + 1) if self.least == 0 else None


def take_count(reader: Reader, negated: bool) -> Count | None:
    """The count that begins here, already negated if the clause is; None when there is none.

    Raises:
        TranslationError: a count beyond `MAX_VISITS`, or one that "not" leaves without sense.
    """
    begin, start = reader.at, reader.peek()
    if start.text in ("on", "for") and reader.sees(*_NUMBERS, *_MARKERS, ahead=1):
        reader.at += 1
    markers: set[str] = set()
    numbers: list[int] = []
    times = False
    while True:
        token = reader.peek()
        if token.kind in _MARKERS:
            markers.add(token.kind)
        elif token.kind in _NUMBERS and not (token.kind == "once" and _joins(reader)):
            numbers.append(NUMBERS[token.text] if token.text in NUMBERS else int(token.text[:9]))
            times = times or token.kind != "number"
        elif token.kind == "times":
            times = True
        elif not (token.kind in ("or", "and") and (markers or numbers) and _goes_on(reader)):
            break
        reader.at += 1
    if not numbers or not times:
        reader.at = begin
        return None
    if max(numbers) > MAX_VISITS:
        reader.refuse(f"at most {MAX_VISITS} visits can be counted", start)
    return _range(reader, markers, numbers, negated, begin)


def _joins(reader: Reader) -> bool:
    """Whether "once" here means "as soon as"."""
    return reader.sees("you", "article", "word", "quoted", "pronoun", "all of", "either", ahead=1)


def _goes_on(reader: Reader) -> bool:
    return reader.sees(*_NUMBERS, *_MARKERS, ahead=1)


def _range(
    reader: Reader, markers: set[str], numbers: list[int], negated: bool, begin: int
) -> Count:
    n = numbers[-1]
    if "more or less" in markers:  # "not more or less than n": exactly n
        return Count(n, n)
    if markers & {"exactly", "only"} or {"at least", "at most"} <= markers:
        count = Count(n, n)
    elif markers & {"at most", "or less"} or 0 in numbers:
        count = Count(0, max(numbers))
    elif "less than" in markers:
        count = Count(0, n - 1)
    elif "more than" in markers and len(numbers) == 1:
        count = Count(n + 1)
    else:
        count = Count(min(numbers))
    if not negated:
        return count
    rest = count.negated()
    if rest is None or (rest.most is not None and rest.most < 0):
        reader.refuse("say how often it may be instead", reader.tokens[begin])
    return rest

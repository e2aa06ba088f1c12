"""Times of day in words: "half past three in the afternoon", "9 a.m.", "tonight at ten"."""

from __future__ import annotations

import re

from edge.mission.language.words.everyday_words import phrase_of
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.tokens import unclear
from edge.number_words import SMALL_NUMBERS, TENS, number

CLOCK = r"(?:1[0-2]|[1-9]):[0-5]\d [ap]m"
"""Regular expression for a time of day as `write_times` writes it: "9:00 am"."""
_HOUR_WORDS = "|".join(sorted(SMALL_NUMBERS[1:13], key=len)[::-1])
_UNITS = "|".join(SMALL_NUMBERS[1:10])
_MINUTE_WORDS = rf"(?:(?:{'|'.join(TENS[:4])})(?: (?:{_UNITS}))?|{'|'.join(SMALL_NUMBERS[10:])})"
_DAILY = r"(?:every|each)(?: single)? day|daily"
_HALF = r"(?P<half>[ap])(?:m\b|\.m\b(?:\.(?! (?-i:[A-Z])))?)"  # "am", "p.m."
_PART = r"(?P<%s>morning|afternoon|evening|night)"
_TIME = re.compile(
    rf"\b(?:(?:(?P<daily_before>{_DAILY})|(?P<tonight_before>tonight)|today|"
    rf"(?:(?P<each_before>every|each)|this|in the) {_PART % 'part_before'}),? )?"
    r"(?P<word>at|until)(?: (?:about|around|exactly|precisely|roughly))? "
    r"(?:(?:(?:12|twelve) )?(?P<named>noon|midday|midnight)|"
    rf"(?:(?P<minutes>(?:a )?quarter|half|\d\d?|{_MINUTE_WORDS}|{_UNITS})(?: minutes)? "
    rf"(?P<side>past|after|to) )?"
    rf"(?P<hour>2[0-3]|1\d|0?\d|{_HOUR_WORDS})"
    rf"(?:[:.](?P<digits>[0-5]\d)(?!\d)| (?P<spoken>oh (?:{_UNITS})|{_MINUTE_WORDS}))?"
    rf"(?P<oclock> o'? ?clock| hours)?(?: ?{_HALF})?)(?![\w:]|\.\d)"
    r"(?: sharp| on the dot)?"
    rf"(?:,? (?:(?P<daily>{_DAILY})|(?P<tonight>tonight)|today|"
    rf"(?:(?P<each>every|each)|this|in the) {_PART % 'part'}|(?P<at_night>at night))\b)?",
    re.I,
)
_EACH = re.compile(r"(?:every|each) (?:day|morning|afternoon|evening|night),? ", re.I)
# Part of the day → its hours on a clock of twelve hours, and the hours of the day that they mean.
_HOURS = {
    "morning": {h: h for h in range(1, 12)},
    "afternoon": {12: 12, **{h: h + 12 for h in range(1, 7)}},
    "evening": {h: h + 12 for h in range(4, 12)},
    "night": {**{h: h for h in range(1, 5)}, **{h: h + 12 for h in range(8, 12)}, 12: 0},
    "tonight": {**{h: h for h in range(1, 5)}, **{h: h + 12 for h in range(5, 12)}, 12: 0},
}
_VERBS = ("verb", "avoid", "endless", "stay", "do")
_AFTER_A_TIME = ("and", "then", "but", "or", "to", "please", "every", "each", "daily", "without")


_DATE = re.compile(rf"\b{phrase_of('date')}\b", re.I)


def write_times(text: str) -> str:
    """Return a text with each clear time of day as "at 9:00 am" or "every day at 9:00 am".

    A time that may be in the morning or in the evening stays as it is.

    >>> write_times("tonight at half past ten, go to the dock and wait until noon")
    'at 10:30 pm, go to the dock and wait until 12:00 pm'
    >>> write_times("every morning go to the bed at 8"), write_times("go to the bed at three")
    ('every day at 8:00 am, go to the bed', 'go to the bed at three')
    """
    for found in _TIME.finditer(text):
        # "every morning, go to the bed at 8": the time belongs to the beginning.
        each = _EACH.match(text)
        if each and each.end() < found.start() and not text[found.end() :].strip(" .!"):
            text = (
                f"{each[0].strip(' ,')} {found[0]}, {text[each.end() : found.start()].strip(' ,')}"
            )
            break
    return _TIME.sub(_written, text)


def time_of_day(clock: str) -> str:
    """Return a time that matches `CLOCK` on a clock of 24 hours.

    >>> time_of_day("9:05 am"), time_of_day("12:00 am"), time_of_day("12:30 pm")
    ('09:05', '00:00', '12:30')
    """
    hour, minute, half = re.split("[: ]", clock)
    return f"{int(hour) % 12 + 12 * (half == 'pm'):02}:{minute}"


def refuse_unclear_times(text: str) -> None:
    """Refuse a time that may be in the morning or in the evening, such as "at three".

    Raises:
        UnclearError: the text has such a time.
    """
    if _DATE.search(text):
        return  # which is refused in any case
    for found in _TIME.finditer(text):
        if not _is_time(found) or _hour_and_minute(found) is not None:
            continue
        hour, minute = _given(found)
        shown = f"{hour % 12 or 12}" + (f":{minute:02}" if minute else "")
        word = found["word"].lower()
        choices = [f"{word} {shown} am", f"{word} {shown} pm"]
        if (hour, minute) == (12, 0):
            choices = [f"{word} noon", f"{word} midnight"]
        raise unclear(
            found[0], f"unclear which half of the day; say '{choices[0]}' or '{choices[1]}'"
        )


def _written(found: re.Match[str]) -> str:
    time = _hour_and_minute(found) if _is_time(found) else None
    if time is None:
        return found[0]
    hour, minute = time
    daily = any(found[name] for name in ("daily_before", "daily", "each_before", "each"))
    clock = f"{hour % 12 or 12}:{minute:02} {'ap'[hour >= 12]}m"
    return f"{'every day ' * bool(daily)}{found['word'].lower()} {clock}"


def _is_time(found: re.Match[str]) -> bool:
    """Return False for the number of "look at five chairs", which has no word of a time."""
    marks = ("named", "side", "digits", "oclock", "half", "part", "part_before", "tonight")
    if any(found[name] for name in (*marks, "tonight_before", "daily", "daily_before", "at_night")):
        return True
    after = re.match(r" (\S+)", found.string[found.end() :])
    if after is None:
        return True
    word = after[1].lower().strip(".,;!?")
    return word in _AFTER_A_TIME or TABLE.get((word,)) in _VERBS


def _given(found: re.Match[str]) -> tuple[int, int]:
    """Return the hour and the minute as they were said."""
    if found["named"]:
        return (0 if found["named"].lower() == "midnight" else 12), 0
    hour = number([found["hour"].lower()]) or 0
    if found["side"]:
        said = found["minutes"].lower().removeprefix("a ")
        minute = {"quarter": 15, "half": 30}.get(said) or number(said.split()) or 0
        if found["side"].lower() == "to":
            return (hour - 1) % 24 or (12 if hour == 1 else 0), 60 - minute
        return hour, minute
    spoken = (found["spoken"] or "").lower().removeprefix("oh ")
    return hour, int(found["digits"] or (number(spoken.split()) if spoken else 0) or 0)


def _hour_and_minute(found: re.Match[str]) -> tuple[int, int] | None:
    """Return the hour from 0 to 23 and the minute; None if the half of the day is unclear."""
    hour, minute = _given(found)
    if minute > 59:
        return None
    tonight = found["tonight"] or found["tonight_before"]
    part = "tonight" if tonight else (found["part"] or found["part_before"] or "").lower()
    part = "night" if found["at_night"] else part
    if found["half"] and found["side"] == "to" and hour == 11:
        return None  # of "quarter to twelve pm", "pm" may be of the eleven or of the twelve
    if found["half"] and 1 <= hour <= 12:
        hour = hour % 12 + 12 * (found["half"].lower() == "p")
    elif found["half"]:
        return None  # "15 am"
    elif found["named"] or hour > 12 or re.fullmatch(r"0\d?", found["hour"]):
        pass  # on a clock of 24 hours: "09:00"
    elif part:
        meant = _HOURS[part].get(hour)
        return None if meant is None else (meant, minute)
    else:
        return None
    return (hour, minute) if not part or hour in _HOURS[part].values() else None

"""Splitting of an order with a condition: "find the mug; if it is not there, come back".

The condition is the outcome of an earlier order: it succeeded (the object was found, the place was
reached), or it failed. `split_outcomes` finds the conditions and the orders around them; the
module `edge.mission.fallbacks` translates the parts.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

from edge.mission.language.errands.areas import AREA, JOINT
from edge.mission.language.words.everyday_words import NAME, phrase_of
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.templates import SentenceTemplate, compile_templates
from edge.mission.language.words.tokens import UnclearError, unclear

Outcome = Literal["found", "failed"]


@dataclass(frozen=True, slots=True)
class OutcomeCondition:
    """The outcome of an order, in the words of a person."""

    outcome: Outcome  # "found" if the order succeeded, "failed" if not
    # True for an object ("it is not there"), False for a place ("you can not get in"), None for
    # either ("otherwise")
    is_object: bool | None = None
    name: str = ""  # its name with the article; "" for the last goal of the order ("it")
    at: str = ""  # " in the kitchen": the object is there or not; "" if no place is given
    there: bool = False  # True if the object is at the place of the order
    # True if the condition also says what to do: "if you can not find the bed"
    presumes: bool = False
    state: bool = False  # True if it is a state of a place: "if it is blocked"


@dataclass(frozen=True, slots=True)
class Branches:
    """An order, and what to do after each of its outcomes."""

    order: str  # the order whose last goal has the outcome; "" if the condition presumes it
    condition: OutcomeCondition
    found: Branches | str | None  # what to do if it succeeds; None: nothing more
    # what to do if it fails; None: the mission fails, or with `found`, nothing more
    failed: Branches | str | None
    after: str = ""  # what to do in the end, whatever the outcome; "": nothing
    both: bool = False  # True if the text says what to do after both outcomes
    # True if the text may also be read as orders to drive: "…, then in the hall, …"
    may_drive: bool = False

    @property
    def is_rule(self) -> bool:
        """True if it may be a rule that holds all the time: "…, if you see the dog, come back"."""
        condition = self.condition
        named = bool(self.order and condition.name) and condition.outcome == "found"
        return named and isinstance(self.found, str) and self.failed is None


_PARTS = {
    "if": "[just|well]* (if|in case|in the event that|supposing) [that]",
    "it": "(it|they|he|she|that|this|one|either [of them]|(that|this|the first) one)",
    "them": "(it|them|one|any|anything|him|her|that|either [of them]|any of them|a single one)",
    "is": "{still} (is|are|was|were) {still}",
    "still": "[really|actually|still|by any chance|perhaps|maybe|also|already|indeed|even]*",
    "there": """
        (there|here|in there|in here|inside it|in it|around|to be found|present|anywhere|
        in that room|in this room|at that place)
        """,
    "gone": "(not [{there}]|nowhere [{there}|in sight]|gone|missing)",
    "either": "[either|at all|any more|anymore|though|as well|too|yet|for some reason|after all]*",
    "cannot": """
        (can not|could not|do not|did not|are not able to|are unable to|were unable to|fail to|
        failed to|have not|never|will not|can not seem to|do not manage to|struggle to)
        """,
    "see": "(find|found|see|saw|seen|spot|spotted|locate|located|detect|notice)",
    "can": "[can|do|could|did|happen to|manage to|are able to|should]*",
    "at": "[(standing|lying|sitting|parked|placed|left)] [<relation> (<anchor>|it|them)]",
    "blocked": """
        (blocked|closed off|shut off|closed|locked|shut|obstructed|not (open|accessible|reachable))
        """,
    "enter": """
        ((get|go|drive|come|make it) (in|inside|in there|into it|to it|there|through [it]|past)|
        reach {them}|reach there|enter [it|there|that room])
        """,
}
# Outcome → kind of target → templates, one for each line. True: an object; False: a place; None:
# either.
_TEMPLATES: dict[Outcome, dict[bool | None, str]] = {
  "failed": {
    True: """
        {if} {it} {is} {gone} {either}
        {if} {it} {is} not {at} {either}
        {if} <object> {is} {gone} {either}
        {if} <object> {is} not {at} {either}
        {if} you {still} {cannot} {see} {them} {at} [{there}] {either}
        {if} you {still} {cannot} {see} <object> {at} [{there}] {either}
        {if} there {is} (not [one|any]|none|nothing) [{there}] {either}
        {if} there {is} (no|not (a|an|any)) <object> {at} [{there}] {either}
        {if} (nothing|no <object>|none) (is|are) [{there}|found] {at} {either}
    """,
    False: """
        {if} you {still} {cannot} {enter} {either}
        {if} you {still} {cannot} (get (to|into|in|inside)|reach|enter|go (to|into|in)|
            make it (to|into)) <object> {either}
        {if} ({it}|the way|the path|the way in) {is} {blocked} {either}
        {if} <object> {is} {blocked} {either}
        {if} you get stuck [there]
    """,
    None: """
        {if} (no|not [found|there|successful|possible]|no luck|no success|unsuccessful|
            (that|it|this|you) (fails|fail)|
            (that|this) (does|did) not work [out]|(that|it|this) is not possible|
            you can not [do (it|that)]|you have no luck)
        (failing that|or otherwise|otherwise|else|if else)
    """,
  },
  "found": {
    True: """
        {if} {it} {is} {there} {either}
        {if} <object> {is} {there} {either}
        {if} ({it}|<object>) {is} <relation> <anchor>
        {if} you {can} {see} {them} {at} [{there}]
        {if} you {can} {see} <object> {at} [{there}]
        {if} there {is} (one|any|some|<object>) {at} [{there}]
    """,
    False: "{if} you {can} {enter}",
    None: """
        {if} (so|yes|you (do|did|have)|it (is|was)|there (is|are)|they are|found|successful|
            that works [out]|you succeed)
    """,
  },
}  # fmt: skip
_TRIGGER = re.compile(
    r"(?<![^\s,;.!?:-])(?P<word>if|in case|in the event|supposing|failing that|otherwise|else"
    r"|(?:or else|(?:and )?then)(?= (?P<area>\w+ .*)))\b",
    re.I,
)
# Before "if" in "check if there is a mug", and in "only if".
_ASKED = re.compile(
    r"\b(?:check|control|see|look|out|verify|confirm|know|wonder|wondering|sure|say|ask|me|us|whether)$",
    re.I,
)
_LIMITED = re.compile(r"\b(?:only|even|as|except|not|unless)$", re.I)
_WHAT_ELSE = re.compile(r"(?:thing|where|one|body|or|who|what|how)$", re.I)
_ENDS_CLAUSE = re.compile(r"[,;.!?:-]$|\b(?:and|but|or)$", re.I)
_JOINTS = re.compile(rf"{JOINT}$", re.I)
_BOUND = re.compile(
    r"[,;.!?:-]\s*(?:(?:and|but|or|then|so)\s+)*$|(?:^|\s)(?:and|but|or|then|so)\s+$", re.I
)
_LEADS = re.compile(
    r"^(?:[\s,;:-]|(?:then|please|just|you (?:can|should|must|could)|kindly)\b)+", re.I
)
# Orders after which "there" is where the robot was before.
_RETURNS = re.compile(
    r"(?:(?:come|go|get|drive|return|head) )?(?:back|home)\b|return$|wait|stay|stop", re.I
)
_SEARCH_VERB = re.compile(r"\b(?:find|look|search|locate|hunt|check|try)\b", re.I)
_DRIVES = re.compile(r"\b(?:go|drive|head|move|come|visit)\b(?! (?:back|home)\b)", re.I)
_INSTEAD = re.compile(r",? instead\b(?! of)", re.I)
# What follows in any case.
_AFTER = re.compile(
    r"(?:[.;!?,]+\s+(?:and |but |then )*(?:either way|in (?:any|either) case|in both cases|"
    r"whatever happens|no matter what|regardless)|[.;!?]+\s+(?:and )?(?:then|after that|"
    r"afterwards|finally|lastly|in the end|at the end|(?:when|once) (?:you are )?done)),?"
    r"\s+(?P<rest>.+)$",
    re.I,
)
_NEEDS_VERB = re.compile(r"\b(?:can not|have|do|did|is|are|was)$", re.I)
_RELATION = re.compile(rf"\s+{phrase_of('relation')}\s", re.I)
_IN_CLAUSE = r"(?:(?! and )[^,;.!?])*"
# "search the hall for the mug", "look for the mug in the hall", "find the mug in the hall or else"
_SEARCHES = re.compile(
    rf"\b(?:(?:search|check) {NAME} for\b|look {phrase_of('relation')} {_IN_CLAUSE} for\b|"
    rf"(?:(?:look|hunt|search)\b{_IN_CLAUSE} for|find\b(?=.* or else$)){_IN_CLAUSE} "
    rf"{phrase_of('relation')} ){_IN_CLAUSE}[,;.]? (?:or else|(?:and )?then)$",
    re.I,
)


@cache
def _conditions() -> list[tuple[SentenceTemplate, Outcome, bool | None]]:
    return [
        (template, outcome, is_object)
        for outcome, rows in _TEMPLATES.items()
        for is_object, lines in rows.items()
        for template in compile_templates(lines, _PARTS)
    ]


@dataclass(frozen=True, slots=True)
class _Match:
    """A condition at a place of the text."""

    begin: int
    end: int
    condition: OutcomeCondition
    is_bare: bool  # "otherwise", also "then in the hall"
    may_drive: bool = False  # see `Branches`


def split_outcomes(text: str) -> Branches | None:
    """Return an order with conditions as branches; None for an order without conditions.

    Raises:
        UnclearError: it is unclear which order belongs to which outcome.

    Example:
        >>> split = split_outcomes("find the mug; if it is not there, come back")
        >>> split.order, split.found, split.failed
        ('find the mug', None, 'come back')
    """
    text = re.sub(r"\b(?:nobody|no one)\b", "no person", text, flags=re.I)
    matches = _matches(text)
    if not matches:
        return None
    tail = _AFTER.search(text, matches[-1].end)
    body, after = (text[: tail.start()], tail["rest"]) if tail else (text, "")
    may_drive = any(one.may_drive for one in matches)
    return replace(_split(body, matches, 0), after=after, may_drive=may_drive)


def _split(text: str, matches: Sequence[_Match], begin: int) -> Branches:
    """Return the branches of the text from an offset on, whose conditions are given."""
    first, *rest = matches
    before, behind = text[begin : first.begin], text[first.end :]
    at = next((i for i, one in enumerate(rest) if _is_opposite(first, one)), len(rest))
    nested, opposite, last = rest[:at], rest[at : at + 1], rest[at + 1 :]
    answer_text = text[first.end : opposite[0].begin if opposite else len(text)]
    order, answer, condition = _order(before), _order(answer_text), first.condition
    if re.match(r"\s+(?:and|or)\b", answer_text, re.I):  # "if it is not in the hall or the study"
        raise _unclear(text[first.begin :])
    is_inside = before.strip() and not (first.is_bare or _BOUND.search(before))
    if answer and is_inside and re.match(r"[,;.!?]|\s+then\b", answer_text, re.I):
        raise _unclear(text[first.begin : first.end])  # "the bed if it is there, then the sofa"
    if _INSTEAD.search(answer_text) and condition.name:  # then the robot was to go to the object
        condition = replace(condition, presumes=True)
    if not answer:  # "come back if you can not find it"
        *orders, answer = re.split(r",? (?:and|or|but|then)(?: then)? |[,;.] ", order)
        order = orders[0] if orders else ""
        there = first.condition.there and not _RETURNS.match(answer)
        no_order = bool(orders) and not _is_followed_by_order(f" {answer}")
        if _BOUND.search(before) or len(orders) > 1 or nested or there or no_order:
            raise _unclear(text[first.begin : first.end])
    if nested and (opposite or first.condition.outcome == "found"):
        raise _unclear(text[nested[0].begin : nested[0].end])
    then: Branches | str = _split(text, nested, first.end) if nested else answer
    other: Branches | str | None = None
    if opposite:
        _refuse_other_subject(text, first, opposite[0])
        behind = text[opposite[0].end :]
        other = _split(text, last, opposite[0].end) if last else _order(behind)
        if not behind.strip(" .,;!?"):
            raise _unclear(text[opposite[0].begin :])
    outcomes = (then, other) if first.condition.outcome == "found" else (other, then)
    return Branches(order, condition, *outcomes, both=bool(opposite))


def _is_opposite(first: _Match, second: _Match) -> bool:
    """Return True if the second condition is the opposite outcome of the same order."""
    if second.condition.name or second.condition.at:
        return False
    if second.is_bare:
        return not first.is_bare
    return second.condition.outcome != first.condition.outcome


def _refuse_other_subject(text: str, first: _Match, second: _Match) -> None:
    """Refuse a second condition that may be about the order between the two.

    An example is "go to the bed; if that fails go to the sofa; if that works come back".
    """
    between, phrase = text[first.end : second.begin], text[second.begin : second.end]
    is_object = second.condition.is_object
    missed = first.condition.outcome == "failed"
    drives = (is_object is False or missed) and is_object is not None and _DRIVES.search(between)
    may_search = is_object is not None or (missed and second.is_bare)
    searches = may_search and _SEARCH_VERB.search(between)
    if re.search(r"\b(?:that|this)\b", phrase, re.I) or drives or searches:
        hint = "unclear which of the orders this is about; say first what to do if it is there"
        raise unclear(phrase, hint)


def _order(text: str) -> str:
    """Return an order without the words and marks that join it to others."""
    order = _LEADS.sub("", _JOINTS.sub("", text).strip()).strip(" ,;.!?")
    return _INSTEAD.sub("", order)


def _unclear(part: str) -> UnclearError:
    part = part.strip(" .,;!?")
    hint = "unclear what to do then; say for example 'find the mug; if it is not there, come back'"
    return UnclearError(f"instruction: {part!r}: {hint}", part)


def _matches(text: str) -> list[_Match]:
    """Return the conditions in a text; [] if it has another condition, too."""
    found: list[_Match] = []
    for trigger in _TRIGGER.finditer(text):
        begin, word = trigger.start(), trigger["word"].lower()
        before = text[:begin].rstrip()
        if found and begin < found[-1].end:
            continue
        if trigger["area"]:  # "look for the mug in the hall, then in the kitchen"
            area = AREA.match(trigger["area"])
            if area is None or area["verb"] or not area["relation"] or area[0].startswith("go "):
                continue
            if not found and _SEARCHES.search(text[: trigger.end()]):
                goes_on = re.search(r"\w", trigger["area"][area.end() :]) is not None
                may_drive = goes_on and "then" in trigger["word"].lower()
                condition = OutcomeCondition("failed")
                found.append(_Match(begin, trigger.end(), condition, True, may_drive))
            continue
        if _LIMITED.search(before):
            return []
        if word == "if" and _ASKED.search(before):
            continue  # "check if there is a mug"
        if word == "else" and _WHAT_ELSE.search(before):
            continue
        if word == "otherwise" and not found and not _ENDS_CLAUSE.search(before):
            continue  # "until I tell you otherwise"
        matched = _condition_at(text, begin)
        if matched is None or (matched.is_bare and not before):
            return []
        found.append(matched)
    return found


def _condition_at(text: str, begin: int) -> _Match | None:
    """Return the longest condition that begins at an offset; None if none does."""
    best: tuple[re.Match[str], Outcome, bool | None] | None = None
    spaced = f" {text[begin:]}"
    for template, outcome, is_object in _conditions():
        match = template.match(spaced)
        if match is None or re.match(r" not\b", spaced[match.end() :]):  # "if you do not mind"
            continue
        if best is None or match.end() > best[0].end():
            best = match, outcome, is_object
    if best is None:
        return None
    match, outcome, is_object = best
    slots = {slot: part for slot, part in match.groupdict().items() if part}
    at = f" {slots['relation']} {slots.get('anchor', 'it')}" if slots.get("relation") else ""
    phrase, name = match[0].strip(), slots.get("object", "")
    is_bare = re.fullmatch(r"failing that|(?:or )?otherwise|(?:if )?else", phrase, re.I) is not None
    says_there = re.sub(r"^\w+ there\b", "", phrase)
    there = re.search(r"\b(?:there|here|in it|(?:that|this) (?:room|place))\b", says_there, re.I)
    state = is_object is False and re.search(r" (?:is|are|was|were) ", phrase, re.I) is not None
    presumes = bool(name) and (bool(at) or (outcome == "failed" and not state))
    rest = spaced[match.end() :]
    # "if it is not there in the hall"
    is_area = bool(there) and is_object and _RELATION.match(rest)
    is_report = outcome == "found" or is_object is not None
    if is_report and not (is_area or _is_followed_by_order(rest)):
        return None  # "if you enter the hall", "if you have been to the bed", "if it is not free"
    if _NEEDS_VERB.search(phrase) and re.match(r" (?!then\b)\w", rest):
        return None  # "if you can not hear the dog", "if you have reached the sofa"
    condition = OutcomeCondition(outcome, is_object, name, at, bool(there), presumes, state)
    return _Match(begin, begin + match.end() - 1, condition, is_bare)


def _is_followed_by_order(text: str) -> bool:
    """Return True if a clause ends before a text, or an order begins with it."""
    word = re.match(r" (?:then |please |just )*(\w+)", text)
    is_order = word is not None and TABLE.get((word[1].lower(),)) in ("verb", "and", "or")
    area = AREA.match(text.strip())
    is_area = area is not None and area["verb"] is not None
    return word is None or is_order or is_area or _RETURNS.match(word[1]) is not None

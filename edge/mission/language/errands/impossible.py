"""Refusal of errands that a robot with wheels, a camera and text cannot do."""

from __future__ import annotations

import re

from edge.mission.language.words.everyday_words import ARTICLE, PLAIN_NAME, bare, is_room, phrase_of
from edge.mission.language.words.tokens import UnclearError, unclear

_OPENS_CLAUSE = r"(?:^|[.;,!?] |\b(?:and|then|to|go|or) )(?:also |quickly |just |now )?"
_DRIVES = (
    r"(?! (?:to|by|over|into|toward|towards|around|along|back|through|past|near|in|left|right|"
    r"on|out|off|aside|forward|forwards|closer|away|(?:me|us) to|"
    r"a (?:look|peek|glance|tour|break)|"
    r"(?:(?:the|a|any) )?(?:way|route|path|road|street|bridge|hall|hallway|corridor|aisle|tunnel|"
    r"passage|alley))\b)"
)
"""Refuses a match before words with which a verb of handling means driving: "move to"."""
# Pattern of what the robot cannot do, and the hint of the refusal.
_CANNOT = (
    (
        rf"{_OPENS_CLAUSE}{phrase_of('follow')}\b",
        "the robot cannot follow or lead; say where to go",
    ),
    (
        rf"{_OPENS_CLAUSE}(?:{phrase_of('carry')}\b{_DRIVES}"
        rf"|(?:bring|fetch|carry|hand|take) (?:over|up|in|out|down|back) {ARTICLE}\b)",
        "the robot has no arms; it can drive to objects, so say for example 'find the mug'",
    ),
    (
        rf"\balong {ARTICLE} (?!(?:\w+ )?(?:way|route|path|line|road|street|aisle|lane|hall|"
        r"hallway|corridor|passage)\b)",
        "the robot cannot drive along an object; say where to go",
    ),
    (rf"{_OPENS_CLAUSE}{phrase_of('talk')}\b", "the robot answers here in text, and does no more"),
    (rf"\b{phrase_of('climb')}\b", "the robot cannot change floors; say where to go on this one"),
    (
        rf"\b{phrase_of('date')}\b",
        "the robot knows no dates or weekdays; say a time of day, as in 'at 9 am'",
    ),
    (
        rf"\b{phrase_of('clock')}\b|\bat \d+(?::\d+)?(?: ?[ap]m)?(?=[ .,!?]|$)",
        "to give a time of day, say for example 'at 9 am, go …' or 'every day at 9 am, go …'",
    ),
    (
        r"\b(?:until|by|before|after|around) \d\d?(?::\d\d)? ?[ap]m\b"
        r"|\bfrom \d\d?(?::\d\d)?(?: ?[ap]m)? (?:to|until) \d\d?(?::\d\d| ?[ap]m|(?=[ .,!?]|$))",
        "the robot can begin at a time of day, or wait until then; say for example 'at 9 am, go …'",
    ),
    (r"\b(?:every|each) hour\b", "say what to do then, as in 'every hour, go to the dock'"),
)
_WORK = re.compile(rf"{_OPENS_CLAUSE}{phrase_of('work')}\b", re.I)
# "Anna's mug"
_OWNED = re.compile(rf"\b(?P<owner>[\w.]+(?: [A-Z][\w.]+)?)'s (?P<object>{PLAIN_NAME})")
# "a free chair", "dirty tables", but not "the closed captioning screen" and "the open kitchen"
_IN_STATE = re.compile(
    r"\b(?!open (?:kitchen|office)\b)(?P<state>free|available|vacant|occupied|unoccupied|open|"
    r"opened|closed|shut|locked|unlocked|busy|taken|reserved|clean|dirty) "
    r"(?:chair|seat|stool|bench|sofa|couch|bed|table|desk|door|"
    r"gate|window|drawer|cupboard|fridge|room|bathroom|toilet|kitchen|bedroom|office|cup|mug|plate|"
    r"glass|towel|lift|elevator|parking spot|charger|socket)(?:e?s)?"
    r"(?=[.,;!?]|$| (?:and|or|then|but|that|which|in|on|at|next|near|with|if|for|first)\b)",
    re.I,
)


def refuse_states(text: str) -> None:
    """Refuse an object by a state that only people see, such as "a free chair".

    Raises:
        UnclearError: the text names a state.
    """
    for found in _IN_STATE.finditer(text):
        hint = f"the robot cannot see if an object is {found['state'].lower()}; leave the word out"
        raise UnclearError(
            f"instruction: {found[0]!r}: {hint}, or quote the full name if it is a kind of object",
            found[0],
        )


def refuse_impossible(text: str) -> None:
    """Refuse what no wheels, camera and text can do: carrying, calling, following.

    Raises:
        UnclearError: the text asks for such an object.
    """
    text = re.sub(r'"[^"]*"', '"x"', text)
    for pattern, hint in _CANNOT:
        if found := re.search(pattern, text, re.I):
            part = found[0].strip(" .,;!?")
            raise unclear(part, hint)
    owned = _OWNED.search(text)
    if owned and not is_room(bare(owned["object"])):
        noun = owned["object"]
        raise unclear(owned[0], f"the camera cannot see whose {noun} it is; say 'the {noun}'")


def asks_for_work(text: str) -> bool:
    """Return True if a text asks for work at an object, to which the robot can only drive.

    >>> asks_for_work("Wipe the table, then go home"), asks_for_work("Go to the clean table")
    (True, False)
    """
    return _WORK.search(re.sub(r'"[^"]*"', '"x"', text)) is not None

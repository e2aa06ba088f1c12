"""Refusal of errands that a robot with wheels, a camera and text cannot do."""

from __future__ import annotations

import re

from edge.mission.language.errands.errand_patterns import BAN
from edge.mission.language.words import nouns
from edge.mission.language.words.everyday_words import ARTICLE, PLAIN_NAME, bare, is_room, phrase_of
from edge.mission.language.words.tokens import UnclearError, unclear

_OPENS_CLAUSE = r"(?:^|[.;,!?] |\b(?:and|then|to|go|or) )(?:also |quickly |just |now )?"
_DRIVES = (
    r"(?! (?:to|by|over|into|toward|towards|around|along|back|through|past|near|in|left|right|"
    r"on|out|off|aside|forward|forwards|closer|away|(?:me|us) to|"
    r"a (?:look|peek|glance|tour|break|picture|photo)|some (?:pictures|photos)|down[.!]*$|"
    r"(?:(?:the|a|any) )?(?:way|route|path|road|street|bridge|hall|hallway|corridor|aisle|tunnel|"
    r"passage|alley))\b)"
)
"""Refuses a match before words with which a verb of handling means driving: "move to"."""
_ENDS = r"(?=[.,;!?]|$| (?:and|then)\b)"
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
        rf"{_OPENS_CLAUSE}(?:(?:re)?charge(?: up)?|(?:(?:re)?charge|dock|\"x\") yourself){_ENDS}",
        "name the place of the charger, as in 'go to the dock'",
    ),
    (
        rf"{_OPENS_CLAUSE}(?:go away|back (?:up|off)|get (?:away|lost|out)|come (?:closer|near)|"
        rf"move (?:aside|over|away|back|closer)|(?:get|move) out of (?:the|my) way)"
        rf"(?: a (?:bit|little))?{_ENDS}",
        "the robot drives only to objects, rooms and places; say where to go",
    ),
    (
        r"^(?:good (?:job|work|night|bye|robot)|well done|nice (?:job|work)|goodbye|bye)[.!]*$",
        "nothing is asked for; say for example 'go to the bed'",
    ),
    (
        r"^(?:(?:shut|power) (?:down|off)|(?:turn|switch) (?:yourself )?off|reboot|restart|wake up|"
        r"(?:go to )?sleep)[.!]*$",
        "this starts or ends no program; to stop the robot, say 'stop'",
    ),
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
_HOW = r"(?: (?:a (?:little|bit)|very|really|so|quite|rather|as|much|more|super))*"
_SPEEDS = (
    r"(?:carefully|cautiously|slowly|quickly|swiftly|rapidly|speedily|gently|quietly|silently|calmly|"
    r"smoothly|steadily|hurriedly|thoroughly|properly|faster|slower|quicker)"
)
# " carefully" of "go carefully to the sofa", " very fast" of "go very fast to the bed"
_MANNER = re.compile(
    rf"(?:(?:,(?=[^,.;!?]*[.!]*$))?{_HOW} (?:{_SPEEDS}|fast(?=(?: as (?:possible|you can))?[.!]*$))"
    rf"|(?P<verb> (?:drive|go|move|come)){_HOW} (?:fast|slow))"
    r"(?: enough| as (?:possible|you can))?(?=[ ,.;!?]|$)",
    re.I,
)
_ONLY_MANNER = re.compile(
    rf"(?: (?:go|drive|move|run|walk|come))?{_HOW} (?:{_SPEEDS}|(?:hurry|slow|speed)(?: it)?"
    r"(?: up| down)|hurry|fast|slow|quick)(?: a (?:bit|little)| enough)?[.!]*",
    re.I,
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


# "the left door", "the second bedroom"; names of places are marked by now
_BY_POSITION = re.compile(
    rf"\b(?:{ARTICLE}|to|find) (?P<which>(?P<number>{'|'.join(sorted(nouns.ORDINALS))}|"
    rf"\d+(?:st|nd|rd|th))|(?:left|right)(?:-hand)?|middle|leftmost|rightmost) "
    rf"(?P<object>{PLAIN_NAME})",
    re.I,
)


def refuse_unseen(text: str) -> None:
    """Refuse an object by what only people see: "a free chair", "the left chair".

    Raises:
        UnclearError: the text names a state, a side, or a number of a room. Memory numbers objects.
    """
    for found in _BY_POSITION.finditer(text):
        words, which = found["object"].lower().split(), found["which"].lower()
        # The longest known name: "chair" of "the left chair straight away".
        known = next((n for n in range(len(words), 0, -1) if _is_known(words[:n])), 0)
        name = " ".join(words[:known])
        is_refused = is_room(name) if found["number"] else known
        if is_refused and not nouns.is_noun(f"{which} {name}"):
            hint = "give a room this name first" if is_room(name) else "give its kind or colour"
            part = text[found.start("which") : found.end()]
            raise unclear(part, f"the camera cannot see which one is the {which}; {hint}")
    for found in _IN_STATE.finditer(text):
        hint = f"the robot cannot see if an object is {found['state'].lower()}; leave the word out"
        raise UnclearError(
            f"instruction: {found[0]!r}: {hint}, or quote the full name if it is a kind of object",
            found[0],
        )


def _is_known(words: list[str]) -> bool:
    return nouns.unknown_in(words) is None or is_room(" ".join(words))


def without_manner(text: str) -> str:
    """Return a text without adverbs of manner, except in bans: "go slowly to the sofa".

    Raises:
        UnclearError: the text only says how to drive.
    """
    if _ONLY_MANNER.fullmatch(text):
        raise unclear(text, "how fast it drives is set in the motion controller")

    def drop(found: re.Match[str]) -> str:
        clause = re.split(r"[.;!?,]| and | then | but ", text[: found.start()])[-1]
        return found[0] if BAN.search(clause) else found["verb"] or ""

    return _MANNER.sub(drop, text)


def says_manner(text: str) -> bool:
    """Return True if a text says how fast or how carefully to drive.

    >>> says_manner("Drive slowly to the bed"), says_manner("Find the fast food counter")
    (True, False)
    """
    return _MANNER.search(re.sub(r'"[^"]*"', '"x"', f" {text}")) is not None


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

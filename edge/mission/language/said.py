"""Classification of what a person says: a mission, a question, an order to learn, or control.

Each kind but the mission has templates (`utterances`). What fits none of them is a mission, and the
translators read it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Union

from edge.mission.language.everyday_words import NAME, NOWHERE, any_of, bare, is_room, is_vague
from edge.mission.language.remarks import is_remark
from edge.mission.language.spans import seconds_of
from edge.mission.language.templates import compiled, first_match
from edge.mission.language.tidy import TidySpeech, stripped, tidied
from edge.mission.language.tokens import UnclearError
from edge.mission.language.utterances import CONTROL, ORDERS, PARTS, QUESTIONS

Topic = Literal["where", "exists", "rooms", "places", "seen", "self"]
Learnt = Literal["place", "room", "forget", "keep_out", "stay_inside", "open"]


@dataclass(frozen=True, slots=True)
class MissionOrder:
    """An errand, in plain words for the translators."""

    speech: TidySpeech


@dataclass(frozen=True, slots=True)
class MemoryQuestion:
    """A question that memory answers; the robot does not drive.

    Attributes:
        topic: "where" and "exists" ask for objects of the name `about`; "rooms", "places" and
            "seen" for all that are known; "self" for the robot's own place.
        about: a name without an article, which may be related to another one, as in "mug on the
            table"; "" if the topic needs none.
        room: only objects in this room; "" for all.
    """

    topic: Topic
    about: str = ""
    room: str = ""


@dataclass(frozen=True, slots=True)
class SiteOrder:
    """An order to learn or to forget a place, a room or a zone.

    Attributes:
        do: "place" and "room" name the pose or the room of the robot. "keep_out" and "stay_inside"
            make a zone of a room, and "open" removes it. "forget" removes an entry.
        name: without an article; "" is the room that the robot is in.
    """

    do: Learnt
    name: str


@dataclass(frozen=True, slots=True)
class Control:
    """An order about the present mission.

    Attributes:
        do: "pause" stops the robot, "resume" goes on, and "cancel" ends the mission.
        seconds: length of a pause; None until it is told to go on.
    """

    do: Literal["pause", "resume", "cancel"]
    seconds: float | None = None


Said = Union[MissionOrder, MemoryQuestion, SiteOrder, Control]


class NoMissionError(UnclearError):
    """An utterance that is a question, an order to learn, or about the present mission.

    Attributes:
        said: its parts.
    """

    def __init__(self, said: MemoryQuestion | SiteOrder | Control) -> None:
        what = {
            MemoryQuestion: "a question, which memory answers",
            SiteOrder: "an order to learn",
            Control: "about the present mission",
        }[type(said)]
        super().__init__(f"instruction: no mission, but {what}; send it to the running service")
        self.said = said


_IN_A_MISSION = ("keep_out", "stay_inside", "pause")
_NAMES = ("thing", "name", "anchor", "room")
_ZONES = ("keep_out", "stay_inside", "open")
_AS_QUESTIONS = (
    (re.compile(r"^(?:so )?there (is|are)\b(?=[^.;:!]*\?$)", re.I), r"\1 there"),
    (re.compile(r"^it (is|was) there (?=[^.;:!]*\?$)", re.I), r"\1 there "),
    (re.compile(rf"^({NAME}),? (is|are|was|were) (?:it|they)(?= )", re.I), r"\2 \1"),
    (re.compile(rf"^((?:in|on|under|at) {NAME}),? (?:there (is|are)|(is|are) there)"
                rf" ({NAME})(?=\?$)", re.I), r"\2\3 there \4 \1"),
    (re.compile(rf"^({NAME}) (is|are|was|were)(?=(?: still| really)* {any_of('relation')} "
                r"[^.;:!]*\?$)", re.I), r"\2 \1"),
)  # fmt: skip
"""Questions in the order of words of statements, as questions."""
_LOOK = re.compile(
    r"(?:go |drive |run )?(?:over |there )*(?:and )?(?:check|see|look|find out|have a look|"
    r"take a look)(?: there| for me)*",
    re.I,
)
"""The order after a question to go and look for the answer."""
_ONE_BY_ONE = "instruction: say one thing at a time: an errand, a question, or what to remember"


@lru_cache(maxsize=1)
def _templates() -> dict[str, list[re.Pattern[str]]]:
    """Return the patterns of each kind in the order in which they are tried."""
    rows = {**QUESTIONS, **CONTROL, **ORDERS}
    return {kind: compiled(lines, PARTS) for kind, lines in rows.items()}


def understand(said: str, sites: Collection[str] = ()) -> Said:
    """Return the kind of an utterance with its parts.

    Args:
        said: the person's words.
        sites: names of places, rooms and zones, which may be kept out of as rooms are.

    Raises:
        TranslationError: a self-correction is unclear, or several kinds are mixed.

    Example:
        >>> understand("Where did you see the mug?")
        MemoryQuestion(topic='where', about='mug', room='')
        >>> understand("Please stay out of the bathroom.").do
        'keep_out'
    """
    speech = tidied(said)
    whole = _plain(speech.text)
    if (found := _classified(whole, sites)) is not None:
        return found
    question, _, order = speech.text.partition("?")
    if _LOOK.fullmatch(stripped(order)):
        asked_for = _classified(_plain(f"{question}?"), sites)
        if isinstance(asked_for, MemoryQuestion) and asked_for.topic == "exists":
            thing, room = asked_for.about, asked_for.room
            check = f"check if there is a {thing}{f' in the {room}' * bool(room)}"
            return MissionOrder(replace(speech, text=check))
    pieces = [stripped(piece) for piece in re.split(r"[.!?;,]+(?: |$)", speech.text)]
    pieces = [piece for piece in pieces if piece and not is_remark(piece, states=True)]
    kinds = [_classified(_plain(piece), sites) for piece in pieces]
    orders = [kind for kind in kinds if kind is not None]
    if not orders or (None in kinds and all(_may_be_in_a_mission(one) for one in orders)):
        return MissionOrder(speech)
    if None not in kinds and all(one == orders[0] for one in orders):
        return orders[0]
    asked = [one for one in orders if isinstance(one, MemoryQuestion)]
    if len(asked) == len(kinds) == 2 and asked[1].about in ("", "it", "them"):
        return asked[0]
    raise UnclearError(_ONE_BY_ONE)


def _may_be_in_a_mission(one: Said) -> bool:
    return isinstance(one, (SiteOrder, Control)) and one.do in _IN_A_MISSION


def _plain(text: str) -> str:
    """Return the text without commas; a stop within it is a word of its own, which no slot has.

    "There is a mug?" becomes "is there a mug": without its question mark, it is no question. "My
    keys, are they on the desk?" becomes "are My keys on the desk".
    """
    for stated, asked in _AS_QUESTIONS:
        text = stated.sub(asked, text)
    text = re.sub(r"[.;:!?]+(?= )", " .", re.sub(r"[.,;:!?]+$|,(?= )", "", text))
    return " ".join(text.split())


def _classified(text: str, sites: Collection[str]) -> Said | None:
    """Return the first kind whose template fits the whole text; None for an errand."""
    for kind, patterns in _templates().items():
        for pattern in patterns:
            slots = first_match([pattern], text)
            if slots is not None and _fits(slots, sites if kind in _ZONES else ()):
                return _made(kind, slots)
    return None


def _fits(slots: Mapping[str, str], sites: Collection[str]) -> bool:
    """Return True if each slot has a name of its kind."""
    room = bare(slots.get("room", ""))
    if room and not is_room(room) and room not in sites:
        return False
    if "within" in slots and not is_room(bare(slots["within"])):
        return False
    if bare(slots.get("anchor", "x")).split()[-1] in NOWHERE:
        return False
    return not any(is_vague(name) for slot, name in slots.items() if slot in _NAMES)


def _made(kind: str, slots: Mapping[str, str]) -> Said:
    room = bare(slots.get("room", ""))
    if kind in QUESTIONS:
        about, relation = bare(slots.get("thing", "")), slots.get("relation", "").lower()
        anchor = bare(slots.get("anchor", ""))
        about, room = about.removesuffix(" left"), bare(slots.get("within", "")) or room
        if relation in ("in", "inside", "at", "on") and is_room(anchor):
            room = anchor
        elif anchor:
            about = f"{about} {relation} the {anchor}".strip()
        return MemoryQuestion(kind, about, room)  # type: ignore[arg-type]
    if kind in CONTROL:
        span = slots.get("span")
        return Control(kind, seconds_of(span) if span else None)  # type: ignore[arg-type]
    name = bare(slots.get("site", slots.get("name", ""))) or room
    if kind == "place" and is_room(name):
        kind = "room"
    return SiteOrder(kind, name)  # type: ignore[arg-type]

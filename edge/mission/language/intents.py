"""Classification of an utterance: a mission, a question, an order to learn, or control.

`understand` is the entry for all that a person writes. Each kind except the mission has sentence
templates (module `utterances`) with slots for names (see `templates`). An utterance that fits none
of them is a mission for the translators.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Union

from edge.mission.language.remarks import has_order, is_remark
from edge.mission.language.tidy import TidySpeech, strip_politeness, tidy_up
from edge.mission.language.words import nouns
from edge.mission.language.words.everyday_words import (
    NAME,
    NOWHERE,
    bare,
    is_room,
    is_vague,
    phrase_of,
)
from edge.mission.language.words.places import is_marked
from edge.mission.language.words.spans import seconds_of
from edge.mission.language.words.templates import SentenceTemplate, compile_templates, first_match
from edge.mission.language.words.tokens import UnclearError, unclear
from edge.mission.language.words.utterances import CONTROL, ORDERS, PARTS, QUESTIONS

Topic = Literal["where", "exists", "count", "rooms", "places", "doing", "help", "seen", "self"]
Learnt = Literal["place", "room", "forget", "keep_out", "stay_inside", "open"]


@dataclass(frozen=True, slots=True)
class MissionOrder:
    """An order that becomes a mission.

    Attributes:
        speech: the utterance in plain words, for the translators.
    """

    speech: TidySpeech


@dataclass(frozen=True, slots=True)
class MemoryQuestion:
    """A question that memory answers; the robot does not drive.

    Attributes:
        topic: "where", "exists" and "count" ask for objects of the name `about`; "rooms", "places"
            and "seen" for all that are known; "self" for the robot's own place; "doing" for the
            state of the mission; "help" for the possible instructions.
        about: a name without an article, which may be related to another one, as in "mug on the
            table". For "seen", what the objects are near. "" if the topic needs none.
        room: only objects in this room; "" for all.
    """

    topic: Topic
    about: str = ""
    room: str = ""

    @property
    def object_phrase(self) -> str:
        """The object with its article and its room: "the mug in the kitchen"."""
        return f"the {self.about}" + (f" in the {self.room}" if self.room else "")


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
    """An order about the present mission, or the last one.

    Attributes:
        do: "pause" stops the robot, "resume" goes on, and "cancel" ends the mission; "again" starts
            the last one once more.
        seconds: length of a pause; None: until an order to go on.
    """

    do: Literal["pause", "resume", "cancel", "again"]
    seconds: float | None = None


Intent = Union[MissionOrder, MemoryQuestion, SiteOrder, Control]


class NoMissionError(UnclearError):
    """An utterance that is a question, an order to learn, or about the present mission.

    Attributes:
        intent: the kind of the utterance, with its parts.
    """

    def __init__(self, intent: MemoryQuestion | SiteOrder | Control) -> None:
        what = {
            MemoryQuestion: "a question, which memory answers",
            SiteOrder: "an order to learn",
            Control: "about the present or last mission",
        }[type(intent)]
        super().__init__(f"instruction: no mission, but {what}; send it to the running service")
        self.intent = intent


_IN_A_MISSION = ("keep_out", "stay_inside", "pause")  # `do` of orders that a mission may contain
_OBJECT_SLOTS = ("object", "name", "anchor", "room")  # slots whose text must not be vague
_ZONE_KINDS = ("keep_out", "stay_inside", "open")  # `do` of orders whose room may also be a site
_QUESTION_REWRITES = (
    # "somebody put the mug on the desk, is that right?"
    (re.compile(rf"^(?:(?:somebody|someone) \w+ )?({NAME} {phrase_of('relation')} {NAME})"
                r", (?:is that (?:right|true|so)|right|yes or no)(?=\?$)", re.I), r"is \1"),
    # "my keys, they are on the desk?"
    (re.compile(rf"^({NAME}),? (?:it|they) (is|are|was|were)"
                rf"(?= {phrase_of('relation')} [^.;:!]*\?$)", re.I), r"\2 \1"),
    # "is there a mug on this floor?"
    (re.compile(r"^((?:is|are|was|were|do|does|did|have|where|which|what|how|any)\b.*) "
                r"(?:on this floor|in this (?:building|house|flat|apartment))(?=[.?!]*$)", re.I),
     r"\1"),
    # "so there is a mug?", "it is there a mug?"
    (re.compile(r"^(?:so )?there (is|are)\b(?=[^.;:!]*\?$)", re.I), r"\1 there"),
    (re.compile(r"^it (is|was) there (?=[^.;:!]*\?$)", re.I), r"\1 there "),
    # "my keys, are they on the desk?"
    (re.compile(rf"^({NAME}),? (is|are|was|were) (?:it|they)(?= )", re.I), r"\2 \1"),
    # "on the desk, is there a mug?"
    (re.compile(rf"^((?:in|on|under|at) {NAME}),? (?:there (is|are)|(is|are) there)"
                rf" ({NAME})(?=\?$)", re.I), r"\2\3 there \4 \1"),
    # "the mug is still on the desk?"
    (re.compile(rf"^({NAME}) (is|are|was|were)(?=(?: still| really)* {phrase_of('relation')} "
                r"[^.;:!]*\?$)", re.I), r"\2 \1"),
)  # fmt: skip
"""Pattern of a question with the word order of a statement, and its replacement."""
_GO_AND_LOOK = re.compile(
    r"(?:go |drive |run )?(?:over |there )*(?:and )?(?:check|see|look|count|find out|have a look|"
    r"take a look)(?: there| for me)*",
    re.I,
)
"""The order, after a question, to go and look for the answer."""
_AND_GO = re.compile(
    r"^(?:(?:find out|figure out|work out|see|check|discover)(?: for me)? (?=where\b))?"
    r"(?P<question>.+?)(?:[?.!,;:]+ *| (?=(?:and|then|go|drive|find) ))"
    r"(?:(?:and|then|so|please|now|okay),? )*"
    r"(?:(?:go|drive|head|move|run|roll)(?: right| straight| over| up| on| back)* "
    r"(?:there|(?:to|near|next to) (?:it|them|one))|(?:go |try )?(?:and |to )?(?:find|look for|"
    r"search for|locate) (?:it|them))(?=[.,;!?]|$| (?:and|then|but)\b)(?P<rest>.*)$",
    re.I,
)
"""A question about an object, and the order to go there: "where is the mug? Go there"."""
_WHETHER_THERE = re.compile(
    r"^(?:find out|figure out|check|see|look|tell me)(?: for me)? (?:if|whether) there (is|are)\b",
    re.I,
)
_REMEMBER = re.compile(
    rf"(?:remember|memori[sz]e|save|store|note) {NAME}(?:(?:,| and| or)+ {NAME})*[.!]*", re.I
)
"""An order to remember that does not say as what; the grammar would read a visit."""
_QUESTION = re.compile(
    r"(?:(?:how|what|which|whose)(?: [\w'-]+){0,3}?|who|whom|why|when|where)"
    r" (?:is|are|am|was|were|do|does|did|have|has|had|can|could|will|would|should)\b"
    r"[^.,;:!?]*[.!?]*"
    r"|(?:is|are|am|was|were|does|did|has|had|do (?:you|we|i)|have (?:you|we|i))\b[^.,;:!?]*\?",
    re.I,
)
_UNANSWERED = (
    "a question that the robot cannot answer; it can say where an object or itself is, when it saw "
    "something, how many it knows of, which rooms and places it knows, and what it is doing"
)
_SEVERAL_KINDS = "instruction: say one at a time: an errand, a question, or what to remember"


@lru_cache(maxsize=1)
def _templates() -> dict[str, list[SentenceTemplate]]:
    """Return the templates of each kind, in the order in which they are tried."""
    templates = {**QUESTIONS, **CONTROL, **ORDERS}
    return {kind: compile_templates(lines, PARTS) for kind, lines in templates.items()}


def understand(utterance: str, sites: Collection[str] = ()) -> Intent:
    """Return the kind of an utterance with its parts.

    Args:
        utterance: the words of a person.
        sites: names of places, rooms and zones; the robot can keep out of them as out of rooms.

    Raises:
        TranslationError: a self-correction is unclear, or several kinds are mixed.

    Example:
        >>> understand("Where did you see the mug?")
        MemoryQuestion(topic='where', about='mug', room='')
        >>> understand("Please stay out of the bathroom.").do
        'keep_out'
    """
    speech = tidy_up(utterance)
    if (kind := _classify(speech.text, sites)) is not None:
        return kind
    if _REMEMBER.fullmatch(speech.text):
        raise UnclearError(
            "instruction: unclear what to remember; say 'remember this as the …', or 'go to the …'"
        )
    question, _, order = speech.text.partition("?")
    if _GO_AND_LOOK.fullmatch(strip_politeness(order.strip(" .!"))):
        asked = _classify(f"{question}?", sites)
        orders = {"exists": "check if there is a", "count": "find all"}
        if isinstance(asked, MemoryQuestion) and asked.topic in orders:
            check = f"{orders[asked.topic]} {asked.object_phrase.removeprefix('the ')}"
            return MissionOrder(replace(speech, text=check))
    if (order_to_find := _as_search(speech.text, sites)) is not None:
        return MissionOrder(replace(speech, text=order_to_find))
    if _QUESTION.fullmatch(speech.text):
        raise unclear(speech.text, _UNANSWERED)
    pieces = [strip_politeness(piece) for piece in re.split(r"[.!?;,]+(?: |$)", speech.text)]
    pieces = [piece for piece in pieces if piece and not is_remark(piece, states=True)]
    kinds = [_classify(piece, sites) for piece in pieces]
    known = [kind for kind in kinds if kind is not None]
    if Control("pause") in known and not any(map(_may_be_order, pieces, kinds)):
        return Control("pause")  # "Oh dear, stop, I nearly fell over you!"
    if not known or (None in kinds and all(_may_be_in_a_mission(kind) for kind in known)):
        return MissionOrder(speech)
    if None not in kinds and all(kind == known[0] for kind in known):
        return known[0]
    questions = [kind for kind in known if isinstance(kind, MemoryQuestion)]
    if len(questions) == len(kinds) == 2 and questions[1].about in ("", "it", "them"):
        return questions[0]  # "Did you see the mug? Where is it?"
    raise UnclearError(_SEVERAL_KINDS)


def _as_search(text: str, sites: Collection[str]) -> str | None:
    """Return "where is the mug? Go there" as the order to find the mug; None for other texts."""
    found = _AND_GO.match(text)
    question = _WHETHER_THERE.sub(r"\1 there", found["question"]) if found else ""
    asked = _classify(f"{question}?", sites)
    if found is None or not isinstance(asked, MemoryQuestion) or not asked.about:
        return None
    if asked.topic not in ("where", "exists") or re.match("which", question, re.I):
        return None
    return f"go to {asked.object_phrase}{found['rest']}"


def _may_be_in_a_mission(kind: Intent) -> bool:
    return isinstance(kind, (SiteOrder, Control)) and kind.do in _IN_A_MISSION


def _may_be_order(piece: str, kind: Intent | None) -> bool:
    """Return True if a piece may say more than to stop."""
    if kind is not None:
        return kind not in (Control("pause"), Control("again"))
    words = piece.lower().split()
    named = is_room(bare(piece)) or nouns.unknown_in(bare(piece).split()) is None
    return named or has_order(words) or not {"to", "into", "then", "not", "but"}.isdisjoint(words)


def _classify(text: str, sites: Collection[str]) -> Intent | None:
    """Return the first kind whose template fits the entire text; None for a mission.

    No slot extends over a comma: "it is over, room 6 is open again" is not about "over room 6".
    """
    # Without its question mark "There is a mug?" would be a statement: it becomes "is there a mug".
    # "My keys, are they on the desk?" becomes "are My keys on the desk".
    asked = text
    for stated, question in _QUESTION_REWRITES:
        asked = stated.sub(question, asked)
    # Remove commas and the final mark. A full stop in the text becomes a separate word ".", so that
    # no slot extends over it.
    plain = re.sub(r"[.;:!?]+(?= )", " .", re.sub(r"[.,;:!?]+$|,(?= )", "", asked))
    plain = " ".join(plain.split())
    for kind, patterns in _templates().items():
        for pattern in patterns:
            slots = first_match([pattern], plain)
            if slots is None or not all(slot in asked for slot in slots.values()):
                continue
            if kind == "moved" and text.endswith("?"):
                continue  # "the dock is here?"
            if _slots_fit(kind, slots, sites):
                return _make_kind(kind, slots)
    return None


def _is_place_name(name: str) -> bool:
    """Return True if "this is the tea corner" names a place, unlike "this is fun"."""
    plain = bare(name)
    last = plain.split()[-1]
    if is_marked(plain) or re.fullmatch(rf".*\bcorner|{phrase_of('room of')}(?: area)?", plain):
        return True
    is_object = name.lower().startswith("the ") and nouns.is_noun(last)
    return last not in NOWHERE and (is_object or nouns.is_place(plain))


def _may_move(name: str, sites: Collection[str]) -> bool:
    """Return True if "the dock is here" names a place, unlike "the doctor is here"."""
    is_numbered_kind = name.split()[-1] in nouns.NUMBERED
    return name in sites or is_room(name) or nouns.is_place(name) or is_numbered_kind


def _slots_fit(kind: str, slots: Mapping[str, str], sites: Collection[str]) -> bool:
    """Return True if each slot has a name of its kind; a zone may also be of one of the sites."""
    room = bare(slots.get("room", ""))
    if room and not is_room(room) and not (kind in _ZONE_KINDS and room in sites):
        return False
    if "within" in slots and not is_room(bare(slots["within"])):
        return False
    if kind == "stated" and not _is_place_name(slots["name"]):
        return False
    if kind == "moved" and not _may_move(bare(slots["name"]), sites):
        return False
    if bare(slots.get("anchor", "x")).split()[-1] in NOWHERE:
        return False
    return not any(
        is_vague(name) and not (slot == "name" and bare(name) == "home")  # people name places so
        for slot, name in slots.items()
        if slot in _OBJECT_SLOTS
    )


def _make_kind(kind: str, slots: Mapping[str, str]) -> Intent:
    """Return a matched utterance."""
    room = bare(slots.get("room", ""))
    if kind in QUESTIONS:
        about, relation = bare(slots.get("object", "")), slots.get("relation", "").lower()
        anchor = bare(slots.get("anchor", ""))
        about, room = about.removesuffix(" left"), bare(slots.get("within", "")) or room
        if relation in ("in", "inside", "at", "on") and is_room(anchor):
            room = anchor
        elif anchor:
            about = f"{about} {relation} the {anchor}" if about else anchor
        return MemoryQuestion(kind, about, room)  # type: ignore[arg-type]
    if kind in CONTROL:
        span = slots.get("span")
        return Control(kind, seconds_of(span) if span else None)  # type: ignore[arg-type]
    name = bare(slots.get("site", slots.get("name", ""))) or room
    if kind in ("place", "stated", "moved"):
        kind = "room" if is_room(name) else "place"
    return SiteOrder(kind, name)  # type: ignore[arg-type]

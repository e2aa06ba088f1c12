"""Parser of one step of an instruction; see the grammar in `edge.tasks.sentences.reading`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile

from edge.mission.language.words.tokens import Token, TokenReader, TranslationError
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.sentences.object_phrases import (
    UnseenScene,
    object_of_last_step,
    only_one,
    read_object,
    read_objects,
    read_own_side,
    read_passing_side,
)
from edge.tasks.sentences.phrases import ground_kind
from edge.tasks.sentences.steps import OTHER_SIDE, InstructionStep, Kind

_SIDE_OF = {
    "left of": "left", "its left": "left", "right of": "right", "its right": "right",
}  # fmt: skip
RELATIONS = (
    "to", "at", "past", "along", "around", "between", "left of", "right of", "in front of",
    "behind", "straight", "its left", "its right", "circle", "halfway", "onto", "across", "until",
)  # fmt: skip
_MOTIONS = ("circle", "across")
"""Kinds of relations that are verbs, too: "circle the tree", "cross the road"."""
PASSED = ("past", "around", "along", "across")
"""Kinds of steps after which a destination needs no joint: "past the van to the gate"."""
STOPPED_AT = ("to", "next to", "between", "straight")
"""Kinds of steps after which "there" is clear."""
JOINTS = ("then", "and", "comma", "stop mark")
"""Kinds of tokens between two steps."""
_LONG_THINGS = ("fence", "wall", "hedge", "railing", "building", "house", "shelf", "corridor")
"""Objects along which the robot can drive."""
_RETURN = "say where to return to, as 'back to the gate'"  # error for a bare "go back"


def read_step(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read one step; `before` are the steps that were read before it."""
    if reader.peek().text == "in" and reader.is_at("number", ahead=1):  # "in 3 m, turn left"
        reader.at += 1
        return InstructionStep("straight", distance_m=_read_distance_m(reader))
    if _is_elliptic(reader, before) and not _counts_metres(reader):
        return _read_destination(reader, scene, before)
    verb = reader.take("go", "pass", "stop", "reach", "leave", "follow")
    reader.skip("first", "filler")
    if verb is None and not _may_lack_verb(reader, before):
        if reader.peek().text == "back":
            reader.refuse(_RETURN)
        reader.refuse("expected what to do: go to, drive past, around, between, stop at, …")
    doing = verb.kind if verb else "go"
    if doing == "pass" and not reader.is_at("between"):
        return _read_passing(reader, scene, before, "past")
    if doing == "leave":
        return _read_leaving(reader, scene, before)
    if doing == "reach":
        return _read_destination(reader, scene, before)
    if doing == "follow":
        return _read_following(reader, scene, before)
    if doing in ("go", "stop") and _counts_metres(reader):
        return _read_counted(reader, scene, before, doing)
    if doing == "stop" and (there := reader.take("there")):
        if not before or before[-1].kind not in STOPPED_AT:
            reader.refuse("it is not clear where; name an object", there)
        return InstructionStep("stop")
    relation = reader.take(*RELATIONS)
    if relation is None:
        if doing == "stop":
            return InstructionStep("stop")
        if verb and (verb.text == "return" or reader.peek().text == "back"):
            reader.refuse(_RETURN, verb)
        reader.refuse("expected where: to, past, around, between, left of, straight, …")
    if relation.kind == "to" and reader.peek().text.startswith(("the ", "its ")):
        relation = reader.take(*_SIDE_OF) or relation  # "back to the left of the van"
    if doing == "go" and relation.text == "by":
        reader.refuse("it can be read in two ways; say 'past' or 'to'", relation)
    if doing == "stop" and relation.kind in ("past", "around", "along", "straight", *_MOTIONS):
        reader.refuse("a robot cannot stop there; say 'at', 'left of', 'behind', …", relation)
    return _read_related(reader, scene, before, relation)


def _read_related(
    reader: TokenReader,
    scene: Scene | UnseenScene,
    before: Sequence[InstructionStep],
    relation: Token,
) -> InstructionStep:
    """Read the rest of a step after its relation, such as "past" or "left of"."""
    match relation.kind:
        case "past" | "around" | "along" | "circle":
            return _read_passing(reader, scene, before, relation.kind)
        case "halfway":
            return InstructionStep("halfway", (read_object(reader, scene, before),))
        case "onto" | "across":
            return _read_onto(reader, scene, relation.kind)
        case "between":
            return InstructionStep("between", _read_two_objects(reader, scene, before))
        case "straight" if reader.take("to"):  # "straight to the van"
            return _read_destination(reader, scene, before)
        case "straight" if reader.take("until", "until level"):
            return InstructionStep("straight", (read_object(reader, scene, before),))
        case "straight" if reader.is_at("first", "then", "comma", "stop mark"):
            reader.skip("first")
            return InstructionStep("straight")  # as far as the next step's object
        case "straight":
            reader.take("for") or (reader.peek().text == "by" and reader.take("at"))
            return InstructionStep("straight", distance_m=_read_distance_m(reader))
        case "to" | "at" | "until":
            if relation.kind == "to" and (ground := read_ground(reader, scene)):
                return InstructionStep("onto", ground=ground)
            return _read_destination(reader, scene, before)
        case "its left" | "its right":
            return InstructionStep(
                "next to",
                (object_of_last_step(scene, before, reader, relation),),
                _SIDE_OF[relation.kind],
            )
    obj = read_object(reader, scene, before)
    return InstructionStep("next to", (obj,), _SIDE_OF.get(relation.kind, relation.kind))


def check_joined(reader: TokenReader, last: InstructionStep, verb: Token) -> None:
    """Check that the meaning of a relation without a verb is clear.

    "To the gate, past the van" may lead past the van first. "Past the left of the van and right of
    the gate" may also lead past the gate. `last` is the step before, which begins with `verb`.

    Raises:
        TranslationError: the meaning is not clear.
    """
    token, comma = reader.peek(), reader.is_at("comma", ahead=-1)
    passing = last.kind in ("past", "around", "along")
    # "to the gate, past the van" may pass the van first, so only these may follow a comma.
    after_comma = ("past", "around", "between", "to") if passing else ("to",)
    changes_order = comma and token.kind not in after_comma
    # "go past the left of the van and right of the gate" may pass the gate too, but
    # "go past the left of the van and to the right of the gate" goes there.
    goes_there = token.text.startswith("to ") and verb.kind != "pass"
    may_extend_passing = passing and token.kind in _SIDE_OF and not goes_there
    if changes_order or may_extend_passing:
        reader.refuse("it is not clear when or how; say 'then go', 'then go past' or 'passing'")


def _counts_metres(reader: TokenReader) -> bool:
    """Return True if a distance comes: "3 metres straight on", "half a metre forward"."""
    counted = reader.is_at("number", "article") and reader.is_at("metres", "and a half", ahead=1)
    return counted or reader.is_at("half")


def _may_lack_verb(reader: TokenReader, before: Sequence[InstructionStep]) -> bool:
    """Return True if a step without a verb may begin here: "…, then past the van"."""
    goes_on = reader.is_at(*RELATIONS) or _counts_metres(reader)
    after_limit = reader.at > 0 and not reader.is_at(*JOINTS, ahead=-1) and reader.is_at("to")
    begins = reader.is_at(*_MOTIONS, "until") or reader.peek().text == "enter"
    return (bool(before) and goes_on) or after_limit or begins


def _is_elliptic(reader: TokenReader, before: Sequence[InstructionStep]) -> bool:
    """Return True if a verb is left out here: "first the van", "to the gate, then the van"."""
    joint = reader.peek(-1).kind if reader.at else ""
    goes_on = joint == "then" and bool(before) and before[-1].kind == "to"
    begins = joint == "first" and not before
    return (goes_on or begins) and reader.is_at("article")


def _read_following(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read `follow the fence`: only long objects that do not move can be followed."""
    reader.skip("article")
    start, begin = reader.peek(), reader.at
    obj = read_object(reader, scene, before)
    words = takewhile(lambda token: token.kind == "word", reader.tokens[begin : reader.at])
    *_, noun = ("", *(token.text for token in words))
    if noun not in _LONG_THINGS:
        reader.refuse("this cannot be followed; say 'go past …' or 'go to …'", start)
    return InstructionStep("along", (obj,))


def _read_onto(reader: TokenReader, scene: Scene | UnseenScene, kind: Kind) -> InstructionStep:
    """Read `the grass` of "onto the grass" and "across the grass"."""
    start = reader.peek()
    ground = read_ground(reader, scene)
    if not ground:
        reader.refuse("expected a kind of ground, as the road or the grass", start)
    return InstructionStep(kind, ground=ground)


def _read_destination(
    reader: TokenReader,
    scene: Scene | UnseenScene,
    before: Sequence[InstructionStep],
    distance_m: float = 0.0,
) -> InstructionStep:
    """Read `the van`, `the van's left side`, `the van, but stay 2 metres away`."""
    obj = read_object(reader, scene, before)
    side = read_own_side(reader)
    if reader.take("from behind"):
        side = "behind"
    if reader.is_at("gap", ahead=1 if reader.is_at("comma") else 0) and not (side or distance_m):
        reader.skip("comma")
        reader.skip("gap")
        distance_m = _read_distance_m(reader)
        reader.take("away")
    elif not (side or distance_m):
        distance_m = _read_stop_before_it(reader)
    if side:
        return InstructionStep("next to", (obj,), side)
    return InstructionStep("to", (obj,), distance_m=distance_m)


def _read_stop_before_it(reader: TokenReader) -> float:
    """Read `and stop 2 metres before it`; return the distance, or 0.0 if no such words come."""
    at = reader.at
    reader.skip(*JOINTS)
    if (
        reader.at > at
        and reader.take("stop")
        and reader.is_at("number", "article", "half")
        and reader.is_at("metres", ahead=1)
    ):
        distance_m = _read_distance_m(reader)
        if reader.peek().text.endswith(" it") and reader.take("away"):
            return distance_m
    reader.at = at
    return 0.0


def _read_counted(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep], doing: str
) -> InstructionStep:
    """Read `3 metres forward`, `3 metres before the van`, `3 metres behind the van`."""
    distance_m = _read_distance_m(reader)
    after_turn = before and before[-1].kind == "turn" and reader.is_at("end", *JOINTS)
    if doing == "go" and (reader.take("straight") or after_turn):
        return InstructionStep("straight", distance_m=distance_m)
    if reader.take("before", "short of", "from", "in front of"):
        return _read_destination(reader, scene, before, distance_m)
    if relation := reader.take("behind", "left of", "right of"):
        side = _SIDE_OF.get(relation.kind, relation.kind)
        obj = read_object(reader, scene, before)
        return InstructionStep("next to", (obj,), side, distance_m)
    reader.refuse("say in which direction, as '3 metres straight on'")


def _read_passing(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep], kind: Kind
) -> InstructionStep:
    """Read `past the left of the van`, `around the van on its left`, `around the van once`."""
    step = _read_passed(reader, scene, before, kind)
    if kind in ("past", "along"):
        return replace(step, kind="past") if step.side else step
    if sense := reader.take("clockwise", "counterclockwise"):
        if step.side:
            reader.refuse("the side is said twice", sense)
        step = replace(step, side="left" if sense.kind == "clockwise" else "right")
    if reader.peek().text == "once" and reader.is_at("end", *JOINTS, ahead=1):
        reader.at += 1
        return replace(step, kind="circle")
    return step


def _read_passed(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep], kind: Kind
) -> InstructionStep:
    """Read the object that is passed, and on which side."""
    if side := reader.take("left of", "right of"):
        return InstructionStep(kind, (read_object(reader, scene, before),), _SIDE_OF[side.kind])
    if side := reader.take("its left", "its right"):
        return InstructionStep(
            kind, (object_of_last_step(scene, before, reader, side),), _SIDE_OF[side.kind]
        )
    begin, start = reader.at, reader.peek()
    found = read_objects(reader, scene, before, is_passed=True)
    said, passing = reader.peek(), read_passing_side(reader)
    if passing is None or reader.is_at("its left", "its right"):
        if (
            passing is not None
        ):  # "the car on the left on its right": the first side chooses the car
            reader.at = begin
            found = read_objects(reader, scene, before)
        side = reader.take("its left", "its right")
        whose = _SIDE_OF[side.kind] if side else read_own_side(reader)
        return InstructionStep(kind, (only_one(found, reader, start),), whose)
    # The side may also choose the object: read the phrase again in that sense.
    end, reader.at = reader.at, begin
    try:
        on_that_side = read_objects(reader, scene, before)
    except TranslationError:
        on_that_side = []  # no such object on that side: the words can only mean the passing side
    reader.at = end
    side = OTHER_SIDE[passing.direction] if passing.of_robot else passing.direction
    differs = isinstance(scene, Scene) and bool(on_that_side) and on_that_side[0] is not found[0]
    if len(found) > 1 or differs:
        reader.refuse(
            f"it may say which one is meant, or on which side to pass it; say '{kind} the {side} "
            f"of …', or '… that is on the {passing.direction}'", said,
        )  # fmt: skip
    return InstructionStep(kind, (found[0],), side)


def _read_leaving(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read `leave the van on your left`: the robot passes its right."""
    start = reader.peek()
    obj = only_one(read_objects(reader, scene, before, is_passed=True), reader, start)
    passing = read_passing_side(reader)
    if passing is None:
        reader.refuse("say on which side, as 'on your left'", start)
    return InstructionStep("past", (obj,), OTHER_SIDE[passing.direction])


def _read_two_objects(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> tuple[SceneObject, ...]:
    """Read `the van and the tree`, `the two cars` or `the cars`."""
    start = reader.peek()
    if reader.is_at("article") and reader.is_at("number", ahead=1) and reader.peek(1).text == "2":
        reader.at += 2
    found = read_objects(reader, scene, before)
    if reader.take("and"):
        found = [only_one(found, reader, start), read_object(reader, scene, before)]
        if found[0] is found[1]:
            reader.refuse("this is the same object twice; name two", start)
    if len(found) != 2 and isinstance(scene, Scene):
        reader.refuse(f"there are {len(found)} of them; name two: 'between … and …'", start)
    return tuple(found)


def _read_distance_m(reader: TokenReader) -> float:
    """Read `3 metres`, `half a metre`, `a metre and a half`."""
    start, distance_m = reader.peek(), 0.0
    if token := reader.take("number"):
        distance_m = float(token.text)
    elif reader.take("half"):
        distance_m = 0.5
    elif start.text == "a" and reader.take("article"):
        distance_m = 1.0
    more = start.kind == "number" and reader.take("and a half")  # "3 and a half metres"
    if not reader.take("metres") or not distance_m:
        reader.refuse("say how far, as 'straight for 5 metres'", start)
    # "3 metres and a half"
    more = more or (start.kind != "half" and reader.take("and a half"))
    return distance_m + (0.5 if more else 0.0)


class UnseenGroundError(TranslationError):
    """A kind of ground that the scene does not have.

    Attributes:
        kind: the kind; see `edge.tasks.sentences.phrases.GROUNDS`.
    """

    def __init__(self, message: str, part: str, position: int, kind: str) -> None:
        super().__init__(message, part, position)
        self.kind = kind


def read_ground(reader: TokenReader, scene: Scene | UnseenScene) -> str:
    """Read `the road`; return the kind of ground, or "" if no name of ground comes.

    Raises:
        UnseenGroundError: the scene has no such ground.
    """
    at = reader.at
    reader.skip("article")
    token = reader.take("ground")
    if token is None or reader.is_at("word"):  # "the street light"
        reader.at = at
        return ""
    kind = ground_kind(token.text)
    if isinstance(scene, Scene):
        kinds = dict.fromkeys(ground_kind(region.label) for region in scene.regions.values())
        if kind not in kinds:
            there = ", ".join(kinds) or "no named ground"
            hint = f"no ground here has that name; there is {there}"
            try:
                reader.refuse(hint, token)
            except TranslationError as error:
                raise UnseenGroundError(str(error), error.part, error.position, kind) from None
    return kind

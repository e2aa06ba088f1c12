"""Parser of instructions: a small grammar reads them as steps.

    task   = step { ("then" | "and" | "," | ".") step } ["stop" ["there"]]
    step   = go ("to" | "near" | …) thing ["'s" side] | "approach" thing
           | (go "past" | "pass" | go "around") [side "of"] thing [on its side | "'s" side | aside]
           | ("leave" | "keep" | "with") thing aside
           | go (side "of" | "in front of" | "behind") thing | go "to its" side
           | go "between" (thing "and" thing | "the two" things)
           | go "straight" distance | go distance "straight"
           | "stop" ("at" | side "of" | "in front of" | "behind" | "between" …) thing
    thing  = [article] { description } name { place } | "it"
           | "object" number | [article] { description } name ["number"] number
             with `chooser` anywhere before the places
    distance = (number ["and a half"] | "half a" | "a") "metres" ["and a half"]
    chooser = order | "second" | "left" | "right"
    order  = ("nearest" | "farthest") ["to" thing] | "leftmost" | "rightmost"
           | "second from the left"
    place  = "on the left" | "on the right" | "ahead" | "behind you" | "near" thing
           | order | "that is" (description | place)
    aside  = "on the left" | "on your left" | …

`_read_step` reads a step, `_read_objects` a thing, `_read_distance_m` a distance, `_read_word` a
chooser, and `_read_passing_side` an aside: the side on which an object is passed.

A clause may depend on another ("after passing …", "before you …", see `edge.tasks.clauses`). Words
in double quotes can only name or describe an object.

The robot's place at the time of the request decides which object is meant. A number counts from the
nearest object. "From the left" counts only objects ahead. If the robot passes an object "on your
left", the object is on the robot's left. If it passes "on the left", the robot is on the left side
of the object. If "on the left" may also choose the object, the instruction is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import NoReturn

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.mission.language.tokens import Token, TokenReader, TranslationError
from edge.mission.task_step import TaskStep
from edge.tasks.clauses import list_in_order, order_clauses
from edge.tasks.outline import outline_of
from edge.tasks.phrases import ground_kind, tokenise
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.steps import InstructionStep, Kind, RouteLimits
from edge.text import one_line

SIDE_RAD = math.radians(5)
"""An object closer to straight ahead than this is neither on the left nor on the right."""
AHEAD_RAD = math.radians(45)
"""An object closer to straight ahead than this is "ahead"; the same holds for "behind"."""
NEAR_M = 3.0
"""Largest distance of an object that is "near" another one."""


def parse_steps(
    instruction: str, scene: Scene, step_slice: slice = slice(None)
) -> list[InstructionStep]:
    """Parse the steps of an instruction, at least one.

    Args:
        instruction: the text.
        scene: what is around the robot.
        step_slice: steps to return. The objects of the other steps need not be in the scene. No
            returned step may refer (`it`) to an object that another step names.

    Raises:
        TranslationError: the instruction is not understood; the error names the part.
    """
    steps = _read_steps(
        instruction,
        lambda n: scene if n is None or _is_selected(n, step_slice) else _UnseenScene(),
    )
    return steps[step_slice]


def _is_selected(n: int, step_slice: slice) -> bool:
    """Return True if a slice selects step n. The slice counts from the start: no negative ends."""
    return n in range(n + 1)[step_slice]


def _read_steps(
    instruction: str, scene_for: Callable[[int | None], Scene | _UnseenScene]
) -> list[InstructionStep]:
    """Parse all steps.

    Args:
        instruction: the text.
        scene_for: returns the scene for the step with a given index; None: for what restricts all
            steps.
    """
    tokens = list_in_order(tokenise(instruction))
    reader = TokenReader(instruction, order_clauses(instruction, tokens))
    steps: list[InstructionStep] = []
    limits, limit_scene = RouteLimits(), scene_for(None)
    reader.skip("filler", "first")
    start = reader.peek()
    while not reader.is_at("end"):
        if (more := _read_limits(reader, limit_scene, steps, limits)) is not None:
            limits = more
            _end_step(reader, "to", "until")
            start = reader.peek()
            continue
        verb, start, begin = start, reader.peek(), reader.at
        if steps and start.kind in _RELATIONS:
            _check_joined(reader, steps[-1], verb)
        found = _read_turn(reader, scene_for, steps) or [
            _read_step(reader, _turned(scene_for(len(steps)), steps), steps)
        ]
        said = instruction[start.start : reader.peek(-1).end]
        if found[0].things:
            _check_sides(reader, begin, steps)
        steps += [replace(step, said=said) for step in found]
        _end_step(reader, *(("to", "until") if found[-1].kind in _PASSED else ()))
        if start.kind == "stop" and not reader.is_at("end", *_LIMITS):
            reader.refuse("the robot stops here; no step can follow", start)
    if not steps:
        reader.refuse("say where to go")
    if steps[-1].kind == "stop":
        if len(steps) == 1:
            reader.refuse("say where to go first", reader.tokens[0])
        steps = steps[:-1]
    return [replace(step, limits=limits) for step in _with_distances(reader, steps)]


def _end_step(reader: TokenReader, *more: str) -> None:
    """Read the joint after a step; `more` are kinds of tokens that may follow without a joint."""
    reader.skip("for me")
    if not reader.is_at("end", *_JOINTS, *_LIMITS, *more):
        reader.refuse("not known here; a step ends with 'then', 'and' or a comma")
    first_joint = reader.at
    reader.skip(*_JOINTS, "filler", "first")
    for joint in reader.tokens[first_joint : reader.at]:
        if joint.kind in ("then", "and") and reader.is_at("end"):
            reader.refuse("no step follows", joint)


def _with_distances(reader: TokenReader, steps: list[InstructionStep]) -> list[InstructionStep]:
    """Return the steps, with an end for each "straight" without one: the next step's object."""
    done = []
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        if step.kind == "straight" and not (step.things or step.distance_m):
            if following is None or following.kind != "to":
                start = next(t for t in reader.tokens if t.kind == "straight")
                reader.refuse("say how far, as 'straight for 5 metres'", start)
            step = replace(step, things=following.things)
        done.append(step)
    return done


def _read_limits(
    reader: TokenReader,
    scene: Scene | _UnseenScene,
    before: Sequence[InstructionStep],
    limits: RouteLimits,
) -> RouteLimits | None:
    """Read `avoid the van`, `keep to the road`, `follow the road`; None if no such words come."""
    at = reader.at
    reader.take("go")
    token = reader.take(*_LIMITS, "follow", "along")
    if token is None:
        reader.at = at
        return None
    ground = _read_ground(reader, scene)
    if ground and token.kind == "avoid":
        return replace(limits, avoid_ground=(*limits.avoid_ground, ground))
    if ground:
        return replace(limits, keep_to=(*limits.keep_to, ground))
    if token.kind == "avoid":
        found = _read_objects(reader, scene, before)
        return replace(limits, avoid=(*limits.avoid, *found))
    if token.kind == "keep to":
        reader.refuse("say the kind of ground, as 'keep to the road'")
    reader.at = at
    return None


def _read_ground(reader: TokenReader, scene: Scene | _UnseenScene) -> str:
    """Read `the road`; return the kind of ground, or "" if no name of ground comes.

    Raises:
        TranslationError: the scene has no such ground.
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
            there = ", ".join(kinds) or "none told apart"
            reader.refuse(f"no ground here has that name; there is {there}", token)
    return kind


def _read_turn(
    reader: TokenReader,
    scene_for: Callable[[int | None], Scene | _UnseenScene],
    before: Sequence[InstructionStep],
) -> list[InstructionStep]:
    """Read `turn left`, `turn 45 degrees to the left`, `turn left at the van`; [] if none comes."""
    token = reader.take("turn", "turn left", "turn right", "turn around")
    if token is None:
        return []
    scene = scene_for(len(before))
    side, degrees = token.kind.removeprefix("turn").strip(), 0.0
    if reader.peek().text == "by":
        reader.at += 1
    if number := reader.take("number"):
        degrees = float(number.text)
        if not reader.take("degrees") or not 0.0 < degrees <= 180.0 or side == "around":
            reader.refuse("say the angle, as 'turn left by 45 degrees' (at most 180)", number)
    if not side:
        if reader.is_at("to") and reader.is_at("article", ahead=1):
            reader.at += 2
        token = reader.take(*_TURN_SIDES)
        if token is None:
            reader.refuse("say to which side, as 'turn left'")
        side = _TURN_SIDES[token.kind]
    angle_rad = {"left": 1.0, "right": -1.0, "around": 2.0}[side] * math.radians(degrees or 90.0)
    turn = InstructionStep("turn", turn_rad=angle_rad)
    if before and before[-1].kind in _STOPPED_AT:
        reader.take("there")
    if not reader.take("at"):
        return [turn]
    thing = _read_object(reader, scene, before)
    scene_for(len(before) + 1)  # the turn is a step of its own
    return [InstructionStep("to", (thing,)), turn]


def _turned(scene: Scene | _UnseenScene, before: Sequence[InstructionStep]) -> Scene | _UnseenScene:
    """Return the scene as the robot sees it after the turns with which the instruction begins."""
    if isinstance(scene, _UnseenScene):
        return scene
    turned_rad = sum(step.turn_rad for step in before)
    return replace(scene, pose=SE2(scene.pose.x_m, scene.pose.y_m, scene.pose.yaw_rad + turned_rad))


def _check_sides(reader: TokenReader, begin: int, before: Sequence[InstructionStep]) -> None:
    """Check that no words from `begin` on choose an object by its side after a turn elsewhere.

    Raises:
        TranslationError: they do.
    """
    if all(step.kind == "turn" for step in before) or not any(step.turn_rad for step in before):
        return
    if reader.tokens[begin + 1].kind == "straight":  # "go straight"; but "the car straight ahead"
        begin += 2
    for token in reader.tokens[begin : reader.at]:
        if token.kind in _CHOSEN_BY_SIDE:
            reader.refuse("after a turn it is not clear which this is; name the object", token)


def task_steps(instruction: str) -> tuple[TaskStep, ...]:
    """Parse the steps of an instruction by its grammar alone, before any object was seen.

    Names are nouns in the singular; a repeated name keeps its first spelling. Words before the
    noun only describe the object and are left out.

    Raises:
        TranslationError: the instruction is not understood; the error names the part.
    """
    unseen: list[_UnseenScene] = []
    avoided = _UnseenScene()

    def scene_for(number: int | None) -> _UnseenScene:
        if number is None:
            return avoided
        unseen.append(_UnseenScene())
        return unseen[-1]

    steps = _read_steps(instruction, scene_for)
    spelling: dict[str, str] = {}  # canonical name -> its first spelling in the instruction
    names_of_steps = [
        tuple(spelling.setdefault(canonical, name) for canonical, name in scene.names.items())
        for scene in (*unseen, avoided)
    ]
    return tuple(
        TaskStep(
            step.said,
            # What the path stays away from must be seen before it is driven.
            tuple(
                dict.fromkeys(
                    names_of_steps[n]
                    + (names_of_steps[n + 1] if _ends_at_next(step) else ())
                    + names_of_steps[-1]
                )
            ),
            unseen[n].refers,
        )
        for n, step in enumerate(steps)
    )


def _ends_at_next(step: InstructionStep) -> bool:
    """Return True if the end of a step depends on the object of the next step."""
    return step.kind in ("around", "along") or (step.kind == "straight" and not step.distance_m)


def named_objects(instruction: str) -> tuple[str, ...]:
    """Return the names in an instruction, each object once; see `task_steps`.

    >>> named_objects("pass the van on its left, then go to the red car")
    ('van', 'car')
    """
    return tuple(dict.fromkeys(name for step in task_steps(instruction) for name in step.names))


@dataclass(slots=True)
class _UnseenScene:
    """Stand-in for a scene: every name that is read gives one placeholder object.

    Attributes:
        names: names that were read, by their canonical name (see `edge.names.canonical`).
        refers: True if the step refers to the object of the previous step.
    """

    names: dict[str, str] = field(default_factory=dict)
    refers: bool = False

    def thing(self, words: Sequence[Token] = ()) -> SceneObject:
        """Return the placeholder object for some words; without words, for a bare number."""
        if _is_name(words):
            nouns = list(names.head_nouns(" ".join(token.text for token in words)))
            noun = next(filter(names.is_known, nouns), nouns[0])
            singular = names.singular(noun)  # wrong for "chest of drawers", so compare the two
            noun = singular if names.same_name(singular, noun) else noun
            self.names.setdefault(names.canonical(noun), noun)
        return SceneObject(0, "", "", np.zeros(3), np.zeros(3), 0.0, np.empty((0, 3)), {})


def _read_step(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep]
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
        if not before or before[-1].kind not in _STOPPED_AT:
            reader.refuse("it is not clear where; name a thing", there)
        return InstructionStep("stop")
    relation = reader.take(*_RELATIONS)
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
    match relation.kind:
        case "past" | "around" | "along" | "circle":
            return _read_passing(reader, scene, before, relation.kind)
        case "halfway":
            return InstructionStep("halfway", (_read_object(reader, scene, before),))
        case "onto" | "across":
            return _read_onto(reader, scene, relation.kind)
        case "between":
            return InstructionStep("between", _read_two_objects(reader, scene, before))
        case "straight" if reader.take("to"):  # "straight to the van"
            return _read_destination(reader, scene, before)
        case "straight" if reader.take("until", "until level"):
            return InstructionStep("straight", (_read_object(reader, scene, before),))
        case "straight" if reader.is_at("first", "then", "comma", "stop mark"):
            reader.skip("first")
            return InstructionStep("straight")  # as far as the next step's object
        case "straight":
            reader.take("for") or (reader.peek().text == "by" and reader.take("at"))
            return InstructionStep("straight", distance_m=_read_distance_m(reader))
        case "to" | "at" | "until":
            if relation.kind == "to" and (ground := _read_ground(reader, scene)):
                return InstructionStep("onto", ground=ground)
            return _read_destination(reader, scene, before)
        case "its left" | "its right":
            return InstructionStep(
                "beside",
                (_object_of_last_step(scene, before, reader, relation),),
                _SIDE_OF[relation.kind],
            )
    thing = _read_object(reader, scene, before)
    return InstructionStep("beside", (thing,), _SIDE_OF.get(relation.kind, relation.kind))


def _check_joined(reader: TokenReader, last: InstructionStep, verb: Token) -> None:
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
    goes_on = reader.is_at(*_RELATIONS) or _counts_metres(reader)
    after_limit = reader.at > 0 and not reader.is_at(*_JOINTS, ahead=-1) and reader.is_at("to")
    begins = reader.is_at(*_MOTIONS, "until") or reader.peek().text == "enter"
    return (bool(before) and goes_on) or after_limit or begins


def _is_elliptic(reader: TokenReader, before: Sequence[InstructionStep]) -> bool:
    """Return True if a verb is left out here: "first the van", "to the gate, then the van"."""
    joint = reader.peek(-1).kind if reader.at else ""
    goes_on = joint == "then" and bool(before) and before[-1].kind == "to"
    begins = joint == "first" and not before
    return (goes_on or begins) and reader.is_at("article")


def _read_following(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read `follow the fence`: only long things that do not move can be followed."""
    reader.skip("article")
    start, begin = reader.peek(), reader.at
    thing = _read_object(reader, scene, before)
    words = takewhile(lambda token: token.kind == "word", reader.tokens[begin : reader.at])
    *_, noun = ("", *(token.text for token in words))
    if noun not in _LONG_THINGS:
        reader.refuse("this cannot be followed; say 'go past …' or 'go to …'", start)
    return InstructionStep("along", (thing,))


def _read_onto(reader: TokenReader, scene: Scene | _UnseenScene, kind: Kind) -> InstructionStep:
    """Read `the grass` of "onto the grass" and "across the grass"."""
    start = reader.peek()
    ground = _read_ground(reader, scene)
    if not ground:
        reader.refuse("expected a kind of ground, as the road or the grass", start)
    return InstructionStep(kind, ground=ground)


def _read_destination(
    reader: TokenReader,
    scene: Scene | _UnseenScene,
    before: Sequence[InstructionStep],
    distance_m: float = 0.0,
) -> InstructionStep:
    """Read `the van`, `the van's left side`, `the van, but stay 2 metres away`."""
    thing = _read_object(reader, scene, before)
    side = _read_own_side(reader)
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
        return InstructionStep("beside", (thing,), side)
    return InstructionStep("to", (thing,), distance_m=distance_m)


def _read_stop_before_it(reader: TokenReader) -> float:
    """Read `and stop 2 metres before it`; return the distance, or 0.0 if no such words come."""
    at = reader.at
    reader.skip(*_JOINTS)
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
    reader: TokenReader,
    scene: Scene | _UnseenScene,
    before: Sequence[InstructionStep],
    doing: str,
) -> InstructionStep:
    """Read `3 metres forward`, `3 metres before the van`, `3 metres behind the van`."""
    distance_m = _read_distance_m(reader)
    after_turn = before and before[-1].kind == "turn" and reader.is_at("end", *_JOINTS)
    if doing == "go" and (reader.take("straight") or after_turn):
        return InstructionStep("straight", distance_m=distance_m)
    if reader.take("before", "short of", "from", "in front of"):
        return _read_destination(reader, scene, before, distance_m)
    if relation := reader.take("behind", "left of", "right of"):
        side = _SIDE_OF.get(relation.kind, relation.kind)
        thing = _read_object(reader, scene, before)
        return InstructionStep("beside", (thing,), side, distance_m)
    reader.refuse("say in which direction, as '3 metres straight on'")


def _read_own_side(reader: TokenReader) -> str:
    """Read the side that follows `the van's`; return "" if there is none."""
    token = reader.take("left", "right")
    if token is None:
        return ""
    while reader.peek().text in ("hand", "side"):
        reader.at += 1
    return token.kind


_SIDE_OF = {
    "left of": "left", "its left": "left", "right of": "right", "its right": "right",
}  # fmt: skip
_RELATIONS = (
    "to", "at", "past", "along", "around", "between", "left of", "right of", "in front of",
    "behind", "straight", "its left", "its right", "circle", "halfway", "onto", "across", "until",
)  # fmt: skip
_MOTIONS = ("circle", "across")
"""Kinds of relations that are verbs, too: "circle the tree", "cross the road"."""
_PASSED = ("past", "around", "along", "across")
"""Kinds of steps after which a destination needs no joint: "past the van to the gate"."""
_STOPPED_AT = ("to", "beside", "between", "straight")
"""Kinds of steps after which "there" is clear."""
_TURN_SIDES = {
    "left": "left", "right": "right", "on the left": "left", "on the right": "right",
    "counterclockwise": "left", "clockwise": "right",
}  # fmt: skip
"""Kind of token → side of a turn."""
_JOINTS = ("then", "and", "comma", "stop mark")
"""Kinds of tokens between two steps."""
_LIMITS = ("avoid", "keep to")
"""Kinds of words that restrict the whole path."""
_LONG_THINGS = ("fence", "wall", "hedge", "railing", "building", "house", "shelf", "corridor")
"""Things along which the robot can drive."""
_RETURN = "say where to return to, as 'back to the gate'"  # error for a bare "go back"
OTHER_SIDE = {"left": "right", "right": "left"}
"""Side → the opposite one."""


def _read_passing(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep], kind: Kind
) -> InstructionStep:
    """Read `past the left of the van`, `around the van on its left`, `around the van once`."""
    step = _read_passed(reader, scene, before, kind)
    if kind in ("past", "along"):
        return replace(step, kind="past") if step.side else step
    if sense := reader.take("clockwise", "counterclockwise"):
        if step.side:
            reader.refuse("the side is said twice", sense)
        step = replace(step, side="left" if sense.kind == "clockwise" else "right")
    if reader.peek().text == "once" and reader.is_at("end", *_JOINTS, ahead=1):
        reader.at += 1
        return replace(step, kind="circle")
    return step


def _read_passed(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep], kind: Kind
) -> InstructionStep:
    """Read the object that is passed, and on which side."""
    if side := reader.take("left of", "right of"):
        return InstructionStep(kind, (_read_object(reader, scene, before),), _SIDE_OF[side.kind])
    if side := reader.take("its left", "its right"):
        return InstructionStep(
            kind, (_object_of_last_step(scene, before, reader, side),), _SIDE_OF[side.kind]
        )
    begin, start = reader.at, reader.peek()
    found = _read_objects(reader, scene, before, is_passed=True)
    said, aside = reader.peek(), _read_passing_side(reader)
    if aside is None or reader.is_at("its left", "its right"):
        if aside is not None:  # "the car on the left on its right": the first side chooses the car
            reader.at = begin
            found = _read_objects(reader, scene, before)
        side = reader.take("its left", "its right")
        whose = _SIDE_OF[side.kind] if side else _read_own_side(reader)
        return InstructionStep(kind, (_only_one(found, reader, start),), whose)
    # The side may also choose the object: read the phrase again in that sense.
    end, reader.at = reader.at, begin
    try:
        on_that_side = _read_objects(reader, scene, before)
    except TranslationError:
        on_that_side = []  # no such object on that side: the words can only mean the passing side
    reader.at = end
    side = OTHER_SIDE[aside.direction] if aside.of_robot else aside.direction
    differs = isinstance(scene, Scene) and bool(on_that_side) and on_that_side[0] is not found[0]
    if len(found) > 1 or differs:
        reader.refuse(
            f"it may say which one is meant, or on which side to pass it; say '{kind} the {side} "
            f"of …', or '… that is on the {aside.direction}'", said,
        )  # fmt: skip
    return InstructionStep(kind, (found[0],), side)


def _read_leaving(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read `leave the van on your left`: the robot passes its right."""
    start = reader.peek()
    thing = _only_one(_read_objects(reader, scene, before, is_passed=True), reader, start)
    aside = _read_passing_side(reader)
    if aside is None:
        reader.refuse("say on which side, as 'on your left'", start)
    return InstructionStep("past", (thing,), OTHER_SIDE[aside.direction])


@dataclass(frozen=True, slots=True)
class _PassingSide:
    """A side after an object: `on the left`, or with `of_robot` `on your left`."""

    direction: str
    of_robot: bool


def _read_passing_side(reader: TokenReader) -> _PassingSide | None:
    """Read the side after an object that is passed; return None if there is no such phrase."""
    token, at = reader.peek(), reader.at
    if _is_passing_side(reader):
        reader.at += 1
        # "on your left", "on the robot's left"; but "on the left" is a side of the object.
        of_robot = token.text.split()[1] != "the" or "robot" in token.text
        return _PassingSide(token.kind.removeprefix("on the "), of_robot)
    if reader.take("to") and reader.take("article"):
        side = _read_own_side(reader)
        if side and not reader.is_at("word"):
            return _PassingSide(side, reader.tokens[at + 1].text in ("your", "my"))
    reader.at = at
    return None


def _is_passing_side(reader: TokenReader) -> bool:
    """Return True if a side ends the phrase here, and is not a side of the road."""
    ends = not reader.is_at(*_PLACES, *_ORDER, "at", "which is", ahead=1)
    of_road = reader.peek().text.endswith((" road", " street"))
    return ends and reader.is_at("on the left", "on the right") and not of_road


def _object_of_last_step(
    scene: Scene | _UnseenScene,
    before: Sequence[InstructionStep],
    reader: TokenReader,
    token: Token,
) -> SceneObject:
    """Return the only object of the previous step, for which `it` or `its` stands."""
    if not before or len(before[-1].things) != 1:
        reader.refuse("it is not clear what this stands for; name the object", token)
    if isinstance(scene, _UnseenScene):
        scene.refers = True
    return before[-1].things[0]


def _read_two_objects(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep]
) -> tuple[SceneObject, ...]:
    """Read `the van and the tree`, `the two cars` or `the cars`."""
    start = reader.peek()
    if reader.is_at("article") and reader.is_at("number", ahead=1) and reader.peek(1).text == "2":
        reader.at += 2
    found = _read_objects(reader, scene, before)
    if reader.take("and"):
        found = [_only_one(found, reader, start), _read_object(reader, scene, before)]
        if found[0] is found[1]:
            reader.refuse("this is the same thing twice; name two", start)
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


class AmbiguousObjectError(TranslationError):
    """A name that fits several objects.

    Attributes:
        things: ids of these objects.
    """

    def __init__(self, message: str, part: str, position: int, things: tuple[int, ...]) -> None:
        super().__init__(message, part, position)
        self.things = things


def _read_object(
    reader: TokenReader, scene: Scene | _UnseenScene, before: Sequence[InstructionStep]
) -> SceneObject:
    """Read a noun phrase and return the only object that it names."""
    start = reader.peek()
    return _only_one(_read_objects(reader, scene, before), reader, start)


def _only_one(found: list[SceneObject], reader: TokenReader, start: Token) -> SceneObject:
    """Return the only object found; raise AmbiguousObjectError if there are several."""
    if len(found) > 1:
        listed = ", ".join(map(object_name, found[:4])) + (", …" if len(found) > 4 else "")
        hint = f"it may be any of {len(found)}: {listed}; say which, as 'the nearest' or 'object 3'"
        try:
            reader.refuse(hint, start)
        except TranslationError as error:
            things = tuple(thing.id for thing in found)
            raise AmbiguousObjectError(str(error), error.part, error.position, things) from None
    return found[0]


def _read_objects(
    reader: TokenReader,
    scene: Scene | _UnseenScene,
    before: Sequence[InstructionStep],
    is_passed: bool = False,
) -> list[SceneObject]:
    """Read a noun phrase and return the objects that it may mean, at least one.

    If `is_passed` is True, a side at the end is left to the caller, because the object is passed.
    Words that choose an object, such as "nearest" and "second", are kept as `choosers`.
    """
    start = reader.peek()
    if token := reader.take("pronoun"):
        return [_object_of_last_step(scene, before, reader, token)]
    reader.skip("article")
    choosers, words = [], []
    while token := _read_word(reader, bool(words)):
        if token.kind == "id":
            return [_read_by_number(reader, scene, words, choosers)]
        if token.kind != "word":
            choosers.append(token)
            continue
        if token.text.endswith("'s") and _is_own_side(reader):
            words.append(replace(token, text=token.text.removesuffix("'s")))
            break
        words.append(token)
    if words and reader.is_at("number"):
        return [_read_by_number(reader, scene, words, choosers)]
    if not _is_name(words):
        reader.refuse("expected the name of a thing", start)
    unseen = isinstance(scene, _UnseenScene)
    found = (
        [scene.thing(words)]
        if unseen
        else _objects_described(_objects_named(reader, scene, words), reader, words)
    )
    origin = _read_origin(reader, scene, before, choosers)
    words_before_that_is, after_that_is = list(choosers), False
    while (after_that_is or not (is_passed and _is_passing_side(reader))) and (
        token := reader.take(*_PLACES, "at", *_ORDER, "which is")
    ):
        if not after_that_is:
            words_before_that_is.append(token)
        if token.kind == "which is":
            at, found = reader.at, _read_that_is(found, reader, scene)
            after_that_is = reader.at == at  # no description: a place or an order must follow
            continue
        after_that_is = False
        if token.kind in _ORDER:
            choosers.append(token)
            origin = origin or _read_origin(reader, scene, before, [token])
            continue
        other = _read_object(reader, scene, before) if token.kind == "at" else None
        if unseen:
            continue
        if other is not None:
            found = _filtered(
                found, lambda t, o=other: t is not o and _gap_m(scene, t, o) <= NEAR_M
            )
        else:
            found = _filtered(found, lambda t, k=token.kind: _PLACES[k](_bearing_rad(scene, t)))
        if not found:
            reader.refuse("no such thing is there", token)
    for token in words_before_that_is if is_passed else ():
        if token.kind in ("leftmost", "rightmost") and token.text.startswith(_SIDE_OPENERS):
            side = token.kind.removesuffix("most")
            hint = f"say 'past the {side} of …', or 'the {token.kind} …'"
            reader.refuse(
                f"it may say which one is meant, or on which side to pass it; {hint}", token
            )
    for token in choosers:
        if token.kind.startswith("from the") and not any(t.kind in _COUNTS for t in choosers):
            reader.refuse(f"say which, as 'second {token.text}'", token)
    return found if unseen else _choose(found, reader, scene, choosers, origin)


_SIDE_OPENERS = ("on ", "to ", "at ")
"""First words of "on the far left"; a bare "far left" has none of them."""
_COUNTS = ("ordinal", "first")
"""Kinds of words that count: "from the left" needs one, as in "second from the left"."""


def _read_word(reader: TokenReader, has_name: bool) -> Token | None:
    """Read the next word of a noun phrase: part of the name, or a word that chooses an object.

    `has_name` is True after a word of the name. A word that is also a verb or a unit belongs to the
    name before another word ("the stop sign"), or if nothing else can be meant ("the shower head",
    "the parking meter").
    """
    token = reader.peek()
    begins = reader.is_at("word", ahead=1)
    if (begins and token.kind in ("go", "stop", "pass", "metres", "ground")) or (
        has_name and token.kind in ("go", "stop", "metres", "ground")
    ):
        reader.at += 1
        return replace(token, kind="word")
    if token.text in _NO_NAMES:
        return None
    if has_name and not begins and reader.is_at("left", "right"):
        reader.refuse(
            f"say 'the {token.text} …', '… on the {token.text}' or 'the {token.text} of …'"
        )
    return reader.take("word", "ordinal", "first", "left", "right", *_ORDER, "id")


_NO_NAMES = ("not", "or", "nor", "but", "no", "except", "unless", "until", "instead", "never")
"""Words that change the request and describe no object."""


def _is_own_side(reader: TokenReader) -> bool:
    """Return True if a side follows that is no part of a name: `the van's left`, no `left door`."""
    beyond = reader.peek(1)
    own = beyond.kind != "word" or beyond.text in ("hand", "side")
    return reader.is_at("left", "right") and own


def _read_that_is(
    found: list[SceneObject], reader: TokenReader, scene: Scene | _UnseenScene
) -> list[SceneObject]:
    """Read the words after `that is`: a description, unless a place follows."""
    words = []
    while reader.is_at("word") and reader.peek().text not in _NO_NAMES:
        words.append(reader.take("word"))
    if not words and not reader.is_at(*_PLACES, "at", *_ORDER):
        reader.refuse("expected what it is like, or where it is")
    return found if isinstance(scene, _UnseenScene) else _objects_described(found, reader, words)


def _read_origin(
    reader: TokenReader,
    scene: Scene | _UnseenScene,
    before: Sequence[InstructionStep],
    choosers: Sequence[Token],
) -> SceneObject | None:
    """Return the object of `nearest to the sign`, or None if the robot is meant."""
    at = reader.at
    if not any(token.kind in ("nearest", "farthest") for token in choosers) or _read_passing_side(
        reader
    ):
        reader.at = at  # "the nearest tree to the left"
        return None
    return _read_object(reader, scene, before) if reader.take("to", "from") else None


def _read_by_number(
    reader: TokenReader, scene: Scene | _UnseenScene, words: list[Token], choosers: Sequence[Token]
) -> SceneObject:
    """Return the object with the number that comes next; the words before must fit the object."""
    start = reader.peek()
    token = reader.take("number")
    if token is None:
        reader.refuse("say its number", start)
    if choosers:
        reader.refuse("this chooses the object in two ways; say only one", choosers[0])
    if isinstance(scene, _UnseenScene):
        return scene.thing(words)
    thing = scene.objects.get(int(token.text)) if token.text.isdecimal() else None
    if thing is None:
        reader.refuse(f"no object has that number; there are {_labels_text(scene)}", start)
    if words and thing not in _objects_described(
        _objects_named(reader, scene, words), reader, words
    ):
        reader.refuse(f"that is the number of {object_name(thing)}", start)
    return thing


def _objects_named(reader: TokenReader, scene: Scene, words: list[Token]) -> list[SceneObject]:
    """Return the objects whose kind is named by the longest possible end of `words`.

    The words before that end stay in `words`, because they describe the object.
    """
    for begin in range(len(words)):
        if kinds := _objects_of_kind(scene, words[begin:]):
            del words[begin:]
            return kinds
    # No object has such a name. If fewer words are a name, the next word is the wrong one.
    for end in range(len(words) - 1, 0, -1):
        if any(_objects_of_kind(scene, words[begin:end]) for begin in range(end)):
            reader.refuse(f"unknown word after {words[end - 1].text!r}", words[end])
    reader.refuse(f"no object here has that name; there are {_labels_text(scene)}", words[0])


def _is_name(words: Sequence[Token]) -> bool:
    return names.is_name(" ".join(token.text for token in words))


def _objects_of_kind(scene: Scene, words: Sequence[Token]) -> list[SceneObject]:
    if not _is_name(words):
        return []
    name = " ".join(token.text for token in words)
    return _filtered(
        list(scene.objects.values()), lambda thing: names.is_kind_of(thing.label, name)
    )


def _objects_described(
    found: list[SceneObject], reader: TokenReader, words: Sequence[Token]
) -> list[SceneObject]:
    """Return the objects that every word describes."""
    for token in words:
        fitting = _filtered(found, lambda t, word=token.text: word in _caption_words(t))
        if not fitting:
            hint = f"this word describes none of them: {', '.join(map(object_name, found[:4]))}"
            reader.refuse(hint, token)
        found = fitting
    return found


def _choose(
    found: list[SceneObject],
    reader: TokenReader,
    scene: Scene,
    choosers: Sequence[Token],
    origin: SceneObject | None,
) -> list[SceneObject]:
    """Return the objects that sides, an order and a number choose, as seen from the robot.

    `nearest` and `farthest` are measured from `origin`; None: from the robot.
    """
    order: Token | None = None  # "nearest", "leftmost", …
    number: Token | None = None  # "first", "second", …
    for token in choosers:
        if token.kind in ("left", "right"):
            side = _PLACES[f"on the {token.kind}"]
            kept = _filtered(found, lambda t, side=side: side(_bearing_rad(scene, t)))
            if not kept:
                _none_there(found, reader, token)
            found = kept
            continue
        is_order = token.kind in _ORDER
        if (order if is_order else number) is not None:
            reader.refuse("this chooses the object in two ways; say only one", token)
        if is_order:
            order = token
        else:
            number = token
    if order is None and number is None:
        return found
    place = int(number.text) - 1 if number and number.kind == "ordinal" else 0
    kind = order.kind if order else "nearest"
    found = [thing for thing in found if thing is not origin]
    if kind not in ("nearest", "farthest"):
        ahead = _filtered(found, lambda t: abs(_bearing_rad(scene, t)) < math.pi / 2)
        found = ahead or found  # "from left to right" counts the objects in view
    if origin is not None:
        away_m = {t.id: _gap_m(scene, t, origin) for t in found}
        found = sorted(found, key=lambda t: away_m[t.id] * (-1.0 if kind == "farthest" else 1.0))
    else:
        found = sorted(found, key=lambda t: _ORDER[kind](scene, t))
    if not 0 <= place < len(found):
        _none_there(found, reader, number or order)
    return [found[place]]


def _none_there(found: list[SceneObject], reader: TokenReader, token: Token | None) -> NoReturn:
    there = ", ".join(map(object_name, found[:4])) or "no others"
    reader.refuse(f"there is no such object; there are {there}", token)


def centre_m(thing: SceneObject) -> tuple[float, float]:
    """Return the centre of an object on the ground, (x, y) in `map`."""
    x, y = thing.position_m[:2].tolist()
    return x, y


def _distance_m(scene: Scene, thing: SceneObject) -> float:
    return scene.pose.distance_to(*centre_m(thing))


def _bearing_rad(scene: Scene, thing: SceneObject) -> float:
    return scene.pose.bearing_to(*centre_m(thing))


def _gap_m(scene: Scene, a: SceneObject, b: SceneObject) -> float:
    """Return the distance between the outlines of two objects."""
    cells_m = outline_of(b, scene.occupancy).cells_m
    return float(outline_of(a, scene.occupancy).gaps_m(cells_m).min())


def _filtered(found: list[SceneObject], keep: Callable[[SceneObject], bool]) -> list[SceneObject]:
    return [thing for thing in found if keep(thing)]


def _caption_words(thing: SceneObject) -> set[str]:
    return set(re.findall(r"[^\W_]+", f"{thing.label} {thing.caption}".lower()))


def object_name(thing: SceneObject) -> str:
    """Return an object's label, id and caption, to distinguish it from others."""
    caption = one_line(thing.caption, 40)
    return f"{thing.label} {thing.id}" + (f" ({caption})" if caption else "")


def _labels_text(scene: Scene) -> str:
    labels = dict.fromkeys(thing.label for thing in scene.objects.values())
    return one_line(", ".join(labels), 120) or "no objects"


_PLACES: dict[str, Callable[[float], bool]] = {
    "on the left": lambda bearing_rad: bearing_rad > SIDE_RAD,
    "on the right": lambda bearing_rad: bearing_rad < -SIDE_RAD,
    "straight": lambda bearing_rad: abs(bearing_rad) < AHEAD_RAD,
    "here ahead": lambda bearing_rad: abs(bearing_rad) < AHEAD_RAD,
    "here behind": lambda bearing_rad: abs(bearing_rad) > math.pi - AHEAD_RAD,
}
"""Kind of phrase → function that returns True if an object at this bearing is meant."""
_ORDER: dict[str, Callable[[Scene, SceneObject], float]] = {
    "nearest": lambda scene, thing: _distance_m(scene, thing),
    "farthest": lambda scene, thing: -_distance_m(scene, thing),
    "leftmost": lambda scene, thing: -_bearing_rad(scene, thing),
    "rightmost": lambda scene, thing: _bearing_rad(scene, thing),
    "from the left": lambda scene, thing: -_bearing_rad(scene, thing),
    "from the right": lambda scene, thing: _bearing_rad(scene, thing),
}
"""Kind of phrase → sort key of the objects; the first is meant, or the one of a number."""
_CHOSEN_BY_SIDE = {*_PLACES, *_ORDER, "left", "right"} - {"nearest", "farthest"}
"""Kinds of words that choose an object by where it is seen from the robot."""

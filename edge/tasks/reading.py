"""Parser of instructions: a small grammar reads them as steps.

    task   = step { ("then" | "and" | "," | ".") step } ["stop" ["there"]]
    step   = go ("to" | "near" | …) thing ["'s" side | "from behind" | gap] | "approach" thing
           | (go "past" | "pass" | go "around") [side "of"] thing [on its side | "'s" side | aside]
           | ("circle" | go "around" thing "once") [("counter")"clockwise"]
           | (go "along" | "follow") thing | go "halfway to" thing
           | ("leave" | "keep" | "with") thing aside
           | go (side "of" | "in front of" | "behind") thing | go "to its" side
           | go "between" (thing "and" thing | "the two" things)
           | go "straight" (distance | "until you reach" thing) | go distance "straight"
           | "turn" (side | "around") [angle] ["at" thing]
           | go "onto" ground | "cross" ground
           | "stop" ("at" | side "of" | "in front of" | "behind" | "between" …) thing
           | "stop" distance ("before" | "behind" | side "of") thing
    limit  = "avoid" (thing | ground) | "keep to" ground, anywhere between steps
    gap    = "but stay" distance "away" | "and stop" distance "before it"
    distance = (number ["and a half"] | "half a" | "a") "metres" ["and a half"]

`edge.tasks.object_phrases` reads a thing and an aside; the words are in `edge.tasks.phrases`.
`_read_step` reads a step, `_read_limits` a limit, `_read_distance_m` a distance.

A clause may depend on another ("after passing …", "before you …", see `edge.tasks.clauses`). Words
in double quotes can only name or describe an object.

If the robot passes an object "on your left", the object is on the robot's left. If it passes "on
the left", the robot is on the left side of the object. If "on the left" may also choose the object,
the instruction is refused. "Straight" without a distance ends level with the next step's object.
After a turn, sides are as the robot sees them then; if that is not known yet, they are refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import takewhile

from edge.geometry import SE2
from edge.mission.language.tokens import Token, TokenReader, TranslationError
from edge.mission.task_step import TaskStep
from edge.tasks.clauses import list_in_order, order_clauses
from edge.tasks.object_phrases import (
    CHOSEN_BY_SIDE,
    UnseenScene,
    object_of_last_step,
    only_one,
    read_object,
    read_objects,
    read_own_side,
    read_passing_side,
)
from edge.tasks.phrases import ground_kind, tokenise
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.steps import InstructionStep, Kind, RouteLimits


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
        lambda n: scene if n is None or _is_selected(n, step_slice) else UnseenScene(),
    )
    return steps[step_slice]


def route_limits(instruction: str, scene: Scene) -> RouteLimits:
    """Parse the restrictions of the path alone; the objects of steps need not be in the scene.

    Raises:
        TranslationError: the instruction is not understood; the error names the part.
    """
    steps = _read_steps(instruction, lambda n: scene if n is None else UnseenScene())
    return steps[0].limits


def _is_selected(n: int, step_slice: slice) -> bool:
    """Return True if a slice selects step n. The slice counts from the start: no negative ends."""
    return n in range(n + 1)[step_slice]


def _read_steps(
    instruction: str, scene_for: Callable[[int | None], Scene | UnseenScene]
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
            start = start if steps else reader.peek()
            continue
        if steps and start.kind == "stop":
            reader.refuse("the robot stops here; no step can follow", start)
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
    scene: Scene | UnseenScene,
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
        found = read_objects(reader, scene, before)
        return replace(limits, avoid=(*limits.avoid, *found))
    if token.kind == "keep to":
        reader.refuse("say the kind of ground, as 'keep to the road'")
    reader.at = at
    return None


class UnseenGroundError(TranslationError):
    """A kind of ground that the scene does not have.

    Attributes:
        kind: the kind; see `edge.tasks.phrases.GROUNDS`.
    """

    def __init__(self, message: str, part: str, position: int, kind: str) -> None:
        super().__init__(message, part, position)
        self.kind = kind


def _read_ground(reader: TokenReader, scene: Scene | UnseenScene) -> str:
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


def _read_turn(
    reader: TokenReader,
    scene_for: Callable[[int | None], Scene | UnseenScene],
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
    thing = read_object(reader, scene, before)
    scene_for(len(before) + 1)  # the turn is a step of its own
    return [InstructionStep("to", (thing,)), turn]


def _turned(scene: Scene | UnseenScene, before: Sequence[InstructionStep]) -> Scene | UnseenScene:
    """Return the scene as the robot sees it after the turns with which the instruction begins."""
    if isinstance(scene, UnseenScene):
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
        if token.kind in CHOSEN_BY_SIDE:
            reader.refuse("after a turn it is not clear which this is; name the object", token)


def task_steps(instruction: str) -> tuple[TaskStep, ...]:
    """Parse the steps of an instruction by its grammar alone, before any object was seen.

    Names are nouns in the singular; a repeated name keeps its first spelling. Words before the
    noun only describe the object and are left out.

    Raises:
        TranslationError: the instruction is not understood; the error names the part.
    """
    unseen: list[UnseenScene] = []
    avoided = UnseenScene()

    def scene_for(number: int | None) -> UnseenScene:
        if number is None:
            return avoided
        unseen.append(UnseenScene())
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
            unseen[n].refers or _begins_turned(steps, n),
        )
        for n, step in enumerate(steps)
    )


def _begins_turned(steps: Sequence[InstructionStep], n: int) -> bool:
    """Return True if step n depends on the heading at the end of the step before it."""
    kinds = [step.kind for step in steps[max(n - 1, 0) : n + 1]]
    return n > 0 and (kinds[1] == "turn" or kinds == ["turn", "straight"])


def _ends_at_next(step: InstructionStep) -> bool:
    """Return True if the end of a step depends on the object of the next step."""
    return step.kind in ("around", "along") or (step.kind == "straight" and not step.distance_m)


def named_objects(instruction: str) -> tuple[str, ...]:
    """Return the names in an instruction, each object once; see `task_steps`.

    >>> named_objects("pass the van on its left, then go to the red car")
    ('van', 'car')
    """
    return tuple(dict.fromkeys(name for step in task_steps(instruction) for name in step.names))


def _read_step(
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
            if relation.kind == "to" and (ground := _read_ground(reader, scene)):
                return InstructionStep("onto", ground=ground)
            return _read_destination(reader, scene, before)
        case "its left" | "its right":
            return InstructionStep(
                "next to",
                (object_of_last_step(scene, before, reader, relation),),
                _SIDE_OF[relation.kind],
            )
    thing = read_object(reader, scene, before)
    return InstructionStep("next to", (thing,), _SIDE_OF.get(relation.kind, relation.kind))


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
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read `follow the fence`: only long things that do not move can be followed."""
    reader.skip("article")
    start, begin = reader.peek(), reader.at
    thing = read_object(reader, scene, before)
    words = takewhile(lambda token: token.kind == "word", reader.tokens[begin : reader.at])
    *_, noun = ("", *(token.text for token in words))
    if noun not in _LONG_THINGS:
        reader.refuse("this cannot be followed; say 'go past …' or 'go to …'", start)
    return InstructionStep("along", (thing,))


def _read_onto(reader: TokenReader, scene: Scene | UnseenScene, kind: Kind) -> InstructionStep:
    """Read `the grass` of "onto the grass" and "across the grass"."""
    start = reader.peek()
    ground = _read_ground(reader, scene)
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
    thing = read_object(reader, scene, before)
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
        return InstructionStep("next to", (thing,), side)
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
    scene: Scene | UnseenScene,
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
        thing = read_object(reader, scene, before)
        return InstructionStep("next to", (thing,), side, distance_m)
    reader.refuse("say in which direction, as '3 metres straight on'")


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
_STOPPED_AT = ("to", "next to", "between", "straight")
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
    if reader.peek().text == "once" and reader.is_at("end", *_JOINTS, ahead=1):
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
    said, aside = reader.peek(), read_passing_side(reader)
    if aside is None or reader.is_at("its left", "its right"):
        if aside is not None:  # "the car on the left on its right": the first side chooses the car
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
    side = OTHER_SIDE[aside.direction] if aside.of_robot else aside.direction
    differs = isinstance(scene, Scene) and bool(on_that_side) and on_that_side[0] is not found[0]
    if len(found) > 1 or differs:
        reader.refuse(
            f"it may say which one is meant, or on which side to pass it; say '{kind} the {side} "
            f"of …', or '… that is on the {aside.direction}'", said,
        )  # fmt: skip
    return InstructionStep(kind, (found[0],), side)


def _read_leaving(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> InstructionStep:
    """Read `leave the van on your left`: the robot passes its right."""
    start = reader.peek()
    thing = only_one(read_objects(reader, scene, before, is_passed=True), reader, start)
    aside = read_passing_side(reader)
    if aside is None:
        reader.refuse("say on which side, as 'on your left'", start)
    return InstructionStep("past", (thing,), OTHER_SIDE[aside.direction])


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

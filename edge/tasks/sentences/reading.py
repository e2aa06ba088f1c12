"""Parser of instructions: a small grammar reads them as steps.

    task   = step { ("then" | "and" | "," | ".") step } ["stop" ["there"]]
    step   = go ("to" | "near" | …) object ["'s" side | "from behind" | gap] | "approach" object
           | (go "past" | "pass" | go "around") [side "of"] object
             [on its side | "'s" side | passing]
           | ("circle" | go "around" object "once") [("counter")"clockwise"]
           | (go "along" | "follow") object | go "halfway to" object
           | ("leave" | "keep" | "with") object passing
           | go (side "of" | "in front of" | "behind") object | go "to its" side
           | go "between" (object "and" object | "the two" objects)
           | go "straight" (distance | "until you reach" object) | go distance "straight"
           | "turn" (side | "around") [angle] ["at" object]
           | go "onto" ground | "cross" ground
           | "stop" ("at" | side "of" | "in front of" | "behind" | "between" …) object
           | "stop" distance ("before" | "behind" | side "of") object
    limit  = "avoid" (object | ground) | "keep to" ground, anywhere between steps
    gap    = "but stay" distance "away" | "and stop" distance "before it"
    distance = (number ["and a half"] | "half a" | "a") "metres" ["and a half"]

`object_phrases` reads objects and passing sides; the words are in `phrases`. `step_phrases` reads
a step and a distance, `_read_limits` a limit.

A clause may depend on another ("after passing …", "before you …", see `clauses`). Words
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
from itertools import groupby

from edge.geometry import SE2
from edge.mission.language.words.tokens import TokenReader
from edge.mission.task_step import TaskStep
from edge.tasks.scene.scene import Scene
from edge.tasks.sentences.clauses import list_in_order, order_clauses
from edge.tasks.sentences.object_phrases import (
    CHOSEN_BY_SIDE,
    UnseenScene,
    read_object,
    read_objects,
)
from edge.tasks.sentences.phrases import tokenise
from edge.tasks.sentences.step_phrases import (
    JOINTS,
    PASSED,
    RELATIONS,
    STOPPED_AT,
    check_joined,
    read_ground,
    read_step,
)
from edge.tasks.sentences.steps import InstructionStep, RouteLimits

_TURN_SIDES = {
    "left": "left", "right": "right", "on the left": "left", "on the right": "right",
    "counterclockwise": "left", "clockwise": "right",
}  # fmt: skip
"""Kind of token → side of a turn."""
_ONLY_OF_PATHS = (
    "past", "along", "around", "between", "left of", "right of", "in front of", "behind",
    "straight", "circle", "halfway",
)  # fmt: skip
"""Kinds of words that missions do not have."""
LIMITS = ("avoid", "keep to")
"""Kinds of words that restrict the entire path."""


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
        instruction, lambda n: scene if n is None or _is_selected(n, step_slice) else UnseenScene()
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
        if steps and start.kind in RELATIONS:
            check_joined(reader, steps[-1], verb)
        found = _read_turn(reader, scene_for, steps) or [
            read_step(reader, _turned(scene_for(len(steps)), steps), steps)
        ]
        said = instruction[start.start : reader.peek(-1).end]
        if found[0].objects:
            _check_sides(reader, begin, steps)
        steps += [replace(step, said=said) for step in found]
        _end_step(reader, *(("to", "until") if found[-1].kind in PASSED else ()))
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
    if not reader.is_at("end", *JOINTS, *LIMITS, *more):
        reader.refuse("not known here; a step ends with 'then', 'and' or a comma")
    first_joint = reader.at
    reader.skip(*JOINTS, "filler", "first")
    for joint in reader.tokens[first_joint : reader.at]:
        if joint.kind in ("then", "and") and reader.is_at("end"):
            reader.refuse("no step follows", joint)


def _with_distances(reader: TokenReader, steps: list[InstructionStep]) -> list[InstructionStep]:
    """Return the steps, with an end for each "straight" without one: the next step's object."""
    done = []
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        if step.kind == "straight" and not (step.objects or step.distance_m):
            if following is None or following.kind != "to":
                start = next(t for t in reader.tokens if t.kind == "straight")
                reader.refuse("say how far, as 'straight for 5 metres'", start)
            step = replace(step, objects=following.objects)
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
    token = reader.take(*LIMITS, "follow", "along")
    if token is None:
        reader.at = at
        return None
    ground = read_ground(reader, scene)
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
    if before and before[-1].kind in STOPPED_AT:
        reader.take("there")
    if not reader.take("at"):
        return [turn]
    obj = read_object(reader, scene, before)
    scene_for(len(before) + 1)  # the turn is a step of its own
    return [InstructionStep("to", (obj,)), turn]


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


def describes_path(instruction: str) -> bool:
    """Return True if an instruction says how to drive: a turn, a side, a distance, a way around.

    Raises:
        TranslationError: the instruction is not understood.

    >>> describes_path("go past the van, then to the car"), describes_path("go to the van")
    (True, False)
    """
    steps = _read_steps(instruction, lambda number: UnseenScene())
    return any(step.kind != "to" or step.side or step.distance_m for step in steps)


def noun_phrases(instruction: str) -> list[list[str]]:
    """Return the words that name objects, without articles.

    >>> noun_phrases("turn left at the red sofa, then go past the bed")
    [['red', 'sofa'], ['bed']]
    """
    runs = groupby(tokenise(instruction), key=lambda token: token.kind == "word")
    return [[token.text for token in run] for is_name, run in runs if is_name]


def begins_with_path_word(text: str) -> bool:
    """Return True if a text begins with a word about paths: "left", "past the sofa"."""
    return tokenise(text)[0].kind in (*_TURN_SIDES, *_ONLY_OF_PATHS)

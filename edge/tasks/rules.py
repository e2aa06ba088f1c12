"""Planner `rules`: instructions that a small grammar knows, turned into the calls that a model's
script would make. No server, and nothing is guessed.

    task   = step { ("then" | "and" | "," | ".") step } ["stop"]
    step   = go ("to" | "near" | …) thing
           | (go "past" | "pass" | go "around") [side "of"] thing [on its side]
           | go (side "of" | "in front of" | "behind") thing
           | go "between" (thing "and" thing | "the two" things)
           | go "straight" number "metres"
           | "stop" ("at" | side "of" | "in front of" | "behind" | "between" …) thing
    thing  = [article] { which | description } name [place] | "object" number | "it"
    which  = "second" | "nearest" | "farthest" | "left" | "right" | "leftmost" | "rightmost"
    place  = "on the left" | "on the right" | "ahead" | "behind you" | "near" thing

Which thing is meant is told from where the robot stands when it is asked, as its user sees it. The
sides of a thing are those that the robot sees as it comes to it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.mission.language.words import Reader, Token
from edge.tasks.functions import BESIDE_M, SIDES_RAD, CallError, Functions, Point
from edge.tasks.outline import outline_of
from edge.tasks.phrases import tokenise
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.trajectory import TrajectoryError
from edge.text import one_line

ASIDE_RAD = math.radians(5)
"""What is nearer to straight ahead is neither on the left nor on the right."""
AHEAD_RAD = math.radians(45)
NEAR_M = 3.0
SNAP_M = 1.0
"""How far a point of a way may be moved to where the robot can be."""
BEYOND_RAD = math.radians(45)
"""A thing is past when it is so far behind the side that the robot passes it on."""

Kind = Literal["to", "past", "around", "beside", "between", "straight", "stop"]


@dataclass(frozen=True, slots=True)
class Step:
    """One part of an instruction.

    Attributes:
        things: two of "between", none of "straight" and a mere "stop", else one.
        side: of `edge.tasks.functions.SIDES_RAD`; "" where none is said.
        distance_m: of "straight".
        said: its part of the instruction.
    """

    kind: Kind
    things: tuple[SceneObject, ...] = ()
    side: str = ""
    distance_m: float = 0.0
    said: str = ""

    def __str__(self) -> str:
        called = " and ".join(f"{thing.label} {thing.id}" for thing in self.things)
        match self.kind:
            case "straight":
                return f"straight on for {self.distance_m:g} m"
            case "past" | "around" if self.side:
                return f"{self.kind} the {self.side} of {called}"
            case "beside":
                return f"{self.side}{_OF.get(self.side, '')} {called}"
        return f"{self.kind} {called}".strip()


def carry_out(instruction: str, functions: Functions) -> str:
    """Hand over the trajectory that an instruction asks for.

    Returns:
        What was understood, in words that name the things by their numbers.

    Raises:
        TranslationError: the instruction is not understood; it names the part.
        TrajectoryError: it is understood, and cannot be done.
    """
    steps = read(instruction, functions.ground.scene)
    pose = functions.ground.scene.pose
    here, heading_rad = (pose.x_m, pose.y_m), pose.yaw_rad
    segments: list[list[Point]] = []
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        try:
            segments += _segment(step, following, SE2(*here, heading_rad), functions)
        except TrajectoryError as error:
            raise TrajectoryError(f"{one_line(step.said, 60)!r}: {error}") from None
        (x0, y0), (x1, y1) = ([here] + segments[-1])[-2:]
        here = segments[-1][-1]
        if (x0, y0) != (x1, y1):
            heading_rad = math.atan2(y1 - y0, x1 - x0)
    regions = {functions.region_at(at) for segment in segments for at in segment} - {0}
    functions.give_trajectory(segments, sorted(regions), heading_rad=_facing(steps[-1], here))
    return "; ".join(map(str, steps))


def _facing(last: Step, at: Point) -> float | None:
    """The direction in which the robot looks at the end: at what it was sent to."""
    if last.kind not in ("to", "beside") or at == _centre(last.things[0]):
        return None
    (x, y), (tx, ty) = at, _centre(last.things[0])
    return math.atan2(ty - y, tx - x)


def read(instruction: str, scene: Scene | _Unseen) -> list[Step]:
    """The steps of an instruction, at least one.

    Raises:
        TranslationError: it is not understood; it names the part.
    """
    reader = Reader(instruction, tokenise(instruction))
    steps: list[Step] = []
    reader.skip("filler", "first")
    while not reader.sees("end"):
        start = reader.peek()
        step = _step(reader, scene, steps)
        end = reader.peek(-1).end
        steps.append(replace(step, said=instruction[start.start : end]))
        if not reader.sees("end", "then", "and", "comma", "stop mark"):
            reader.refuse("not known here; a step ends with 'then', 'and' or a comma")
        joint = reader.peek()
        reader.skip("then", "and", "comma", "stop mark", "filler", "first")
        if joint.kind in ("then", "and") and reader.sees("end"):
            reader.refuse("nothing comes after it", joint)
        if start.kind == "stop" and not reader.sees("end"):
            reader.refuse("a way ends where the robot stops; nothing can come after it", start)
    if not steps:
        reader.refuse("say where to go")
    if steps[-1].kind != "stop":
        return steps
    if len(steps) == 1:
        reader.refuse("say where to go first", reader.tokens[0])
    return steps[:-1]


def named(instruction: str) -> tuple[str, ...]:
    """What an instruction names, before anything of it was seen: its grammar alone is read.

    Returns:
        Names as they are said, in the singular, each thing once: of words before a noun that is
        known, which only describe, nothing is left.

    Raises:
        TranslationError: it is not understood; it names the part.
    """
    unseen = _Unseen()
    read(instruction, unseen)
    return tuple(unseen.names.values())


@dataclass(frozen=True, slots=True)
class _Unseen:
    """In the place of a scene: each name that is read stands for one thing.

    Attributes:
        names: those that were read, by the one name of what they stand for.
    """

    names: dict[str, str] = field(default_factory=dict)

    def thing(self, words: Sequence[Token] = ()) -> SceneObject:
        """What words stand for; without any, whatever has some number."""
        if words:
            nouns = list(names.head_nouns(" ".join(token.text for token in words)))
            noun = names.singular(next(filter(names.is_known, nouns), nouns[0]))
            self.names.setdefault(names.canonical(noun), noun)
        return SceneObject(0, "", "", np.zeros(3), np.zeros(3), 0.0, np.empty((0, 3)), {})


def _step(reader: Reader, scene: Scene | _Unseen, before: Sequence[Step]) -> Step:
    verb = reader.take("go", "pass", "stop")
    reader.skip("first", "filler")
    if verb is None and not (before and reader.sees(*_RELATIONS)):
        reader.refuse("expected what to do: go to, drive past, around, between, stop at, …")
    if verb and verb.kind == "pass":
        return _passing(reader, scene, before, "past")
    relation = reader.take(*_RELATIONS)
    if relation is None:
        if verb and verb.kind == "stop":
            return Step("stop")
        reader.refuse("expected where: to, past, around, between, left of, straight, …")
    if verb and verb.kind == "go" and relation.text == "by":
        reader.refuse("it can be read in two ways; say 'past' or 'to'", relation)
    if verb and verb.kind == "stop" and relation.kind in ("past", "around", "straight"):
        reader.refuse("a robot cannot stop there; say 'at', 'left of', 'behind', …", relation)
    match relation.kind:
        case "past" | "around":
            return _passing(reader, scene, before, relation.kind)
        case "between":
            return Step("between", _two(reader, scene, before))
        case "straight" if reader.sees("to"):
            reader.refuse("a way that is straight to a thing is not known; say 'to'", relation)
        case "straight":
            return Step("straight", distance_m=_metres(reader))
        case "to" | "at":
            return Step("to", (_thing(reader, scene, before),))
    return Step(
        "beside", (_thing(reader, scene, before),), _SIDE_OF.get(relation.kind, relation.kind)
    )


_OF = {"left": " of", "right": " of"}
_SIDE_OF = {
    "left of": "left", "its left": "left", "right of": "right", "its right": "right",
}  # fmt: skip
_RELATIONS = (
    "to", "at", "past", "around", "between", "left of", "right of", "in front of", "behind",
    "straight",
)  # fmt: skip


def _passing(reader: Reader, scene: Scene | _Unseen, before: Sequence[Step], kind: Kind) -> Step:
    """`past the left of the van`, `around the van on its left`, `past the van`."""
    side = reader.take("left of", "right of")
    thing = _thing(reader, scene, before)
    side = side or reader.take("its left", "its right")
    return Step(kind, (thing,), _SIDE_OF[side.kind] if side else "")


def _two(reader: Reader, scene: Scene | _Unseen, before: Sequence[Step]) -> tuple[SceneObject, ...]:
    """`the van and the tree`, `the two cars`, `the cars`."""
    start = reader.peek()
    if reader.sees("article") and reader.sees("number", ahead=1) and reader.peek(1).text == "2":
        reader.at += 2
    found = _things(reader, scene, before)
    if reader.take("and"):
        found = [_only(found, reader, start), _thing(reader, scene, before)]
        if found[0] is found[1]:
            reader.refuse("it is the same thing twice", start)
    if len(found) != 2 and isinstance(scene, Scene):
        reader.refuse(f"there are {len(found)} of them; name two: 'between … and …'", start)
    return tuple(found)


def _metres(reader: Reader) -> float:
    reader.skip("for")
    start = reader.peek()
    token = reader.take("number")
    if token is None or not reader.take("metres"):
        reader.refuse("say how far, as 'straight for 5 metres'", start)
    return float(token.text)


def _thing(reader: Reader, scene: Scene | _Unseen, before: Sequence[Step]) -> SceneObject:
    """The one thing that the noun phrase here names."""
    start = reader.peek()
    return _only(_things(reader, scene, before), reader, start)


def _only(found: list[SceneObject], reader: Reader, start: Token) -> SceneObject:
    if len(found) > 1:
        listed = ", ".join(map(_called, found[:4])) + (", …" if len(found) > 4 else "")
        hint = f"it may be any of {len(found)}: {listed}; say which, as 'the nearest' or 'object 3'"
        reader.refuse(hint, start)
    return found[0]


def _things(reader: Reader, scene: Scene | _Unseen, before: Sequence[Step]) -> list[SceneObject]:
    """What the noun phrase here may mean, at least one thing."""
    start = reader.peek()
    if token := reader.take("pronoun"):
        if not before or len(before[-1].things) != 1:
            reader.refuse("it is not clear what this stands for; name it", token)
        return list(before[-1].things)
    reader.skip("article")
    which, words = [], []
    while token := reader.take("word", "ordinal", "first", *_WHICH, "id"):
        if token.kind == "id":
            return [_by_id(reader, scene, start)]
        (words if token.kind == "word" else which).append(token)
    if not words:
        reader.refuse("expected the name of a thing", start)
    if isinstance(scene, _Unseen):
        found = [scene.thing(words)]
        while token := reader.take(*_PLACES, "at"):
            if token.kind == "at":
                _thing(reader, scene, before)
        return found
    found = _described(_named(reader, scene, words), reader, words)
    while token := reader.take(*_PLACES, "at"):
        if token.kind == "at":
            other = _thing(reader, scene, before)
            found = _kept(found, lambda t, o=other: t is not o and _gap_m(scene, t, o) <= NEAR_M)
        else:
            found = _kept(found, lambda t, k=token.kind: _PLACES[k](_bearing_rad(scene, t)))
        if not found:
            reader.refuse("no such thing is there", token)
    for token in which:
        found = _chosen(found, reader, scene, token)
    return found


def _by_id(reader: Reader, scene: Scene | _Unseen, start: Token) -> SceneObject:
    token = reader.take("number")
    if isinstance(scene, _Unseen):
        return scene.thing() if token else reader.refuse("say its number", start)
    thing = scene.objects.get(int(token.text)) if token and token.text.isdecimal() else None
    if thing is None:
        reader.refuse(f"no object has that number; there are {_listed(scene)}", start)
    return thing


def _named(reader: Reader, scene: Scene, words: list[Token]) -> list[SceneObject]:
    """The things whose kind the longest possible end of some words names; the words that are left
    before it stay in `words`, as they describe."""
    for begin in range(len(words)):
        if kinds := _of_kind(scene, words[begin:]):
            del words[begin:]
            return kinds
    for end in range(len(words) - 1, 0, -1):
        if any(_of_kind(scene, words[begin:end]) for begin in range(end)):
            reader.refuse(f"no word that is known after {words[end - 1].text!r}", words[end])
    reader.refuse(f"nothing of that name is here; there are {_listed(scene)}", words[0])


def _of_kind(scene: Scene, words: Sequence[Token]) -> list[SceneObject]:
    name = " ".join(token.text for token in words)
    return _kept(list(scene.objects.values()), lambda thing: names.is_kind_of(thing.label, name))


def _described(
    found: list[SceneObject], reader: Reader, words: Sequence[Token]
) -> list[SceneObject]:
    """Those of which each word is said."""
    for token in words:
        fitting = _kept(found, lambda t, word=token.text: word in _words_of(t))
        if not fitting:
            hint = f"that is not said of any here: {', '.join(map(_called, found[:4]))}"
            reader.refuse(hint, token)
        found = fitting
    return found


def _chosen(
    found: list[SceneObject], reader: Reader, scene: Scene, token: Token
) -> list[SceneObject]:
    """Those that an ordinal or a side picks out, as the robot sees them."""
    if token.kind in ("left", "right"):
        kept = _kept(found, lambda t: _PLACES[f"on the {token.kind}"](_bearing_rad(scene, t)))
    else:
        by, place = _WHICH.get(token.kind, (_distance_m, 0))
        ordered = sorted(found, key=lambda thing: by(scene, thing))
        if token.kind == "ordinal":
            place = int(token.text) - 1
            ordered = ordered if 0 <= place < len(ordered) else []
        kept = ordered[place:][:1]
    if not kept:
        reader.refuse(f"there is none; there are {', '.join(map(_called, found[:4]))}", token)
    return kept


def _segment(
    step: Step, following: Step | None, here: SE2, functions: Functions
) -> list[list[Point]]:
    """The way of one step, in one segment from `here`."""
    at = (here.x_m, here.y_m)
    match step.kind:
        case "straight":
            end = here.ahead(step.distance_m)
            way = functions.line(at, end)
            blocked = next((p for p in way[1:] if not functions.is_free(p)), None)
            if blocked is not None:
                gone_m = math.dist(at, blocked)
                raise CallError(f"the way straight on is blocked after {gone_m:.1f} m")
            return [way]
        case "to":
            points = [functions.stopping_point(step.things[0].id, at)]
        case "beside":
            points = [_beside(step.things[0], step.side, at, functions)]
        case "between":
            middle = functions.ground.nearest(*_middle(step, functions), within_m=SNAP_M)
            if middle is None:
                raise CallError(f"{step} is no room for the robot")
            points = [middle]
        case _:
            return [_round(step, following, at, functions)]
    return [_through(at, points, functions)]


def _round(step: Step, following: Step | None, at: Point, functions: Functions) -> list[Point]:
    """Past a thing or around it; where no side is said, the shorter way."""
    ways, why = [], []
    for side in [step.side] if step.side else ["left", "right"]:
        try:
            ways.append(
                _through(at, _beside_points(step, following, at, side, functions), functions)
            )
        except TrajectoryError as error:
            why.append(str(error))
    if not ways:
        raise CallError(why[0])
    return min(ways, key=_length_m)


def _beside_points(
    step: Step, following: Step | None, at: Point, side: str, functions: Functions
) -> list[Point]:
    """Points on the arc past a side of a thing: past it till `BEYOND_RAD` behind that side, around
    it till what comes next, or its far side.

    The point at the side itself must be there, and on that side; others are left out where the
    robot cannot be.
    """
    thing = step.things[0]
    abeam = functions.offset(thing.id, side, BESIDE_M, at)
    end = functions.offset(thing.id, "behind", BESIDE_M, at)
    if step.kind == "around" and following and following.things not in ((), step.things):
        end = _centre(following.things[0])
    arc = functions.arc(thing.id, at, end, side, BESIDE_M)
    looking_rad = functions.heading(at, _centre(thing))
    points = [_beside(thing, side, at, functions)]
    k = min(range(len(arc)), key=lambda i: math.dist(arc[i], abeam))
    for point in arc[k + 1 :]:
        angle_rad = functions.heading(_centre(thing), point)
        behind_rad = abs(math.remainder(angle_rad - looking_rad, math.tau))
        if step.kind == "past" and behind_rad < math.pi / 2 - BEYOND_RAD - 1e-6:
            break
        snapped = functions.ground.nearest(*point, within_m=SNAP_M)
        if snapped is not None and functions.ground.faces(thing, snapped):
            points.append(snapped)
    return points


def _through(at: Point, points: Sequence[Point], functions: Functions) -> list[Point]:
    """The cheapest way through points."""
    way = [at]
    for point in points:
        way += functions.a_star_plan(way[-1], point)[1:]
    return way


def _beside(thing: SceneObject, side: str, seen_from: Point, functions: Functions) -> Point:
    """Where the robot can be on a side of a thing, with nothing in between: at `BESIDE_M` from it,
    or nearer."""
    looking_rad = functions.heading(seen_from, _centre(thing))
    for distance_m in (BESIDE_M, 0.6 * BESIDE_M, 0.3 * BESIDE_M):
        wanted = functions.offset(thing.id, side, distance_m, seen_from)
        found = functions.ground.nearest(*wanted, within_m=SNAP_M)
        if found is not None and functions.ground.faces(thing, found):
            away = SE2(*_centre(thing), looking_rad + SIDES_RAD[side])
            if abs(away.bearing_to(*found)) < math.pi / 2:
                return found
    raise CallError(f"there is no room for the robot {side}{_OF.get(side, '')} {_called(thing)}")


def _middle(step: Step, functions: Functions) -> Point:
    """Half way between the outlines of two things."""
    a, b = step.things
    angle_rad = functions.heading(_centre(a), _centre(b))
    (px, py) = functions.ground.outline(a).beside(angle_rad, 0.0)
    (qx, qy) = functions.ground.outline(b).beside(angle_rad + math.pi, 0.0)
    return 0.5 * (px + qx), 0.5 * (py + qy)


def _length_m(way: Sequence[Point]) -> float:
    return float(np.hypot(*np.diff(np.array(way), axis=0).T).sum())


def _centre(thing: SceneObject) -> Point:
    x, y = thing.position_m[:2].tolist()
    return x, y


def _distance_m(scene: Scene, thing: SceneObject) -> float:
    return scene.pose.distance_to(*_centre(thing))


def _bearing_rad(scene: Scene, thing: SceneObject) -> float:
    return scene.pose.bearing_to(*_centre(thing))


def _gap_m(scene: Scene, a: SceneObject, b: SceneObject) -> float:
    """Between the outlines of two things."""
    cells_m = outline_of(b, scene.occupancy).cells_m
    return float(outline_of(a, scene.occupancy).gaps_m(cells_m).min())


def _kept(found: list[SceneObject], keep: Callable[[SceneObject], bool]) -> list[SceneObject]:
    return [thing for thing in found if keep(thing)]


def _words_of(thing: SceneObject) -> set[str]:
    return set(re.findall(r"[^\W_]+", f"{thing.label} {thing.caption}".lower()))


def _called(thing: SceneObject) -> str:
    said = one_line(thing.caption, 40)
    return f"{thing.label} {thing.id}" + (f" ({said})" if said else "")


def _listed(scene: Scene) -> str:
    labels = dict.fromkeys(thing.label for thing in scene.objects.values())
    return one_line(", ".join(labels), 120) or "no things"


_PLACES: dict[str, Callable[[float], bool]] = {
    "on the left": lambda bearing_rad: bearing_rad > ASIDE_RAD,
    "on the right": lambda bearing_rad: bearing_rad < -ASIDE_RAD,
    "straight": lambda bearing_rad: abs(bearing_rad) < AHEAD_RAD,
    "here ahead": lambda bearing_rad: abs(bearing_rad) < AHEAD_RAD,
    "here behind": lambda bearing_rad: abs(bearing_rad) > math.pi - AHEAD_RAD,
}
"""Kind of phrase → whether what lies in that direction from the robot is meant."""
_WHICH: dict[str, tuple[Callable[[Scene, SceneObject], float], int]] = {
    "nearest": (_distance_m, 0),
    "farthest": (_distance_m, -1),
    "leftmost": (_bearing_rad, -1),
    "rightmost": (_bearing_rad, 0),
    "left": (_bearing_rad, 0),
    "right": (_bearing_rad, 0),
}
"""Kind of phrase → by what the things are sorted, and the place in that order."""

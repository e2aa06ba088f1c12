"""Parser of the objects that an instruction names: `the second car on the left`, `it`, `object 3`.

    object  = [article] { description } name { place } | "it"
            | "object" number | [article] { description } name ["number"] number
              with `chooser` anywhere before the places
    chooser = order | "second" | "left" | "right"
    order   = ("nearest" | "farthest") ["to" object] | "leftmost" | "rightmost"
            | "second from the left"
    place   = "on the left" | "on the right" | "ahead" | "behind you" | "near" object
            | order | "that is" (description | place)
    passing = "on the left" | "on your left" | …

`read_objects` reads an object, `_read_word` a chooser, and `read_passing_side` the side on
which an object is passed. `edge.tasks.sentences.reading` reads the rest.

The robot's place at the time of the request decides which object is meant. A number counts from the
nearest object. "From the left" counts only objects ahead.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NoReturn

import numpy as np

from edge import names
from edge.mission.language.words.tokens import Token, TokenReader, TranslationError
from edge.tasks.scene.outline import outline_of
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.sentences.steps import InstructionStep
from edge.text import one_line

SIDE_RAD = math.radians(5)
"""An object closer to straight ahead than this is neither on the left nor on the right."""
AHEAD_RAD = math.radians(45)
"""An object closer to straight ahead than this is "ahead"; the same holds for "behind"."""
NEAR_M = 3.0
"""Largest distance of an object that is "near" another one."""


@dataclass(slots=True)
class UnseenScene:
    """Stand-in for a scene: every name that is read gives one placeholder object.

    Attributes:
        names: names that were read, by their canonical name (see `edge.names.canonical`).
        refers: True if the step refers to the object of the previous step.
    """

    names: dict[str, str] = field(default_factory=dict)
    refers: bool = False

    def placeholder(self, words: Sequence[Token] = ()) -> SceneObject:
        """Return the placeholder object for some words; without words, for a bare number."""
        if _is_name(words):
            nouns = list(names.head_nouns(" ".join(token.text for token in words)))
            noun = next(filter(names.is_known, nouns), nouns[0])
            singular = names.singular(noun)  # wrong for "chest of drawers", so compare the two
            noun = singular if names.same_name(singular, noun) else noun
            self.names.setdefault(names.canonical(noun), noun)
        return SceneObject(0, "", "", np.zeros(3), np.zeros(3), 0.0, np.empty((0, 3)), {})


def read_own_side(reader: TokenReader) -> str:
    """Read the side that follows `the van's`; return "" if there is none."""
    token = reader.take("left", "right")
    if token is None:
        return ""
    while reader.peek().text in ("hand", "side"):
        reader.at += 1
    return token.kind


@dataclass(frozen=True, slots=True)
class _PassingSide:
    """A side after an object: `on the left`, or with `of_robot` `on your left`."""

    direction: str
    of_robot: bool


def read_passing_side(reader: TokenReader) -> _PassingSide | None:
    """Read the side after an object that is passed; return None if there is no such phrase."""
    token, at = reader.peek(), reader.at
    if _is_passing_side(reader):
        reader.at += 1
        # "on your left", "on the robot's left"; but "on the left" is a side of the object.
        of_robot = token.text.split()[1] != "the" or "robot" in token.text
        return _PassingSide(token.kind.removeprefix("on the "), of_robot)
    if reader.take("to") and reader.take("article"):
        side = read_own_side(reader)
        if side and not reader.is_at("word"):
            return _PassingSide(side, reader.tokens[at + 1].text in ("your", "my"))
    reader.at = at
    return None


def _is_passing_side(reader: TokenReader) -> bool:
    """Return True if a side ends the phrase here, and is not a side of the road."""
    ends = not reader.is_at(*_PLACES, *_ORDER, "at", "which is", ahead=1)
    of_road = reader.peek().text.endswith((" road", " street"))
    return ends and reader.is_at("on the left", "on the right") and not of_road


def object_of_last_step(
    scene: Scene | UnseenScene, before: Sequence[InstructionStep], reader: TokenReader, token: Token
) -> SceneObject:
    """Return the only object of the previous step, for which `it` or `its` stands."""
    if not before or len(before[-1].objects) != 1:
        reader.refuse("it is not clear what this stands for; name the object", token)
    if isinstance(scene, UnseenScene):
        scene.refers = True
    return before[-1].objects[0]


class UnseenObjectError(TranslationError):
    """A description that fits no object that was seen so far."""


class AmbiguousObjectError(TranslationError):
    """A name that fits several objects."""

    def __init__(self, message: str, part: str, position: int, ids: tuple[int, ...]) -> None:
        super().__init__(message, part, position)
        self.ids = ids


def read_object(
    reader: TokenReader, scene: Scene | UnseenScene, before: Sequence[InstructionStep]
) -> SceneObject:
    """Read a noun phrase and return the only object that it names."""
    start = reader.peek()
    return only_one(read_objects(reader, scene, before), reader, start)


def only_one(found: list[SceneObject], reader: TokenReader, start: Token) -> SceneObject:
    """Return the only object found; raise AmbiguousObjectError if there are several."""
    if len(found) > 1:
        listed = ", ".join(map(object_name, found[:4])) + (", …" if len(found) > 4 else "")
        hint = f"it may be any of {len(found)}: {listed}; say which, as 'the nearest' or 'object 3'"
        try:
            reader.refuse(hint, start)
        except TranslationError as error:
            ids = tuple(obj.id for obj in found)
            raise AmbiguousObjectError(str(error), error.part, error.position, ids) from None
    return found[0]


def read_objects(
    reader: TokenReader,
    scene: Scene | UnseenScene,
    before: Sequence[InstructionStep],
    is_passed: bool = False,
) -> list[SceneObject]:
    """Read a noun phrase and return the objects that it may mean, at least one.

    If `is_passed` is True, a side at the end is left to the caller, because the object is passed.
    Words that choose an object, such as "nearest" and "second", are kept as `choosers`.
    """
    start = reader.peek()
    if token := reader.take("pronoun"):
        return [object_of_last_step(scene, before, reader, token)]
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
        reader.refuse("expected the name of an object", start)
    unseen = isinstance(scene, UnseenScene)
    found = (
        [scene.placeholder(words)]
        if unseen
        else _objects_described(_objects_named(reader, scene, words), reader, words)
    )
    found, origin, before_that_is = _read_places(reader, scene, before, found, choosers, is_passed)
    for token in before_that_is if is_passed else ():
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


def _read_places(
    reader: TokenReader,
    scene: Scene | UnseenScene,
    before: Sequence[InstructionStep],
    found: list[SceneObject],
    choosers: list[Token],
    is_passed: bool,
) -> tuple[list[SceneObject], SceneObject | None, list[Token]]:
    """Read the places after a name, such as "on the left" or "next to the van".

    Words that choose an object are added to `choosers`.

    Returns:
        Those of `found` that are there; the origin of distances, if one is named; and the words
        that chose an object or a place before "that is".
    """
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
        other = read_object(reader, scene, before) if token.kind == "at" else None
        if isinstance(scene, UnseenScene):
            continue
        if other is not None:
            found = _filtered(
                found, lambda t, o=other: t is not o and _gap_m(scene, t, o) <= NEAR_M
            )
        else:
            found = _filtered(found, lambda t, k=token.kind: _PLACES[k](_bearing_rad(scene, t)))
        if not found:
            reader.refuse("no such object is there", token)
    return found, origin, words_before_that_is


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
    found: list[SceneObject], reader: TokenReader, scene: Scene | UnseenScene
) -> list[SceneObject]:
    """Read the words after `that is`: a description, unless a place follows."""
    words = []
    while reader.is_at("word") and reader.peek().text not in _NO_NAMES:
        words.append(reader.take("word"))
    if not words and not reader.is_at(*_PLACES, "at", *_ORDER):
        reader.refuse("expected what it is like, or where it is")
    return found if isinstance(scene, UnseenScene) else _objects_described(found, reader, words)


def _read_origin(
    reader: TokenReader,
    scene: Scene | UnseenScene,
    before: Sequence[InstructionStep],
    choosers: Sequence[Token],
) -> SceneObject | None:
    """Return the object of `nearest to the sign`, or None if the robot is meant."""
    at = reader.at
    if not any(token.kind in ("nearest", "farthest") for token in choosers) or read_passing_side(
        reader
    ):
        reader.at = at  # "the nearest tree to the left"
        return None
    return read_object(reader, scene, before) if reader.take("to", "from") else None


def _read_by_number(
    reader: TokenReader, scene: Scene | UnseenScene, words: list[Token], choosers: Sequence[Token]
) -> SceneObject:
    """Return the object with the number that comes next; the words before must fit the object."""
    start = reader.peek()
    token = reader.take("number")
    if token is None:
        reader.refuse("say its number", start)
    if choosers:
        reader.refuse("this chooses the object in two ways; say only one", choosers[0])
    if isinstance(scene, UnseenScene):
        return scene.placeholder(words)
    obj = scene.objects.get(int(token.text)) if token.text.isdecimal() else None
    if obj is None:
        reader.refuse(f"no object has that number; there are {_labels_text(scene)}", start)
    if words and obj not in _objects_described(_objects_named(reader, scene, words), reader, words):
        reader.refuse(f"that is the number of {object_name(obj)}", start)
    return obj


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
    return _filtered(list(scene.objects.values()), lambda obj: names.is_kind_of(obj.label, name))


def _objects_described(
    found: list[SceneObject], reader: TokenReader, words: Sequence[Token]
) -> list[SceneObject]:
    for token in words:
        fitting = _filtered(found, lambda t, word=token.text: word in _caption_words(t))
        if not fitting:
            hint = f"this word describes none of them: {', '.join(map(object_name, found[:4]))}"
            try:
                reader.refuse(hint, token)
            except TranslationError as error:
                raise UnseenObjectError(str(error), error.part, error.position) from None
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
    found = [obj for obj in found if obj is not origin]
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


def centre_m(obj: SceneObject) -> tuple[float, float]:
    """Return the centre of an object on the ground, (x, y) in `map`."""
    x, y = obj.position_m[:2].tolist()
    return x, y


def _distance_m(scene: Scene, obj: SceneObject) -> float:
    return scene.pose.distance_to(*centre_m(obj))


def _bearing_rad(scene: Scene, obj: SceneObject) -> float:
    return scene.pose.bearing_to(*centre_m(obj))


def _gap_m(scene: Scene, a: SceneObject, b: SceneObject) -> float:
    """Return the distance between the outlines of two objects."""
    cells_m = outline_of(b, scene.occupancy).cells_m
    return float(outline_of(a, scene.occupancy).gaps_m(cells_m).min())


def _filtered(found: list[SceneObject], keep: Callable[[SceneObject], bool]) -> list[SceneObject]:
    return [obj for obj in found if keep(obj)]


def _caption_words(obj: SceneObject) -> set[str]:
    return set(re.findall(r"[^\W_]+", f"{obj.label} {obj.caption}".lower()))


def object_name(obj: SceneObject) -> str:
    """Return an object's label, id and caption, to distinguish it from others."""
    caption = one_line(obj.caption, 40)
    return f"{obj.label} {obj.id}" + (f" ({caption})" if caption else "")


def _labels_text(scene: Scene) -> str:
    labels = dict.fromkeys(obj.label for obj in scene.objects.values())
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
    "nearest": lambda scene, obj: _distance_m(scene, obj),
    "farthest": lambda scene, obj: -_distance_m(scene, obj),
    "leftmost": lambda scene, obj: -_bearing_rad(scene, obj),
    "rightmost": lambda scene, obj: _bearing_rad(scene, obj),
    "from the left": lambda scene, obj: -_bearing_rad(scene, obj),
    "from the right": lambda scene, obj: _bearing_rad(scene, obj),
}
"""Kind of phrase → sort key of the objects; the first is meant, or the one of a number."""
CHOSEN_BY_SIDE = {*_PLACES, *_ORDER, "left", "right"} - {"nearest", "farthest"}
"""Kinds of words that choose an object by where it is seen from the robot."""

"""What is kept of a mission, and as which bytes.

One JSON object `{"format", "version", "sha256", "mission"}`, whose checksum is over the bytes of
`mission`. Everything is checked on the way in and on the way out, so that whatever was written
can be read again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from edge.config.section import Name
from edge.errors import UserError
from edge.mission.automaton import NOTHING
from edge.mission.ltl import parse, propositions
from edge.text import one_line
from edge.types import Instance, InstanceState

VERSION = 1
MAX_POINTS = 64
MAX_INSTANCES = 256
MAX_BYTES = 8 << 20

_FILE = re.compile(
    rb'\{"format":"edge-mission","version":([0-9]{1,9}),"sha256":"([0-9a-f]{64})","mission":(.*)\}\n',
    re.DOTALL,
)
_STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
Point = tuple[Metres, Metres, Metres]
Count = Annotated[int, Field(ge=0, lt=1 << 63)]
Stamp = Annotated[int, Field(ge=-(1 << 63), lt=1 << 63)]
Word = Annotated[str, Field(max_length=1000)]
Words = Annotated[tuple[Word, ...], Field(max_length=10_000)]


@dataclass(frozen=True)
class SavedInstance:
    """A thing in the map (see `edge.types.Instance`), with at most `MAX_POINTS` of its points."""

    __pydantic_config__ = _STRICT

    id: Count
    label: Name
    center_m: Point
    points_m: Annotated[tuple[Point, ...], Field(min_length=1, max_length=MAX_POINTS)]
    score: Annotated[float, Field(ge=0, le=1)]
    hits: Count
    state: InstanceState


@dataclass(frozen=True)
class Saved:
    """A mission as it stood.

    Attributes:
        word: the letters taken so far, `NOTHING` included. The automaton's state is not kept: it
            follows from running them, whatever number a later compiler gives to it.
        reached: R of ViTL III; `failed` is B, `detected` is D. All are propositions of `formula`.
        target: the proposition that was pursued, or None.
        pose: x and y in metres, yaw in radians in `map`, at `stamp_ns` of the sensors' clock.
        odometry_epoch: of the source in the process that wrote this.
        id: see `edge.mission.run.MissionRun`.
    """

    __pydantic_config__ = _STRICT

    instruction: str
    formula: str
    backend: Word
    english: str
    word: Words
    reached: Words
    failed: Words
    detected: Words
    target: Word | None
    phase: Word
    reason: str
    paused: bool
    elapsed_s: Annotated[float, Field(ge=0)]
    path_m: Annotated[float, Field(ge=0)]
    pose: Point | None
    stamp_ns: Stamp
    odometry_epoch: Count
    instances: Annotated[tuple[SavedInstance, ...], Field(max_length=MAX_INSTANCES)]
    id: Word = ""


_MISSION = TypeAdapter(Saved)


def encode(saved: Saved) -> bytes:
    """The file's content.

    Raises:
        ValueError: with one line, where `decode` would not take it.
    """
    body = _MISSION.dump_json(saved)
    _check(body)
    digest = hashlib.sha256(body).hexdigest()
    head = f'{{"format":"edge-mission","version":{VERSION},"sha256":"{digest}","mission":'
    content = head.encode() + body + b"}\n"
    if len(content) > MAX_BYTES:
        raise ValueError(f"{len(content)} bytes, at most {MAX_BYTES} are kept")
    return content


def decode(content: bytes) -> Saved:
    """What `encode` made a file of.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    if len(content) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES} bytes")
    whole = _FILE.fullmatch(content)
    if whole is None:
        raise ValueError("not a whole checkpoint of a mission")
    if int(whole[1]) != VERSION:
        raise ValueError(f"version {int(whole[1])}, this program reads {VERSION}")
    if hashlib.sha256(whole[3]).hexdigest().encode() != whole[2]:
        raise ValueError("damaged: its checksum does not match")
    return _check(whole[3])


def save_instances(instances: Iterable[Instance]) -> tuple[SavedInstance, ...]:
    """Instances as they are kept: the `MAX_INSTANCES` that were seen most, points thinned."""
    most = sorted(instances, key=lambda i: (-i.hits, i.id))[:MAX_INSTANCES]
    return tuple(
        SavedInstance(
            i.id, i.label, _rounded(i.center_m[None])[0], _rounded(_thinned(i.points_m)),
            min(float(i.score), 1.0), i.hits, i.state,
        )
        for i in most
    )  # fmt: skip


def restore_instance(saved: SavedInstance, stamp_ns: int) -> Instance:
    """The instance again, as if it had been seen at `stamp_ns`."""
    return Instance(
        saved.id, saved.label, np.array(saved.center_m, np.float32),
        np.array(saved.points_m, np.float32), saved.score, saved.hits,
        first_seen_ns=stamp_ns, last_seen_ns=stamp_ns, state=saved.state,
    )  # fmt: skip


def _check(body: bytes) -> Saved:
    """The mission in these bytes; ValueError with one line if there is none."""
    try:
        saved = _MISSION.validate_json(body)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "mission"
        raise ValueError(f"{where}: {one_line(first['msg'])}") from None
    letters = _letters(saved.formula)
    for name in ("word", "reached", "failed", "detected"):
        unknown = set(getattr(saved, name)) - letters - ({NOTHING} if name == "word" else set())
        if unknown:
            raise ValueError(f"{name}: {min(unknown)!r:.60} is not in the formula")
    if saved.target is not None and saved.target not in letters:
        raise ValueError(f"target: {saved.target!r:.60} is not in the formula")
    return saved


@lru_cache(maxsize=4)
def _letters(formula: str) -> frozenset[str]:
    try:
        return frozenset(propositions(parse(formula)))
    except UserError as error:
        raise ValueError(f"formula: {error}") from None


def _thinned(points_m: np.ndarray) -> np.ndarray:
    """(k, 3) to at most (MAX_POINTS, 3), evenly over the order they are in."""
    if len(points_m) <= MAX_POINTS:
        return points_m
    return points_m[np.linspace(0, len(points_m) - 1, MAX_POINTS).astype(np.intp)]


def _rounded(points_m: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    """To a tenth of a millimetre: half the bytes, and nobody measures better."""
    return tuple(map(tuple, np.round(points_m.astype(np.float64), 4).tolist()))

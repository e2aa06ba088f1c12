"""What is kept of a mission, and as which bytes.

One JSON object `{"format", "version", "sha256", "mission"}`, whose checksum is over the bytes of
`mission`. Everything is checked on the way in and on the way out, so that whatever was written
can be read again. What was seen where is kept elsewhere (`edge.loop.places`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from edge.errors import UserError
from edge.mission.logic.automaton import NOTHING
from edge.mission.logic.ltl import parse, propositions
from edge.mission.sealed import Sealed
from edge.text import bounded_repr, one_line

VERSION = 2
MAX_BYTES = 8 << 20

FILE = Sealed(
    "edge-mission", "checkpoint of a mission", VERSION, rb'"mission":(?P<body>.*)\}\n', MAX_BYTES
)
_STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

Word = Annotated[str, Field(max_length=1000)]
Words = Annotated[tuple[Word, ...], Field(max_length=10_000)]


@dataclass(frozen=True)
class Saved:
    """A mission as it stood.

    Attributes:
        word: the letters taken so far, `NOTHING` included. The automaton's state is not kept: it
            follows from running them, whatever number a later compiler gives to it.
        reached: R of ViTL III; `failed` is B, `detected` is D. All are propositions of `formula`.
        target: the proposition that was pursued, or None.
        reading, readings, implied: see `edge.mission.translate.Translation`.
        id: see `edge.mission.run.MissionRun`.
        task: it is a task (`edge.tasks`): `word` has one `NOTHING` for each step that was driven.
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
    reading: Annotated[int, Field(ge=1)] | None = None
    readings: tuple[str, ...] = ()
    implied: bool = False
    id: Word = ""
    task: bool = False


_MISSION = TypeAdapter(Saved)


def encode(saved: Saved) -> bytes:
    """The file's content.

    Raises:
        ValueError: with one line, where `decode` would not take it.
    """
    body = _MISSION.dump_json(saved)
    _check(body)
    return FILE.seal('"mission":', body, b"}\n")


def decode(content: bytes) -> Saved:
    """What `encode` made a file of.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    _, body = FILE.open(content)
    return _check(bytes(body))


def _check(body: bytes) -> Saved:
    """The mission in these bytes; ValueError with one line if there is none."""
    try:
        saved = _MISSION.validate_json(body)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "mission"
        raise ValueError(f"{where}: {one_line(first['msg'])}") from None
    letters = _letters(saved.formula)
    if saved.task:
        return saved
    for name in ("word", "reached", "failed", "detected"):
        unknown = set(getattr(saved, name)) - letters - ({NOTHING} if name == "word" else set())
        if unknown:
            raise ValueError(f"{name}: {bounded_repr(min(unknown), 60)} is not in the formula")
    if saved.target is not None and saved.target not in letters:
        raise ValueError(f"target: {bounded_repr(saved.target, 60)} is not in the formula")
    return saved


@lru_cache(maxsize=4)
def _letters(formula: str) -> frozenset[str]:
    try:
        return frozenset(propositions(parse(formula)))
    except UserError as error:
        raise ValueError(f"formula: {error}") from None

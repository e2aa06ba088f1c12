"""JSON of evaluations: figures as data, and files of JSON lines, appended as they come."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from edge.errors import FileError, UserError
from edge.host.files import read_regular
from edge.text import one_line, read_json_object

MAX_BYTES = 1 << 30
"""Largest file of outcomes that is read."""
T = TypeVar("T")
Parser = Callable[[dict[str, Any]], T]
"""Makes an item from a JSON object. Raises KeyError, TypeError or ValueError if it cannot."""


def json_data(value: Any, digits: int | None = None) -> Any:
    """Return data that `json.dumps` takes: named tuples become objects, inf and NaN null.

    Numbers are rounded to `digits` after the point; None: not at all.

    Example:
        >>> json_data({"rate": (0.12345, float("nan"))}, digits=2)
        {'rate': [0.12, None]}
    """
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {str(key): json_data(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_data(item, digits) for item in value]
    if isinstance(value, (float, np.floating)):
        if not math.isfinite(value):
            return None
        return float(value) if digits is None else round(float(value), digits)
    return value


def parser_of(kind: type[T]) -> Parser[T]:
    """Return a parser for the dataclass `kind` that checks the types of all fields."""
    adapter = TypeAdapter(kind)

    def parse(data: dict[str, Any]) -> T:
        try:
            return adapter.validate_python(data)
        except ValidationError as error:
            fault = error.errors(include_input=False, include_url=False)[0]
            raise ValueError(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}") from None

    return parse


def parse_lines(path: Path, content: bytes, parse: Parser[T], what: str, advice: str) -> list[T]:
    """Parse the lines of a file, without the empty ones.

    Raises:
        UserError: a line is not an item.
    """
    found = []
    for number, line in enumerate(content.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            found.append(parse(read_json_object(line)))
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(
                f"{path}: line {number}: not {what}: {one_line(error)}; {advice}"
            ) from None
    return found


def read_lines(
    path: Path,
    max_bytes: int,
    parse: Parser[T],
    what: str,
    advice: str,
    line_advice: str = "",
    complete: bool = True,
) -> list[T]:
    """Read the items of a file of at most `max_bytes`.

    `what` is the name of an item with its article, for messages; `line_advice` replaces `advice` if
    a line is not an item. If not `complete`, a last line without its end is ignored.

    Raises:
        FileError: the file cannot be read.
        UserError: a line is not an item.
    """
    try:
        content = read_regular(path, max_bytes)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}; {advice}") from None
    content = content if complete else content[: content.rfind(b"\n") + 1]
    return parse_lines(path, content, parse, what, line_advice or advice)


def to_line(data: dict[str, Any]) -> bytes:
    """Return a JSON object as a line; raise ValueError if a number is not finite."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).encode() + b"\n"


class JsonLinesFile(Generic[T]):
    """JSON lines file of dataclass items: reads those that are there, then appends.

    A last line without its end is removed. With `digits`, numbers are rounded to that many digits
    after the point, and those that are not finite become null. Without, these are refused.

    Attributes:
        known: all items by their key, of several with one key the last.

    Raises:
        FileError: the file cannot be read or written.
        UserError: the file has other content.
    """

    def __init__(
        self,
        path: Path,
        kind: type[T],
        what: str,
        key: Callable[[T], Any] = attrgetter("key"),
        digits: int | None = None,
    ) -> None:
        self._path, self._key, self._digits = path, key, digits
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = read_regular(path, MAX_BYTES) if path.exists() else b""
            complete = content[: content.rfind(b"\n") + 1]
            if len(complete) < len(content):  # a run was interrupted during a write
                path.write_bytes(complete)
        except OSError as error:
            raise FileError(
                f"{path}: cannot be used: {error.strerror or error}; choose another --out"
            ) from None
        what = f"{what} of this version of edge"
        found = parse_lines(path, complete, parser_of(kind), what, "choose another --out")
        self.known = {key(item): item for item in found}

    def append(self, item: T) -> None:
        """Append an item.

        Raises:
            FileError: the disk is full, or the folder is gone.
            ValueError: a number is not finite.
        """
        data = asdict(item)  # type: ignore[call-overload]
        line = to_line(data if self._digits is None else json_data(data, self._digits))
        try:
            with self._path.open("ab", buffering=0) as file:
                file.write(line)
        except OSError as error:
            raise FileError(f"{self._path}: cannot be written: {error.strerror or error}") from None
        self.known[self._key(item)] = item

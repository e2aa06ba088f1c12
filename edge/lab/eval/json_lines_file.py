"""Files of JSON lines: an evaluation's episodes, and its results, appended as they come."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import TypeAdapter, ValidationError

from edge.errors import FileError, UserError
from edge.host.files import read_regular
from edge.text import one_line, read_json_object

T = TypeVar("T")
Parser = Callable[[dict[str, Any]], T]
"""Makes an item from a JSON object. Raises KeyError, TypeError or ValueError if it cannot."""


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
    """JSON lines file: reads the lines that are there, then appends.

    A last line without its end is removed.

    Attributes:
        found: the items that were there at first.

    Raises:
        FileError: the file cannot be read or written.
        UserError: the file has other content.
    """

    def __init__(self, path: Path, parse: Parser[T], what: str, max_bytes: int) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = read_regular(path, max_bytes) if path.exists() else b""
            complete = content[: content.rfind(b"\n") + 1]
            if len(complete) < len(content):  # a run was interrupted during a write
                path.write_bytes(complete)
        except OSError as error:
            raise FileError(
                f"{path}: cannot be used: {error.strerror or error}; choose another --out"
            ) from None
        what = f"{what} of this version of edge"
        self.found = parse_lines(path, complete, parse, what, "choose another --out")

    def append(self, line: bytes) -> None:
        """Append a line, which must end with a newline.

        Raises:
            FileError: the disk is full, or the folder is gone.
        """
        try:
            with self.path.open("ab", buffering=0) as file:
                file.write(line)
        except OSError as error:
            raise FileError(f"{self.path}: cannot be written: {error.strerror or error}") from None

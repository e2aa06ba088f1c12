"""A file of JSON lines to which an evaluation appends its results as they come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

from edge.errors import FileError, UserError
from edge.host.files import read_regular
from edge.text import one_line, read_json_object

T = TypeVar("T")


class JsonLinesFile(Generic[T]):
    """JSON lines file: reads the lines that are there, then appends.

    A last line without its end is removed.

    Args:
        path: the file; its folder is made if it is missing.
        parse: makes an item from a line's JSON object; raises KeyError, TypeError or ValueError if
            it cannot.
        what: name of an item with its article, for messages.
        max_bytes: size limit of the file.

    Attributes:
        found: the items that were there at first.

    Raises:
        FileError: the file cannot be read or written.
        UserError: the file has other content.
    """

    def __init__(
        self, path: Path, parse: Callable[[dict[str, Any]], T], what: str, max_bytes: int
    ) -> None:
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
        self.found: list[T] = []
        for number, text in enumerate(complete.splitlines(), start=1):
            try:
                self.found.append(parse(read_json_object(text)))
            except (KeyError, TypeError, ValueError) as error:
                raise UserError(
                    f"{path}: line {number}: not {what} of this version of edge "
                    f"({one_line(error)}); choose another --out"
                ) from None

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

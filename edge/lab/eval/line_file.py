"""A file of JSON lines that grows while something runs, whole lines at a time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

from edge.errors import FileError, UserError
from edge.host.files import read_regular
from edge.text import one_line, read_json_object

T = TypeVar("T")


class LineFile(Generic[T]):
    """What is there, and what is appended.

    Args:
        path: its folder is made where it is not there.
        parse: a line's object; raises KeyError, TypeError or ValueError where it is none.
        what: a line holds, with its article, for messages.
        max_bytes: more is not read.

    Attributes:
        found: what was there.

    Raises:
        FileError: it cannot be read or written.
        UserError: it has something else in it.
    """

    def __init__(
        self, path: Path, parse: Callable[[dict[str, Any]], T], what: str, max_bytes: int
    ) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = read_regular(path, max_bytes) if path.exists() else b""
            whole = content[: content.rfind(b"\n") + 1]
            if len(whole) < len(content):  # a run was broken off while it wrote
                path.write_bytes(whole)
        except OSError as error:
            raise FileError(f"{path}: {error.strerror or error}") from None
        self.found: list[T] = []
        for number, text in enumerate(whole.splitlines(), start=1):
            try:
                self.found.append(parse(read_json_object(text)))
            except (KeyError, TypeError, ValueError) as error:
                raise UserError(
                    f"{path}: line {number}: not {what} of this version ({one_line(error)}): "
                    "take another --out"
                ) from None

    def append(self, line: bytes) -> None:
        """
        Raises:
            FileError: the disk is full, or the folder has gone.
        """
        try:
            with self.path.open("ab", buffering=0) as file:
                file.write(line)
        except OSError as error:
            raise FileError(f"{self.path}: {error.strerror or error}") from None

"""Errors of the export programs for the user, checks of file hashes, and cards."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import yaml

from edge.errors import UserError
from edge.host.files import write_atomically
from edge.perception.runtime import model_file


class ExportError(UserError):
    """Error of an export that the user can fix; its text is one line: what, where, what to do."""


def exit_on_user_error(main: Callable[[list[str] | None], object]) -> Callable[..., int]:
    """Wrap a program: print a UserError as one line on stderr, and return exit code 1."""

    @wraps(main)
    def run(argv: list[str] | None = None) -> int:
        try:
            main(argv)
        except UserError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        return 0

    return run


def sha256_of(path: Path) -> str:
    """Return the hex digest of a file; raise ExportError if it cannot be read."""
    try:
        return model_file.sha256_of(path)
    except OSError as error:
        raise ExportError(f"{path}: cannot be read ({error.strerror}); check the path") from None


def check_sha256(path: Path, expected: str) -> None:
    """Raise ExportError unless the file has this digest."""
    found = sha256_of(path)
    if found != expected:
        raise ExportError(
            f"{path}: SHA-256 is {found[:12]}…, expected {expected[:12]}…; the file is not loaded, "
            "because a checkpoint can run code; fetch the file again from the card's sources"
        )


def write_card(card: dict[str, Any], folder: Path) -> None:
    """Write a model card as `NAME.yaml`."""
    text = yaml.safe_dump(card, sort_keys=False, width=110)
    write_atomically(folder / f"{card['name']}.yaml", text.encode())

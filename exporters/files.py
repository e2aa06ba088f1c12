"""Files that an export reads: digests, errors that say what to do."""

from __future__ import annotations

from pathlib import Path

from edge.errors import UserError
from edge.perception import model_file


class ExportError(UserError):
    """An error that the user can act on; its text is one line: what, where, what to do."""


def sha256_of(path: Path) -> str:
    """Hex digest of a file; raises ExportError if it cannot be read."""
    try:
        return model_file.sha256_of(path)
    except OSError as error:
        raise ExportError(f"{path}: cannot be read ({error.strerror}); check the path") from None


def check_sha256(path: Path, expected: str) -> None:
    """Raise ExportError unless the file has this digest."""
    found = sha256_of(path)
    if found != expected:
        raise ExportError(
            f"{path}: sha256 is {found[:12]}…, expected {expected[:12]}…; not loaded, since a "
            "checkpoint can run code: fetch the file again from the card's sources"
        )

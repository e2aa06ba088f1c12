"""Model files on the disk: their hashes, and what goes wrong with them."""

from __future__ import annotations

import contextlib
import hashlib
import json
from pathlib import Path

from edge import resources
from edge.errors import UnavailableError
from edge.files import write_atomically


class ModelError(UnavailableError):
    """A model that cannot be used: one line that says what, where and what to do."""


def sha256_of(path: Path) -> str:
    """Hex digest of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def remembered_sha256(path: Path) -> str:
    """Hash of a file; remembered across starts in the cache, as large files take a while.

    It is computed anew when the file's size or its time of change is another.

    Raises:
        ModelError: the file cannot be read.
    """
    try:
        return _remembered_sha256(path)
    except OSError as error:
        raise ModelError(
            f"{path}: cannot be read ({error.strerror}); make it readable, or remove it"
        ) from None


def _remembered_sha256(path: Path) -> str:
    stat = path.stat()
    key = f"{path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}"
    memory = resources.cache_dir() / "sha256.json"
    try:
        known = json.loads(memory.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        known = {}
    if isinstance(known, dict) and isinstance(known.get(key), str):
        return known[key]
    digest = sha256_of(path)
    prefix = f"{path.resolve()}|"
    known = {k: v for k, v in dict(known).items() if not k.startswith(prefix)} | {key: digest}
    with contextlib.suppress(OSError):  # a read-only cache only costs hashing again
        memory.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(memory, json.dumps(known, indent=1).encode())
    return digest

"""Model files on the disk: their hashes, and what goes wrong with them.

A hash is computed anew at every start, since a disk may rot under an unchanged time of change. It
is remembered too, in the cache, by path, size and time of change: `$EDGE_TRUST_CACHE` takes the
memory's word for it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from pathlib import Path

from edge.errors import UnavailableError
from edge.host import resources
from edge.host.files import open_regular, read_regular, write_atomically
from edge.text import read_json_object

TRUST_CACHE = "EDGE_TRUST_CACHE"
"""Variable of the environment; not empty, remembered hashes are not computed again."""


class ModelError(UnavailableError):
    """A model that cannot be used: one line that says what, where and what to do."""


def sha256_of(path: Path) -> str:
    """Hex digest of a file."""
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def trusts_cache() -> bool:
    return bool(os.environ.get(TRUST_CACHE))


def fresh_sha256(path: Path) -> str:
    """Hash of a file, computed and remembered.

    Raises:
        ModelError: the file cannot be read.
    """
    try:
        key = _key(path)
        digest = sha256_of(path)
    except OSError as error:
        raise _unreadable(path, error) from None
    known, prefix, file = _memory(), f"{path.resolve()}|", _memory_file()
    if known.get(key) == digest:  # a start writes nothing
        return digest
    known = {k: v for k, v in known.items() if not k.startswith(prefix)} | {key: digest}
    with contextlib.suppress(OSError):  # a read-only cache only costs hashing again
        write_atomically(file, json.dumps(known, indent=1).encode())
    return digest


def known_sha256(path: Path) -> str | None:
    """The hash that a file of this size and time of change had when it was last computed.

    Raises:
        ModelError: the file is not there, or may not be looked at.
    """
    try:
        known = _memory().get(_key(path))
    except OSError as error:
        raise _unreadable(path, error) from None
    return known if isinstance(known, str) else None


def remembered_sha256(path: Path) -> str:
    """`known_sha256`, else `fresh_sha256`: for what belongs to a file that is verified anyway."""
    return known_sha256(path) or fresh_sha256(path)


def check_unchanged(path: Path, sha256: str) -> None:
    """Raise ModelError unless a file, hashed anew, has this hash.

    For what is to be made of the file and kept: it must not outlive the damage of a file whose
    hash was only remembered.
    """
    if fresh_sha256(path) != sha256:
        raise ModelError(
            f"{path}: damaged or another model: sha256 is not {sha256[:12]}…; pull or export it "
            "again"
        )


def _unreadable(path: Path, error: OSError) -> ModelError:
    return ModelError(f"{path}: cannot be read ({error.strerror}); make it readable, or remove it")


def _key(path: Path) -> str:
    found = path.stat()
    return f"{path.resolve()}|{found.st_size}|{found.st_mtime_ns}"


def _memory_file() -> Path:
    return resources.cache_dir() / "sha256.json"


def _memory() -> dict[str, object]:
    try:
        return read_json_object(read_regular(_memory_file()))
    except (OSError, ValueError):
        return {}

"""Model files on the disk, and their hashes.

A hash is computed at every start, since a disk may corrupt a file without changing its time. The
cache also remembers each hash, by path, size and time of change. With `$EDGE_TRUST_CACHE` set, a
remembered hash is used and not computed again.
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
"""Environment variable; if its value is not empty, remembered hashes are used."""


class ModelError(UnavailableError):
    """A model that cannot be used: one line with the fault, the file or card, and what to do."""


def sha256_of(path: Path) -> str:
    """Return the hex digest of a file."""
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def trusts_cache() -> bool:
    """Return True if `$EDGE_TRUST_CACHE` is set: remembered hashes are used."""
    return bool(os.environ.get(TRUST_CACHE))


def fresh_sha256(path: Path) -> str:
    """Compute the hash of a file, remember it, and return it.

    Raises:
        ModelError: the file cannot be read.
    """
    try:
        key = _key(path)
        digest = sha256_of(path)
    except OSError as error:
        raise _unreadable(path, error) from None
    # Forget the hashes of the file's earlier versions.
    known, prefix, file = _remembered(), f"{path.resolve()}|", _memory_file()
    if known.get(key) == digest:  # do not write at every start
        return digest
    known = {k: v for k, v in known.items() if not k.startswith(prefix)} | {key: digest}
    with contextlib.suppress(OSError):  # a read-only cache only costs hashing again
        write_atomically(file, json.dumps(known, indent=1).encode())
    return digest


def known_sha256(path: Path) -> str | None:
    """Return the remembered hash of a file with this size and time of change; None if unknown.

    Raises:
        ModelError: the file is missing or may not be read.
    """
    try:
        known = _remembered().get(_key(path))
    except OSError as error:
        raise _unreadable(path, error) from None
    return known if isinstance(known, str) else None


def remembered_sha256(path: Path) -> str:
    """Return `known_sha256`, else `fresh_sha256`. Use it for a file that another call verifies."""
    return known_sha256(path) or fresh_sha256(path)


def check_unchanged(path: Path, sha256: str) -> None:
    """Raise ModelError unless the file, hashed now, has this hash.

    Call it before something is made from the file and kept: a remembered hash may hide damage.
    """
    if fresh_sha256(path) != sha256:
        raise ModelError(
            f"{path}: damaged or another model: sha256 is not {sha256[:12]}…; pull or export it "
            "again"
        )


def _unreadable(path: Path, error: OSError) -> ModelError:
    """Return the error to raise for a file that cannot be read."""
    return ModelError(f"{path}: cannot be read ({error.strerror}); make it readable, or remove it")


def _key(path: Path) -> str:
    """Return path, size and time of change; a file with the same key has not changed."""
    found = path.stat()
    return f"{path.resolve()}|{found.st_size}|{found.st_mtime_ns}"


def _memory_file() -> Path:
    """Return the path of the file with the remembered hashes."""
    return resources.cache_dir() / "sha256.json"


def _remembered() -> dict[str, object]:
    """Return the remembered hashes by `_key`; {} if there are none."""
    try:
        return read_json_object(read_regular(_memory_file()))
    except (OSError, ValueError):
        return {}

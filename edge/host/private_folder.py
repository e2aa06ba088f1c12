"""Temporary folders that are removed even if their process was killed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def private_folder(prefix: str, parent: str | None = None) -> Iterator[Path]:
    """Create a folder that only this user can enter, and remove it after the block.

    The process holds a lock on its folder, which the kernel releases when the process ends. Folders
    of the same prefix without a lock, left by `kill -9`, are removed first. Process ids in the name
    would not work, since containers may share the folder.

    Args:
        prefix: start of the folder's name.
        parent: where to create it; None: the system's folder for temporary files.

    Raises:
        OSError: the folder cannot be created.
    """
    parent = parent or tempfile.gettempdir()
    _remove_stale(prefix, parent)
    folder, fd = _make_locked(prefix, parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(fd)


def _make_locked(prefix: str, parent: str) -> tuple[Path, int]:
    """Return a new folder, and the descriptor that holds its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        with contextlib.suppress(FileNotFoundError):
            fd = _lock(folder, fcntl.LOCK_EX)
            if folder.is_dir():
                return folder, fd
            os.close(fd)
        # Another process has just removed it as stale.


def _remove_stale(prefix: str, parent: str) -> None:
    """Remove folders of this prefix and user that no process holds."""
    for folder in Path(parent).glob(f"{prefix}*"):
        # Not a folder, already gone, or in use (BlockingIOError is an OSError).
        with contextlib.suppress(OSError):
            if folder.lstat().st_uid == os.getuid():
                fd = _lock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
                os.close(fd)


def _lock(folder: Path, operation: int) -> int:
    """Lock a folder and return its descriptor; raise OSError if that fails."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(fd, operation)
    except OSError:
        os.close(fd)
        raise
    return fd

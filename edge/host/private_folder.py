"""Temporary folders that do not outlive their process for long, however it ends."""

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
    """A folder that only this user can enter; it goes with the block.

    Whoever makes one holds a lock on it, which the kernel lets go of when the process ends, and
    first removes those of the same prefix that nobody holds: what was left by `kill -9`. (A
    process's number in the name would not do: containers may share the folder but no numbers.)

    Args:
        parent: where it is made; by default the system's place for temporary files.

    Raises:
        OSError: none can be made.
    """
    parent = parent or tempfile.gettempdir()
    _remove_stale(prefix, parent)
    folder, fd = _make(prefix, parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(fd)


def _make(prefix: str, parent: str) -> tuple[Path, int]:
    """A new folder, and the descriptor that its lock hangs on."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        with contextlib.suppress(FileNotFoundError):
            fd = _lock(folder, fcntl.LOCK_EX)
            if folder.is_dir():
                return folder, fd
            os.close(fd)
        # Another process has just taken it for a stale one.


def _remove_stale(prefix: str, parent: str) -> None:
    for folder in Path(parent).glob(f"{prefix}*"):
        # Not a folder, gone meanwhile, or in use: BlockingIOError is an OSError, too.
        with contextlib.suppress(OSError):
            if folder.lstat().st_uid == os.getuid():
                fd = _lock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
                os.close(fd)


def _lock(folder: Path, how: int) -> int:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(fd, how)
    except OSError:
        os.close(fd)
        raise
    return fd

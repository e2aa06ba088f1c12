"""Atomic writes, and reads that never block on pipes or devices."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from edge.errors import FileError

MAX_TEXT_BYTES = 64 << 20
"""Default size limit of a file that is read."""


def open_regular(path: str | os.PathLike[str], max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file for reading, without blocking.

    Opening a pipe without a writer would block forever, and a device may have no end.

    Raises:
        OSError: the file cannot be opened, is not a regular file, or is longer than `max_bytes`;
            `strerror` has the reason.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = os.fstat(handle)
        if stat.S_ISDIR(found.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "Not a regular file", str(path))
        if max_bytes is not None and found.st_size > max_bytes:
            raise OSError(errno.EFBIG, f"Longer than {max_bytes} bytes", str(path))
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_regular(path: str | os.PathLike[str], max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Return the content of a regular file; raise OSError as `open_regular` does."""
    with open_regular(path, max_bytes) as file:
        return file.read(max_bytes)


@contextmanager
def replace_atomically(path: Path, temporary: Path | None = None) -> Iterator[Path]:
    """Yield a temporary path, whose file replaces `path` if the block succeeds.

    A reader sees the old or the new file, never a part, also after a power cut. The folder is
    created if needed.

    Args:
        path: file to replace.
        temporary: path to yield, in the same folder. Give it if there is only one writer at a time:
            the next writer overwrites what a killed writer left. None: a new, unique path.

    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if temporary is None:
        handle, name = tempfile.mkstemp(path.suffix, f".{path.name}.", path.parent)
        os.fchmod(handle, 0o644)  # with mkstemp's 0600, a web server could not read the file
        os.close(handle)
        temporary = Path(name)
    try:
        yield temporary
        sync(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes) -> None:
    """Replace the content of `path`; see `replace_atomically`."""
    with replace_atomically(path) as temporary:
        temporary.write_bytes(content)


def save(path: Path, content: bytes) -> None:
    """Write a file that a user named; like `write_atomically`.

    Raises:
        FileError: the file cannot be written; one line.
    """
    try:
        write_atomically(path, content)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from None


def sync(path: Path) -> None:
    """Flush a file's content, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_writable(directory: Path) -> None:
    """Create a directory if needed, and raise OSError if files cannot be written there."""
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=directory, prefix=".writable."):
        pass

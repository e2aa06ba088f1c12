"""Files that are there whole or not at all, and files that are read without waiting for them."""

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
"""No text that a person or a program writes for `edge` is longer."""


def open_regular(path: str | os.PathLike[str], max_bytes: int | None = None) -> BinaryIO:
    """Open a file for reading, at once or not at all.

    A pipe without a writer would be waited for without end, and a device may have no end.

    Raises:
        OSError: it cannot be opened, is no regular file, or is longer than `max_bytes`; its
            `strerror` says which.
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
    """The content of a file; raises OSError as `open_regular` does."""
    with open_regular(path, max_bytes) as file:
        return file.read(max_bytes)


@contextmanager
def replace_atomically(path: Path, beside: Path | None = None) -> Iterator[Path]:
    """Yield a path whose file takes the place of `path` if the block succeeds.

    A reader sees the old file or the new, never a part, also after a power cut. The folder is
    made if need be.

    Args:
        beside: the path to yield, in the same folder, for one writer at a time: what it leaves
            there when it is killed, the next writes over. By default one that nobody else has.

    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if beside is None:
        handle, name = tempfile.mkstemp(path.suffix, f".{path.name}.", path.parent)
        os.fchmod(handle, 0o644)  # mkstemp's 0600 would keep a web server from reading it
        os.close(handle)
        beside = Path(name)
    try:
        yield beside
        sync(beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes) -> None:
    """Replace `path` with `content`; see `replace_atomically`."""
    with replace_atomically(path) as beside:
        beside.write_bytes(content)


def save(path: Path, content: bytes) -> None:
    """`write_atomically`, of a file that a user named.

    Raises:
        FileError: it cannot be written.
    """
    try:
        write_atomically(path, content)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from None


def sync(path: Path) -> None:
    """Have a file's content, or the names in a folder, on the disk and not only in its cache."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_writable(directory: Path) -> None:
    """Make a directory if need be, and see that files can be written there.

    Raises:
        OSError: they cannot.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=directory, prefix=".writable."):
        pass

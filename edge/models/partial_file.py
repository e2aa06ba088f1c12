"""A partial file: a download in progress, moved to its target only when it is complete.

The package pooch is not used, since it does not keep partial downloads.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import stat
from pathlib import Path
from typing import BinaryIO

from edge.host.files import sync, write_atomically
from edge.perception.runtime.model_file import ModelError

MAX_BYTES = 4 << 30
"""Size limit of a model file."""


class FetchError(ModelError):
    """A source failed to give the file of the card; another source may."""


class InterruptedFetchError(FetchError):
    """The connection broke; the bytes so far are kept, and another try may resume."""


class PartialFile:
    """A file that is being downloaded or copied, next to its target; used as a context.

    If it is not complete at the end of the context, it is kept for the next run, unless it is
    empty.

    Args:
        sha256: hash of the complete file; None: unknown.
        size: size of the complete file in bytes; None: unknown.
        companion: path and content of another file, written when this one is complete.

    Attributes:
        sha256: hash of the complete file; None: unknown.
        size: size of the complete file in bytes; None: unknown.
        have: number of bytes so far.

    Raises:
        ModelError: on entry, if the folder cannot be written, or another process has the file.
    """

    def __init__(
        self,
        target: Path,
        sha256: str | None,
        size: int | None = None,
        companion: tuple[Path, bytes] | None = None,
    ) -> None:
        self.target, self.sha256, self.size, self._companion = target, sha256, size, companion
        key = (sha256 or "unknown")[:12]
        self.path = target.with_name(f".{target.name}.{key}.part")
        self.have = 0
        self._resumed = False  # see `mark_resumed`
        self._file: BinaryIO | None = None
        self._digest = hashlib.sha256()

    def __enter__(self) -> PartialFile:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Unbuffered, so that `close` does not try to write again on a full disk.
            self._file = self.path.open("ab+", buffering=0)
            if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                raise OSError(errno.EINVAL, "Not a regular file")
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._close()
            raise ModelError(
                f"{self.path}: another process is downloading it; wait for that process, or stop it"
            ) from None
        except OSError as error:
            self._close()
            raise ModelError(
                f"{self.path}: cannot be written ({error.strerror}); make the file writable, or "
                "set $EDGE_CACHE_DIR to another folder"
            ) from None
        self._file.seek(0)
        while block := self._file.read(1 << 20):
            self._digest.update(block)
            self.have += len(block)
        if self.sha256 is None:  # nothing shows that it is the start of the same file
            self.restart()
        return self

    def __exit__(self, *exc: object) -> None:
        if not self.have:
            self.path.unlink(missing_ok=True)
        self._close()

    def write(self, block: bytes) -> None:
        """Append a block.

        Raises:
            FetchError: the file is too long; it is emptied.
            ModelError: the disk cannot be written.
        """
        limit = MAX_BYTES if self.size is None else self.size
        if self.have + len(block) > limit:
            self.restart()
            raise FetchError(f"the file is longer than the expected {limit} bytes")
        left = memoryview(block)
        try:
            while left:  # a nearly full disk may take only a part
                left = left[self._file.write(left) :]
        except OSError as error:
            raise ModelError(f"{self.path}: cannot be written ({error.strerror})") from None
        self._digest.update(block)
        self.have += len(block)

    def mark_resumed(self) -> None:
        """Note that the bytes so far are from another run or source, and may not fit the next."""
        self._resumed = self.have > 0

    def restart(self) -> None:
        """Empty the file, to begin again."""
        self._file.truncate(0)
        self._digest = hashlib.sha256()
        self.have, self._resumed = 0, False

    @property
    def digest(self) -> str:
        """SHA-256 of the bytes so far."""
        return self._digest.hexdigest()

    def is_complete(self) -> bool:
        """Return True if the bytes so far have the hash of the complete file."""
        return self._digest.hexdigest() == self.sha256

    def finish(self) -> Path:
        """Verify the file, move it to its target atomically, and return that path.

        Raises:
            InterruptedFetchError: the hash is wrong, and the start of the file was from another run
                or source. The file is emptied, and another try may succeed.
            FetchError: size or hash is wrong; the file is emptied.
            ModelError: the disk cannot be written.
        """
        if self.size is not None and self.have != self.size:
            have = self.have
            self.restart()
            raise FetchError(f"the file has {have} bytes, expected {self.size}")
        if self.sha256 is not None and not self.is_complete():
            found, resumed = self._digest.hexdigest(), self._resumed
            self.restart()
            kind = InterruptedFetchError if resumed else FetchError
            raise kind(
                f"the file's sha256 is {found[:12]}…, expected {self.sha256[:12]}…: file removed"
            )
        try:
            os.fchmod(self._file.fileno(), 0o644)
            os.fsync(self._file.fileno())
            if self._companion is not None:
                write_atomically(*self._companion)
            self.path.replace(self.target)
            sync(self.target.parent)  # else a power cut may lose the new name
        except OSError as error:
            raise ModelError(f"{self.target}: cannot be written ({error.strerror})") from None
        return self.target

    def _close(self) -> None:
        """Close the file, if it is open."""
        if self._file is not None:
            self._file.close()  # releases the lock, too

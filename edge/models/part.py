"""A file on its way: written beside its place, and put there only when it is whole.

Our own, since pooch keeps nothing of what broke off.
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
"""No file of a model is longer."""


class FetchError(ModelError):
    """A source that does not give what its card says; another may."""


class Interrupted(FetchError):
    """The connection broke; what came is kept, and asking again may go on from there."""


class Part:
    """The beginning of a file, kept between runs until its end has come.

    A context; at its end the part stays where it holds something, and goes where it is empty.

    Attributes:
        target: where the file will lie.
        sha256: what it must hash to; None where that is not known.
        size: bytes it must have; None where that is not known.
        have: bytes that are there.
    """

    def __init__(
        self,
        target: Path,
        sha256: str | None,
        size: int | None = None,
        beside: tuple[Path, bytes] | None = None,
    ) -> None:
        """
        Args:
            beside: another file and its content, put in place with the whole one and only then.
        """
        self.target, self.sha256, self.size, self._beside = target, sha256, size, beside
        key = (sha256 or "unknown")[:12]
        self.path = target.with_name(f".{target.name}.{key}.part")
        self.have = 0
        self._resumed = False
        self._file: BinaryIO | None = None
        self._digest = hashlib.sha256()

    def __enter__(self) -> Part:
        """
        Raises:
            ModelError: the folder cannot be written, or another process is at the same file.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Unbuffered: what a full disk did not take would be written again at the close.
            self._file = self.path.open("ab+", buffering=0)
            if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                raise OSError(errno.EINVAL, "Not a regular file")
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._close()
            raise ModelError(
                f"{self.path}: another process is fetching it; wait for that one, or stop it"
            ) from None
        except OSError as error:
            self._close()
            raise ModelError(
                f"{self.path}: cannot be written ({error.strerror}); free the place, or set "
                "$EDGE_CACHE_DIR"
            ) from None
        self._file.seek(0)
        while block := self._file.read(1 << 20):
            self._digest.update(block)
            self.have += len(block)
        if self.sha256 is None:  # it could be the beginning of anything
            self.restart()
        return self

    def __exit__(self, *exc: object) -> None:
        if not self.have:
            self.path.unlink(missing_ok=True)
        self._close()

    def write(self, block: bytes) -> None:
        """Append; a file that grows longer than it should is let go.

        Raises:
            FetchError: too long.
            ModelError: the disk does not take it.
        """
        limit = MAX_BYTES if self.size is None else self.size
        if self.have + len(block) > limit:
            self.restart()
            raise FetchError(f"is longer than the {limit} bytes it should have")
        left = memoryview(block)
        try:
            while left:  # a disk that is nearly full takes a part
                left = left[self._file.write(left) :]
        except OSError as error:
            raise ModelError(f"{self.path}: cannot be written ({error.strerror})") from None
        self._digest.update(block)
        self.have += len(block)

    def ask_elsewhere(self) -> None:
        """A source goes on from here that has not given what is there, and may not fit it."""
        self._resumed = self.have > 0

    def restart(self) -> None:
        """Forget what is there."""
        self._file.truncate(0)
        self._digest = hashlib.sha256()
        self.have, self._resumed = 0, False

    @property
    def digest(self) -> str:
        """The sha256 of what is there."""
        return self._digest.hexdigest()

    def is_whole(self) -> bool:
        """Whether nothing is missing, as far as the hash tells."""
        return self._digest.hexdigest() == self.sha256

    def finish(self) -> Path:
        """Check the whole file and put it in its place, atomically.

        Raises:
            Interrupted: it is not what it should be, but began with the part of an earlier run
                or of another source, which may be to blame: that is forgotten now.
            FetchError: it is not what it should be, and is forgotten.
            ModelError: the disk does not take it.
        """
        if self.size is not None and self.have != self.size:
            have = self.have
            self.restart()
            raise FetchError(f"has {have} bytes, not the {self.size} it should have")
        if self.sha256 is not None and not self.is_whole():
            found, resumed = self._digest.hexdigest(), self._resumed
            self.restart()
            kind = Interrupted if resumed else FetchError
            raise kind(f"sha256 is {found[:12]}…, not {self.sha256[:12]}…: removed")
        try:
            os.fchmod(self._file.fileno(), 0o644)
            os.fsync(self._file.fileno())
            if self._beside is not None:
                write_atomically(*self._beside)
            self.path.replace(self.target)
            sync(self.target.parent)  # or the new name may be lost with the power
        except OSError as error:
            raise ModelError(f"{self.target}: cannot be written ({error.strerror})") from None
        return self.target

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()  # lets the lock go too

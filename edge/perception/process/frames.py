"""Images in memory that two processes share: one writes, the other reads where they lie."""

from __future__ import annotations

import mmap
import os
import tempfile
from pathlib import Path

import numpy as np

SHARED_MEMORY = Path("/dev/shm")
PIXELS_AT = 64
"""Offset of the pixels in bytes: a cache line, the two sequence numbers are before it."""
_BEFORE, _AFTER = 0, 1


def shared_dir() -> str:
    """Where files for two processes are kept: in memory where there is such a place."""
    usable = SHARED_MEMORY.is_dir() and os.access(SHARED_MEMORY, os.W_OK)
    return str(SHARED_MEMORY) if usable else tempfile.gettempdir()


class FrameFile:
    """The writer's end. The file has no name, so nothing is left of it however the writer ends.

    Attributes:
        fd: for the reader to inherit.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(dir=shared_dir())  # noqa: SIM115
        self.fd = self._file.fileno()
        self._bytes = np.empty(0, np.uint8)
        self._seq = np.empty(0, np.int64)

    def write(self, seq: int, rgb: np.ndarray) -> None:
        """Put an image there, over the one before.

        Args:
            seq: positive, another one for every image.
            rgb: (h, w, 3) uint8, contiguous.

        Raises:
            OSError: no memory for an image of this size.
        """
        end = PIXELS_AT + rgb.nbytes
        if end > len(self._bytes):
            self._grow(end)
        self._seq[_BEFORE] = seq
        self._bytes[PIXELS_AT:end] = rgb.reshape(-1)
        self._seq[_AFTER] = seq

    def _grow(self, size: int) -> None:
        # Reserved now: writing to a full /dev/shm later would end this process with SIGBUS.
        os.posix_fallocate(self.fd, 0, size)
        self._bytes, self._seq = _map(self.fd, size)

    def close(self) -> None:
        self._bytes, self._seq = np.empty(0, np.uint8), np.empty(0, np.int64)
        self._file.close()


class FrameView:
    """The reader's end, on the descriptor of a `FrameFile`."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._bytes = np.empty(0, np.uint8)
        self._seq = np.empty(0, np.int64)

    def read(self, seq: int, image_hw: tuple[int, int]) -> np.ndarray:
        """The image with this number, (h, w, 3) uint8, where it lies.

        Whoever has read it asks `is_whole` whether it was the same until then.

        Raises:
            ValueError: another image, or part of one, is there.
        """
        end = PIXELS_AT + image_hw[0] * image_hw[1] * 3
        if end > len(self._bytes):
            self._bytes, self._seq = _map(self._fd, end)
        if self._seq[_AFTER] != seq or not self.is_whole(seq):
            raise ValueError(f"frame {seq}: torn, frame {self._seq[_BEFORE]} is in its place")
        return self._bytes[PIXELS_AT:end].reshape(*image_hw, 3)

    def is_whole(self, seq: int) -> bool:
        """Whether no newer image has been begun."""
        return bool(self._seq[_BEFORE] == seq)


def _map(fd: int, needed: int) -> tuple[np.ndarray, np.ndarray]:
    """The file's bytes, and the two sequence numbers that they begin with.

    Raises:
        ValueError: there are fewer than needed.
    """
    size = os.fstat(fd).st_size
    if size < needed:
        raise ValueError(f"frame file: {size} bytes, {needed} are needed")
    content = np.frombuffer(mmap.mmap(fd, size), np.uint8)
    return content, content[:16].view(np.int64)

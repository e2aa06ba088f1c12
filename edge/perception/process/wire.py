"""Encoding of what the service and a model process exchange: messages, and images in memory.

A message goes over a socket. It is a JSON header; an answer has one block of bytes with arrays
after it. An image is in shared memory. Data from the model process is not trusted: that process
may be failing.
"""

from __future__ import annotations

import json
import mmap
import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from edge.perception.embedding.text import PromptError
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import ModelHealth, invalid_boxes_reason
from edge.text import bounded_repr, one_line
from edge.types import ContextBoxes, Detections

MAX_BYTES = 1 << 18
"""Size limit of a message. A thousand boxes are 28 KB, the prompts of the longest request 120 KB.

A longer message is cut off and so refused; most systems do not even send it."""
END_OF_HEADER = b"\n"
# Four corners, score, class and competing score (`Detections.competing_score`), of four bytes each.
_BOX_BYTES = 28
_STATES = get_args(get_type_hints(ModelHealth)["state"])
SHARED_MEMORY = Path("/dev/shm")
PIXELS_AT = 64
"""Offset of the pixels in the frame file in bytes: a cache line, with the two sequence numbers."""
_BEFORE = 0  # index of the sequence number that is written before the pixels
_AFTER = 1  # index of the one that is written after them


class ModelProcessError(ModelError):
    """The model's process failed or is not ready: one line."""


class DetectorReply(NamedTuple):
    """Detections of one image (without its observation), and the detector's health."""

    found: Detections
    health: ModelHealth
    invalid_boxes: int


def encode(**header: object) -> bytes:
    """Encode a message that has only a header."""
    return json.dumps(header).encode()


def encode_answer(seq: int, found: Detections, health: ModelHealth, invalid_boxes: int) -> bytes:
    """Encode the detections of an image, by its number, and the detector's health.

    They have context boxes and competing scores, as those of each `OnnxDetector`. The message is
    the header, a line end, and a block with the arrays.
    """
    context = found.context
    header = {
        "seq": seq,
        "n": len(found),
        "prompts": found.prompts,
        "context": {"n": len(context), "words": context.words},
        "health": health,
        "invalid_boxes": invalid_boxes,
    }
    # Context boxes have no competing score; zeros keep `_BOX_BYTES`.
    block = _pack(found, found.competing_score) + _pack(context, np.zeros(len(context)))
    return encode(**header) + END_OF_HEADER + block


def _pack(boxes: Detections | ContextBoxes, competing_score: np.ndarray) -> bytes:
    """Return the arrays of boxes as bytes, one array after the other."""
    arrays = (
        (boxes.xyxy_px, "<f4"),
        (boxes.score, "<f4"),
        (boxes.class_id, "<i4"),
        (competing_score, "<f4"),
    )
    return b"".join(np.ascontiguousarray(a, dtype).tobytes() for a, dtype in arrays)


def encode_error(error: BaseException, **header: int) -> bytes:
    """Encode an exception as a header; `raise_error` is the counterpart."""
    return encode(**header, error=type(error).__name__, text=str(error))


def decode_answer(seq: int, header: dict[str, Any], block: bytes) -> DetectorReply:
    """Check and decode the output of `encode_answer`.

    Raises:
        ValueError: the message is invalid, for the reason given in one line.
    """
    prompts, invalid = header.get("prompts"), header.get("invalid_boxes")
    if header.get("seq") != seq:
        raise ValueError(f"seq: expected {seq}, got {bounded_repr(header.get('seq'), 40)}")
    if type(invalid) is not int:
        raise ValueError(f"invalid_boxes: expected an integer, got {bounded_repr(invalid, 40)}")
    around = header.get("context")
    if not isinstance(around, dict):
        raise ValueError(f"context: expected an object, got {bounded_repr(around, 40)}")
    words, n, m = around.get("words"), header.get("n"), around.get("n")
    _check_words("prompts", prompts)
    _check_words("context", words)
    counted = type(n) is int and type(m) is int and min(n, m) >= 0
    if not counted or len(block) != (n + m) * _BOX_BYTES:
        raise ValueError(
            f"{len(block)} bytes do not fit n {bounded_repr(n, 40)} boxes and "
            f"{bounded_repr(m, 40)} context boxes of {_BOX_BYTES} bytes"
        )
    xyxy, score, class_id, competing_score = _unpack(block[: n * _BOX_BYTES], n, prompts)
    context = ContextBoxes(*_unpack(block[n * _BOX_BYTES :], m, words)[:3], tuple(words))
    found = Detections(None, xyxy, score, class_id, tuple(prompts), competing_score, context)
    return DetectorReply(found, decode_health(header), invalid)


def _check_words(what: str, words: Any) -> None:
    """Raise ValueError unless a field of a header is a list of words."""
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise ValueError(f"{what}: expected a list of words, got {bounded_repr(words, 40)}")


def _unpack(
    block: bytes, n: int, words: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return boxes, scores, classes and competing scores of `n` boxes, each checked."""
    # The arrays follow each other as in `_pack`.
    reals = np.frombuffer(block, "<f4").astype(np.float32)
    xyxy, score, competing_score = (
        reals[: 4 * n].reshape(n, 4),
        reals[4 * n : 5 * n],
        reals[6 * n :],
    )
    class_id = np.frombuffer(block, "<i4")[5 * n : 6 * n].astype(np.int32)
    if fault := invalid_boxes_reason(xyxy, score, competing_score):
        raise ValueError(fault)
    if not ((class_id >= 0) & (class_id < len(words))).all():
        raise ValueError(f"a class_id is not from 0 to {len(words) - 1}")
    return xyxy, score, class_id, competing_score


def decode_health(header: dict[str, Any]) -> ModelHealth:
    """Decode the health in a header.

    Raises:
        ValueError: there is none, or it is invalid.
    """
    health = header.get("health")
    if (
        not isinstance(health, list)
        or len(health) != 2
        or not all(isinstance(t, str) for t in health)
    ):
        raise ValueError(f"health: expected [state, detail], got {bounded_repr(health, 40)}")
    if health[0] not in _STATES:
        raise ValueError(
            f"health: unknown state {bounded_repr(health[0], 40)} (choices: {', '.join(_STATES)})"
        )
    return ModelHealth(*health)


def raise_error(header: dict[str, Any], name: str) -> None:
    """Raise the error of the process of model `name`, if the header holds one.

    Errors that a user can cause keep their type and text; any other becomes a ModelProcessError.
    """
    if "error" not in header:
        return
    kind, text = str(header["error"]), str(header.get("text"))
    if kind == "ModelError":
        raise ModelError(text)
    if kind == "PromptError":
        raise PromptError(text)
    raise ModelProcessError(f"model {name}, in its process: {kind}: {one_line(text, 300)}")


def shared_dir() -> str:
    """Return the folder for files shared by two processes; in memory if possible."""
    usable = SHARED_MEMORY.is_dir() and os.access(SHARED_MEMORY, os.W_OK)
    return str(SHARED_MEMORY) if usable else tempfile.gettempdir()


class FrameFile:
    """The writer's end of the frame file: two sequence numbers, then the pixels of one image.

    The file has no name, so nothing is left of it however the writer ends.

    Attributes:
        fd: descriptor for the reader to inherit.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(dir=shared_dir())  # noqa: SIM115
        self.fd = self._file.fileno()
        self._bytes = np.empty(0, np.uint8)
        self._seq = np.empty(0, np.int64)

    def write(self, seq: int, rgb: np.ndarray) -> None:
        """Write an image over the one before.

        Args:
            seq: positive, different for every image.
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
        """Make the file large enough, and map it again."""
        # Reserve now: writing to a full /dev/shm later would end this process with SIGBUS.
        os.posix_fallocate(self.fd, 0, size)
        self._bytes, self._seq = _map(self.fd, size)

    def close(self) -> None:
        self._bytes, self._seq = np.empty(0, np.uint8), np.empty(0, np.int64)
        self._file.close()


class FrameView:
    """The reader's end of the frame file, on the descriptor of a `FrameFile`."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._bytes = np.empty(0, np.uint8)
        self._seq = np.empty(0, np.int64)

    def read(self, seq: int, image_hw: tuple[int, int]) -> np.ndarray:
        """Return the image with this number as a view of the shared memory, (h, w, 3) uint8.

        After use, the caller checks with `is_intact` that the image was not overwritten.

        Raises:
            ValueError: another image, or part of one, is there.
        """
        end = PIXELS_AT + image_hw[0] * image_hw[1] * 3
        if end > len(self._bytes):
            self._bytes, self._seq = _map(self._fd, end)
        if self._seq[_AFTER] != seq or not self.is_intact(seq):
            raise ValueError(f"frame {seq}: overwritten by frame {self._seq[_BEFORE]}")
        return self._bytes[PIXELS_AT:end].reshape(*image_hw, 3)

    def is_intact(self, seq: int) -> bool:
        """Return True if no newer image has been begun."""
        return bool(self._seq[_BEFORE] == seq)


def _map(fd: int, needed: int) -> tuple[np.ndarray, np.ndarray]:
    """Map the file: its bytes, and the two sequence numbers at its beginning."""
    size = os.fstat(fd).st_size
    if size < needed:
        raise ValueError(f"frame file: {size} bytes, {needed} are needed")
    content = np.frombuffer(mmap.mmap(fd, size), np.uint8)
    return content, content[:16].view(np.int64)

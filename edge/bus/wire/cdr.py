"""Reader, with bounds checks, and writer of CDR, the binary format of ROS 2 messages.

Only little-endian CDR (header `00 01 00 00`).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

HEADER = b"\x00\x01\x00\x00"
"""First bytes of each payload; the alignment of fields counts from their end."""

# Layouts without padding: numbers, and a time in seconds and nanoseconds.
U8 = struct.Struct("<B")
U32 = struct.Struct("<I")
STAMP = struct.Struct("<iI")


class DecodeError(ValueError):
    """A payload does not match its topic's type; the message is one line."""


class CdrReader:
    """Reads one payload field by field; a read outside the payload raises DecodeError.

    Attributes:
        payload: the message with its header.
        at: offset of the next unread byte.

    >>> CdrReader(HEADER + U32.pack(7)).read(U32, 4)
    (7,)
    """

    __slots__ = ("_size", "at", "payload")

    def __init__(self, payload: bytes | bytearray | memoryview) -> None:
        if bytes(payload[:2]) != HEADER[:2] or len(payload) < len(HEADER):
            raise DecodeError(
                "not little-endian CDR: the message begins with "
                f"{bytes(payload[:4]).hex() or 'nothing'}, expected {HEADER.hex()}"
            )
        self.payload = payload
        self.at = len(HEADER)
        self._size = len(payload)

    def _advance(self, size: int, align: int) -> int:
        """Return the offset of the next `size` bytes and skip them.

        The alignment counts from the end of the header.
        """
        begin = self.at + (-(self.at - len(HEADER))) % align  # (-n) % align: padding after n bytes
        if size > self._size - begin:
            raise DecodeError(
                f"truncated: {size} bytes expected from byte {begin}, the message has {self._size}"
            )
        self.at = begin + size
        return begin

    def read(self, layout: struct.Struct, align: int) -> tuple:
        """Return the fields of `layout`, which has no padding and is aligned to `align`."""
        return layout.unpack_from(self.payload, self._advance(layout.size, align))

    @property
    def left(self) -> int:
        """Number of unread bytes."""
        return self._size - self.at

    def skip(self, size: int, align: int) -> None:
        """Skip a field."""
        self._advance(size, align)

    def string(self) -> str:
        """Read a string, without its final zero byte."""
        (length,) = self.read(U32, 4)
        begin = self._advance(length, 1)
        try:
            return bytes(self.payload[begin : begin + length]).rstrip(b"\0").decode()
        except UnicodeDecodeError:
            raise DecodeError(f"the string at byte {begin} is not UTF-8") from None

    def sequence(self, item_size: int) -> tuple[int, int]:
        """Return (count, offset of the first item) of a sequence of numbers, and skip it."""
        (count,) = self.read(U32, 4)
        # There is no padding before the items of an empty sequence.
        return count, self._advance(count * item_size, item_size if count else 1)

    def stamp_ns(self) -> int:
        """Read builtin_interfaces/Time in nanoseconds."""
        seconds, nanoseconds = self.read(STAMP, 4)
        if nanoseconds >= 1_000_000_000:
            raise DecodeError(f"the stamp has nanosec {nanoseconds}, expected less than 1000000000")
        return seconds * 1_000_000_000 + nanoseconds

    def header(self) -> tuple[int, str]:
        """Read std_msgs/Header as (stamp_ns, frame_id)."""
        return self.stamp_ns(), self.string()


class CdrWriter:
    """Builds one payload.

    >>> CdrWriter().write(U32, 4, 7).bytes() == HEADER + U32.pack(7)
    True
    """

    __slots__ = ("_buffer",)

    def __init__(self) -> None:
        self._buffer = bytearray(HEADER)

    def write(self, layout: struct.Struct, align: int, *values: float) -> CdrWriter:
        """Append the fields of `layout`, aligned to `align`; return this writer."""
        self._buffer += bytes(-(len(self._buffer) - len(HEADER)) % align)
        self._buffer += layout.pack(*values)
        return self

    def string(self, text: str) -> CdrWriter:
        data = text.encode() + b"\0"
        self.write(U32, 4, len(data))
        self._buffer += data
        return self

    def stamp_ns(self, stamp_ns: int) -> CdrWriter:
        return self.write(STAMP, 4, *divmod(int(stamp_ns), 1_000_000_000))

    def header(self, stamp_ns: int, frame_id: str) -> CdrWriter:
        return self.stamp_ns(stamp_ns).string(frame_id)

    def block(self, align: int, data: memoryview) -> CdrWriter:
        """Append items that are already in wire format."""
        self._buffer += bytes(-(len(self._buffer) - len(HEADER)) % align)
        self._buffer += data
        return self

    def floats(self, values: Sequence[float], code: str) -> CdrWriter:
        """Append a fixed array of `f` (float32) or `d` (float64)."""
        layout = struct.Struct(f"<{len(values)}{code}")
        return self.write(layout, 4 if code == "f" else 8, *values)

    def bytes(self, tail: bytes | memoryview = b"") -> bytes:
        """Return the payload with `tail`, such as image pixels, at its end; makes one copy."""
        return b"".join((self._buffer, tail))

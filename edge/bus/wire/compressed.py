"""Codec of sensor_msgs/CompressedImage: JPEG and PNG images, and depth as PNG.

The image size is read from the first bytes of the JPEG or PNG and compared with the expected size
before a decoder allocates memory.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from edge.bus.wire.cdr import U32, CdrReader, CdrWriter, DecodeError
from edge.bus.wire.images import ImageHeader, integers_into
from edge.host.c_stderr import silence_c_stderr

_PNG = b"\x89PNG\r\n\x1a\n"
_IHDR = struct.Struct(">4sIIB")  # name of the first chunk, width, height, bits
# A PNG is a signature and chunks: length, name, data, checksum. A lower-case name marks a chunk
# that a decoder may skip; the others are critical.
_CHUNK, _CHECKSUM = struct.Struct(">I4s"), 4  # length, name; bytes of the checksum
_CRITICAL, _ANIMATED = (b"IHDR", b"PLTE", b"IDAT"), (b"acTL", b"fcTL", b"fdAT")
_JPEG, _JPEG_SCAN, _JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
# A JPEG is a list of segments, then scans with the pixels. One segment, the frame, has the size.
_SEGMENT = struct.Struct(">BBH")  # marker, kind, length without the first two
_FRAME = struct.Struct(">BHH")  # bits, height, width
_NOT_FRAME_KINDS = (0xC4, 0xC8, 0xCC)  # kinds from 0xC0 to 0xCF that have no image size
_SCAN_KIND = 0xDA  # the pixels follow
_MAX_SEGMENTS = 64  # of a JPEG before its pixels
_MAX_SCANS = 100  # of a JPEG
# compressed_depth_image_transport puts this before the PNG: how depth was quantized to 16 bits.
_DEPTH_HEADER = struct.Struct("<iff")
_COLOUR_UNROTATED = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION

# See `CompressedHeader.content`.
Content = Literal["colour", "16UC1", "inverse"]


@dataclass(frozen=True, slots=True)
class CompressedHeader:
    """The header of a compressed image.

    Attributes:
        height: height of the image in pixels.
        width: width of the image in pixels.
        content: `colour`; `16UC1`: plain depth; `inverse`: quantized 32FC1 depth: a value v > 0
            stands for `a / (v - b)` metres (compressed_depth_image_transport).
        begin: offset of the first byte of the JPEG or PNG in the payload.
        end: offset after its last byte.
        a: see `content`.
        b: see `content`.
        is_rgb: True if the encoder got RGB in place of BGR (`…; jpeg compressed rgb8`).
    """

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    content: Content
    begin: int
    end: int
    a: float = 0.0
    b: float = 0.0
    is_rgb: bool = False


def decode_compressed_header(payload: bytes) -> CompressedHeader:
    """Decode the header of a sensor_msgs/CompressedImage.

    `format` is as image_transport writes it: `jpeg`, `png`, `rgb8; jpeg compressed bgr8`,
    `16UC1; png compressed`, `16UC1; compressedDepth png`, `32FC1; compressedDepth png`.

    Raises:
        DecodeError: the message is malformed, the image is neither JPEG nor PNG (such as RVL), or
            depth is not a PNG of 16 bits.
    """
    reader = CdrReader(payload)
    stamp_ns, frame_id = reader.header()
    format_text = reader.string()
    size, begin = reader.sequence(1)
    end, a, b = begin + size, 0.0, 0.0
    encoding = format_text.partition(";")[0].strip()
    content: Content = "16UC1" if encoding in ("16UC1", "mono16") else "colour"
    if "compressedDepth" in format_text:
        if size < _DEPTH_HEADER.size:
            raise DecodeError(
                f"compressed depth image of {size} bytes: too short, its header alone has "
                f"{_DEPTH_HEADER.size}"
            )
        _, a, b = _DEPTH_HEADER.unpack_from(payload, begin)
        begin += _DEPTH_HEADER.size
        content = "inverse" if encoding == "32FC1" else "16UC1"
        if not (np.isfinite(a) and np.isfinite(b)):
            raise DecodeError("compressed depth image: its quantization parameters are NaN or inf")
    height, width, bits = _read_size(payload, begin, end, format_text)
    if bits != (expected := 8 if content == "colour" else 16):
        raise DecodeError(
            f"compressed image {format_text[:40]!r}: {bits} bits per channel, expected {expected}"
        )
    is_rgb = "compressed rgb" in format_text
    return CompressedHeader(stamp_ns, frame_id, height, width, content, begin, end, a, b, is_rgb)


def encode_jpeg(stamp_ns: int, frame_id: str, rgb: np.ndarray, quality: int) -> bytes:
    """Encode (h, w, 3) uint8 RGB as a JPEG in a sensor_msgs/CompressedImage."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    _, jpeg = cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, quality))
    writer = CdrWriter().header(stamp_ns, frame_id).string("jpeg").write(U32, 4, len(jpeg))
    return writer.bytes(memoryview(jpeg.reshape(-1)))


def _read_size(payload: bytes, begin: int, end: int, format_text: str) -> tuple[int, int, int]:
    """Return (height, width, bits per channel) of a JPEG or PNG from its first bytes."""
    if payload[begin : begin + 8] == _PNG and end - begin >= 8 + 4 + _IHDR.size:
        # Behind the signature (8 bytes) and the first chunk's length (4).
        name, width, height, bits = _IHDR.unpack_from(payload, begin + 12)
        if name == b"IHDR":
            _check_chunks(payload, begin + 8, end)
            return height, width, bits
    elif payload[begin : begin + 2] == _JPEG:
        return _jpeg_size(payload, begin + 2, end)
    raise DecodeError(f"compressed image {format_text[:40]!r}: neither JPEG nor PNG")


def _check_chunks(payload: bytes, at: int, end: int) -> None:
    """Raise DecodeError for a PNG with chunks that exceed the payload, or an animation.

    OpenCV allocates the length a chunk declares, up to 4 GB, before it reads the chunk. The frames
    of an animation have their own sizes.
    """
    while at + _CHUNK.size + _CHECKSUM <= end:
        length, name = _CHUNK.unpack_from(payload, at)
        if name == b"IEND":
            return
        if name in _ANIMATED:
            raise DecodeError("compressed image: an animated PNG cannot be read")
        if not (name.isalpha() and (name[:1].islower() or name in _CRITICAL)):
            raise DecodeError(f"compressed image: PNG with an unknown chunk {name!r}")
        at += _CHUNK.size + length + _CHECKSUM
    raise DecodeError("compressed image: PNG is cut off")


def _jpeg_size(payload: bytes, at: int, end: int) -> tuple[int, int, int]:
    """Return `_read_size` for a JPEG: walk over the segments before the pixels, to their end."""
    size = None
    for _ in range(_MAX_SEGMENTS):
        if at + _SEGMENT.size + _FRAME.size > end:
            break
        marker, kind, length = _SEGMENT.unpack_from(payload, at)
        if marker != 0xFF:
            break
        if 0xC0 <= kind <= 0xCF and kind not in _NOT_FRAME_KINDS:
            bits, height, width = _FRAME.unpack_from(payload, at + _SEGMENT.size)
            size = height, width, bits
        if kind == _SCAN_KIND:
            if size is None or payload.rfind(_JPEG_END, at, end) < 0:
                break
            # A scan costs as much as an entire image; a small file can hold minutes of them.
            if payload.count(_JPEG_SCAN, at, end) > _MAX_SCANS:
                raise DecodeError(
                    f"compressed image: JPEG has more than {_MAX_SCANS} scans: send baseline JPEG"
                )
            return size
        at += 2 + length
    raise DecodeError("compressed image: JPEG is cut off, or has no size")


def decode_compressed_into(
    payload: bytes, header: CompressedHeader, out: np.ndarray, unit_m: float | None = None
) -> None:
    """Decode an image into `out`: (h, w, 3) uint8 RGB, or (h, w) float32 metres.

    Depth is 0 or NaN if there was no return. The decoder allocates one image of the size of `out`,
    because OpenCV cannot decode in place.

    Raises:
        DecodeError: the image is corrupt, or does not match `out`.
    """
    if out.shape[:2] != (header.height, header.width):
        height, width = out.shape[:2]
        raise DecodeError(f"image is {header.width}x{header.height}, expected {width}x{height}")
    colour = header.content == "colour"
    if out.dtype != (np.uint8 if colour else np.float32):
        raise DecodeError(
            f"compressed image is {header.content}, but {out.dtype} pixels are expected"
        )
    data = np.frombuffer(payload, np.uint8, header.end - header.begin, header.begin)
    try:
        with silence_c_stderr():
            picture = cv2.imdecode(data, _COLOUR_UNROTATED if colour else cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None or picture.shape != out.shape:
        raise DecodeError(f"compressed image of {len(data)} bytes is corrupt")
    if colour:
        if header.is_rgb:
            np.copyto(out, picture)
        else:
            cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=out)
    elif header.content == "16UC1":
        integers_into(picture, _pixels_of(header), out, unit_m)
    else:
        np.subtract(picture, np.float32(header.b), out=out, dtype=np.float32)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            np.divide(np.float32(header.a * (unit_m or 1.0)), out, out=out)
        out[picture == 0] = 0.0


def _pixels_of(header: CompressedHeader) -> ImageHeader:
    """Return an `ImageHeader` of the decoded image in memory."""
    h, w = header.height, header.width
    return ImageHeader(
        header.stamp_ns, header.frame_id, h, w, "16UC1", 2 * w, 0, sys.byteorder == "big"
    )

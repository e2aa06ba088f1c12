"""Codec of sensor_msgs/Image, decoded directly into preallocated arrays."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import cv2
import numpy as np

from edge.bus.wire import kernels
from edge.bus.wire.cdr import U8, U32, CdrReader, CdrWriter, DecodeError

_HEIGHT_WIDTH = struct.Struct("<II")

# Encoding: (bytes per pixel, channels).
_LAYOUTS = {
    "rgb8": (3, 3), "bgr8": (3, 3), "rgba8": (4, 4), "bgra8": (4, 4), "mono8": (1, 1),
    "16UC1": (2, 1), "mono16": (2, 1), "32FC1": (4, 1), "8UC3": (3, 3), "8UC1": (1, 1),
    "bayer_rggb8": (1, 1), "bayer_bggr8": (1, 1), "bayer_gbrg8": (1, 1), "bayer_grbg8": (1, 1),
    "yuv422": (2, 2), "uyvy": (2, 2), "yuv422_yuy2": (2, 2), "yuyv": (2, 2),
}  # fmt: skip
_TO_RGB = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "mono8": cv2.COLOR_GRAY2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,  # OpenCV's own order
    "8UC1": cv2.COLOR_GRAY2RGB,
    # OpenCV names a pattern by the second row, from the second column on.
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "yuyv": cv2.COLOR_YUV2RGB_YUY2,
}
_ENCODING_OF = {("uint8", 3): "rgb8", ("uint16", 2): "16UC1", ("float32", 2): "32FC1"}
M_PER_MM = 0.001
"""Metres in a millimetre."""
_NO_DEPTH = np.uint16(64_000)
"""16-bit depth from this value on is invalid, in any unit.

Many drivers send 65535 for no return; time-of-flight sensors use 64001 and more for errors.
"""


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """The header of an image message, checked against the payload's size.

    Attributes:
        encoding: such as `rgb8`.
        step: bytes from row to row.
        data_offset: offset of the first pixel in the payload.
        big_endian: True if the most significant byte of a number comes first.
    """

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    encoding: str
    step: int
    data_offset: int
    big_endian: bool


def encode_image(stamp_ns: int, frame_id: str, array: np.ndarray) -> bytes:
    """Encode (h, w, 3) uint8 (rgb8), (h, w) uint16 (16UC1) or float32 (32FC1) as sensor_msgs/Image.

    Raises:
        ValueError: the array has another type or shape.

    Example:
        >>> payload = encode_image(0, "camera", np.zeros((2, 3), np.uint16))
        >>> header = decode_image_header(payload)
        >>> header.encoding, header.height, header.width
        ('16UC1', 2, 3)
    """
    return b"".join(image_parts(stamp_ns, frame_id, array))


def image_parts(stamp_ns: int, frame_id: str, array: np.ndarray) -> tuple[bytes, memoryview]:
    """Return the parts of `encode_image`. The second is a view of the array if possible."""
    encoding = _ENCODING_OF.get((array.dtype.name, array.ndim))
    if encoding is None or (array.ndim == 3 and array.shape[2] != 3):
        raise ValueError(
            f"no image encoding for an array of {array.dtype} {array.shape} "
            f"(encodings: {', '.join(_ENCODING_OF.values())})"
        )
    height, width = array.shape[:2]
    step = width * _LAYOUTS[encoding][0]
    writer = CdrWriter().header(stamp_ns, frame_id)
    writer.write(_HEIGHT_WIDTH, 4, height, width).string(encoding)
    # is_bigendian, step, size of data
    writer.write(U8, 1, 0).write(U32, 4, step).write(U32, 4, height * step)
    pixels = np.ascontiguousarray(array).reshape(-1)
    return writer.bytes(), memoryview(pixels.view(np.uint8))


def decode_image_header(payload: bytes) -> ImageHeader:
    """Decode the header of a sensor_msgs/Image and check that the pixels are in the payload."""
    reader = CdrReader(payload)
    stamp_ns, frame_id = reader.header()
    height, width = reader.read(_HEIGHT_WIDTH, 4)
    encoding = reader.string()
    (big_endian,) = reader.read(U8, 1)
    (step,) = reader.read(U32, 4)
    size, offset = reader.sequence(1)
    layout = _LAYOUTS.get(encoding)
    if layout is None:
        raise DecodeError(
            f"image encoding {encoding[:20]!r} is unknown (known: {', '.join(_LAYOUTS)})"
        )
    row = width * layout[0]
    if height * row == size:  # no padding: the step is redundant, ignore a wrong one
        step = row
    if layout == (2, 2) and width % 2:
        raise DecodeError(f"image {width}x{height} {encoding}: the width must be even")
    if step < row or height * step > size:
        raise DecodeError(
            f"image {width}x{height} {encoding}: step {step} does not fit {size} bytes of data: "
            f"step must be {row} or more"
        )
    return ImageHeader(stamp_ns, frame_id, height, width, encoding, step, offset, bool(big_endian))


def decode_image_into(
    payload: bytes, header: ImageHeader, out: np.ndarray, unit_m: float | None = None
) -> None:
    """Write the pixels into `out`, converted; allocates no array of the image's size.

    Args:
        payload: the message.
        header: from `decode_image_header`.
        out: (h, w, 3) uint8 for rgb8 and the encodings of `_TO_RGB`, as RGB; (h, w) float32 for
            16UC1 and 32FC1 in metres, 0 = no return; (h, w) uint16 for raw 16UC1.
        unit_m: metres per unit of depth; None: 0.001 for integers, 1 for floats (REP 118).

    Raises:
        DecodeError: the encoding or the size does not match `out`.
    """
    encoding = header.encoding
    if out.shape[:2] != (header.height, header.width):
        height, width = out.shape[:2]
        raise DecodeError(f"image is {header.width}x{header.height}, expected {width}x{height}")
    if out.dtype == np.uint8 and encoding in ("rgb8", *_TO_RGB):
        pixels = _pixels(payload, header, "u1")
        if encoding == "rgb8":
            np.copyto(out, pixels)
        elif out.size:
            cv2.cvtColor(pixels, _TO_RGB[encoding], dst=out)
    elif out.dtype == np.float32 and encoding == "32FC1":
        pixels = _pixels(payload, header, "f4")
        if unit_m is None:
            np.copyto(out, pixels)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                np.multiply(pixels, np.float32(unit_m), out=out)
    elif out.dtype == np.float32 and encoding in ("16UC1", "mono16"):
        integers_into(payload, header, out, unit_m)
    elif out.dtype == np.uint16 and encoding in ("16UC1", "mono16"):
        np.copyto(out, _pixels(payload, header, "u2"))
    else:
        raise DecodeError(f"image encoding is {encoding}, but {out.dtype} pixels are expected")


def integers_into(
    data: bytes | np.ndarray, header: ImageHeader, out: np.ndarray, unit_m: float | None
) -> None:
    """Write 16-bit depth into `out`, (h, w) float32 metres; `_NO_DEPTH` and above become 0.

    Args:
        data: the bytes that the header describes.
        header: header of the image; `data_offset` counts in `data`.
        out: array to write.
        unit_m: metres per unit; None: 0.001.
    """
    pixels = np.frombuffer(data, np.uint8)
    pixels.flags.writeable = False  # the kernel is compiled for read-only bytes
    kernels.depth_of_integers(
        pixels, header.data_offset, header.step, header.big_endian,
        np.float32(unit_m or M_PER_MM), _NO_DEPTH, out,
    )  # fmt: skip


def drop_beyond(depth_m: np.ndarray, farthest_m: float) -> None:
    """Set depth beyond `farthest_m` to 0 (no return) in place; NaN stays."""
    if depth_m.size:
        cv2.threshold(depth_m, farthest_m, 0.0, cv2.THRESH_TOZERO_INV, dst=depth_m)


def _pixels(payload: bytes, header: ImageHeader, code: str) -> np.ndarray:
    """Return the pixels as a view of the payload, without row padding."""
    bytes_px, channels = _LAYOUTS[header.encoding]
    dtype = np.dtype((">" if header.big_endian else "<") + code)
    shape = (header.height, header.width)
    strides = (header.step, bytes_px)
    if channels > 1:
        shape, strides = (*shape, channels), (*strides, 1)
    return np.ndarray(shape, dtype, payload, header.data_offset, strides)

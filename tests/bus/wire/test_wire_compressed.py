"""Compressed pictures as `rosbags` writes them and OpenCV compresses them, and false ones."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from edge.bus.wire import DecodeError
from edge.bus.wire.compressed import decode_compressed_header, decode_compressed_into

STORE = get_typestore(Stores.ROS2_HUMBLE)
NAME = "sensor_msgs/msg/CompressedImage"
GRADIENT = np.dstack(np.meshgrid(np.arange(0, 240, 8), np.arange(0, 160, 8), indexing="ij"))
BGR = np.concatenate([GRADIENT, 255 - GRADIENT[..., :1]], axis=2).astype(np.uint8)
DEPTH_MM = (100 + 7 * np.arange(30 * 20, dtype=np.uint16)).reshape(30, 20)
DEPTH_MM[3, 4] = 0


def ros(words: str, data: bytes) -> bytes:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 6), "camera")
    message = types[NAME](header, words, np.frombuffer(data, np.uint8))
    return bytes(STORE.serialize_cdr(message, NAME))


def picture(kind: str, array: np.ndarray) -> bytes:
    return cv2.imencode(kind, array)[1].tobytes()


def inverse(depth_m: np.ndarray, a: float, b: float) -> bytes:
    """32FC1 as compressed_depth_image_transport quantizes it."""
    values = np.zeros(depth_m.shape, np.uint16)
    there = np.isfinite(depth_m)
    values[there] = np.round(a / depth_m[there] + b)
    return struct.pack("<iff", 1, a, b) + picture(".png", values)


def decoded(payload: bytes, out: np.ndarray, unit_m: float | None = None) -> np.ndarray:
    header = decode_compressed_header(payload)
    assert (header.stamp_ns, header.frame_id) == (5_000_000_006, "camera")
    assert (header.height, header.width) == out.shape[:2]
    decode_compressed_into(payload, header, out, unit_m)
    return out


@pytest.mark.parametrize(
    ("words", "kind", "tolerance"),
    [
        ("png", ".png", 0),
        ("bgr8; png compressed bgr8", ".png", 0),
        ("jpeg", ".jpg", 8),
        ("rgb8; jpeg compressed bgr8", ".jpg", 8),
    ],
)
def test_a_colour_picture_becomes_rgb(words, kind, tolerance):
    out = decoded(ros(words, picture(kind, BGR)), np.zeros((30, 20, 3), np.uint8))
    np.testing.assert_allclose(out.astype(int), BGR[..., ::-1].astype(int), atol=tolerance)


def test_a_picture_compressed_as_rgb_is_not_swapped():
    payload = ros("rgb8; png compressed rgb8", picture(".png", BGR))
    np.testing.assert_array_equal(decoded(payload, np.zeros((30, 20, 3), np.uint8)), BGR)


def test_a_turned_camera_turns_no_picture():
    """EXIF's orientation is for people; the camera's intrinsics are those of the pixels."""
    jpeg = picture(".jpg", BGR)
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    turned = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(exif)) + exif + jpeg[2:]
    out = decoded(ros("jpeg", turned), np.zeros((30, 20, 3), np.uint8))
    np.testing.assert_allclose(out.astype(int), BGR[..., ::-1].astype(int), atol=8)


@pytest.mark.parametrize(
    ("words", "before"),
    [
        ("16UC1; png compressed ", b""),
        ("16UC1; compressedDepth png", struct.pack("<iff", 0, 0.0, 0.0)),
        ("16UC1; compressedDepth", struct.pack("<iff", 0, 0.0, 0.0)),
    ],
)
def test_depth_in_millimetres_becomes_metres(words, before):
    out = decoded(ros(words, before + picture(".png", DEPTH_MM)), np.zeros((30, 20), np.float32))
    np.testing.assert_allclose(out, 0.001 * DEPTH_MM, rtol=1e-6)


def test_the_unit_holds_for_quantized_depth():
    depth_mm = np.linspace(500.0, 8000.0, 600, dtype=np.float32).reshape(30, 20)
    payload = ros("32FC1; compressedDepth png", inverse(depth_mm, 10001.0 * 1000, -1000.0))
    out = decoded(payload, np.zeros((30, 20), np.float32), unit_m=0.001)
    np.testing.assert_allclose(out, 0.001 * depth_mm, rtol=1e-3)


def test_quantized_depth_in_metres_is_decoded():
    depth_m = np.linspace(0.5, 8.0, 600, dtype=np.float32).reshape(30, 20)
    depth_m[0, :3] = np.nan
    payload = ros("32FC1; compressedDepth png", inverse(depth_m, 10001.0, -1000.0))
    out = decoded(payload, np.full((30, 20), 9.0, np.float32))
    assert (out[0, :3] == 0.0).all()
    np.testing.assert_allclose(out.ravel()[3:], depth_m.ravel()[3:], rtol=1e-3)


HUGE_PNG = picture(".png", BGR)
HUGE_PNG = HUGE_PNG[:16] + struct.pack(">II", 2**31 - 1, 2**31 - 1) + HUGE_PNG[24:]
PNG, JPEG = picture(".png", BGR), picture(".jpg", BGR)


@pytest.mark.parametrize(
    ("words", "data", "said"),
    [
        ("jpeg", b"", "neither"),
        ("16UC1; compressedDepth rvl", struct.pack("<iff", 0, 0, 0) + bytes(20), "neither"),
        ("16UC1; compressedDepth png", b"abc", "3 bytes"),
        ("32FC1; compressedDepth png", struct.pack("<iff", 0, np.inf, 0), "NaN or inf"),
        ("png", HUGE_PNG, "expected 20x30"),
        ("png", picture(".png", DEPTH_MM), "16 bits"),
        ("16UC1; png", picture(".png", BGR), "8 bits"),
        ("png", picture(".png", BGR)[:200], "cut off"),
        ("png", PNG[:33] + b"\x7f\xff\xff\xffIDAT" + PNG[41:], "cut off"),
        ("png", PNG[:33] + bytes(4) + b"acTL" + bytes(4) + PNG[33:], "animated"),
        ("png", PNG[:37] + b"IAT8" + PNG[41:], "an unknown chunk b'IAT8'"),
        ("png", PNG[:60] + bytes(20) + PNG[80:], "corrupt"),
        ("jpeg", JPEG[: len(JPEG) // 2], "cut off"),
        ("jpeg", JPEG[:-2] + (b"\xff\xda" + bytes(10)) * 100 + JPEG[-2:], "100 scans"),
    ],
)
def test_an_invalid_picture_is_refused_in_one_line(words, data, said):
    payload = ros(words, data)
    with pytest.raises(DecodeError, match=said) as caught:
        decode_compressed_into(
            payload, decode_compressed_header(payload), np.zeros((30, 20, 3), np.uint8)
        )
    assert "\n" not in str(caught.value)


def test_depth_cannot_be_decoded_as_a_colour_picture():
    payload = ros("png", picture(".png", BGR))
    with pytest.raises(DecodeError, match="float32"):
        decode_compressed_into(
            payload, decode_compressed_header(payload), np.zeros((30, 20), np.float32)
        )
